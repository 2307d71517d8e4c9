"""What the folders of runs hold, read quickly: nothing is computed, and jax is not imported."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eairl_jax import InputError, schema
from eairl_jax.experiments.pipeline import records
from eairl_jax.storage import read_json

DEEPEST = 4  # folders between the folder that is searched and a run
TAIL_BYTES = 1 << 16
SUMMARY = schema.record(
    {},
    {
        "returns": schema.list_of(schema.optional(schema.number()), low=1),
        "normalized": schema.optional(schema.number()),
        "seeds": records.SEEDS,
        "more_iterations": schema.whole(0, 2**31 - 1),
    },
)


@dataclass(frozen=True)
class Overview:
    """One run.

    Attributes:
      folder: its path.
      task: where it learns; of a transfer "source to target".
      method: with the reward form, if it is not the method's own; "expert", "ceiling" or "saved reward" for
        reinforcement learning.
      seeds: how many.
      done: iterations of the newest checkpoint.
      planned: iterations of the whole run.
      score: mean true return; of an unfinished run that of its last iteration; None if there is none yet.
      normalized: the score, 0 for random actions and 1 for the expert; None if unknown.
      is_finished: whether it has a result.
      changed: when its files were written last, in seconds since 1970.
      size: bytes.
      problem: why the folder could not be read; "" if it could.
    """

    folder: str
    task: str = ""
    method: str = ""
    seeds: int = 0
    done: int = 0
    planned: int = 0
    score: float | None = None
    normalized: float | None = None
    is_finished: bool = False
    changed: float = 0.0
    size: int = 0
    problem: str = ""


def find(directory: Path) -> Iterator[Path]:
    """The folders of runs in a folder: those with a `config.json`. Folders inside of a run are its own matter."""
    yield from _find(directory, DEEPEST)


def _find(directory: Path, depth: int) -> Iterator[Path]:
    try:
        entries = sorted(os.scandir(directory), key=lambda entry: entry.name)
    except OSError:
        return
    if any(entry.name == "config.json" for entry in entries):
        yield directory
    elif depth:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _find(directory / entry.name, depth - 1)


def read(path: Path, name: str) -> Overview:
    """What a run's folder holds; a damaged one is described by its `problem`.

    Args:
      name: what to call the folder.
    """
    size, changed = _size_and_change(path)
    try:
        settings = records.settings(path)
        summary = path / "summary.json"
        content = read_json(summary, SUMMARY, records.AGAIN) if summary.is_file() else None
        return _overview(path, name, settings, content, size, changed)
    except InputError as e:
        return Overview(name, size=size, changed=changed, problem=str(e))


def _overview(path: Path, name: str, settings: dict, summary: dict | None, size: int, changed: float) -> Overview:
    is_transfer = "retrain_config" in settings
    config = settings.get("retrain_config" if is_transfer else "config", {})
    seeds = settings.get("seeds", 0)
    planned = config.get("iterations", 0)
    planned = (planned if type(planned) is int else 0) + (summary or {}).get("more_iterations", 0)
    if summary is not None and (path / records.MORE_SEEDS).is_dir():
        seeds = summary.get("seeds", seeds)
    score = normalized = None
    if summary is not None:
        returns = [value for value in summary.get("returns", []) if value is not None]
        score, normalized = (float(np.mean(returns)) if returns else None), summary.get("normalized")
    else:
        score = _last_return(path / "metrics.csv")
    return Overview(
        name,
        " to ".join(filter(None, (settings.get("task", ""), settings.get("target", "")))),
        _method(settings),
        seeds if isinstance(seeds, int) else len(seeds),
        planned if summary is not None else newest_checkpoint(path),
        planned,
        score,
        normalized,
        summary is not None,
        changed,
        size,
    )


def _method(settings: dict) -> str:
    if "demonstrations" not in settings:
        kinds = {None: "expert", "true": "ceiling"}  # of a ceiling, the reward is the true one
        return kinds.get(settings.get("reward"), "saved reward")
    config = settings.get("config", {})
    method, form = str(config.get("method", "")), str(config.get("reward_form", "default"))
    name = method if form == "default" else f"{method}-{form}"
    return f"{name}, sweep" if "sweep" in settings else name


def newest_checkpoint(path: Path) -> int:
    """The iteration of a run's newest checkpoint; 0 if there is none."""
    try:
        names = [entry.name for entry in os.scandir(path / "checkpoints")]
    except OSError:
        return 0
    return max((int(name) for name in names if name.isdecimal()), default=0)


def _last_return(metrics: Path) -> float | None:
    """The mean over the seeds of the last iteration's true return; None if there is none."""
    try:
        with open(metrics, "rb") as file:
            header = file.readline(TAIL_BYTES).decode()
            file.seek(max(len(header), os.fstat(file.fileno()).st_size - TAIL_BYTES))
            lines = file.read(TAIL_BYTES).decode(errors="replace").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    columns = next(csv.reader([header]), [])
    if not {"iteration", "true_return"} <= set(columns):
        return None
    at = columns.index("iteration"), columns.index("true_return")
    last: dict[str, list[float]] = {}
    for row in csv.reader(lines):
        if len(row) == len(columns):
            try:
                last.setdefault(row[at[0]], []).append(float(row[at[1]]))
            except ValueError:
                continue
    finite = [[x for x in values if np.isfinite(x)] for values in last.values()]
    return next((float(np.mean(values)) for values in reversed(finite) if values), None)


def _size_and_change(path: Path) -> tuple[int, float]:
    """Bytes of all files below a folder, and when one of those beside `config.json` was written last."""
    size, changed, folders = 0, 0.0, [os.fspath(path)]
    while folders:
        folder = folders.pop()
        try:
            entries = list(os.scandir(folder))
        except OSError:
            continue
        for entry in entries:
            try:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                    continue
                status = entry.stat(follow_symlinks=False)
            except OSError:
                continue
            size += status.st_size
            if folder == os.fspath(path) and entry.name != ".lock":
                changed = max(changed, status.st_mtime)
    return size, changed
