"""Episodes of trained policies with the positions of their bodies, to be drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import jax
import numpy as np

from eairl_jax.envs.mjx_task import Physics, State
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.train import EVALUATE, lane_keys, take_lanes


class Episodes(NamedTuple):
    """One episode of each policy.

    Attributes:
      qpos: `[lanes, T + 1, nq]` positions, the start included.
      returns: `[lanes]` true returns.
    """

    qpos: np.ndarray
    returns: np.ndarray


def positions(state: State) -> jax.Array:
    """`[nq]` positions of the bodies."""
    return cast(Physics, state.pipeline_state).qpos


def play(policies: Policies, lanes: Sequence[int] | None = None) -> Episodes:
    """An episode of each sampled policy.

    Args:
      lanes: which policies; all of them if None.
    """
    env, algorithm = policies.env, policies.algorithm
    lanes = range(len(policies.seeds)) if lanes is None else lanes

    @jax.jit
    @jax.vmap
    def episode(policy, key):
        reset_key, key = jax.random.split(key)
        start = env.reset(reset_key)

        def step(state, key):
            action = algorithm.act(policy, state.obs[None], key)[0]
            after = env.step(state, action)  # which clips the action
            return after, (positions(after), after.reward, after.done)

        _, (qpos, reward, done) = jax.lax.scan(step, start, jax.random.split(key, env.episode_length))
        alive = jax.numpy.cumsum(done) - done == 0
        # After its end the episode stands still.
        qpos = qpos[jax.numpy.minimum(jax.numpy.arange(len(qpos)), alive.sum() - 1)]
        return jax.numpy.concatenate([positions(start)[None], qpos]), (reward * alive).sum()

    states = jax.tree.map(jax.numpy.asarray, take_lanes(policies.state, np.array(lanes)))
    qpos, returns = episode(states, lane_keys(EVALUATE, [policies.seeds[lane] for lane in lanes]))
    return Episodes(np.asarray(qpos), np.asarray(returns))
