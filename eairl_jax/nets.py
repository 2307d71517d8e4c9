"""The networks. No other file imports flax.linen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from eairl_jax import named_networks
from eairl_jax.config import LAYER_NORM_EPSILON, Config
from eairl_jax.errors import InputError
from eairl_jax.gaussian import Censored, Gaussian
from eairl_jax.schema import shown


class MLP(nn.Module):
    """A multilayer perceptron, `[..., in] -> [..., out]`, with orthogonal initial weights.

    Attributes:
      hidden: widths of the hidden layers.
      out: width of the last layer, which is linear.
      activation: the name of a function in `jax.nn`.
      out_scale: scale of the initial weights of the last layer.
      layer_norm: whether each hidden layer is normalised before its activation.
    """

    hidden: tuple[int, ...]
    out: int
    activation: str
    out_scale: float = 1.0
    layer_norm: bool = False

    @nn.compact
    def __call__(self, x):
        activation = getattr(jax.nn, self.activation)
        for width in self.hidden:
            x = nn.Dense(width, kernel_init=nn.initializers.orthogonal(math.sqrt(2)))(x)
            x = nn.LayerNorm(epsilon=LAYER_NORM_EPSILON, use_fast_variance=False)(x) if self.layer_norm else x
            x = activation(x)
        return nn.Dense(self.out, kernel_init=nn.initializers.orthogonal(self.out_scale))(x)


class Scalar(nn.Module):
    """A potential, value or reward: `([..., in], ...) -> [...]`. Several inputs are concatenated."""

    hidden: tuple[int, ...]
    activation: str
    layer_norm: bool = False

    @nn.compact
    def __call__(self, *inputs):
        return MLP(self.hidden, 1, self.activation, layer_norm=self.layer_norm)(jnp.concatenate(inputs, axis=-1))[
            ..., 0
        ]


class GaussianMLP(nn.Module):
    """A Gaussian over actions: the policy pi(a|s), or the inverse model q(a|s,s'). Several inputs are concatenated.

    Attributes:
      action_size: length of an action.
      config: widths, activation and bounds of the std.
      action_limit: the largest magnitude of an executed action; has an effect if `config.actions` is "clipped".
    """

    action_size: int
    config: Config
    action_limit: float = 1.0

    @nn.compact
    def __call__(self, *inputs) -> Gaussian:
        config, x = self.config, jnp.concatenate(inputs, axis=-1)
        outputs = 2 * self.action_size if config.state_dependent_std else self.action_size
        activation = "relu" if config.policy_activation == "default" else config.policy_activation
        # With small weights in the last layer the first policy acts around 0 at every state, at any scale of obs.
        out = MLP(config.policy_hidden, outputs, activation, out_scale=0.01, layer_norm=config.policy_layer_norm)(x)
        if config.state_dependent_std:
            mean, raw = jnp.split(out, 2, axis=-1)
        else:
            mean, raw = out, self.param("raw_log_std", nn.initializers.zeros, (self.action_size,))
        log_std = jnp.broadcast_to(self.log_std(raw), mean.shape)
        return Censored(mean, log_std, self.action_limit) if config.actions == "clipped" else Gaussian(mean, log_std)

    def log_std(self, raw: jax.Array) -> jax.Array:
        """Log std `[..., act]`: `log_std_init` at raw = 0, with slope 1, between `log_std_min` and `log_std_max`.

        The upper bound is needed if `config.actions` is "sampled". The environment clips the action, but log pi is that
        of the unclipped sample. An adversarial reward then pays for entropy that costs the policy nothing, and an
        unbounded std grows for ever.
        """
        low, high, start = self.config.log_std_min, self.config.log_std_max, self.config.log_std_init
        part = (start - low) / (high - low)
        steepness = 1.0 / ((high - low) * part * (1.0 - part))
        return low + (high - low) * jax.nn.sigmoid(steepness * raw + math.log(part / (1.0 - part)))


def apply(net: Any, params: Any, *inputs: jax.Array) -> Any:
    """The output of a network: `[...]` of a `Scalar`, a `Gaussian` of a `GaussianMLP`."""
    return net.apply(params, *inputs)


@dataclass(frozen=True)
class NamedScalar:
    """A network of a user's own in the place of a `Scalar`: `([..., in], ...) -> [...]`.

    Attributes:
      name: `Config.net`.
      net: the user's flax module, `[..., in] -> [...]`.
    """

    name: str
    net: nn.Module

    def init(self, key: jax.Array, *inputs: jax.Array) -> Any:
        """Fresh parameters."""
        return self.net.init(key, jnp.concatenate(inputs, axis=-1))

    def apply(self, params: Any, *inputs: jax.Array) -> Any:
        """The network's output; several inputs are concatenated."""
        return self.net.apply(params, jnp.concatenate(inputs, axis=-1))

    def shapes(self, size: int) -> dict[str, tuple[int, ...]]:
        """The shape of each parameter for inputs of length `size`, by its path.

        Raises:
          InputError: if the network is no flax module, if it has variables that are no parameters, or if it does not
            map `[..., size]` to `[...]`.
        """
        if not isinstance(self.net, nn.Module):
            raise InputError(f"net = {shown(self.name)} makes {shown(self.net)}: expected a flax.linen.Module")
        try:
            variables = jax.eval_shape(self.net.init, jax.random.PRNGKey(0), jnp.zeros((1, size)))
            outputs = {
                axes: jax.eval_shape(self.net.apply, variables, jnp.zeros((*axes, size))).shape
                for axes in ((), (2,), (2, 3))
            }
        except Exception as e:  # whatever the user's code raises
            raise InputError(
                f"net = {shown(self.name)} cannot be computed for inputs of length {size}: {type(e).__name__}: "
                f"{next(iter(str(e).splitlines()), '')}"
            ) from e
        if set(variables) != {"params"}:
            raise InputError(f"net = {shown(self.name)} has {', '.join(sorted(variables))}: expected parameters alone")
        for axes, shape in outputs.items():
            if shape != axes:
                raise InputError(
                    f"net = {shown(self.name)} gives {shape} for inputs of shape {(*axes, size)}: expected {axes}, one "
                    "number for each input"
                )
        leaves = jax.tree_util.tree_flatten_with_path(variables)[0]
        return {"/".join(str(key.key) for key in path): leaf.shape for path, leaf in leaves}


def scalar(config: Config) -> Scalar | NamedScalar:
    """The network of the reward and of every potential (Appendix D.1, unless `config.net` names another).

    Raises:
      InputError: if `config.net` names a network that the program does not know.
    """
    if config.net != named_networks.MLP:
        return NamedScalar(config.net, named_networks.network(config.net)())
    return Scalar(config.hidden, config.activation, config.layer_norm)


def value(config: Config) -> Scalar:
    """The network of the value function."""
    return Scalar(config.value_hidden, config.activation, config.layer_norm)
