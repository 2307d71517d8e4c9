"""A learned reward on disk: save it, load it, and call it on any observation and action."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax.traverse_util import unflatten_dict

from eairl_jax import arguments, discriminator, horizon, irl, schema, storage
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.methods import with_method_defaults
from eairl_jax.normalize import ObsStats
from eairl_jax.schema import shown

KIND = "eairl_jax reward"
AGAIN = "save the reward again, or use the reward/ folder of a finished run"
LARGEST_SIZE = 2**24
"""Of an observation or an action."""


class LearnedReward:
    """A reward r(s, a) that was learned from demonstrations: one function for each seed of a run. Higher is better.

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

    def __call__(self, obs: jax.Array, action: jax.Array, seed: int = 0) -> jax.Array:
        """Rewards `[...]` of raw observations `[..., obs]` and actions `[..., act]`.

        If `config.actions` is "clipped", the actions must lie within their bounds, as executed.

        Args:
          seed: the position of the seed in the run, from 0; not the seed itself.

        Raises:
          InputError: if the sizes are not those of the reward, or if the run had fewer seeds.
        """
        obs, action = _vectors("obs", obs), _vectors("action", action)
        self.check_sizes(obs.shape[-1], action.shape[-1], "this call")
        if obs.shape[:-1] != action.shape[:-1]:
            raise InputError(
                f"obs has shape {obs.shape} and action {action.shape}: expected the same axes before the last"
            )
        return self._function(self._row(seed), obs, action)

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
        params = self._row(seed)
        obs = horizon.absorb(jnp.zeros(self.description["obs_size"]), jnp.ones(()))
        return float(self._function(params, obs, jnp.zeros(self.description["action_size"])))

    def _row(self, seed: Any) -> irl.RewardParams:
        """The parameters of one seed, by its position."""
        seeds = jax.tree.leaves(self.params)[0].shape[0]
        try:
            row = arguments.count("seed", seed, -seeds, seeds - 1)
        except InputError:
            raise InputError(
                f"seed = {shown(seed)}: the run of this reward had {seeds} seeds; expected 0 to {seeds - 1}"
            ) from None
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[row], self.params)

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


def _vectors(name: str, x: Any) -> jax.Array:
    """An array `[..., size]` of numbers; `InputError` for anything else."""
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
    directory = Path(directory)
    content = {"kind": KIND} | reward.description | {"config": dataclasses.asdict(reward.config)}
    arrays = storage.named_leaves(reward.params)
    content = storage.as_json(content, schema.table_of(schema.anything), "the description")
    _checked_params(arrays, *_checked_description(content, "the description"), "params")
    directory.mkdir(parents=True, exist_ok=True)
    storage.write_arrays(directory / "reward.npz", arrays)
    storage.write_json(directory / "reward.json", storage.sealed(content, arrays))


def load_reward(directory: Path | str, obs_size: int | None = None, action_size: int | None = None) -> LearnedReward:
    """Reads a learned reward. The files may come from a stranger: nothing in them is executed.

    Args:
      directory: a folder that `save_reward` has written (`reward/` of a run).
      obs_size: length of the observations of the task where the reward will be used, if not None.
      action_size: length of the actions of that task, if not None.

    Raises:
      InputError: if the folder does not hold a complete reward, if the parameters do not fit the settings, or if the
        reward has other sizes.
    """
    directory = Path(directory)
    if not (directory / "reward.json").exists():
        raise InputError(f"{directory} holds no reward.json: use the reward/ folder of a finished run")
    content = storage.read_json(directory / "reward.json", advice=AGAIN)
    plain = {name: value for name, value in content.items() if name not in (storage.CHECKSUM, storage.SEALED)}
    description, config = _checked_description(plain, directory / "reward.json")
    arrays = storage.read_arrays(directory / "reward.npz")
    params = _checked_params(arrays, description, config, directory / "reward.npz")
    storage.unsealed(content, directory, arrays)
    reward = LearnedReward(description, config, params)
    sizes = description["obs_size"], description["action_size"]
    expected = sizes[0] if obs_size is None else obs_size, sizes[1] if action_size is None else action_size
    reward.check_sizes(*expected, "the task where you use the reward")
    return reward


# Checks --------------------------------------------------------------------------------------------------------------

