"""The returns of a policy, true or by any other reward."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from eairl_jax import arguments
from eairl_jax.environment import check_steps
from eairl_jax.errors import InputError
from eairl_jax.rollout import action_limit
from eairl_jax.types import Env, Key, Transition

# (obs [episodes, obs], key) -> action [episodes, act]
Act = Callable[[jax.Array, Key], jax.Array]


def evaluate(
    key: Key, env: Env, act: Act, episodes: int, episode_length: int
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Runs whole episodes side by side.

    Args:
      act: `(obs [episodes, obs], key) -> action [episodes, act]`. For a sampled policy, bind the state of
        `Algorithm.act` and pass the key on; for a deterministic policy, ignore the key.
      episodes: number of episodes.
      episode_length: steps of each episode.

    Returns:
      `(returns [episodes], steps)`. A return is the sum of the true rewards up to the end of the episode; it
      is NaN if an action in it was not finite. `steps` is a
      dict of `obs`, `action` (unclipped), `next_obs`, `reward`, `terminated` and `valid`, each `[episodes,
      episode_length, ...]`. `valid` is 0 for the steps after the end of an episode; `reward` and `terminated` are 0
      there too. `demonstrations.from_steps` makes demonstrations of the valid steps.

    Raises:
      InputError: if the environment does not fit (`environment.check_steps`), if `key` is not one random key, if a
        number is no whole number of at least 1, or if `act` is no function or gives actions of another shape.
    """
    check_steps(env)
    key, episodes = arguments.one_key(key), arguments.count("episodes", episodes)
    episode_length = arguments.count("episode_length", episode_length)
    arguments.function("act", act, "act(obs [episodes, obs], key)")
    reset_key, key = jax.random.split(key)
    state = jax.vmap(env.reset)(jax.random.split(reset_key, episodes))
    limit = action_limit(env)

    def step(carry, key_t):
        state, alive = carry
        obs = state.obs
        action = jnp.asarray(act(obs, key_t))
        _check_shape(action, (episodes, getattr(env, "action_size", None)))
        state = jax.vmap(env.step)(state, jnp.clip(action, -limit, limit))
        steps = {
            "obs": obs,
            "action": action,
            "next_obs": state.obs,
            # Not a product: a simulation that goes on after the end may become NaN.
            "reward": jnp.where(alive > 0, state.reward, 0.0),
            "terminated": jnp.where(alive > 0, state.done, 0.0),
            "valid": alive,
        }
        return (state, jnp.where(alive > 0, 1.0 - state.done, 0.0)), steps

    _, steps = jax.lax.scan(step, (state, jnp.ones(episodes)), jax.random.split(key, episode_length))
    steps = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), steps)
    # A policy whose actions are NaN never ends an episode that asks `obs < bound`: its rewards are no score.
    is_number = jnp.isfinite(jnp.where(steps["valid"][..., None] > 0, steps["action"], 0.0)).all(axis=(1, 2))
    return jnp.where(is_number, steps["reward"].sum(axis=1), jnp.nan), steps


def _check_shape(action: jax.Array, expected: tuple[int, int | None]) -> None:
    """Raises `InputError` unless the actions are `[episodes, act]`; an `act` of None is any size."""
    if action.ndim != 2 or action.shape[0] != expected[0] or expected[1] not in (None, action.shape[1]):
        raise InputError(
            f"act gives actions of shape {action.shape}: expected {expected}, one action for each of the episodes"
        )


def reward_per_step(reward: Callable[[Transition], jax.Array], steps: dict[str, jax.Array]) -> jax.Array:
    """Mean reward a step `[]` of whole episodes, of any reward. A step after the end of an episode counts as 0.

    Args:
      reward: `raw transitions [E, T, ...] -> reward [E, T]`.
      steps: as `evaluate` and `demonstrations.to_steps` return them, `[E, T, ...]`.
    """
    zeros = jnp.zeros_like(steps["reward"])
    fields = {name: x for name, x in steps.items() if name != "valid"}
    paid = reward(Transition(**fields, log_prob=zeros, truncated=zeros))
    return jnp.where(jnp.asarray(steps["valid"]) > 0, paid, 0.0).mean()


def random_policy(env: Env) -> Act:
    """`act` of a policy that draws uniform actions from the range of executed actions; a lower reference score."""
    limit = action_limit(env)
    return lambda obs, key: jax.random.uniform(key, (obs.shape[0], env.action_size), minval=-limit, maxval=limit)
