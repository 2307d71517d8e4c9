"""Steps of parallel environments with a time limit and an auto-reset that preserves the true next observation."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax.gaussian import Gaussian
from eairl_jax.shards import ONE, Shards
from eairl_jax.types import Env, Key, PyTree, Transition

UNKNOWN = -jnp.inf
"""Stands for a return that is not known yet."""


@struct.dataclass
class RolloutState:
    """N environments between two rollouts.

    Attributes:
      env: the states of the environments, every leaf `[N, ...]`.
      steps: `[N]` steps in the current episode so far.
      episode_return: `[N]` true return in the current episode so far; -inf in a first episode that began late.
      mean_return: `[]` mean true return of the episodes that ended in the last rollout in which any episode ended; -inf
        before the first such rollout. (Not NaN, which a user may hunt with `JAX_DEBUG_NANS=1`.)
    """

    env: PyTree
    steps: jax.Array
    episode_return: jax.Array
    mean_return: jax.Array


def reset(key: Key, env: Env, num_envs: int, length: int, episode_length: int) -> RolloutState:
    """Starts an episode in each of `num_envs` environments, at different times of the time limit.

    The environments begin at step 0, `length`, 2 `length`, ... of their first episode, by turns. If all began at step 0
    and no episode ended early, every batch would contain the same part of all episodes: with rollouts of a tenth of an
    episode, only every tenth batch would contain the start. The returns of episodes that began late are not counted.
    """
    states = jax.vmap(env.reset)(jax.random.split(key, num_envs))
    steps = length * (jnp.arange(num_envs, dtype=jnp.int32) % max(1, episode_length // length))
    returns = jnp.where(steps > 0, UNKNOWN, jnp.zeros(num_envs))
    return RolloutState(states, steps, returns, jnp.full((), UNKNOWN, jnp.float32))


def action_limit(env: Env) -> float:
    """The largest magnitude of an executed action: `env.action_limit`, or 1 (brax's convention)."""
    return getattr(env, "action_limit", 1.0)


def rollout(
    key: Key,
    env: Env,
    policy: Callable[[jax.Array], Gaussian],
    state: RolloutState,
    length: int,
    episode_length: int,
    shards: Shards = ONE,
) -> tuple[RolloutState, Transition]:
    """Runs the policy for `length` steps in every environment.

    An environment whose episode ends starts again in the same step, from one of N initial states that are drawn once in
    a rollout. `reset` is as expensive as a physics step in many brax tasks; it is compiled and run once, and not at
    every step.

    Args:
      policy: maps raw observations `[N, obs]` to a Gaussian over actions `[N, act]`.
      episode_length: the time limit, in steps.
      shards: the devices, each of which simulates a part of the environments.

    Returns:
      The environments after the rollout, and the transitions `[length, N, ...]`.
    """
    num_envs = state.steps.shape[0]
    reset_key, noise_key, pick_key = jax.random.split(key, 3)
    initial_states = shards.join(jax.vmap(env.reset)(shards.part(jax.random.split(reset_key, num_envs))))
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
        env_state = jax.tree.map(lambda new, old: where_ended(ended, new[picks_t], old), initial_states, stepped)
        carry = env_state, jnp.where(ended, 0, steps), jnp.where(ended, 0.0, episode_return)
        return carry, (transition, ended, episode_return)

    start = shards.part((state.env, state.steps, state.episode_return))
    carry, over_time = jax.lax.scan(step, start, shards.part((noise, picks), axis=1))
    transitions, ended, returns = shards.join(over_time, axis=1)
    counted = ended & jnp.isfinite(returns)  # states of earlier versions have NaN where these have -inf
    count = counted.sum()
    mean = jnp.where(counted, returns, 0.0).sum() / jnp.maximum(count, 1)
    mean_return = jnp.where(count > 0, mean, state.mean_return)
    env_state, steps, episode_return = shards.join(carry)
    return RolloutState(env_state, steps, episode_return, mean_return), transitions


def where_ended(ended: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    """`new` for the environments `[N]` that ended, else `old`; both `[N, ...]`."""
    return jnp.where(ended.reshape(ended.shape + (1,) * (old.ndim - 1)), new, old)
