"""A run's folder: which run it belongs to, what it holds, and the metrics that it gathers."""

from __future__ import annotations

import contextlib
import csv
import datetime
import hashlib
import json
import os
import platform
import resource
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from importlib.metadata import version
from pathlib import Path
from typing import Any

import filelock
import jax
import numpy as np

from eairl_jax import InputError, processes
from eairl_jax.experiments.pipeline import records
from eairl_jax.experiments.pipeline.trackers import Track
from eairl_jax.experiments.settings import SETTINGS, TRIALS, Recipe
from eairl_jax.schema import Schema
from eairl_jax.storage import naming, read_json, replacing, write_json

SECONDS_ADVICE = "remove the file; its seconds are then not counted"
MINIMUM_FREE_BYTES = 50_000_000
LOCK = ".lock"
BYTE_ORDER_MARK = "\ufeff"
# Defaults that have changed. The folders of runs are named after the settings that differ from these values.
FORMER_DEFAULTS = {"episode_length": 100}
PACKAGES = ("eairl-jax", "jax", "brax", "mujoco", "mujoco-mjx", "flax", "optax", "orbax-checkpoint", "numpy")

WAITS: ContextVar[bool] = ContextVar("WAITS", default=False)
"""Whether a training waits while another process trains in its folder: jobs of a cluster share those of ceilings."""


