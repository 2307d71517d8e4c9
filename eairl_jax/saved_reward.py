"""A learned reward on disk: save it, load it, and call it on any observation and action."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
from flax.traverse_util import unflatten_dict

from eairl_jax import horizon, irl, storage
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.normalize import ObsStats

KIND = "eairl_jax reward"


class LearnedReward:
    """A reward r(s, a) that was learned from demonstrations: one function for each seed of a run. Higher is better.

    Attributes:
      description: task, sizes, method, reward form, the seed and the iteration of each function, settings.
      config: the static settings of the run.
      params: `irl.RewardParams`, every leaf `[seeds, ...]`.
    """

    def __init__(self, description: dict, config: Config, params: irl.RewardParams):
        self.description, self.config, self.params = description, config, params
        self._function = irl.reward_function(config)

    def __call__(self, obs: jax.Array, action: jax.Array, seed: int = 0) -> jax.Array:
        """Rewards `[...]` of raw observations `[..., obs]` and actions `[..., act]`.

        If `config.actions` is "clipped", the actions must lie within their bounds, as executed.

        Args:
          seed: the position of the seed in the run, from 0; not the seed itself.

        Raises:
          InputError: if the sizes are not those of the reward, or if the run had fewer seeds.
        """
        obs, action = jnp.asarray(obs), jnp.asarray(action)
        self.check_sizes(obs.shape[-1], action.shape[-1], "this call")
        seeds = jax.tree.leaves(self.params)[0].shape[0]
        if not -seeds <= seed < seeds:
            raise InputError(f"seed = {seed}: the run of this reward had {seeds} seeds; expected 0 to {seeds - 1}")
        return self._function(jax.tree.map(lambda leaf: jnp.asarray(leaf)[seed], self.params), obs, action)

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
        params = jax.tree.map(lambda leaf: jnp.asarray(leaf)[seed], self.params)
        obs = horizon.absorb(jnp.zeros(self.description["obs_size"]), jnp.ones(()))
        return float(self._function(params, obs, jnp.zeros(self.description["action_size"])))

    def check_sizes(self, obs_size: int, action_size: int, where: str) -> None:
        """Checks that observations and actions have the sizes of the reward.

        Args:
          where: the origin of the sizes, for the error message.

        Raises:
          InputError: if a size differs.
        """
        sizes = self.description["obs_size"], self.description["action_size"]
        if sizes != (obs_size, action_size):
            raise InputError(
                f"this reward was learned on {self.description['task']} (observations of length {sizes[0]}, actions of "
                f"length {sizes[1]}), but {where} has observations of length {obs_size} and actions of length "
                f"{action_size}: use the reward on a task with the same lengths"
            )


def save_reward(directory: Path | str, reward: LearnedReward) -> None:
    """Writes `reward.npz` and `reward.json` into a folder, which is created."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    storage.write_arrays(directory / "reward.npz", storage.named_leaves(reward.params))
    content = {"kind": KIND} | reward.description | {"config": dataclasses.asdict(reward.config)}
    storage.write_json(directory / "reward.json", content)


def load_reward(directory: Path | str, obs_size: int | None = None, action_size: int | None = None) -> LearnedReward:
    """Reads a learned reward.

    Args:
      directory: a folder that `save_reward` has written (`reward/` of a run).
      obs_size: length of the observations of the task where the reward will be used, if not None.
      action_size: length of the actions of that task, if not None.

    Raises:
      InputError: if the folder does not hold a complete reward, or if the reward has other sizes.
    """
    directory = Path(directory)
    if not (directory / "reward.json").is_file():
        raise InputError(f"{directory} holds no reward.json: use the reward/ folder of a finished run")
    description, config = _read_description(directory / "reward.json")
    params = _read_params(directory / "reward.npz")
    reward = LearnedReward(description, config, params)
    counts = {leaf.shape[0] for leaf in jax.tree.leaves(params)}
    if counts != {len(description["seeds"])}:
        raise InputError(
            f"{directory}: reward.json names {len(description['seeds'])} seeds, but reward.npz holds {sorted(counts)}: "
            "save the reward again"
        )
    sizes = description["obs_size"], description["action_size"]
    expected = sizes[0] if obs_size is None else obs_size, sizes[1] if action_size is None else action_size
    reward.check_sizes(*expected, "the task where you use the reward")
    return reward


def _read_description(path: Path) -> tuple[dict, Config]:
    description = storage.read_json(path)
    if description.pop("kind", None) != KIND:
        raise InputError(f"{path} does not describe a learned reward: use the reward/ folder of a finished run")
    missing = {"task", "obs_size", "action_size", "seeds", "config"} - set(description)
    if missing:
        raise InputError(f"{path} lacks {', '.join(sorted(missing))}: save the reward again")
    settings = description.pop("config")
    unknown = set(settings) - {field.name for field in dataclasses.fields(Config)}
    if unknown:
        raise InputError(
            f"{path} has settings that this version does not have: {', '.join(sorted(unknown))}; use the version that "
            "saved the reward, or learn the reward again"
        )
    return description, Config.from_json(settings)


def _read_params(path: Path) -> irl.RewardParams:
    tree = unflatten_dict(storage.read_arrays(path), sep="/")
    if "params" not in tree or set(tree.get("obs_stats", ())) != {"mean", "var", "count"}:
        raise InputError(f"{path} does not hold a reward and its normaliser: save the reward again")
    return irl.RewardParams(tree["params"], ObsStats(**tree["obs_stats"]))
