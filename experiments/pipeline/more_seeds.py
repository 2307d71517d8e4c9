"""Seeds that were added to a run: each group is a run of its own, in a folder inside of the run's folder."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import jax
import numpy as np

from eairl_jax import LearnedReward
from eairl_jax.experiments.pipeline.records import MORE_SEEDS


def groups(path: Path, seeds: range, count: int) -> list[range]:
    """The groups of seeds that a run must have, those that it has first.

    Args:
      path: the run's folder.
      seeds: of the run itself.
      count: how many seeds are asked for beyond them. With 0 a group that is not finished is left out.
    """
    found = [group for group in begun(path) if count or (folder(path, group) / "summary.json").is_file()]
    end = max((group.stop for group in found), default=seeds.stop)
    missing = seeds.stop + count - end
    return [*found, range(end, end + missing)] if missing > 0 else found


def begun(path: Path) -> list[range]:
    """The groups that have a folder in a run's folder, in the order of their seeds."""
    names = (re.fullmatch(r"(\d+)-(\d+)", each.name) for each in (path / MORE_SEEDS).glob("*-*"))
    return sorted((range(int(n[1]), int(n[2]) + 1) for n in names if n), key=lambda group: group.start)


def folder(path: Path, group: range) -> Path:
    """Where a group of the run in `path` is trained."""
    return path / MORE_SEEDS / f"{group.start}-{group.stop - 1}"


def finished(path: Path) -> list[Path]:
    """The folders of the groups that belong to a run's result."""
    folders = (folder(path, group) for group in begun(path))
    return [each for each in folders if (each / "summary.json").is_file()]


def joined_rewards(rewards: list[LearnedReward]) -> LearnedReward:
    """The rewards of several groups, one after another."""
    first = rewards[0]
    lists = {
        name: list(itertools.chain.from_iterable(each.description[name] for each in rewards))
        for name in ("seeds", "iterations")
    }
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(each.params for each in rewards))
    return LearnedReward(first.description | lists, first.config, params)
