"""Trajectories that `imitation` saved: a data set of HuggingFace's `datasets` with one row for each trajectory."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from eairl_jax.columns import STEPWISE, expected
from eairl_jax.episodes import (
    ENDS,
    UNFINISHED,
    Episode,
    Options,
    Origin,
    Read,
    end_of,
    gather,
    last_flag,
    listed,
    named,
)
from eairl_jax.errors import InputError
from eairl_jax.extras import required


def read(source: str, options: Options) -> Read:
    """Reads a folder saved by `datasets.save_to_disk`, one trajectory at a time.

    The columns are `obs [T + 1, obs]`, `acts [T, act]`, `terminal`, and optionally `rews [T]` and `infos [T]`.
    `terminal` does not tell a time limit from an end by the task. `infos` does, where Stable-Baselines3 wrote
    "TimeLimit.truncated".

    Args:
      source: the folder.
      options: how it is read.

    Raises:
      InputError: if the library is missing, or if the columns are no trajectories.
    """
    datasets = required("datasets", "hf")
    with _quiet(datasets):
        dataset = datasets.load_from_disk(source)
    if isinstance(dataset, Mapping):
        raise InputError(f"{source} has the splits {listed(dataset)}: give one, e.g. {source}/{next(iter(dataset))}")
    names = {name: name for name in dataset.column_names}
    fields, unused = named(source, names)
    if "obs" not in fields:
        raise InputError(expected(source, dataset.column_names))
    unused = tuple(name for name in unused if name != "infos")
    return gather(_trajectories(dataset.with_format("arrow"), fields), Origin(source, "hf", unused=unused), options)


@contextlib.contextmanager
def _quiet(datasets: Any) -> Iterator[None]:
    """Keeps `datasets` from drawing progress bars."""
    was_on = datasets.is_progress_bar_enabled()
    datasets.disable_progress_bars()
    try:
        yield
    finally:
        if was_on:
            datasets.enable_progress_bars()


def _trajectories(dataset: Any, fields: Mapping[str, str]) -> Iterator[Episode]:
    """One episode for each row, as `imitation` saves them."""
    for number in range(len(dataset)):
        row, where = dataset[number], f"row {number}"
        values = {name: _first(_values(f"{where}, {column}", row.column(column))) for name, column in fields.items()}
        axes = {name: 9 if isinstance(x, dict) else np.ndim(x) for name, x in values.items()}
        if axes["obs"] < 2 or axes.get("action", 9) < 1 or axes.get("reward", 9) < 1:
            raise InputError(
                f"{where}: {fields['obs']} is one observation; expected one row of the data set for each trajectory, "
                "as `imitation` saves them"
            )
        flags = {name: last_flag(where, name, values[name]) for name in ENDS if name in values}
        info = _last_info(row.column("infos")[0].as_py()) if "infos" in row.column_names else {}
        columns = {name: values.get(name) for name in STEPWISE}
        yield Episode(**columns, end=end_of(flags, info), remarks=() if flags else (UNFINISHED,))


def _first(x: Any) -> Any:
    return {key: _first(value) for key, value in x.items()} if isinstance(x, dict) else x[0]


def _last_info(infos: Any) -> Mapping[str, Any]:
    """The last `info` of a trajectory. `imitation` stores JSON; the objects in it are never made."""
    last = infos[-1] if isinstance(infos, list) and infos else {}
    if isinstance(last, str):
        with contextlib.suppress(json.JSONDecodeError, RecursionError):
            last = json.loads(last)
    return last if isinstance(last, dict) else {}


def _values(where: str, array: Any) -> Any:
    """The numbers of an Arrow array of nested lists `[n, ...]`, without a Python object for each number.

    Raises:
      InputError: if lists that should be rows have different lengths, or values are missing.
    """
    pa = required("pyarrow", "hf")
    if isinstance(array, pa.ChunkedArray):
        array = array.combine_chunks()
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    if array.null_count:
        raise InputError(f"{where} has missing values (null): remove these trajectories")
    if pa.types.is_null(array.type):
        return np.zeros(len(array))  # an empty list: it says nothing of its type
    if pa.types.is_struct(array.type):
        return {field.name: _values(f"{where}.{field.name}", array.field(i)) for i, field in enumerate(array.type)}
    if not hasattr(array, "flatten"):  # no list of any kind
        return array.to_numpy(zero_copy_only=False)
    inner = _values(where, array.flatten())
    lengths = np.diff(array.offsets.to_numpy()) if hasattr(array, "offsets") else [array.type.list_size] * len(array)
    if len(set(map(int, lengths))) > 1:
        raise InputError(f"{where} holds rows of different lengths, {sorted(set(map(int, lengths)))[:4]}: expected one")
    if isinstance(inner, dict):
        return {key: x.reshape(len(array), -1, *x.shape[1:]) for key, x in inner.items()}
    return inner.reshape(len(array), int(lengths[0]) if len(lengths) else 0, *inner.shape[1:])
