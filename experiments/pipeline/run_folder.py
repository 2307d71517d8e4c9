"""A run's folder: which run it belongs to, what it holds, and the metrics it gathers."""

from __future__ import annotations

import contextlib
import csv
import datetime
import hashlib
import json
import os
import platform
import shutil
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import filelock
import jax
import numpy as np

from eairl_jax import InputError
from eairl_jax.experiments.recipes import SETTINGS
from eairl_jax.storage import read_json, write_json

MINIMUM_FREE_BYTES = 50_000_000
PACKAGES = ("eairl-jax", "jax", "brax", "mujoco", "mujoco-mjx", "flax", "optax", "orbax-checkpoint", "numpy")


class RunFolder:
    """The folder of one run.

    Opening it claims it: `config.json` is written the first time and must agree ever after, so that a command only
    ever goes on with its own run.

    Args:
      path: created if it is not there.
      settings: everything that makes this run this run; JSON values.

    Raises:
      InputError: if the folder belongs to a different run, or cannot be written.
    """

    def __init__(self, path: Path | str, settings: dict):
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            probe = self.path / ".writable"
            probe.write_text("")
            probe.unlink()
        except OSError as e:
            raise InputError(f"cannot write to {self.path} ({e.strerror}): choose another folder with --out") from None
        if shutil.disk_usage(self.path).free < MINIMUM_FREE_BYTES:
            raise InputError(f"the disk of {self.path} has less than {MINIMUM_FREE_BYTES // 10**6} MB free")
        config = self.path / "config.json"
        if config.exists():
            _refuse_different(self.path, read_json(config), settings)
        elif any(self.path.iterdir()):
            raise InputError(f"{self.path} holds files but no config.json: it is no run's folder; choose another --out")
        else:
            write_json(config, {"settings": settings, "machine": machine()})

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """While it holds, no other process trains in the folder: two would mix their metrics and checkpoints.

        Raises:
          InputError: if one does already.
        """
        try:
            with filelock.FileLock(self.path / ".lock", timeout=0):
                yield
        except filelock.Timeout:
            raise InputError(
                f"another process is training in {self.path}: wait for it, or choose another folder with --out"
            ) from None

    def summary(self) -> dict | None:
        """What the finished run wrote, or None."""
        path = self.path / "summary.json"
        return read_json(path) if path.exists() else None

    def write_summary(self, summary: dict) -> None:
        """Marks the run as finished."""
        write_json(self.path / "summary.json", summary)

    def seconds(self) -> dict[str, float]:
        """Compile and run seconds so far, over every session of this run and of the phases in its folder."""
        total = {"compile_seconds": 0.0, "run_seconds": 0.0}
        for path in self.path.rglob("seconds.json"):
            total = {name: before + read_json(path)[name] for name, before in total.items()}
        return total

    def add_seconds(self, **more: float) -> None:
        """Adds to this folder's own part of `seconds`."""
        path = self.path / "seconds.json"
        own = read_json(path) if path.exists() else {"compile_seconds": 0.0, "run_seconds": 0.0}
        write_json(path, {name: before + more.get(name, 0.0) for name, before in own.items()})

    def append_metrics(self, first_iteration: int, steps: int, labels: list[dict], metrics: dict) -> None:
        """Adds a chunk to `metrics.csv`, a row a lane and iteration; rows from a later, lost chunk are dropped.

        Args:
          first_iteration: iterations done before this chunk.
          steps: environment steps an iteration.
          labels: what tells the lanes apart, for example {"seed": 0}.
          metrics: NumPy arrays `[lanes, length]`.
        """
        path, names = self.path / "metrics.csv", sorted(metrics)
        header = [*labels[0], "iteration", "env_steps", *names]
        rows = [row for row in self.metrics() if int(row["iteration"]) <= first_iteration]
        length = next(iter(metrics.values())).shape[1]
        for t in range(length):
            done = first_iteration + t + 1
            for lane, label in enumerate(labels):
                values = {name: f"{metrics[name][lane, t]:.6g}" for name in names}
                rows.append(label | {"iteration": done, "env_steps": done * steps} | values)
        unfinished = path.with_name("metrics.csv.part")
        with open(unfinished, "w", newline="", encoding="utf-8") as f:
            writer = csv.DictWriter(f, header)
            writer.writeheader()
            writer.writerows(rows)
        os.replace(unfinished, path)

    def metrics(self) -> list[dict]:
        """The rows of `metrics.csv`, as text."""
        path = self.path / "metrics.csv"
        if not path.exists():
            return []
        with open(path, newline="", encoding="utf-8") as f:
            return list(csv.DictReader(f))

    def curve(self, name: str, lanes: int) -> np.ndarray:
        """One metric as `[lanes, iterations]`."""
        values = np.array([float(row[name]) for row in self.metrics()])
        return values.reshape(-1, lanes).T


def writable(path: Path) -> None:
    """Makes the folder of a file that is going to be written.

    Raises:
      InputError: if the file cannot be written there; better said before it is computed.
    """
    there = path.exists()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "a"):
            pass
        if not there:
            path.unlink()
    except OSError as e:
        raise InputError(f"cannot write {path} ({e.strerror}): choose another file") from None


def digest(settings: dict) -> str:
    """Six characters that tell these settings from others, for the name of a folder."""
    return hashlib.sha256(json.dumps(_essential(settings), sort_keys=True, default=str).encode()).hexdigest()[:6]


def machine() -> dict:
    """Versions and device behind a result."""
    return {
        "date": datetime.date.today().isoformat(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
        "device": jax.devices()[0].device_kind,
        "devices": len(jax.devices()),
    }


def _refuse_different(path: Path, content: dict, settings: dict) -> None:
    before, now = _essential(content.get("settings", {})), _essential(settings)
    different = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    if different:
        there, here = ({name: _default(name) for name in different} | flat for flat in (before, now))
        shown = "; ".join(f"{name}: there {there[name]!r}, here {here[name]!r}" for name in different[:4])
        raise InputError(f"{path} belongs to a different run ({shown}). Choose another --out, or remove that folder")


def _essential(settings: dict) -> dict:
    """The settings, flat, without those of training that have their default.

    So a setting that is new in this version leaves a run of an older one the run that it was.
    """
    return {name: value for name, value in _flat(settings).items() if value is None or value != _default(name)}


def _default(name: str):
    """The default of a flat setting of training, `config.hidden` or `retrain_hparams.gamma`; None of any other."""
    group, _, own = name.rpartition(".")
    default = SETTINGS.get(own) if group.endswith(("config", "hparams")) else None
    return list(default) if isinstance(default, tuple) else default


def _flat(tree: dict, prefix: str = "") -> dict:
    flat = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = list(value) if isinstance(value, tuple) else value
    return flat
