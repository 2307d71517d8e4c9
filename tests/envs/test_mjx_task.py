"""What every task keeps to: brax's interface, its docstring's tables, and the little state that it carries."""

import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import Env
from eairl_jax.envs.swimmer import Swimmer


@pytest.fixture(params=envs.TASKS)
def env(request):
    return envs.make(request.param)


def test_the_docstrings_tables_are_the_sizes_and_the_limits(env):
    text = type(env).__doc__
    assert int(re.search(r"Observation \((\d+)\)", text)[1]) == env.observation_size
    rows = re.findall(r"^ *\| (\d+) +\|(.*)\|$", text, re.MULTILINE)
    tables = [int(index) for index, _ in rows]
    observation, action = list(range(env.observation_size)), list(range(env.action_size))
    assert tables in (observation, observation + action)  # a single motor needs no table
    assert all(len(row.split("|")) == 3 for _, row in rows)
    size, limit = re.search(r"Action \((\d+)\).*clipped to \[-(\d+), \2\]", text).groups()
    assert (int(size), float(limit)) == (env.action_size, env.action_limit)
    np.testing.assert_array_equal(env.model.actuator_ctrlrange, [[-env.action_limit, env.action_limit]] * int(size))
    assert len(env.obs_std) == env.observation_size


def test_only_positions_speeds_and_the_warm_start_are_carried(env):
    state = env.reset(jax.random.PRNGKey(0))
    after = jax.eval_shape(env.step, state, jnp.zeros(env.action_size))
    assert jax.tree.structure(after) == jax.tree.structure(state)
    carried = {jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(after)}
    physics = {".pipeline_state.qpos", ".pipeline_state.qvel", ".pipeline_state.qacc_warmstart"}
    assert carried == physics | {".obs", ".reward", ".done"}
    assert [x.shape for x in jax.tree.leaves(after)] == [x.shape for x in jax.tree.leaves(state)]


def test_a_task_is_a_brax_environment_that_never_ends(env):
    assert isinstance(env, Env)
    state = env.reset(jax.random.PRNGKey(0))
    after = jax.eval_shape(env.step, state, jnp.zeros(env.action_size))
    assert state.obs.shape == after.obs.shape == (env.observation_size,)
    assert (state.reward, state.done) == (0.0, 0.0)
    stepped = jax.make_jaxpr(lambda s, a: env.step(s, a).done)(state, jnp.zeros(env.action_size))
    # What comes out as `done` is what went in: no equation touches it.
    assert stepped.jaxpr.outvars[0] in stepped.jaxpr.invars
    np.testing.assert_allclose(env.dt, 0.04 if isinstance(env, Swimmer) else 0.05)


def test_importing_the_tasks_prints_nothing():
    command = [sys.executable, "-c", "import envs"]
    assert subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout == ""
