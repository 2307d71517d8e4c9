"""Mean and variance of observations, a pytree that is saved with every policy and every reward."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax.errors import InputError
from eairl_jax.types import Env


@struct.dataclass
class ObsStats:
    """Statistics of observations.

    Attributes:
      mean: `[obs]`, in the units of the observation.
      var: `[obs]`, in the squared units of the observation.
      count: `[]` number of samples; 0 for statistics that the environment declares.
    """

    mean: jax.Array
    var: jax.Array
    count: jax.Array


def initial(env: Env, mode: str) -> ObsStats:
    """Statistics before the first sample.

    With mode "task" they are the scale of the whole state space, if the environment declares it. The scale of the
    observations decides how a reward extrapolates to places that no demonstration visits. With the standard deviation
    of the demonstrations, the other passage of the maze would be five sigma away.

    Args:
      env: may declare `obs_mean` and `obs_std`.
      mode: `Config.normalize_obs`.

    Raises:
      InputError: if the environment's observations are not flat vectors.
    """
    size = flat_size(env)
    mean, var = jnp.zeros(size), jnp.ones(size)
    if mode == "task" and hasattr(env, "obs_mean"):
        declared: Any = env
        mean, var = jnp.asarray(declared.obs_mean), jnp.asarray(declared.obs_std) ** 2
    return ObsStats(mean, var, jnp.zeros(()))


def without_last(stats: ObsStats, count: int) -> ObsStats:
    """The statistics `[..., obs - count]` of observations without their last `count` entries."""
    size = stats.mean.shape[-1] - count
    return stats.replace(mean=stats.mean[..., :size], var=stats.var[..., :size])


def flat_size(env: Env) -> int:
    """The length of an environment's observations.

    Raises:
      InputError: if the observations are not flat vectors.
    """
    size = env.observation_size
    if not isinstance(size, int):
        raise InputError(
            f"observation_size is {size!r}: expected a whole number, because eairl_jax needs flat vectors as "
            "observations; flatten them in a wrapper of the environment"
        )
    return size


def normalize(stats: ObsStats, obs: jax.Array) -> jax.Array:
    """Centres and scales observations `[..., obs]`, and clips the result to [-10, 10]."""
    return jnp.clip((obs - stats.mean) * jax.lax.rsqrt(stats.var + 1e-8), -10.0, 10.0)


def update(stats: ObsStats, obs: jax.Array, weight: jax.Array | None = None) -> ObsStats:
    """Merges a batch `[..., obs]` into running statistics (Chan et al. 1979).

    Args:
      weight: `[...]` 1 for the observations that count and 0 for the others; None if all count.
    """
    obs = obs.reshape(-1, obs.shape[-1])
    if weight is None:
        size = obs.shape[0]
        mean, var = obs.mean(axis=0), obs.var(axis=0)
    else:
        share = weight.reshape(-1, 1)
        size = jnp.maximum(share.sum(), 1.0)
        mean = (share * obs).sum(axis=0) / size
        var = (share * (obs - mean) ** 2).sum(axis=0) / size
    total = stats.count + size
    delta = mean - stats.mean
    merged_var = (stats.var * stats.count + var * size + delta**2 * stats.count * size / total) / total
    return ObsStats(stats.mean + delta * size / total, merged_var, total)
