"""The networks, and the only file that imports flax.linen."""

from __future__ import annotations

import math
from collections.abc import Callable

import flax.linen as nn
import jax
import jax.numpy as jnp

from eairl_jax.config import Config
from eairl_jax.gaussian import Censored, Gaussian

ACTIVATIONS: dict[str, Callable] = {"relu": nn.relu, "tanh": nn.tanh}


class MLP(nn.Module):
    """Two-layer perceptrons and the like: `[..., in] -> [..., out]`."""

    hidden: tuple[int, ...]
    out: int
    activation: str
    out_scale: float = 1.0

    @nn.compact
    def __call__(self, x):
        for width in self.hidden:
            x = ACTIVATIONS[self.activation](nn.Dense(width, kernel_init=nn.initializers.orthogonal(math.sqrt(2)))(x))
        return nn.Dense(self.out, kernel_init=nn.initializers.orthogonal(self.out_scale))(x)


class Scalar(nn.Module):
    """A potential, value or reward: `([..., in], ...) -> [...]`; several inputs are concatenated."""

    hidden: tuple[int, ...]
    activation: str

    @nn.compact
    def __call__(self, *inputs):
        return MLP(self.hidden, 1, self.activation)(jnp.concatenate(inputs, axis=-1))[..., 0]


class GaussianMLP(nn.Module):
    """A Gaussian over actions given the inputs: the policy pi(a|s) and the inverse model q(a|s,s')."""

    action_size: int
    config: Config
    action_limit: float = 1.0

    @nn.compact
    def __call__(self, *inputs) -> Gaussian:
        config, x = self.config, jnp.concatenate(inputs, axis=-1)
        outputs = 2 * self.action_size if config.state_dependent_std else self.action_size
        # A small last layer: the first policy acts around 0 everywhere, whatever the observation's scale.
        activation = "relu" if config.policy_activation == "default" else config.policy_activation
        out = MLP(config.policy_hidden, outputs, activation, out_scale=0.01)(x)
        if config.state_dependent_std:
            mean, raw = jnp.split(out, 2, axis=-1)
        else:
            mean, raw = out, self.param("raw_log_std", nn.initializers.zeros, (self.action_size,))
        log_std = jnp.broadcast_to(self.log_std(raw), mean.shape)
        return Censored(mean, log_std, self.action_limit) if config.actions == "clipped" else Gaussian(mean, log_std)

    def log_std(self, raw: jax.Array) -> jax.Array:
        """`log_std_init` at 0, slope 1 there, never above `log_std_max` nor below `log_std_min`.

        The upper bound matters where actions are those "sampled": what is executed is clipped, log pi is not, so an
        adversarial reward pays a policy for entropy that costs it nothing, and an unbounded std runs away.
        """
        low, high, start = self.config.log_std_min, self.config.log_std_max, self.config.log_std_init
        part = (start - low) / (high - low)
        steepness = 1.0 / ((high - low) * part * (1.0 - part))
        return low + (high - low) * jax.nn.sigmoid(steepness * raw + math.log(part / (1.0 - part)))


def scalar(config: Config) -> Scalar:
    """The potential functions and the reward (Appendix D.1)."""
    return Scalar(config.hidden, config.activation)


def value(config: Config) -> Scalar:
    """PPO's value function."""
    return Scalar(config.value_hidden, config.activation)
