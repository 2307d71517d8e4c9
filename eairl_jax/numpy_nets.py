"""Rewards and policies computed by NumPy alone, for programs without jax: a Gymnasium loop, a robot, another library.

For one step at a time NumPy is faster than a call of a compiled program: these networks are small. The equations are
those of `irl.reward_function` and `agent.sample_action`; the tests compare them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import artefacts
from eairl_jax.artefacts import POLICY, REWARD, STATS, Contents
from eairl_jax.config import LAYER_NORM_EPSILON
from eairl_jax.errors import InputError
from eairl_jax.methods import with_method_defaults
from eairl_jax.named_networks import MLP as MLP_NAME
from eairl_jax.schema import shown

Array = np.ndarray


def relu(x: Array) -> Array:
    """max(x, 0)."""
    return np.maximum(x, 0.0)


def sigmoid(x: Array) -> Array:
    """1 / (1 + exp(-x))."""
    return 0.5 * (np.tanh(0.5 * x) + 1.0)


def softplus(x: Array) -> Array:
    """log(1 + exp x)."""
    return np.logaddexp(x, np.zeros_like(x))


def elu(x: Array) -> Array:
    """x above 0, exp x - 1 below."""
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0.0)))


def hard_sigmoid(x: Array) -> Array:
    """(x + 3) / 6 between 0 and 1."""
    return np.clip(x + 3.0, 0.0, 6.0) / 6.0


def sparse_plus(x: Array) -> Array:
    """0 below -1, x above 1, (x + 1)^2 / 4 between."""
    return np.where(x >= 1.0, x, 0.25 * (np.clip(x, -1.0, 1.0) + 1.0) ** 2)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "relu": relu,
    "tanh": np.tanh,
    "celu": elu,
    "elu": elu,
    "gelu": lambda x: x * sigmoid(2.0 * math.sqrt(2.0 / math.pi) * (x + 0.044715 * x**3)),  # as `jax.nn`: by a tanh
    "hard_sigmoid": hard_sigmoid,
    "hard_silu": lambda x: x * hard_sigmoid(x),
    "hard_swish": lambda x: x * hard_sigmoid(x),
    "hard_tanh": lambda x: np.clip(x, -1.0, 1.0),
    "identity": lambda x: x,
    "leaky_relu": lambda x: np.where(x >= 0, x, 0.01 * x),
    "log_sigmoid": lambda x: -softplus(-x),
    "mish": lambda x: x * np.tanh(softplus(x)),
    "relu6": lambda x: np.clip(x, 0.0, 6.0),
    "selu": lambda x: 1.0507009873554805 * np.where(x > 0, x, 1.6732632423543772 * np.expm1(np.minimum(x, 0.0))),
    "sigmoid": sigmoid,
    "silu": lambda x: x * sigmoid(x),
    "soft_sign": lambda x: x / (np.abs(x) + 1.0),
    "softplus": softplus,
    "sparse_plus": sparse_plus,
    "sparse_sigmoid": lambda x: 0.5 * np.clip(x + 1.0, 0.0, 2.0),
    "squareplus": lambda x: 0.5 * (x + np.sqrt(x * x + 4.0)),
    "swish": lambda x: x * sigmoid(x),
}
"""The functions of `jax.nn` in `config.ACTIVATIONS`."""


def layer_norm(x: Array, scale: Array, bias: Array) -> Array:
    """`[..., width]` with mean 0 and variance 1 over the last axis, times `scale`, plus `bias`."""
    x = x - x.mean(axis=-1, keepdims=True)
    var = np.mean(x * x, axis=-1, keepdims=True)
    return x / np.sqrt(var + np.float32(LAYER_NORM_EPSILON)) * scale + bias


class MLP:
    """A multilayer perceptron, `[..., in] -> [..., out]` (`nets.MLP`).

    Args:
      arrays: of one seed, by their paths.
      path: of the network in `arrays`, for example "params/g/params".
      activation: a key of `ACTIVATIONS`.
    """

    def __init__(self, arrays: Mapping[str, Array], path: str, activation: str):
        count = sum(name.startswith(f"{path}/MLP_0/") and name.endswith("/kernel") for name in arrays)
        layers = [f"{path}/MLP_0/Dense_{i}" for i in range(count)]
        self._layers = [tuple(np.asarray(arrays[f"{d}/{x}"], np.float32) for x in ("kernel", "bias")) for d in layers]
        self._norms = [
            tuple(np.asarray(arrays[f"{path}/MLP_0/LayerNorm_{i}/{x}"], np.float32) for x in ("scale", "bias"))
            if f"{path}/MLP_0/LayerNorm_{i}/scale" in arrays
            else None
            for i in range(count - 1)
        ]
        self._activation = ACTIVATIONS[activation]

    def __call__(self, x: Array) -> Array:
        for (kernel, bias), norm in zip(self._layers[:-1], self._norms, strict=True):
            x = x @ kernel + bias
            x = self._activation(x if norm is None else layer_norm(x, *norm))
        kernel, bias = self._layers[-1]
        return x @ kernel + bias


class Normalizer:
    """Raw observations `[..., obs]` to those that the networks read (`horizon.living`, `normalize.normalize`)."""

    def __init__(self, arrays: Mapping[str, Array]):
        self.mean = np.asarray(arrays[f"{STATS}/mean"], np.float32)
        self._rate = 1.0 / np.sqrt(np.asarray(arrays[f"{STATS}/var"], np.float32) + np.float32(1e-8))

    def living(self, obs: Array) -> Array:
        """With a last entry of 0, where the networks know an absorbing state."""
        if obs.shape[-1] == len(self.mean):
            return obs
        return np.concatenate([obs, np.zeros((*obs.shape[:-1], 1), obs.dtype)], axis=-1)

    def __call__(self, obs: Array) -> Array:
        return np.minimum(np.maximum((self.living(obs) - self.mean) * self._rate, -10.0), 10.0)


class Reward:
    """A learned reward of one seed: `reward(obs, action)`. Higher is better.

    Attributes:
      description: task, sizes, method, reward form, seeds, settings.
    """

    def __init__(self, contents: Contents, row: int):
        config, arrays = with_method_defaults(contents.config), contents.row(row)
        if config.net != MLP_NAME:
            raise InputError(
                f"NumPy cannot compute the network {shown(config.net)}: use eairl_jax.load_reward, which computes by "
                "jax, or the program that `eairl export` writes"
            )
        self.description, self._form = contents.description, config.reward_form
        self._normalizer, self._is_raw = Normalizer(arrays), config.reward_obs == "raw"
        self._g = MLP(arrays, "params/g/params", config.activation)
        has_net = self._form == "separable" and config.action_part == "net"
        self._k = MLP(arrays, "params/k/params", config.activation) if has_net else None
        raw_cost = arrays.get("params/k/raw_cost")
        self._cost = None if raw_cost is None else np.logaddexp(np.float32(0), np.asarray(raw_cost, np.float32))
        self._limit = contents.description.get("action_limit", 1.0) if config.actions == "clipped" else None
        self._horizon = config.horizon

    def executed(self, action: Any) -> Array:
        """Actions as the reward knows them: within the task's bounds, if `config.actions` is "clipped"."""
        return np.asarray(action) if self._limit is None else np.clip(action, -self._limit, self._limit)

    def after_end(self) -> float:
        """The reward of each step between the end of an episode and the time limit.

        Raises:
          InputError: if the reward was not learned with the horizon "absorbing": it says nothing of such steps.
        """
        if self._horizon != "absorbing":
            raise InputError(
                f'this reward was learned with horizon="{self._horizon}", so it has no value for the steps after the '
                "end of an episode"
            )
        absorbed = np.zeros(len(self._normalizer.mean), np.float32)
        absorbed[-1] = 1.0
        return float(self._value(absorbed, np.zeros(self.description["action_size"], np.float32)))

    def __call__(self, obs: Any, action: Any) -> Array:
        """Rewards `[...]` of raw observations `[..., obs]` and actions `[..., act]`.

        Raises:
          InputError: if the sizes are not those of the reward.
        """
        obs, action = np.asarray(obs, np.float32), np.asarray(action, np.float32)
        artefacts.refuse_other_sizes(self.description, "reward", _length(obs), _length(action), "this call")
        return self._value(obs, action)

    def _value(self, obs: Array, action: Array) -> Array:
        s = self._normalizer.living(obs) if self._is_raw else self._normalizer(obs)
        if self._form == "sa":
            return self._g(np.concatenate([s, action], axis=-1))[..., 0]
        g = self._g(s)[..., 0]
        if self._k is not None:
            return g + self._k(action)[..., 0]
        return g if self._cost is None else g - self._cost * np.sum(action**2, axis=-1)