class RunFolder:
    """The folder of one run.

    The first run that opens a folder claims it: `config.json` is written and must agree whenever the folder is opened
    again. So a command only ever goes on with its own run. A claimed folder is only read until something is trained.

    Args:
      path: created if it does not exist.
      settings: everything that makes this run different from any other; JSON values.
      track: who is told of each chunk of a training in this folder (`trackers.tracked`).

    Raises:
      InputError: if the folder belongs to a different run, or if it is new and cannot be written.
    """

    def __init__(self, path: Path | str, settings: dict, track: Sequence[Track] = ()):
        self.path, self.settings, self.track = Path(path), settings, tuple(track)
        config = self.path / "config.json"
        if config.exists():  # nothing is written: a run can be read where nobody may write
            refuse_different(self.path, records.settings(self.path), settings)
            return
        self.prepare()
        if any(path.name != "config.json.part" for path in self.path.iterdir()):  # a kill leaves this file
            raise InputError(
                f"{self.path} holds files but no config.json, so it is no run's folder: choose another with --out"
            )
        write_json(config, {"settings": settings, "machine": machine()})

    def prepare(self) -> None:
        """Makes the folder, and tries whether it can be written (`prepare`)."""
        prepare(self.path)

    def is_writable(self) -> bool:
        """Whether files can be added. The pictures of a finished run are left out where they cannot."""
        return os.access(self.path, os.W_OK)

    def locked(self) -> contextlib.AbstractContextManager[None]:
        """Keeps other processes from training in the folder (`locked`)."""
        return locked(self.path)

    def summary(self, expected: Schema | None = None) -> dict | None:
        """What the finished run wrote, or None if the run is not finished.

        Args:
          expected: what the summary must look like.
        """
        path = self.path / "summary.json"
        return read_json(path, expected, records.AGAIN) if path.exists() else None

    def write_summary(self, summary: dict) -> None:
        """Marks the run as finished.

        Raises:
          InputError: if the folder was removed meanwhile.
        """
        self._refuse_removed()
        write_json(self.path / "summary.json", summary)

    def seconds(self) -> dict[str, float]:
        """Seconds of compiling and running so far, over all sessions of this run and of the phases in its folder."""
        total = {"compile_seconds": 0.0, "run_seconds": 0.0}
        for path in self.path.rglob("seconds.json"):
            phase = read_json(path, records.SECONDS, SECONDS_ADVICE)
            total = {name: seconds + phase[name] for name, seconds in total.items()}
        return total

    def add_seconds(self, compile_seconds: float = 0.0, run_seconds: float = 0.0) -> None:
        """Adds to this folder's part of `seconds`."""
        path = self.path / "seconds.json"
        more = {"compile_seconds": compile_seconds, "run_seconds": run_seconds}
        before = read_json(path, records.SECONDS, SECONDS_ADVICE) if path.exists() else dict.fromkeys(more, 0.0)
        write_json(path, {name: before[name] + seconds for name, seconds in more.items()})

    def dropped(self) -> list[dict]:
        """The lanes that were dropped because a value was not finite (`divergence`), in the order of dropping."""
        path = self.path / "dropped.json"
        return read_json(path, records.DROPPED, records.AGAIN)["dropped"] if path.exists() else []

    def drop(self, entries: list[dict]) -> None:
        """Adds entries of `divergence.entry` that are not there."""
        before = self.dropped()
        new = [each for each in entries if each not in before]
        if new:
            write_json(self.path / "dropped.json", {"dropped": before + new})

    # Metrics ---------------------------------------------------------------------------------------------------------

    def append_metrics(
        self, first_iteration: int, steps: int, labels: list[dict], metrics: dict[str, np.ndarray]
    ) -> None:
        """Appends a chunk to `metrics.csv`: a line for each lane and iteration.

        Args:
          first_iteration: iterations done before this chunk.
          steps: environment steps of an iteration.
          labels: what tells the lanes apart, for example {"seed": 0}.
          metrics: NumPy arrays `[lanes, length]`.

        Raises:
          InputError: if the folder was removed while it was trained in, or if the file has other columns.
          OSError: if the file cannot be written, with its path.
        """
        self._refuse_removed()
        path, names = self.path / "metrics.csv", sorted(metrics)
        length = next(iter(metrics.values())).shape[1]
        is_new, header = not path.exists(), [*labels[0], "iteration", "env_steps", *names]
        if not is_new:
            self._refuse_other_columns(header)
        with naming(path), open(path, "a", newline="", encoding="utf-8") as f:
            writer = csv.writer(f)
            if is_new:
                writer.writerow(header)
            for t in range(length):
                iteration = first_iteration + t + 1
                for lane, label in enumerate(labels):
                    values = (f"{metrics[name][lane, t]:.6g}" for name in names)
                    writer.writerow([*label.values(), iteration, iteration * steps, *values])

    def keep_metrics(self, count: int, labels: list[dict]) -> None:
        """Keeps the first `count` lines of `metrics.csv`: later ones are of a chunk whose checkpoint was never written.

        The last of the dropped lines may be torn; the kept ones are whole, since a checkpoint follows its metrics.

        Args:
          labels: what tells the lanes apart, as in `append_metrics`.

        Raises:
          InputError: if the file is gone, or if its first `count` lines are not what a training wrote.
        """
        path = self.path / "metrics.csv"
        if count == 0:
            path.unlink(missing_ok=True)
            return
        advice = "bring the file back, or remove the folder to begin anew"
        if not path.exists():
            raise InputError(f"{path} is missing, and with it the {count} lines before the last checkpoint: {advice}")
        try:
            lines = path.read_bytes().decode("utf-8").splitlines(keepends=True)
        except UnicodeDecodeError as e:
            raise InputError(f"{path} is no text ({e}): {advice}") from None
        has_mark = bool(lines) and lines[0].startswith(BYTE_ORDER_MARK)
        if has_mark:  # an editor has added it
            lines[0] = lines[0].removeprefix(BYTE_ORDER_MARK)
        _check_lines(path, lines[: count + 1], count, labels, advice)
        if len(lines) == count + 1 and not has_mark:
            return
        with replacing(path) as unfinished, open(unfinished, "w", newline="", encoding="utf-8") as f:
            f.writelines(lines[: count + 1])

    def _refuse_removed(self) -> None:
        if not (self.path / "config.json").exists():
            raise InputError(
                f"{self.path} was removed, or has lost its config.json, while its command was running: bring it back "
                "and repeat the command to go on; without it, what was computed is lost, and the command begins anew"
            )

    def _refuse_other_columns(self, header: list[str]) -> None:
        with open(self.path / "metrics.csv", newline="", encoding="utf-8") as f:
            there = next(csv.reader(f), [])
        if there != header:
            other = sorted(set(there) ^ set(header)) or ["their order"]
            raise InputError(
                f"{self.path}/metrics.csv has other columns than this training writes ({', '.join(other)}): bring the "
                "file back as it was, or remove the folder to begin anew"
            )

    def metrics(self) -> list[dict[str, str]]:
        """The lines of `metrics.csv`, as text."""
        path = self.path / "metrics.csv"
        if not path.exists():
            return []
        with open(path, newline="", encoding="utf-8") as f:
            return list(csv.DictReader(f))

    def curve(self, name: str, lanes: int) -> np.ndarray:
        """One metric as `[lanes, iterations]`. Of a long file, only this column is held in memory."""
        path = self.path / "metrics.csv"
        if not path.exists():
            return np.zeros((lanes, 0))
        with open(path, newline="", encoding="utf-8") as f:
            rows = csv.reader(f)
            at = next(rows).index(name)
            values = np.fromiter((float(row[at]) for row in rows), float)
        return values.reshape(-1, lanes).T


