"""Episodes of trained policies with the positions of their bodies, to be drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from eairl_jax import InputError
from eairl_jax.envs.mjx_task import Task
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.train import EVALUATE, lane_keys, take_lanes


class Episodes(NamedTuple):
    """One episode of each policy.

    Attributes:
      qpos: `[lanes, T + 1, nq]` positions, the start included. After the end of an episode they stay as they are.
      returns: `[lanes]` true returns.
      lengths: `[lanes]` steps of the episodes, at most T.
    """

    qpos: np.ndarray
    returns: np.ndarray
    lengths: np.ndarray


def check_drawable(task: str, env: Task) -> None:
    """Refuses a task whose episodes cannot be drawn.

    Raises:
      InputError: if the task has no MuJoCo model, or its states do not hold the positions of the model.
    """
    if env.model is None:
        raise InputError(
            f"{task} has no MuJoCo model to draw: give the environment an attribute `model` (a mujoco.MjModel) and a "
            "function `qpos(state)` that returns the positions of the model"
        )
    positions = jax.eval_shape(lambda key: env.qpos(env.reset(key)), jax.random.PRNGKey(0))
    if getattr(positions, "shape", None) != (env.model.nq,):
        raise InputError(
            f"the states of {task} do not hold the {env.model.nq} positions of its model: give the environment a "
            "function `qpos(state)` that returns them"
        )


def play(policies: Policies, lanes: Sequence[int] | None = None) -> Episodes:
    """An episode of each sampled policy, up to the time limit or to the end that the task makes.

    Args:
      lanes: which policies; all of them if None.

    Raises:
      InputError: if episodes of the task cannot be drawn.
    """
    check_drawable(policies.task, policies.env)
    env, algorithm = policies.env, policies.algorithm
    lanes = range(len(policies.seeds)) if lanes is None else lanes

    @jax.jit
    @jax.vmap
    def episode(policy, key):
        reset_key, key = jax.random.split(key)
        start = env.reset(reset_key)

        def step(carry, key):
            state, qpos, alive = carry
            action = algorithm.act(policy, state.obs[None], key)[0]
            after = env.step(state, jnp.clip(action, -env.action_limit, env.action_limit))
            qpos = jnp.where(alive > 0, env.qpos(after), qpos)
            return (after, qpos, alive * (1.0 - after.done)), (qpos, after.reward * alive, alive)

        first = env.qpos(start)
        _, (qpos, reward, alive) = jax.lax.scan(
            step, (start, first, jnp.ones(())), jax.random.split(key, env.episode_length)
        )
        return jnp.concatenate([jnp.asarray(first)[None], qpos]), jnp.where(alive > 0, reward, 0.0).sum(), alive.sum()

    states = jax.tree.map(jax.numpy.asarray, take_lanes(policies.state, np.array(lanes)))
    qpos, returns, lengths = episode(states, lane_keys(EVALUATE, [policies.seeds[lane] for lane in lanes]))
    return Episodes(np.asarray(qpos), np.asarray(returns), np.asarray(lengths).astype(int))