class Policy:
    """A policy of one seed: `policy(obs)` is its mean action, `policy(obs, rng)` a sample.

    Attributes:
      description: task, sizes, method, seeds, settings.
      action_limit: the largest magnitude of an action; what is beyond is clipped.
    """

    def __init__(self, contents: Contents, row: int):
        config, arrays = contents.config, contents.row(row)
        self.description, self._config = contents.description, config
        self.action_limit = np.float32(contents.description.get("action_limit", 1.0))
        self._normalizer = Normalizer(arrays)
        activation = "relu" if config.policy_activation == "default" else config.policy_activation
        self._actor = MLP(arrays, "actor/params", activation)
        self._raw_log_std = arrays.get("actor/params/raw_log_std")
        self._offset = np.asarray(arrays["log_std_offset"], np.float32)

    def __call__(self, obs: Any, rng: np.random.Generator | None = None) -> Array:
        """Actions `[..., act]` for raw observations `[..., obs]`, within the task's bounds.

        Args:
          rng: the source of a sample; None for the mean action.

        Raises:
          InputError: if the length of the observations is not the policy's.
        """
        obs = np.asarray(obs, np.float32)
        size = self.description["action_size"]
        artefacts.refuse_other_sizes(self.description, "policy", _length(obs), size, "this call")
        action, raw = self._actor(self._normalizer(obs)), self._raw_log_std
        if self._config.state_dependent_std:
            action, raw = action[..., :size], action[..., size:]
        if rng is not None:
            std = np.exp(self._log_std(raw) + self._offset)
            action = action + std * rng.standard_normal(action.shape, np.float32)
        return np.clip(action, -self.action_limit, self.action_limit)

    def _log_std(self, raw: Any) -> Array:
        """`nets.GaussianMLP.log_std`."""
        low, high, start = self._config.log_std_min, self._config.log_std_max, self._config.log_std_init
        part = (start - low) / (high - low)
        steepness = 1.0 / ((high - low) * part * (1.0 - part))
        return low + (high - low) / (1.0 + np.exp(-(steepness * np.asarray(raw) + math.log(part / (1.0 - part)))))


def _length(x: Array) -> int:
    return x.shape[-1] if x.ndim else 0


def load_reward(directory: Path | str, seed: int = 0) -> Reward:
    """Reads one seed's reward without jax, as `eairl_jax.load_reward` reads all of them.

    Args:
      seed: the position of the seed in the run, from 0.

    Raises:
      InputError: if the folder does not hold a complete reward, or the run had fewer seeds.
    """
    contents = artefacts.read(directory, REWARD)
    return Reward(contents, artefacts.seed_row(seed, len(contents.description["seeds"]), "reward"))


def load_policy(directory: Path | str, seed: int = 0) -> Policy:
    """Reads one seed's policy without jax, as `eairl_jax.load_policy` reads all of them.

    Args:
      seed: the position of the seed in the run, from 0.

    Raises:
      InputError: if the folder does not hold a complete policy, or the run had fewer seeds.
    """
    contents = artefacts.read(directory, POLICY)
    return Policy(contents, artefacts.seed_row(seed, len(contents.description["seeds"]), "policy"))
