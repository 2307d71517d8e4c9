"""A learned reward as an artefact: save it, load it, call it on any observation and action."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp

from eairl_jax import irl, storage
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.normalize import ObsStats

KIND = "eairl_jax reward"


class LearnedReward:
    """A reward r(s, a) that was learned from demonstrations: higher is better, one for each seed of its run.

    Attributes:
      description: task, sizes, method, reward form, the iteration and the seed of each row, settings.
      config: the static settings that it was trained with.
      params: `irl.RewardParams`, every leaf `[seeds, ...]`.
    """

    def __init__(self, description: dict, config: Config, params: irl.RewardParams):
        self.description, self.config, self.params = description, config, params
        self._function = irl.reward_function(config)

    def __call__(self, obs: jax.Array, action: jax.Array, seed: int = 0) -> jax.Array:
        """Rewards `[...]` of raw observations `[..., obs]` and actions `[..., act]`, by the given row.

        Where `config.actions` is "clipped", give actions as they were executed, within their bounds.

        Raises:
          InputError: if the last axes are not the sizes that the reward was trained with.
        """
        obs, action = jnp.asarray(obs), jnp.asarray(action)
        self.check_sizes(obs.shape[-1], action.shape[-1], "this call")
        rows = jax.tree.leaves(self.params)[0].shape[0]
        if not -rows <= seed < rows:
            raise InputError(f"this reward has {rows} rows, one a seed of its run: there is no row {seed}")
        return self._function(jax.tree.map(lambda leaf: jnp.asarray(leaf)[seed], self.params), obs, action)

    def check_sizes(self, obs_size: int, action_size: int, where: str) -> None:
        """Raises `InputError` unless the reward's observations and actions have these sizes."""
        sizes = self.description["obs_size"], self.description["action_size"]
        if sizes != (obs_size, action_size):
            raise InputError(
                f"this reward was learned on {self.description['task']} (observations of {sizes[0]}, actions of "
                f"{sizes[1]}), but {where} has observations of {obs_size} and actions of {action_size}: "
                "a reward is only reusable on a task of the same sizes"
            )


def save_reward(directory: Path | str, reward: LearnedReward) -> None:
    """Writes `reward.npz` and `reward.json` into a folder."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    storage.write_arrays(directory / "reward.npz", storage.named_leaves(reward.params))
    content = {"kind": KIND} | reward.description | {"config": dataclasses.asdict(reward.config)}
    storage.write_json(directory / "reward.json", content)


def load_reward(directory: Path | str, obs_size: int | None = None, action_size: int | None = None) -> LearnedReward:
    """Reads a learned reward.

    Args:
      directory: a folder that `save_reward` wrote (a run's `reward/`).
      obs_size, action_size: if given, the sizes of the task that it is meant for.

    Raises:
      InputError: if the folder holds no whole reward, or one of other sizes.
    """
    directory = Path(directory)
    if not (directory / "reward.json").is_file():
        raise InputError(f"{directory} holds no reward.json: give the reward/ folder of a finished run")
    description = storage.read_json(directory / "reward.json")
    if description.pop("kind", None) != KIND:
        raise InputError(f"{directory / 'reward.json'} does not describe a learned reward")
    missing = {"task", "obs_size", "action_size", "seeds", "config"} - set(description)
    if missing:
        raise InputError(f"{directory / 'reward.json'} lacks {', '.join(sorted(missing))}: save the reward anew")
    settings = description.pop("config")
    unknown = set(settings) - {field.name for field in dataclasses.fields(Config)}
    if unknown:
        raise InputError(f"{directory / 'reward.json'} has settings that this version does not know: {unknown}")
    tree = storage.nested(storage.read_arrays(directory / "reward.npz"))
    if "params" not in tree or set(tree.get("obs_stats", ())) != {"mean", "var", "count"}:
        raise InputError(f"{directory / 'reward.npz'} does not hold a reward and its normaliser: save it anew")
    params = irl.RewardParams(tree["params"], ObsStats(**tree["obs_stats"]))
    reward = LearnedReward(description, Config.from_json(settings), params)
    rows = {leaf.shape[0] for leaf in jax.tree.leaves(params)}
    if rows != {len(description.get("seeds", ()))}:
        raise InputError(
            f"{directory} describes {len(description.get('seeds', ()))} seeds, but holds rows for {rows}: save it anew"
        )
    own = description["obs_size"], description["action_size"]
    meant = (own[0] if obs_size is None else obs_size, own[1] if action_size is None else action_size)
    reward.check_sizes(*meant, "the task that you want to use it on")
    return reward
