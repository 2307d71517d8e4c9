"""Diagonal Gaussians over actions: over samples before clipping, or over executed actions."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct
from jax.scipy.special import log_ndtr

LOG_2PI = 1.8378770664093453


@struct.dataclass
class Gaussian:
    """A diagonal Gaussian.

    Attributes:
      mean: `[..., act]`, in units of the action.
      log_std: `[..., act]`, log of the standard deviation.
    """

    mean: jax.Array
    log_std: jax.Array

    def sample(self, noise: jax.Array) -> jax.Array:
        """Turns standard normal noise `[..., act]` into a sample `[..., act]`."""
        return self.mean + jnp.exp(self.log_std) * noise

    def log_prob(self, action: jax.Array) -> jax.Array:
        """Log-density `[...]` of actions `[..., act]`."""
        z = (action - self.mean) * jnp.exp(-self.log_std)
        return jnp.sum(-0.5 * z**2 - self.log_std - 0.5 * LOG_2PI, axis=-1)

    def entropy(self) -> jax.Array:
        """Differential entropy `[...]`, in nats."""
        return jnp.sum(self.log_std + 0.5 * (1.0 + LOG_2PI), axis=-1)

    def kl(self, other: Gaussian) -> jax.Array:
        """KL(self || other) `[...]`, in nats."""
        log_ratio = self.log_std - other.log_std
        squared = jnp.exp(2 * log_ratio) + ((self.mean - other.mean) * jnp.exp(-other.log_std)) ** 2
        return jnp.sum(0.5 * (squared - 1.0) - log_ratio, axis=-1)


@struct.dataclass
class Censored(Gaussian):
    """The distribution of executed actions: samples of a diagonal Gaussian, clipped to [-limit, limit].

    A probability is a density inside the bounds and a mass on a bound: `P(a = limit) = P(sample >= limit)`. PPO's
    gradient is then the gradient of Fujita and Maeda (2018). `kl` is inherited: the KL of the unclipped Gaussians, an
    upper bound.

    Attributes:
      limit: the largest magnitude of an executed action.
    """

    limit: float = struct.field(pytree_node=False, default=1.0)

    def sample(self, noise: jax.Array) -> jax.Array:
        """Turns standard normal noise `[..., act]` into an executed action `[..., act]`."""
        return jnp.clip(super().sample(noise), -self.limit, self.limit)

    def log_prob(self, action: jax.Array) -> jax.Array:
        """Log-probability `[...]` of executed actions `[..., act]`."""
        scale = jnp.exp(-self.log_std)
        density = -0.5 * ((action - self.mean) * scale) ** 2 - self.log_std - 0.5 * LOG_2PI
        at_bound = log_ndtr((jnp.sign(action) * self.mean - self.limit) * scale)
        return jnp.sum(jnp.where(jnp.abs(action) < self.limit, density, at_bound), axis=-1)

    def entropy(self) -> jax.Array:
        """Entropy `[...]` of the executed action, in nats: differential inside the bounds, discrete on the bounds."""
        scale = jnp.exp(-self.log_std)
        to_low, to_high = (-self.limit - self.mean) * scale, (self.limit - self.mean) * scale
        low, high = log_ndtr(to_low), log_ndtr(-to_high)
        inside = 1.0 - jnp.exp(low) - jnp.exp(high)
        # -E[log density; inside] = inside (log std + log(2 pi) / 2) + E[z^2; inside] / 2
        squared = inside + to_low * _standard_density(to_low) - to_high * _standard_density(to_high)
        within = inside * (self.log_std + 0.5 * LOG_2PI) + 0.5 * squared
        return jnp.sum(within - low * jnp.exp(low) - high * jnp.exp(high), axis=-1)


def _standard_density(z: jax.Array) -> jax.Array:
    """Density of the standard normal distribution."""
    return jnp.exp(-0.5 * z**2 - 0.5 * LOG_2PI)
