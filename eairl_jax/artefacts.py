"""What leaves a run: a reward or a policy, as a JSON that describes it and an `.npz` of its numbers. Needs no jax.

Both are read as files of a stranger: nothing in them is executed, and every array must have the shape that the settings
in the JSON say.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import arguments, named_networks, schema, storage
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.methods import BUILT_IN, METHODS, with_method_defaults
from eairl_jax.schema import shown

FORMAT = 1
"""Of the files. A version that writes another format reads this one for ever."""
LARGEST_SIZE = 2**24
"""Of an observation or an action."""
STATS = "obs_stats"

Shapes = dict[str, tuple[int, ...]]

NEEDED = {
    "task": schema.text,
    "obs_size": schema.whole(1, LARGEST_SIZE),
    "action_size": schema.whole(1, LARGEST_SIZE),
    "seeds": schema.list_of(schema.whole(0, schema.LARGEST_SEED), low=1),
}
OPTIONAL = {
    "action_limit": schema.number(0.0),
    "method": schema.text,
    "reward_form": schema.text,
    "iterations": schema.list_of(schema.whole(0)),
    "hparams": schema.table_of(schema.number()),
}
DESCRIPTION = schema.record(NEEDED, OPTIONAL)


@dataclass(frozen=True)
class Kind:
    """A kind of artefact.

    Attributes:
      noun: "reward" or "policy"; the names of the files begin with it.
      again: how to get such a folder, for error messages.
      shapes: `(config, length of the observations that its networks read, action size)` to the shape of each array of
        one seed, by its path.
    """

    noun: str
    again: str
    shapes: Callable[[Config, int, int], Shapes]

    @property
    def title(self) -> str:
        """What the JSON calls itself."""
        return f"eairl_jax {self.noun}"


@dataclass(frozen=True)
class Contents:
    """The files of an artefact, read and checked.

    Attributes:
      description: task, sizes, method, the seed and the iteration of each function, settings.
      config: the static settings of the run.
      arrays: by their paths, each `[seeds, ...]`.
    """

    description: dict
    config: Config
    arrays: dict[str, np.ndarray]

    def row(self, seed: int) -> dict[str, np.ndarray]:
        """The arrays of one seed, by its position."""
        return {name: x[seed] for name, x in self.arrays.items()}


def mlp_shapes(path: str, inputs: int, hidden: tuple[int, ...], outputs: int, layer_norm: bool) -> Shapes:
    """The weights of a multilayer perceptron (`nets.MLP`)."""
    shapes: Shapes = {}
    widths = (inputs, *hidden, outputs)
    for i, (before, after) in enumerate(itertools.pairwise(widths)):
        shapes |= {f"{path}/MLP_0/Dense_{i}/kernel": (before, after), f"{path}/MLP_0/Dense_{i}/bias": (after,)}
    for i, width in enumerate(hidden if layer_norm else ()):
        shapes |= {f"{path}/MLP_0/LayerNorm_{i}/{name}": (width,) for name in ("scale", "bias")}
    return shapes


def scalar_shapes(path: str, inputs: int, config: Config) -> Shapes:
    """The weights of the network of a reward (`nets.scalar`) in the arrays below `path`.

    Raises:
      InputError: if the settings name a network that the program does not know.
    """
    if config.net == named_networks.MLP:
        return mlp_shapes(f"{path}/params", inputs, config.hidden, 1, config.layer_norm)
    named_networks.network(config.net)
    nets = importlib.import_module("eairl_jax.nets")  # imports jax, which no other network needs
    return {f"{path}/{name}": shape for name, shape in nets.scalar(config).shapes(inputs).items()}


def stats_shapes(obs_size: int) -> Shapes:
    """The normaliser of observations (`normalize.ObsStats`)."""
    return {f"{STATS}/mean": (obs_size,), f"{STATS}/var": (obs_size,), f"{STATS}/count": ()}


def reward_shapes(config: Config, obs_size: int, action_size: int) -> Shapes:
    """The arrays of `irl.RewardParams`."""
    config = with_method_defaults(config)
    form, part = config.reward_form, config.action_part
    shapes = scalar_shapes("params/g", obs_size + (action_size if form == "sa" else 0), config)
    if form == "separable":
        quadratic = part == "quadratic"
        shapes |= {"params/k/raw_cost": ()} if quadratic else scalar_shapes("params/k", action_size, config)
    return shapes | stats_shapes(obs_size)


def policy_shapes(config: Config, obs_size: int, action_size: int) -> Shapes:
    """The arrays of `saved_policy.PolicyParams`."""
    outputs = 2 * action_size if config.state_dependent_std else action_size
    shapes = mlp_shapes("actor/params", obs_size, config.policy_hidden, outputs, config.policy_layer_norm)
    if not config.state_dependent_std:
        shapes["actor/params/raw_log_std"] = (action_size,)
    return shapes | {"log_std_offset": ()} | stats_shapes(obs_size)


REWARD = Kind("reward", "save the reward again, or use the reward/ folder of a finished run", reward_shapes)
POLICY = Kind("policy", "save the policy again, or use the policy/ folder of a finished run", policy_shapes)


def write(directory: Path, kind: Kind, contents: Contents) -> None:
    """Writes both files into a folder, which is created.

    Raises:
      InputError: if `read` would refuse them.
    """
    config = contents.config
    if kind is REWARD and config.method not in BUILT_IN:
        config = with_method_defaults(config)  # a program that reads the file does not know what the defaults are
    version = {"kind": kind.title, "format": FORMAT}
    content = version | contents.description | {"config": dataclasses.asdict(config)}
    content = storage.as_json(content, schema.table_of(schema.anything), "the description")
    description, config = _checked_description(content, kind, "the description")
    _check_arrays(contents.arrays, description, config, kind, "params")
    directory.mkdir(parents=True, exist_ok=True)
    storage.write_arrays(directory / f"{kind.noun}.npz", contents.arrays)
    storage.write_json(directory / f"{kind.noun}.json", storage.sealed(content, contents.arrays))


def read(directory: Path | str, kind: Kind, net: Callable[[], Any] | None = None) -> Contents:
    """Reads both files.

    Args:
      net: the network that the settings name (`named_networks`), if the program does not know it yet.

    Raises:
      InputError: if the folder does not hold a complete artefact of the kind, or if the arrays do not fit the settings.
    """
    path = Path(directory) / f"{kind.noun}.json"
    if not path.exists():
        raise InputError(f"{directory} holds no {path.name}: use the {kind.noun}/ folder of a finished run")
    content = storage.read_json(path, advice=kind.again)
    plain = {name: value for name, value in content.items() if name not in (storage.CHECKSUM, storage.SEALED)}
    description, config = _checked_description(plain, kind, path)
    if net is not None and config.net == named_networks.MLP:
        raise InputError(f"{path} names no network of yours: leave net out")
    arrays = storage.read_arrays(path.with_suffix(".npz"))
    with named_networks.known(config.net, net):
        _check_arrays(arrays, description, config, kind, path.with_suffix(".npz"))
    storage.unsealed(content, Path(directory), arrays)
    return Contents(description, config, arrays)


def refuse_other_sizes(description: dict, noun: str, obs_size: int, action_size: int, where: str) -> None:
    """Checks that observations and actions have the sizes of an artefact.

    Args:
      where: the origin of the sizes, for the error message.

    Raises:
      InputError: if a size differs.
    """
    sizes = description["obs_size"], description["action_size"]
    if sizes != (obs_size, action_size):
        raise InputError(
            f"this {noun} was learned on {description['task']} (observations of length {sizes[0]}, actions of "
            f"length {sizes[1]}), but {where} has observations of length {obs_size} and actions of length "
            f"{action_size}: use the {noun} on a task with the same lengths"
        )


def _checked_description(content: dict, kind: Kind, where: Path | str) -> tuple[dict, Config]:
    """The description and the settings.

    Raises:
      InputError: if a member is missing or impossible.
    """
    content = dict(content)
    if content.pop("kind", None) != kind.title:
        what = "a learned reward" if kind is REWARD else f"a {kind.noun}"
        raise InputError(f"{where} does not describe {what}: use the {kind.noun}/ folder of a finished run")
    version = content.pop("format", FORMAT)
    if type(version) is not int or not 1 <= version <= FORMAT:
        raise InputError(f"{where} has the format {shown(version)}, and this version reads {FORMAT}: update eairl_jax")
    if "config" not in content:
        raise InputError(f"{where} lacks config: {kind.again}")
    config = Config.from_json(content.pop("config"), where)
    description = storage.check(content, DESCRIPTION, where, kind.again)
    said = {"method": config.method}
    if config.method in METHODS:
        said["reward_form"] = with_method_defaults(config).reward_form
    iterations = description.get("iterations", description["seeds"])
    for name, value in said.items():
        if description.get(name, value) != value:
            raise InputError(
                f"{where}: {name} is {shown(description[name])}, and the config says {value!r}: {kind.again}"
            )
    if len(iterations) != len(description["seeds"]):
        raise InputError(f"{where}: {len(iterations)} iterations of {len(description['seeds'])} seeds: {kind.again}")
    return description, config


def _check_arrays(
    arrays: dict[str, np.ndarray], description: dict, config: Config, kind: Kind, where: Path | str
) -> None:
    """Raises `InputError` unless the arrays `[seeds, ...]` are finite, and those that the settings describe."""
    obs_size, seeds = _read_obs_size(arrays, description["obs_size"], config), len(description["seeds"])
    network = named_networks.NETWORKS.get(config.net)
    needed = _shapes(kind, config, obs_size, description["action_size"], network)
    missing, extra = sorted(set(needed) - set(arrays)), sorted(set(arrays) - set(needed))
    if missing or extra:
        what = f"lacks {schema.listed(missing)}" if missing else f"holds {schema.listed(extra)}, which no network has"
        raise InputError(f"{where} {what}: the settings beside it describe other networks; {kind.again}")
    for name, shape in needed.items():
        x = arrays[name]
        if x.shape != (seeds, *shape):
            raise InputError(
                f"{where}: {name} has shape {x.shape}: expected {(seeds, *shape)} for {seeds} seeds and the networks "
                f"that the settings describe; {kind.again}"
            )
        if x.dtype not in (np.float32, np.float64) or not np.isfinite(x).all():
            raise InputError(
                f"{where}: {name} of type {x.dtype} holds what is no finite float32 or float64; {kind.again}"
            )
    if (arrays[f"{STATS}/var"] < 0).any() or (arrays[f"{STATS}/count"] < 0).any():
        raise InputError(f"{where}: {STATS} has a negative variance or count; {kind.again}")


@functools.lru_cache(maxsize=256)
def _shapes(kind: Kind, config: Config, obs_size: int, action_size: int, network: Any) -> Shapes:
    del network  # what was computed for another network of the same name is not used
    return kind.shapes(config, obs_size, action_size)


def _read_obs_size(arrays: dict[str, np.ndarray], obs_size: int, config: Config) -> int:
    """The length of the observations that the networks read: with an absorbing state one more than the task's."""
    more = {"absorbing": (1,), "default": (0, 1)}.get(config.horizon, (0,))
    found = next((np.shape(x)[-1:] for name, x in arrays.items() if name == f"{STATS}/mean"), None)
    return next((obs_size + n for n in more if found == (obs_size + n,)), obs_size + more[0])


def seed_row(seed: Any, seeds: int, noun: str) -> int:
    """The position of a seed as a Python number.

    Raises:
      InputError: if the run had fewer seeds.
    """
    try:
        return arguments.count("seed", seed, -seeds, seeds - 1)
    except InputError:
        raise InputError(
            f"seed = {shown(seed)}: the run of this {noun} had {seeds} seeds; expected 0 to {seeds - 1}"
        ) from None
