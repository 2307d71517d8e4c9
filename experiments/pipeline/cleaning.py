"""Which checkpoints of finished runs can be removed: those that no command needs any more."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import filelock

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import overview, policies, records

CHECKPOINTS = "checkpoints"


@dataclass(frozen=True)
class Held:
    """The checkpoints of one run.

    Attributes:
      path: the run's folder.
      folders: of the checkpoints, its own and those of the trainings inside of it.
      size: bytes.
      reason: why they are kept; "" if they can be removed.
    """

    path: Path
    folders: tuple[Path, ...]
    size: int
    reason: str = ""


def find(directory: Path) -> Iterator[Held]:
    """The checkpoints of all runs in a folder."""
    for path in overview.find(directory):
        folders = tuple(_checkpoints(path))
        if folders:
            size = sum(file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file())
            yield Held(path, folders, size, _reason(path))


def remove(held: Held) -> str:
    """Removes the checkpoints of a run, after its policies are kept in `policy/`.

    Returns:
      Why nothing was removed; "" if it was.
    """
    try:
        with filelock.FileLock(held.path / ".lock", timeout=0):
            reason = _reason(held.path)  # it may have begun to go on meanwhile
            if reason:
                return reason
            if not _has_policies(held.path):
                policies.keep(held.path)
            for folder in held.folders:
                shutil.rmtree(folder)
    except filelock.Timeout:
        return "another process is training in it"
    except InputError as e:
        return str(e)
    return ""


def _checkpoints(path: Path) -> Iterator[Path]:
    """The folders of checkpoints in a run. Seeds that are still being added keep theirs; links are not followed."""
    for place, names, _ in os.walk(path):
        folder = Path(place)
        if folder.parent.name == records.MORE_SEEDS and not (folder / "summary.json").is_file():
            names.clear()
        elif CHECKPOINTS in names and not (folder / CHECKPOINTS).is_symlink():
            yield folder / CHECKPOINTS
        names[:] = [name for name in names if name != CHECKPOINTS]


def _reason(path: Path) -> str:
    """Why the checkpoints of a run are kept; "" if nothing needs them."""
    if not (path / "summary.json").is_file():
        return "it is not finished"
    try:
        settings = records.settings(path)
        last = policies.planned_iterations(path, settings)
    except InputError as e:
        return str(e)
    if overview.newest_checkpoint(path) > last:
        return "it goes on beyond its plan"
    if "sweep" in settings and not (path / "points").is_dir():
        return "it is a sweep of an earlier version, whose policies are in its checkpoints alone"
    return ""


def _has_policies(path: Path) -> bool:
    settings = records.settings(path)
    is_moved_policy = settings.get("rule", {}).get("kind") == "policy"  # which the learning's folder holds
    return "sweep" in settings or is_moved_policy or (path / "policy" / "policy.json").is_file()
