"""Demonstrations from columns of arrays: `.npz` files, and HDF5 files as in D4RL.

Columns are flat, `[S, ...]` with all episodes one after another, or stacked, `[E, T, ...]`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eairl_jax import storage
from eairl_jax.demonstrations import BLOCK, load
from eairl_jax.episodes import (
    AT_A_JUMP,
    AT_THE_LIMIT,
    ENDS,
    NAMES,
    UNFINISHED,
    Episode,
    Options,
    Origin,
    Read,
    completed,
    cut,
    described,
    end_of,
    flags_of,
    gather,
    last_flag,
    listed,
    named,
    rows,
)
from eairl_jax.errors import InputError
from eairl_jax.extras import required

# Columns that say where episodes begin and end, beside those of `NAMES`.
BOUNDARIES = ("lengths", "episode_starts")
# What every file of this library has.
OURS = {"task", "obs", "next_obs", "terminated"}
# The columns of an `Episode`.
STEPWISE = ("obs", "action", "next_obs", "reward")
Columns = Mapping[str, Any]


def read_npz(source: str, options: Options, task: str | None = None) -> Read:
    """Reads an `.npz`: one of this library, or named arrays, flat or stacked.

    Args:
      source: the file.
      options: how it is read.
      task: the expected task, compared in a file of this library.

    Raises:
      InputError: if the file or its arrays are no demonstrations.
    """
    with storage.archive(Path(source)) as archive:
        if set(archive.names) >= OURS:
            demos = load(source, task)
            return described(demos, Origin(source, "npz"), options)
        fields, unused = fields_of(source, archive.names)
        # An archive reads an array each time that it is asked for it.
        columns = {name: archive.array(column) for name, column in fields.items()}
    origin = Origin(source, "npz", unused=unused)
    if _is_stacked(columns):
        return gather(stacked(source, columns), origin, options)
    return gather(flat(source, columns, options.time_limit), _sized(origin, columns), options)


def read_hdf5(source: str, options: Options) -> Read:
    """Reads an HDF5 file of flat columns, as in D4RL, one episode at a time.

    Args:
      source: the file.
      options: how it is read.

    Raises:
      InputError: if the library is missing, or if the columns are no demonstrations.
    """
    h5py = required("h5py", "hdf5")
    refuse_no_file(Path(source))
    with h5py.File(source, "r") as file:
        fields, unused = fields_of(source, list(file))
        columns = {name: file[column] for name, column in fields.items()}
        origin = _sized(Origin(source, "hdf5", unused=unused), columns)
        return gather(flat(source, columns, options.time_limit), origin, options)


def refuse_no_file(path: Path) -> None:
    """Raises `InputError` unless the path is a regular file: a device or a pipe may have no end."""
    if not path.exists():
        raise InputError(f"{path} does not exist: check the path")
    if not path.is_file():
        raise InputError(f"{path} is no regular file: give a file with the episodes")


def fields_of(source: str, names: list[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """The column of each field and boundary, and the columns that belong to none.

    Raises:
      InputError: if there are no observations, or if two columns mean the same.
    """
    fields, others = named(source, {name: name for name in names})
    if "obs" not in fields:
        raise InputError(expected(source, names))
    fields |= {name: name for name in BOUNDARIES if name in others}
    return fields, tuple(name for name in others if name not in BOUNDARIES)


def expected(source: str, names: list[str]) -> str:
    """What is wrong with columns without observations."""
    known = "; ".join(" or ".join(aliases) for aliases in NAMES.values())
    return f"{source} has the columns {listed(names)}, and no observations: expected {known}"


def _sized(origin: Origin, columns: Columns) -> Origin:
    """The origin with the number of steps, where observations are one array of numbers."""
    shape = getattr(columns["obs"], "shape", None)
    return dataclasses.replace(origin, steps=int(shape[0])) if shape else origin


# Flat columns --------------------------------------------------------------------------------------------------------


class Span(NamedTuple):
    """The rows `start` to `stop` (exclusive) of one episode in flat columns, how it ended, and what was assumed."""

    start: int
    stop: int
    end: str
    remarks: tuple[str, ...] = ()


def flat(source: str, columns: Columns, time_limit: int | None) -> Iterator[Episode]:
    """Episodes of flat columns `[S, ...]`, as in D4RL. Columns are cut only, so a file is read piece by piece."""
    steps = rows(columns["obs"])
    for name, x in columns.items():
        length = rows(x)
        if name != "lengths" and length != steps:
            raise InputError(f"{source}: {name} has {length} rows, and obs {steps}: expected one row for each step")
    for span in spans(source, columns, steps, time_limit) if steps else ():
        found = {name: cut(columns[name], span.start, span.stop) for name in STEPWISE if name in columns}
        episode = completed(found, span.end)
        yield episode._replace(remarks=episode.remarks + span.remarks)


def spans(source: str, columns: Columns, steps: int, time_limit: int | None) -> list[Span]:
    """Where the episodes of flat columns begin and end.

    Args:
      source: for messages.
      columns: `terminated`, `truncated`, `done`, `episode_starts`, `lengths` and `next_obs`, those that there are.
      steps: S, the number of rows.
      time_limit: steps of the longest episode; used if nothing else says where episodes were cut off.

    Raises:
      InputError: if nothing says where episodes end, or what says it is contradictory.
    """
    flags = {
        name: flags_of(source, name, columns[name][:]).reshape(-1)
        for name in (*ENDS, "episode_starts")
        if name in columns
    }
    ends = {name: flags[name] for name in ENDS if name in flags}
    assumed: dict[int, str] = {}
    if "lengths" in columns:
        stops = _stops_of_lengths(source, np.asarray(columns["lengths"][:]), steps)
    elif "episode_starts" in flags:
        starts = np.flatnonzero(flags["episode_starts"])
        if not len(starts) or starts[0] != 0:
            raise InputError(f"{source}: episode_starts is 0 at the first step: expected 1")
        stops = np.append(starts[1:], steps)
    elif ends:
        stops, assumed = _stops_of_ends(columns, ends, time_limit)
    else:
        raise InputError(
            f"{source}: nothing says where an episode ends; found {listed(columns)}; expected terminals and "
            "timeouts, or lengths, or episode_starts, or arrays of [episodes, steps, ...]"
        )
    inside = np.setdiff1d(np.flatnonzero(flags.get("terminated", [])) + 1, stops)
    if len(inside):
        raise InputError(f"{source}: the task ended an episode at row {inside[0] - 1}, but the episode goes on")
    found = []
    for start, stop in itertools.pairwise([0, *map(int, stops)]):
        end = end_of({name: bool(x[stop - 1]) for name, x in ends.items()}, {})
        remark = assumed.get(stop, "" if ends else UNFINISHED)
        found.append(Span(start, stop, end, (remark,) if remark else ()))
    return found


def _stops_of_lengths(source: str, lengths: np.ndarray, steps: int) -> np.ndarray:
    is_whole = lengths.dtype.kind in "iu" and lengths.ndim == 1
    if not is_whole or (lengths < 1).any() or lengths.sum() != steps:
        raise InputError(
            f"{source}: lengths must be whole numbers of at least 1, [episodes], whose sum is the {steps} steps; found "
            f"{lengths.dtype} of shape {lengths.shape}" + (f", sum {lengths.sum()}" if is_whole else "")
        )
    return np.cumsum(lengths)


def _stops_of_ends(
    columns: Columns, ends: dict[str, np.ndarray], time_limit: int | None
) -> tuple[np.ndarray, dict[int, str]]:
    """Where episodes stop by their flags, and what was assumed of some stops.

    Without a column of time limits, an episode also stops where next_obs is not the obs of the next row. Without
    next_obs it stops after `time_limit` steps.
    """
    ended = np.logical_or.reduce([*ends.values()])
    steps, assumed = len(ended), {}
    if "truncated" not in ends and "next_obs" in columns:
        jumps = np.flatnonzero(_jumps(columns, steps) & ~ended)
        ended[jumps] = True
        assumed = dict.fromkeys((jumps + 1).tolist(), AT_A_JUMP)
    stops = np.flatnonzero(ended) + 1
    if not ended[-1]:
        stops = np.append(stops, steps)
        assumed[steps] = UNFINISHED
    if "truncated" not in ends and "next_obs" not in columns and time_limit is not None:
        cuts = [np.arange(a + time_limit, b, time_limit) for a, b in itertools.pairwise([0, *stops])]
        cuts = np.concatenate(cuts).astype(int)
        stops = np.union1d(stops, cuts)
        assumed |= dict.fromkeys(cuts.tolist(), AT_THE_LIMIT)
    return stops, assumed


def _jumps(columns: Columns, steps: int) -> np.ndarray:
    """`[S]` whether a row's next_obs is not the next row's obs: a reset."""
    is_jump = np.zeros(steps, bool)
    obs, next_obs = columns["obs"], columns["next_obs"]
    if isinstance(obs, Mapping):
        return is_jump
    for start in range(0, steps - 1, BLOCK):
        stop = min(start + BLOCK, steps - 1)
        different = np.asarray(next_obs[start:stop]) != np.asarray(obs[start + 1 : stop + 1])
        is_jump[start:stop] = different.reshape(stop - start, -1).any(axis=1)
    return is_jump


# Columns of [episodes, steps, ...] -----------------------------------------------------------------------------------


def _is_stacked(columns: Columns) -> bool:
    """Whether the first axis counts episodes. Rewards and actions tell it best: observations may have more axes."""
    axes = {name: np.ndim(x) for name, x in columns.items()}
    if axes["obs"] < 3:
        return False
    return axes["reward"] == 2 if "reward" in axes else axes.get("action", 3) == 3


def stacked(source: str, columns: Columns) -> Iterator[Episode]:
    """Episodes of `[E, T, ...]`; `lengths [E]` says how many rows of each are steps, if the rest is padding."""
    count = len(columns["obs"])
    different = [f"{name} {len(x)}" for name, x in columns.items() if len(x) != count]
    if different:
        raise InputError(f"{source} has {count} episodes by obs, but {', '.join(different)}: expected the same number")
    counted = [columns[name].shape[1] for name in ("reward", "action", "next_obs") if name in columns]
    longest = counted[0] if counted else columns["obs"].shape[1] - 1
    lengths = columns.get("lengths", np.full(count, longest))
    if lengths.dtype.kind not in "iu" or (lengths < 0).any() or (lengths > longest).any():
        raise InputError(f"{source}: lengths must be whole numbers of at most {longest}, the steps of each array")
    for number, steps in enumerate(lengths):
        where = f"{source}, episode {number}"
        flags = {
            name: last_flag(where, name, np.atleast_1d(columns[name][number])[:steps])
            for name in ENDS
            if name in columns
        }
        found = {name: columns[name][number][:steps] for name in STEPWISE if name in columns}
        end, remarks = end_of(flags, {}), () if flags else (UNFINISHED,)
        if "next_obs" not in found and columns["obs"].shape[1] > steps:
            obs = columns["obs"][number][: steps + 1]
            yield Episode(obs, found.get("action"), None, found.get("reward"), end, remarks)
        else:
            episode = completed(found, end)
            yield episode._replace(remarks=episode.remarks + remarks)
