"""Minari data sets, https://minari.farama.org: read as demonstrations, and written so that others can read ours."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from eairl_jax.episodes import TERMINATED, TRUNCATED, Episode, Options, Origin, Read, gather
from eairl_jax.errors import InputError
from eairl_jax.extras import required
from eairl_jax.storage import read_json
from eairl_jax.types import Demonstrations

PREFIX = "minari:"
FORMATS = ("hdf5", "arrow", "parquet")
# Minari's own rule, and the version that Minari demands.
NAME = re.compile(r"(?:[-_\w][-_\w/]*[-_\w]+/)?[-_\w]+?-v\d+")


def folder_of(name: str) -> Path:
    """The folder of a data set: of a name in Minari's local folder (`MINARI_DATASETS_PATH`), or a path."""
    if _is_path(name):
        return Path(name).expanduser()
    return Path(os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets") / name


def _is_path(name: str) -> bool:
    return name.startswith((".", "/", "~")) or os.path.isabs(name)


def data_folder(folder: Path) -> Path | None:
    """The folder with the data of a Minari data set: `folder/data`, or `folder` itself; None if it is no data set."""
    for path in (folder / "data", folder):
        if (path / "metadata.json").is_file():
            return path
    return None


def read(name: str, options: Options) -> Read:
    """Reads a local Minari data set in any of Minari's forms (HDF5, Arrow, Parquet), one episode at a time.

    Args:
      name: the name of a local data set, for example "pendulum/expert-v0", or its folder.
      options: how it is read.

    Raises:
      InputError: if there is no such data set, if the library is missing, or if the data are no demonstrations.
    """
    folder = data_folder(folder_of(name))
    if folder is None:
        raise InputError(
            f"no Minari data set {name} in {folder_of(name)}: check the name with `minari list local`, or fetch the "
            f"data set with `minari download {name}`"
        )
    metadata = read_json(folder / "metadata.json")
    lacking = [key for key in ("observation_space", "action_space", "data_format") if key not in metadata]
    if lacking:
        raise InputError(
            f"{folder / 'metadata.json'} lacks {', '.join(lacking)}: an old or damaged Minari data set; download it "
            "again, or write it with Minari 0.5"
        )
    minari = required("minari", "minari")
    _require_storage(metadata["data_format"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset = minari.MinariDataset(folder)
    space = dataset.action_space
    if type(space).__name__ != "Box":
        raise InputError(
            f"{name} has actions of {space}: this library needs continuous actions, a Box; choose another data set"
        )
    is_bounded = bool(np.isfinite(space.low).all() and np.isfinite(space.high).all())
    bounds = (space.low, space.high) if is_bounded else (None, None)
    origin = Origin(f"{PREFIX}{name}", "minari", int(metadata.get("total_steps", 0)) or None, *bounds)
    return gather(_episodes(dataset, len(space.shape)), origin, options)


def _require_storage(data_format: str) -> None:
    """Raises `InputError` unless the library that stores this form is installed."""
    if data_format == "hdf5":
        required("h5py", "minari")
    else:
        required("pyarrow", "hf")


def _episodes(dataset: Any, action_axes: int) -> Iterator[Episode]:
    for number, episode in enumerate(dataset.iterate_episodes()):
        where = f"{PREFIX}{dataset.spec.dataset_id}, episode {number}"
        ended = np.flatnonzero(np.asarray(episode.terminations) | np.asarray(episode.truncations))
        steps = len(episode.rewards)
        if len(ended) and ended[0] != steps - 1:
            raise InputError(f"{where} ends at step {ended[0]}, and has {steps} steps: cut the episode after its end")
        if action_axes != 1:
            raise InputError(f"{where}: actions have {action_axes} axes; expected one vector for each step")
        is_end = bool(steps and episode.terminations[-1])
        # The space says that the actions are continuous, whatever type of number holds them.
        action = np.asarray(episode.actions)
        action = action if action.dtype.kind == "f" else action.astype(np.float64)
        yield Episode(episode.observations, action, None, episode.rewards, TERMINATED if is_end else TRUNCATED)


# Writing -------------------------------------------------------------------------------------------------------------


def write(
    name: str,
    demos: Demonstrations,
    *,
    task: str,
    action_limit: float | None = None,
    reference: tuple[float, float] | None = None,
    data_format: str = "hdf5",
    metadata: dict[str, Any] | None = None,
) -> Path:
    """Writes demonstrations as a Minari data set, which `minari.load_dataset(name)` reads. Values are not changed.

    The data set appears under its name when it is complete. One episode at a time is copied.

    Args:
      name: a name for the local folder of Minari, for example "pendulum/expert-v0", or a path whose last part is such
        a name, for example "./pendulum-v0".
      demos: with actions and rewards, which Minari demands.
      task: the name of the demonstrated task. It goes into the description.
      action_limit: the bound of the action space; it is left out if an action is outside.
      reference: true returns of random actions and of the expert, Minari's reference scores.
      data_format: "hdf5", "arrow" or "parquet".
      metadata: more entries of Minari's metadata, for example `algorithm_name`, `author`, `code_permalink`.

    Returns:
      the folder of the data set.

    Raises:
      InputError: if the name is not Minari's or is taken, if actions or rewards are missing, or if an episode's next
        observation is not the observation of its next step, so that Minari has no place for it.
    """
    folder, dataset_id = free_folder(name)
    _refuse_unfit(name, demos, data_format)
    minari = required("minari", "minari")
    _require_storage(data_format)
    storage = required("minari.dataset.minari_storage", "minari").MinariStorage
    spaces = required("gymnasium", "minari").spaces
    limit = action_limit if action_limit is not None and np.abs(demos.action).max() <= action_limit else np.inf
    description = f"Demonstrations of {task} by eairl_jax {version('eairl-jax')}."
    scores = {} if reference is None else {"ref_min_score": float(reference[0]), "ref_max_score": float(reference[1])}
    with _unfinished(folder) as unfinished, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        written = storage.new(
            unfinished / "data",
            observation_space=spaces.Box(-np.inf, np.inf, demos.obs.shape[1:], np.float32),
            action_space=spaces.Box(-limit, limit, demos.action.shape[1:], np.float32),
            data_format=data_format,
        )
        entries = {"dataset_id": dataset_id, "minari_version": version("minari"), "description": description}
        written.update_metadata(entries | {"task": task} | scores | (metadata or {}))
        written.update_episodes(_buffers(minari, demos))
    _announce_namespaces(minari, dataset_id, folder)
    return folder


def _buffers(minari: ModuleType, demos: Demonstrations) -> Iterator[Any]:
    """Minari's records of the episodes; `InputError` where the observations of an episode are not one chain."""
    stops = np.cumsum(demos.lengths)
    for number, (start, stop) in enumerate(zip(stops - demos.lengths, stops, strict=True)):
        obs, next_obs = demos.obs[start:stop], demos.next_obs[start:stop]
        broken = np.flatnonzero((obs[1:] != next_obs[:-1]).any(axis=1))
        if len(broken):
            raise InputError(
                f"episode {number}: next_obs at step {broken[0]} is not obs at step {broken[0] + 1}; Minari keeps one "
                "row of observations, so it has no place for both: write a .npz instead"
            )
        terminations = demos.terminated[start:stop] > 0
        truncations = np.zeros(len(obs), bool)
        truncations[-1] = not terminations[-1]
        yield minari.data_collector.EpisodeBuffer(
            observations=np.concatenate([obs, next_obs[-1:]]),
            actions=demos.action[start:stop],
            rewards=demos.reward[start:stop],
            terminations=terminations,
            truncations=truncations,
            infos={},
        )


def free_folder(name: str) -> tuple[Path, str]:
    """The folder that a data set is going to have, and its name in Minari.

    Raises:
      InputError: if the name is not Minari's, or is taken.
    """
    folder = folder_of(name)
    dataset_id = folder.name if _is_path(name) else name
    if not NAME.fullmatch(dataset_id):
        raise InputError(
            f"{name} is no name of a Minari data set: expected letters, digits, - and _, and a version at the end, "
            f"for example {re.sub(r'[^-_/0-9A-Za-z]', '-', dataset_id) or 'pendulum'}-v0"
        )
    if folder.exists():
        raise InputError(f"{folder} exists: choose another name or version, or remove it")
    return folder, dataset_id


def _refuse_unfit(name: str, demos: Demonstrations, data_format: str) -> None:
    if data_format not in FORMATS:
        raise InputError(f"unknown form {data_format!r} of a Minari data set: choose {', '.join(FORMATS)}")
    missing = [field for field in ("action", "reward") if getattr(demos, field) is None]
    if missing:
        raise InputError(
            f"{PREFIX}{name}: the demonstrations have no {' and no '.join(missing)}, which Minari demands: write a "
            ".npz instead"
        )


@contextlib.contextmanager
def _unfinished(folder: Path) -> Iterator[Path]:
    """A hidden folder that becomes `folder` when the block ends, and is removed if it fails."""
    unfinished = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    unfinished.mkdir(parents=True)
    try:
        yield unfinished
        os.rename(unfinished, folder)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


def _announce_namespaces(minari: ModuleType, dataset_id: str, folder: Path) -> None:
    """Minari lists the folders between its root and a data set by a file in each."""
    parents = dataset_id.split("/")[:-1]
    for path in [folder.parents[level] for level in range(len(parents))]:
        file = path / minari.namespace.NAMESPACE_METADATA_FILENAME
        if not file.exists():
            file.write_text(json.dumps({}), encoding="utf-8")
