"""Vectorised steps with a time limit and an auto-reset that keeps the true next observation."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax.gaussian import Gaussian
from eairl_jax.types import Env, Key, PyTree, Transition


@struct.dataclass
class RolloutState:
    """N environments between two rollouts.

    Attributes:
      env: the environments' states, every leaf `[N, ...]`.
      steps: `[N]` steps taken in the current episode.
      episode_return: `[N]` true return so far in the current episode; NaN in a first one that began late.
      mean_return: `[]` mean true return of the episodes that ended in the last rollout in which any did; NaN before.
    """

    env: PyTree
    steps: jax.Array
    episode_return: jax.Array
    mean_return: jax.Array


def reset(key: Key, env: Env, num_envs: int, length: int, episode_length: int) -> RolloutState:
    """Starts an episode in each of `num_envs` environments, and counts some of them as `length`, 2 `length`, ... old.

    Where nothing ends early, environments that start together would stay together: with rollouts of a tenth of an
    episode every batch would hold one tenth of it, the start only every tenth time. Returns of episodes that began
    late are not counted.
    """
    states = jax.vmap(env.reset)(jax.random.split(key, num_envs))
    steps = length * (jnp.arange(num_envs, dtype=jnp.int32) % max(1, episode_length // length))
    returns = jnp.where(steps > 0, jnp.nan, jnp.zeros(num_envs))
    return RolloutState(states, steps, returns, jnp.full((), jnp.nan, jnp.float32))


def action_limit(env: Env) -> float:
    """The largest magnitude of an executed action: the environment's own, or brax's 1."""
    return getattr(env, "action_limit", 1.0)


def rollout(
    key: Key,
    env: Env,
    policy: Callable[[jax.Array], Gaussian],
    state: RolloutState,
    length: int,
    episode_length: int,
) -> tuple[RolloutState, Transition]:
    """Runs the policy for `length` steps in every environment.

    An environment that ends is started again in the same step. The states it may start from are drawn once a
    rollout, N fresh ones, and each restart picks one at random: the environment's `reset`, which in many brax tasks
    is as dear as a physics step, is compiled and run once and not at every step.

    Args:
      policy: maps raw observations `[N, obs]` to a Gaussian over actions `[N, act]`.

    Returns:
      The environments afterwards, and the transitions `[length, N, ...]`.
    """
    num_envs = state.steps.shape[0]
    reset_key, noise_key, pick_key = jax.random.split(key, 3)
    fresh = jax.vmap(env.reset)(jax.random.split(reset_key, num_envs))
    noise = jax.random.normal(noise_key, (length, num_envs, env.action_size))
    picks = jax.random.randint(pick_key, (length, num_envs), 0, num_envs)
    limit = action_limit(env)

    def step(carry, randomness):
        env_state, steps, episode_return = carry
        noise_t, picks_t = randomness
        obs = env_state.obs
        pi = policy(obs)
        action = pi.sample(noise_t)
        stepped = jax.vmap(env.step)(env_state, jnp.clip(action, -limit, limit))
        steps, episode_return = steps + 1, episode_return + stepped.reward
        terminated = stepped.done.astype(jnp.float32)
        truncated = (steps >= episode_length) * (1.0 - terminated)
        transition = Transition(obs, action, pi.log_prob(action), stepped.obs, stepped.reward, terminated, truncated)
        ended = (terminated + truncated) > 0
        env_state = jax.tree.map(lambda new, old: _where(ended, new[picks_t], old), fresh, stepped)
        carry = env_state, jnp.where(ended, 0, steps), jnp.where(ended, 0.0, episode_return)
        return carry, (transition, ended, episode_return)

    carry, (transitions, ended, returns) = jax.lax.scan(
        step, (state.env, state.steps, state.episode_return), (noise, picks)
    )
    counted = ended & ~jnp.isnan(returns)
    count = counted.sum()
    mean = jnp.where(counted, returns, 0.0).sum() / jnp.maximum(count, 1)
    mean_return = jnp.where(count > 0, mean, state.mean_return)
    return RolloutState(*carry, mean_return), transitions


def _where(ended: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    return jnp.where(ended.reshape(ended.shape + (1,) * (old.ndim - 1)), new, old)
