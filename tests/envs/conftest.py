"""The compiled steps that the tests of several tasks share."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import MjxTask, Physics

BATCH = 50
OPTIMISED = {"xla_backend_optimization_level": 2, "xla_llvm_disable_expensive_passes": False}


class CompiledStep(NamedTuple):
    """A task and its compiled step of `BATCH` environments."""

    env: MjxTask
    program: jax.stages.Compiled

    def __call__(self, qpos, qvel, warmstart, action):
        """The states after one step from each of any number of states: `[n, nq]`, `[n, nv]`, `[n, nv]`, `[n, act]`."""
        columns, count = [np.asarray(x, np.float32) for x in (qpos, qvel, warmstart, action)], len(qpos)
        batches = []
        for first in range(0, count, BATCH):
            chosen = np.minimum(np.arange(first, first + BATCH), count - 1)  # the last batch is filled up
            *physics, actions = (jnp.asarray(x[chosen]) for x in columns)
            batches.append(self.program(Physics(*physics), actions))
        return jax.tree.map(lambda *x: np.concatenate(x)[:count], *batches)


@pytest.fixture(scope="session")
def compiled_step():
    """`(task, fidelity) -> CompiledStep`; each program is compiled once a session."""

    @functools.cache
    def compile_step(task, fidelity="fast"):
        env = envs.make(task, **({} if fidelity == "fast" else {"fidelity": fidelity}))
        start = env.reset(jax.random.PRNGKey(0))
        step = jax.jit(jax.vmap(lambda physics, action: env.step(start.replace(pipeline_state=physics), action)))
        one = (start.pipeline_state, jnp.zeros(env.action_size))
        batch = jax.tree.map(lambda x: jax.ShapeDtypeStruct((BATCH, *x.shape), jnp.float32), one)
        # Without optimisations MJX's own solver has a NaN in 3 of 400 steps of the ant on some CPUs, with them in none.
        options = {} if fidelity == "fast" else OPTIMISED
        return CompiledStep(env, step.lower(*batch).compile(compiler_options=options))

    return compile_step
