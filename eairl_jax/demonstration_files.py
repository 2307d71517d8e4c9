"""Demonstrations in the files of other libraries: `read` finds the format of a source by itself.

| source | format | library |
|---|---|---|
| `minari:NAME`, or the folder of a Minari data set | "minari" | `minari` |
| a folder saved by `datasets.save_to_disk`, with trajectories of `imitation` | "hf" | `datasets` |
| `.hdf5` or `.h5` with flat columns, as in D4RL | "hdf5" | `h5py` |
| `.npz` of this library, or with flat columns, or with `[episodes, steps, ...]` | "npz" | |
"""

from __future__ import annotations

from pathlib import Path

from eairl_jax import columns, huggingface_sets, minari_sets
from eairl_jax.episodes import Options, Read, readable
from eairl_jax.errors import InputError
from eairl_jax.minari_sets import PREFIX

FORMATS = ("minari", "hf", "hdf5", "npz")


def read(
    source: Path | str,
    format: str | None = None,
    *,
    obs_key: str | None = None,
    max_episodes: int | None = None,
    action_limit: float | None = None,
    time_limit: int | None = None,
    task: str | None = None,
) -> Read:
    """Reads demonstrations of any known format, one episode at a time: `demos, facts = read(source)`.

    Args:
      source: a file or a folder, or `minari:NAME` for a data set in the local folder of Minari.
      format: "minari", "hf", "hdf5" or "npz"; None to find it from the source.
      obs_key: of dictionary observations, the entry to use, or "flatten" for all entries in the order of their names.
      max_episodes: how many episodes are read, from the first; None for all.
      action_limit: actions outside `[-action_limit, action_limit]` are counted. Minari's data sets know their bounds.
      time_limit: steps after which the task's time limit ends an episode. Longer episodes are cut there. It also
        decides where the data do not say where or why an episode ended.
      task: the expected task. It is compared with the task in a file of this library.

    Raises:
      InputError: if the source does not exist or is damaged, if its format or its columns are unknown, if a library is
        missing, or if the data are no demonstrations for this library.
    """
    options = Options(obs_key, max_episodes, action_limit, time_limit)
    chosen = format or format_of(source)
    if chosen not in FORMATS:
        raise InputError(f"unknown format {chosen!r}: choose {', '.join(FORMATS)}")
    with readable(str(source)):
        if chosen == "minari":
            return minari_sets.read(_minari_name(str(source)), options)
        if chosen == "hf":
            return huggingface_sets.read(str(source), options)
        if chosen == "hdf5":
            return columns.read_hdf5(str(source), options)
        return columns.read_npz(str(source), options, task)


def _minari_name(source: str) -> str:
    """The name of a Minari data set, or the path of its folder; a path may lead to the file inside."""
    if source.startswith(PREFIX):
        return source.removeprefix(PREFIX)
    path = Path(source).absolute()
    return str(path.parent if path.is_file() else path)


def format_of(source: Path | str) -> str:
    """The format of a source: "minari", "hf", "hdf5" or "npz".

    Raises:
      InputError: if the source does not exist, or is none of them.
    """
    if str(source).startswith(PREFIX):
        return "minari"
    path = Path(source)
    if path.is_dir():
        if minari_sets.data_folder(path):
            return "minari"
        if any((path / name).is_file() for name in ("dataset_info.json", "dataset_dict.json")):
            return "hf"
        found = ", ".join(sorted(entry.name for entry in path.iterdir())[:6]) or "nothing"
        raise InputError(
            f"{path} holds {found}: expected the folder of a Minari data set (data/metadata.json), or a folder saved "
            "by `datasets.save_to_disk` (dataset_info.json)"
        )
    columns.refuse_no_file(path)
    if path.name == "main_data.hdf5" and minari_sets.data_folder(path.parent):
        return "minari"
    known = {".npz": "npz", ".hdf5": "hdf5", ".h5": "hdf5"}
    if path.suffix not in known:
        raise InputError(
            f"{path}: unknown suffix {path.suffix!r}; expected {', '.join(known)}, a folder, or {PREFIX}NAME; choose "
            "the format with --format (format=...)"
        )
    return known[path.suffix]