def prepare(path: Path) -> None:
    """Makes a folder, and tries whether it can be written. It is better to fail before anything is computed.

    Raises:
      InputError: if it cannot be written, or if its disk is nearly full.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.write_text("")
        probe.unlink()
    except OSError as e:
        raise InputError(f"cannot write to {path} ({e.strerror}): choose another folder with --out") from None
    if shutil.disk_usage(path).free < MINIMUM_FREE_BYTES:
        raise InputError(
            f"the disk of {path} has less than {MINIMUM_FREE_BYTES // 10**6} MB free: free some space, or "
            "choose another folder with --out"
        )


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keeps other processes from training in a folder: they would mix their metrics and checkpoints.

    What a killed process has left of a file that it was writing (`storage.replacing`) is removed.

    Raises:
      InputError: if another process is training in the folder (with `WAITS` its end is waited for), or if the folder
        cannot be written.
    """
    prepare(path)
    try:
        with filelock.FileLock(path / LOCK, timeout=-1 if WAITS.get() else 0):
            for unfinished in path.glob("*.part"):
                unfinished.unlink(missing_ok=True)
            yield
    except filelock.Timeout:
        raise InputError(
            f"another process is training in {path}: wait for it, or choose another folder with --out"
        ) from None


def _check_lines(path: Path, lines: list[str], count: int, labels: list[dict], advice: str) -> None:
    """Raises `InputError` unless the lines are a header and `count` whole lines of lanes and iterations in order."""
    rows = list(csv.reader(lines))
    first = [*labels[0], "iteration", "env_steps"]
    if not rows or rows[0][: len(first)] != first:
        raise InputError(f"{path}: its first line is not {','.join(first)},...: {advice}")
    if len(rows) != count + 1:
        raise InputError(f"{path} has {len(rows) - 1} lines of metrics, and the last checkpoint {count}: {advice}")
    start = None
    for number, row in enumerate(rows[1:]):
        step, lane = divmod(number, len(labels))
        try:
            values = [float(value) for value in row]
        except ValueError:
            values = []
        start = values[len(first) - 2] - step if start is None and values else start
        expected = [*(float(value) for value in labels[lane].values()), (start or 0) + step]
        if len(values) != len(rows[0]) or values[: len(first) - 1] != expected:
            raise InputError(f"{path}, line {number + 2}: expected the metrics of a lane and an iteration: {advice}")


def check_writable(path: Path) -> None:
    """Makes the folder of a file that is going to be written. It is better to fail before the file is computed.

    Raises:
      InputError: if the file cannot be written.
    """
    is_there = path.exists()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "a"):
            pass
        if not is_there:
            path.unlink()
    except OSError as e:
        raise InputError(f"cannot write {path} ({e.strerror}): choose another file") from None


def settings_digest(settings: dict) -> str:
    """Six characters that tell these settings from others, for the name of a folder."""
    return hashlib.sha256(json.dumps(_essential(settings), sort_keys=True, default=str).encode()).hexdigest()[:6]


def machine() -> dict[str, Any]:
    """Versions and devices behind a result."""
    team = processes.current()
    return {
        "date": datetime.date.today().isoformat(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
        "device": jax.local_devices()[0].device_kind,
        "devices": sum(team.devices) if team else jax.local_device_count(),
        **({"processes": len(team.devices)} if team else {}),
    }


def peak_memory_gb() -> float:
    """The most memory that this process has held, in GB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


def refuse_different(path: Path, content: dict, settings: dict) -> None:
    """Raises `InputError` if the settings in a folder, `content`, are those of another run."""
    before, now = _essential(content), _essential(settings)
    different = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    if different:
        defaults = {name: _default(name) for name in different}
        there, here = defaults | before, defaults | now
        shown = "; ".join(f"{name}: there {there[name]!r}, here {here[name]!r}" for name in different[:4])
        raise InputError(
            f"{path} belongs to a different run ({shown}): choose another folder with --out, or remove that folder"
        )


def _essential(settings: dict) -> dict:
    """The settings as one flat dict, without those that have their default.

    A setting that is new in this version is thus absent both here and in the `config.json` of an older version's run.
    """
    return {name: value for name, value in flat(settings).items() if value is None or value != _default(name)}


def _default(name: str) -> Any:
    """The default of a flat setting of training (`config.hidden`, `retrain_hparams.gamma`, `trials`), else None."""
    if name in TRIALS:
        return getattr(Recipe, name)
    group, _, setting = name.rpartition(".")
    if setting in FORMER_DEFAULTS:
        return FORMER_DEFAULTS[setting]
    default = SETTINGS.get(setting) if group.endswith(("config", "hparams")) else None
    return list(default) if isinstance(default, tuple) else default


def flat(tree: dict, prefix: str = "") -> dict:
    """A tree of settings as one dict: `config.gamma` for the member `gamma` of the member `config`."""
    leaves = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves |= flat(value, f"{prefix}{key}.")
        else:
            leaves[prefix + key] = list(value) if isinstance(value, tuple) else value
    return leaves
