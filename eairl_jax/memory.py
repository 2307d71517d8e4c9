"""Whether there is memory for a training, said before it begins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from eairl_jax.errors import InputError
from eairl_jax.types import PyTree

MEMINFO, CGROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


def host_free(meminfo: Path = MEMINFO, cgroup: Path = CGROUP) -> int | None:
    """Bytes of memory that a process of this host can still get; None where the system does not say.

    Args:
      meminfo: Linux' file of that name.
      cgroup: the folder with the limit of a container (cgroup v2), if there is one.
    """
    if not meminfo.is_file():
        return None
    lines = dict(line.split(":", 1) for line in meminfo.read_text().splitlines())
    free = int(lines["MemAvailable"].split()[0]) * 1024
    limit, used = cgroup / "memory.max", cgroup / "memory.current"
    if limit.is_file() and used.is_file() and limit.read_text().strip() != "max":
        free = min(free, int(limit.read_text()) - int(used.read_text()))
    return free


def device_free(device: Any) -> int | None:
    """Bytes that are free on a GPU; None where it does not say."""
    stats = device.memory_stats() or {}
    return stats["bytes_limit"] - stats["bytes_in_use"] if "bytes_limit" in stats else None


def size(tree: PyTree) -> int:
    """Bytes of all leaves, which may be shapes."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


def scratch(program: jax.stages.Compiled) -> int:
    """Bytes that a program needs on each device beside its arguments and results; 0 where XLA does not say."""
    analysis = program.memory_analysis()
    return analysis.temp_size_in_bytes if analysis else 0


def refuse_too_much(needed: int, what: str, devices: Sequence[Any]) -> None:
    """Raises `InputError` unless each of some devices of one kind has the memory.

    The cores of a host share its memory.

    Args:
      needed: bytes on each device.
      what: what the memory is for.
    """
    if devices[0].platform == "cpu":
        needed, free, where = needed * len(devices), host_free(), "on this machine"
    else:
        known = [free for free in map(device_free, devices) if free is not None]
        free, where = min(known, default=None), f"on {devices[0].device_kind}"
    if free is not None and needed > max(free, 0):
        raise InputError(
            f"{what} need {needed / 1e9:,.1f} GB of memory, and {max(free, 0) / 1e9:,.1f} GB are free {where}: train "
            "fewer seeds (or values of a sweep) at a time, or choose fewer environments (num_envs), a shorter rollout "
            "(rollout_length) or a shorter history (history, history_length)"
        )