DESCRIPTION = schema.record(
    {
        "task": schema.text,
        "obs_size": schema.whole(1, LARGEST_SIZE),
        "action_size": schema.whole(1, LARGEST_SIZE),
        "seeds": schema.list_of(schema.whole(0, schema.LARGEST_SEED), low=1),
    },
    {
        "action_limit": schema.number(0.0),
        "method": schema.text,
        "reward_form": schema.text,
        "iterations": schema.list_of(schema.whole(0)),
        "hparams": schema.table_of(schema.number()),
    },
)


def _checked_description(content: dict, where: Path | str) -> tuple[dict, Config]:
    """The description and the settings of a reward.

    Raises:
      InputError: if a member is missing or impossible.
    """
    content = dict(content)
    if content.pop("kind", None) != KIND:
        raise InputError(f"{where} does not describe a learned reward: use the reward/ folder of a finished run")
    if "config" not in content:
        raise InputError(f"{where} lacks config: {AGAIN}")
    config = Config.from_json(content.pop("config"), where)
    description = storage.check(content, DESCRIPTION, where, AGAIN)
    form, iterations = with_method_defaults(config).reward_form, description.get("iterations", description["seeds"])
    for name, value in (("method", config.method), ("reward_form", form)):
        if description.get(name, value) != value:
            raise InputError(f"{where}: {name} is {shown(description[name])}, and the config says {value!r}: {AGAIN}")
    if len(iterations) != len(description["seeds"]):
        raise InputError(f"{where}: {len(iterations)} iterations of {len(description['seeds'])} seeds: {AGAIN}")
    return description, config


def _checked_params(
    arrays: dict[str, np.ndarray], description: dict, config: Config, where: Path | str
) -> irl.RewardParams:
    """Parameters `[seeds, ...]` of exactly the networks that the settings describe.

    Raises:
      InputError: if an array is missing or not needed, has another shape, or holds anything except finite numbers.
    """
    sizes = description["obs_size"], description["action_size"]
    absorbing = {"absorbing": (1,), "default": (0, 1)}.get(config.horizon, (0,))
    found = next((np.shape(x)[-1:] for name, x in arrays.items() if name == "obs_stats/mean"), None)
    obs_size = next((sizes[0] + more for more in absorbing if found == (sizes[0] + more,)), sizes[0] + absorbing[0])
    needed, seeds = _shapes(with_method_defaults(config), obs_size, sizes[1]), len(description["seeds"])
    missing, extra = sorted(set(needed) - set(arrays)), sorted(set(arrays) - set(needed))
    if missing or extra:
        what = f"lacks {schema.listed(missing)}" if missing else f"holds {schema.listed(extra)}, which no network has"
        raise InputError(f"{where} {what}: the settings beside it describe other networks; {AGAIN}")
    for name, shape in needed.items():
        x = arrays[name]
        if x.shape != (seeds, *shape):
            raise InputError(
                f"{where}: {name} has shape {x.shape}: expected {(seeds, *shape)} for {seeds} seeds and the networks "
                f"that the settings describe; {AGAIN}"
            )
        if x.dtype not in (np.float32, np.float64) or not np.isfinite(x).all():
            raise InputError(f"{where}: {name} of type {x.dtype} holds what is no finite float32 or float64; {AGAIN}")
    if (arrays["obs_stats/var"] < 0).any() or (arrays["obs_stats/count"] < 0).any():
        raise InputError(f"{where}: obs_stats has a negative variance or count; {AGAIN}")
    tree = unflatten_dict(arrays, sep="/")
    return irl.RewardParams(tree["params"], ObsStats(**tree["obs_stats"]))


def _shapes(config: Config, obs_size: int, action_size: int) -> dict[str, tuple[int, ...]]:
    """The shape of each array of one seed's reward, by its path; nothing is computed."""
    return _shapes_of(config.hidden, config.activation, config.reward_form, config.action_part, obs_size, action_size)


@functools.lru_cache(maxsize=256)
def _shapes_of(
    hidden: tuple[int, ...], activation: str, form: str, part: str, obs_size: int, action_size: int
) -> dict[str, tuple[int, ...]]:
    config = Config(hidden=hidden, activation=activation, reward_form=form, action_part=part, shaping="none")
    params = jax.eval_shape(lambda key: discriminator.init(key, obs_size, action_size, config), jax.random.PRNGKey(0))
    stats = {"mean": np.zeros(obs_size), "var": np.zeros(obs_size), "count": np.zeros(())}
    paths, _ = jax.tree_util.tree_flatten_with_path({"params": params, "obs_stats": stats})
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf.shape for path, leaf in paths}
