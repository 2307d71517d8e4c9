"""Points of a sweep: how they are named, and which of the sweep's returns are theirs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from eairl_jax.experiments.pipeline import divergence

Point = dict[str, float]


def name(point: Point) -> str:
    """`lambda_i 0.1, beta 1`; "" for the only point of a sweep over names."""
    return ", ".join(f"{setting} {value:g}" for setting, value in point.items())


def folder_name(point: Point) -> str:
    """`lambda_i=0.1-beta=1`."""
    return "-".join(f"{setting}={value:g}" for setting, value in point.items()) or "all"


def returns(
    points: Sequence[Point], seeds: Sequence[int], values: Sequence[Any], dropped: Sequence[dict]
) -> list[list[Any]]:
    """The returns of each point.

    Args:
      values: the seeds of one point after another, without those that were dropped. None stands for a missing one.
      dropped: entries of `divergence.entry`.
    """
    rest = iter(values)

    def is_kept(lane: dict) -> bool:
        return not any(divergence.matches(each, lane) for each in dropped)

    lanes = [[point | {"seed": seed} for seed in seeds] for point in points]
    return [[next(rest, None) for lane in of_point if is_kept(lane)] for of_point in lanes]
