"""Diagonal Gaussian over actions. No squashing: log-probabilities are those of the unclipped sample."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

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
        """Differential entropy `[...]` in nats."""
        return jnp.sum(self.log_std + 0.5 * (1.0 + LOG_2PI), axis=-1)

    def kl(self, other: Gaussian) -> jax.Array:
        """KL(self || other) `[...]` in nats."""
        log_ratio = self.log_std - other.log_std
        squared = jnp.exp(2 * log_ratio) + ((self.mean - other.mean) * jnp.exp(-other.log_std)) ** 2
        return jnp.sum(0.5 * (squared - 1.0) - log_ratio, axis=-1)
