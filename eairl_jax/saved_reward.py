"""A learned reward on disk: save it, load it, and call it on any observation and action."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax.traverse_util import unflatten_dict

from eairl_jax import artefacts, horizon, irl, numpy_nets, storage
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.normalize import ObsStats
from eairl_jax.schema import shown


class LearnedReward:
    """A reward r(s, a) that was learned from demonstrations: one function for each seed of a run. Higher is better.

    The reward can be pickled. It compiles itself at its first call for each shape.

    Attributes:
      description: task, sizes, method, reward form, the seed and the iteration of each function, settings.
      config: the static settings of the run.
      params: `irl.RewardParams`, every leaf `[seeds, ...]`.

    Raises:
      InputError: if an argument has another type. `save_reward` checks what the arguments hold.
    """

    def __init__(self, description: dict, config: Config, params: irl.RewardParams):
        given = (("description", description, dict), ("config", config, Config), ("params", params, irl.RewardParams))
        for name, value, kind in given:
            if not isinstance(value, kind):
                raise InputError(f"{name} is {shown(value)}: expected a {kind.__name__}")
        self.description, self.config, self.params = description, config, params
        self._function = irl.reward_function(config)
        self._compiled = Compiled(params, self._function)

    def __call__(self, obs: jax.Array, action: jax.Array, seed: int = 0) -> jax.Array:
        """Rewards `[...]` of raw observations `[..., obs]` and actions `[..., act]`.

        If `config.actions` is "clipped", the actions must lie within their bounds, as executed.

        Args:
          seed: the position of the seed in the run, from 0; not the seed itself.

        Raises:
          InputError: if the sizes are not those of the reward, or if the run had fewer seeds.
        """
        obs, action = vectors("obs", obs), vectors("action", action)
        self.check_sizes(obs.shape[-1], action.shape[-1], "this call")
        if obs.shape[:-1] != action.shape[:-1]:
            raise InputError(
                f"obs has shape {obs.shape} and action {action.shape}: expected the same axes before the last"
            )
        return self._compiled(self._row(seed), obs, action)

    def after_end(self, seed: int = 0) -> float:
        """The reward of each step between the end of an episode and the time limit.

        Raises:
          InputError: if the reward was not learned with the horizon "absorbing": it says nothing of such steps.
        """
        if self.config.horizon != "absorbing":
            raise InputError(
                f'this reward was learned with horizon="{self.config.horizon}", so it has no value for the steps after '
                "the end of an episode"
            )
        params = jax.tree.map(lambda leaf: jnp.asarray(leaf)[self._row(seed)], self.params)
        obs = horizon.absorb(jnp.zeros(self.description["obs_size"]), jnp.ones(()))
        return float(self._function(params, obs, jnp.zeros(self.description["action_size"])))

    def function(self, seed: int = 0) -> Callable[[jax.Array, jax.Array], jax.Array]:
        """The reward of one seed as a pure function of `[..., obs]` and `[..., act]`, to be traced into a program.

        Unlike a call it clips actions itself, if the reward was learned of clipped ones, and checks no shapes.

        Args:
          seed: the position of the seed in the run, from 0.

        Raises:
          InputError: if the run had fewer seeds.
        """
        params = jax.tree.map(lambda leaf: jnp.asarray(leaf)[self._row(seed)], self.params)
        limit = self.description.get("action_limit", 1.0) if self.config.actions == "clipped" else None

        def reward(obs: jax.Array, action: jax.Array) -> jax.Array:
            return self._function(params, obs, action if limit is None else jnp.clip(action, -limit, limit))

        return reward

    def numpy(self, seed: int = 0) -> numpy_nets.Reward:
        """The reward of one seed, computed by NumPy alone: the fastest way to judge one step at a time.

        Args:
          seed: the position of the seed in the run, from 0.

        Raises:
          InputError: if the run had fewer seeds.
        """
        return numpy_nets.Reward(self._contents(), self._row(seed))

    def check_sizes(self, obs_size: int, action_size: int, where: str) -> None:
        """Checks that observations and actions have the sizes of the reward.

        Args:
          where: the origin of the sizes, for the error message.

        Raises:
          InputError: if a size differs.
        """
        artefacts.refuse_other_sizes(self.description, "reward", obs_size, action_size, where)

    def _row(self, seed: Any) -> int:
        """The position of a seed."""
        return artefacts.seed_row(seed, jax.tree.leaves(self.params)[0].shape[0], "reward")

    def _contents(self) -> artefacts.Contents:
        return artefacts.Contents(self.description, self.config, storage.named_leaves(self.params))

    def __reduce__(self) -> tuple:
        return LearnedReward, (self.description, self.config, jax.tree.map(np.asarray, self.params))


class Compiled:
    """A function of one seed's parameters, compiled once for each shape of its other arguments.

    Args:
      params: every leaf `[seeds, ...]`.
      function: `(parameters of one seed, *arguments) -> result`.
    """

    def __init__(self, params: Any, function: Any):
        self._params, self._is_put = params, False
        self._call = jax.jit(lambda params, row, *args: function(jax.tree.map(lambda x: x[row], params), *args))

    def __call__(self, row: int, *args: Any) -> Any:
        if not self._is_put:
            with jax.ensure_compile_time_eval():  # a first call inside a user's own jit must leave no tracers here
                self._params = jax.tree.map(jnp.asarray, self._params)
            self._is_put = True
        return self._call(self._params, row, *args)


def vectors(name: str, x: Any) -> Any:
    """An array `[..., size]` of numbers; `InputError` for anything else."""
    if isinstance(x, np.ndarray) and x.ndim and x.dtype.kind == "f":  # the usual case, which should cost nothing
        return x
    try:
        array = jnp.asarray(x)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is {shown(x)}: expected an array [..., {name}] of numbers") from None
    if array.ndim < 1 or not (jnp.issubdtype(array.dtype, jnp.number) or array.dtype == bool):
        raise InputError(
            f"{name} has shape {array.shape} and dtype {array.dtype}: expected an array [..., {name}] of numbers"
        )
    return array


def save_reward(directory: Path | str, reward: LearnedReward) -> None:
    """Writes `reward.npz` and `reward.json` into a folder, which is created.

    Raises:
      InputError: if `load_reward` would refuse the reward.
    """
    if not isinstance(reward, LearnedReward):
        raise InputError(
            f"reward is {shown(reward)}: expected a LearnedReward, made of a description, Config and params"
        )
    artefacts.write(Path(directory), artefacts.REWARD, reward._contents())


def load_reward(
    directory: Path | str,
    obs_size: int | None = None,
    action_size: int | None = None,
    net: Callable[[], Any] | None = None,
) -> LearnedReward:
    """Reads a learned reward. The files may come from a stranger: nothing in them is executed.

    Args:
      directory: a folder that `save_reward` has written (`reward/` of a run).
      obs_size: length of the observations of the task where the reward will be used, if not None.
      action_size: length of the actions of that task, if not None.
      net: of a reward with a network of a user's own (`Config.net`), that flax module. From then on the program knows
        the network by its name (`eairl_jax.NETWORKS`).

    Raises:
      InputError: if the folder does not hold a complete reward, if the parameters do not fit the settings, if the
        reward has other sizes, or if it names a network that the program does not know.
    """
    contents = artefacts.read(directory, artefacts.REWARD, net)
    tree = unflatten_dict(contents.arrays, sep="/")
    params = irl.RewardParams(tree["params"], ObsStats(**tree["obs_stats"]))
    reward = LearnedReward(contents.description, contents.config, params)
    sizes = reward.description["obs_size"], reward.description["action_size"]
    expected = sizes[0] if obs_size is None else obs_size, sizes[1] if action_size is None else action_size
    reward.check_sizes(*expected, "the task where you use the reward")
    return reward
