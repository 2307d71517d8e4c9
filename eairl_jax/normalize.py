"""Mean and variance of observations, as a pytree: saved with every policy and every reward."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax.errors import InputError
from eairl_jax.types import Env


@struct.dataclass
class ObsStats:
    """Statistics of observations.

    Attributes:
      mean, var: `[obs]`, in the observation's units and their square.
      count: `[]` samples behind them; 0 for statistics that were declared, not measured.
    """

    mean: jax.Array
    var: jax.Array
    count: jax.Array


def initial(env: Env, mode: str) -> ObsStats:
    """Statistics before the first sample.

    With mode "task" they are the scale of the task's whole state space, where the environment declares one. The
    scale of a reward's input decides what the reward says of places that no demonstration visits: with the
    demonstrations' own deviation, the other passage of the maze lies five sigma away.

    Raises:
      InputError: if the environment's observations are not one flat vector.
    """
    size = flat_size(env)
    mean, var = jnp.zeros(size), jnp.ones(size)
    if mode == "task" and hasattr(env, "obs_mean"):
        mean, var = jnp.asarray(env.obs_mean), jnp.asarray(env.obs_std) ** 2  # pyright: ignore
    return ObsStats(mean, var, jnp.zeros(()))


def flat_size(env: Env) -> int:
    """The length of an environment's observations.

    Raises:
      InputError: if they are not one flat vector.
    """
    size = env.observation_size
    if not isinstance(size, int):
        raise InputError(f"observation_size is {size!r}: eairl_jax needs flat vector observations; flatten them first")
    return size


def normalize(stats: ObsStats, obs: jax.Array) -> jax.Array:
    """Centres and scales observations `[..., obs]`; clipped at 10 deviations."""
    return jnp.clip((obs - stats.mean) * jax.lax.rsqrt(stats.var + 1e-8), -10.0, 10.0)


def update(stats: ObsStats, obs: jax.Array) -> ObsStats:
    """Merges a batch `[..., obs]` into running statistics (Chan et al. 1979)."""
    obs = obs.reshape(-1, obs.shape[-1])
    size = obs.shape[0]
    mean, var = obs.mean(axis=0), obs.var(axis=0)
    total = stats.count + size
    delta = mean - stats.mean
    merged_var = (stats.var * stats.count + var * size + delta**2 * stats.count * size / total) / total
    return ObsStats(stats.mean + delta * size / total, merged_var, total)
