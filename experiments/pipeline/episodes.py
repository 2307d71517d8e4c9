"""Episodes of the policies that a run left, as positions of their bodies."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

from eairl_jax.experiments.pipeline.learn import take_rows
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.train import EVALUATE, lane_keys


def play(policies: Policies, lanes: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Plays one episode of each sampled policy.

    Args:
      lanes: which policies; None for all.

    Returns:
      `(qpos [lanes, T + 1, nq], returns [lanes])`: positions from the start on, and true returns.
    """
    env, algorithm = policies.env, policies.algorithm
    lanes = range(len(policies.seeds)) if lanes is None else lanes

    @jax.jit
    @jax.vmap
    def episode(state, key):
        reset_key, key = jax.random.split(key)
        start = env.reset(reset_key)

        def step(before, key):
            action = algorithm.act(state, before.obs[None], key)[0]
            after = env.step(before, action)  # which clips the action
            return after, (after.pipeline_state.qpos, after.reward)

        _, (qpos, reward) = jax.lax.scan(step, start, jax.random.split(key, env.episode_length))
        first = start.pipeline_state.qpos
        return jax.numpy.concatenate([first[None], qpos]), reward.sum()

    states = jax.tree.map(jax.numpy.asarray, take_rows(policies.state, np.array(lanes)))
    qpos, returns = episode(states, lane_keys(EVALUATE, [policies.seeds[lane] for lane in lanes]))
    return np.asarray(qpos), np.asarray(returns)
