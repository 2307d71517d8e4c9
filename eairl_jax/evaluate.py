"""True returns of a policy: the score."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from eairl_jax.rollout import action_limit
from eairl_jax.types import Env, Key, PyTree


def evaluate(
    key: Key,
    env: Env,
    act: Callable[[jax.Array, Key], jax.Array],
    episodes: int,
    episode_length: int,
) -> tuple[jax.Array, PyTree]:
    """Runs whole episodes side by side.

    Args:
      act: `(obs [episodes, obs], key) -> action [episodes, act]`; close over a state and pass the key on for the
        sampled policy, ignore the key for a deterministic one.

    Returns:
      `(returns [episodes], steps)`: the sum of true rewards up to the end of each episode, and what was done:
      a dict of `obs`, `action` (unclipped), `next_obs`, `reward`, `terminated`, each `[episodes, T, ...]`.
    """
    reset_key, key = jax.random.split(key)
    state = jax.vmap(env.reset)(jax.random.split(reset_key, episodes))
    limit = action_limit(env)

    def step(carry, key_t):
        state, alive = carry
        obs = state.obs
        action = act(obs, key_t)
        state = jax.vmap(env.step)(state, jnp.clip(action, -limit, limit))
        steps = {
            "obs": obs,
            "action": action,
            "next_obs": state.obs,
            "reward": state.reward * alive,
            "terminated": state.done * alive,
        }
        return (state, alive * (1.0 - state.done)), steps

    _, steps = jax.lax.scan(step, (state, jnp.ones(episodes)), jax.random.split(key, episode_length))
    steps = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), steps)
    return steps["reward"].sum(axis=1), steps


def random_policy(env: Env) -> Callable[[jax.Array, Key], jax.Array]:
    """Uniform actions over the executed range: the floor of every score."""
    limit = action_limit(env)
    return lambda obs, key: jax.random.uniform(key, (obs.shape[0], env.action_size), minval=-limit, maxval=limit)
