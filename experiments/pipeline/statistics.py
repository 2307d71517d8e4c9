"""Scores of several tasks as one figure with its uncertainty (Agarwal et al. 2021), by SciPy's bootstrap.

Every function takes normalised scores, an array `[seeds]` for each task. Resampling is stratified: every task keeps
its number of seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

RESAMPLES = 2000


class Estimate(NamedTuple):
    """A statistic with its 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def interquartile_mean(scores: Sequence[np.ndarray]) -> Estimate:
    """The mean of the middle half of the scores of all tasks and seeds."""

    def statistic(*tasks, axis=-1):
        return stats.trim_mean(np.concatenate(tasks, axis=axis), 0.25, axis=axis)

    return _bootstrap(statistic, scores)


def difference(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Estimate:
    """The mean over seeds of ours minus that of theirs, as a mean over the tasks."""

    def statistic(*both, axis=-1):
        means = [np.mean(task, axis=axis) for task in both]
        return np.mean(means[: len(ours)], axis=0) - np.mean(means[len(ours) :], axis=0)

    return _bootstrap(statistic, [*ours, *theirs])


def probability_of_improvement(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Estimate:
    """The probability that a seed of ours scores above a seed of theirs, as a mean over the tasks; ties count half."""

    def statistic(*both, axis=-1):
        del axis  # SciPy passes the last one
        sides = both[: len(ours)], both[len(ours) :]
        return np.mean([_share_above(x, y) for x, y in zip(*sides, strict=True)], axis=0)

    return _bootstrap(statistic, [*ours, *theirs])


def _share_above(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The statistic U of Mann and Whitney divided by the number of pairs."""
    x, y = x[..., :, None], y[..., None, :]
    return np.mean((x > y) + 0.5 * (x == y), axis=(-2, -1))


def _bootstrap(statistic: Callable, samples: Sequence[np.ndarray]) -> Estimate:
    value = float(statistic(*samples))
    if max(len(sample) for sample in samples) < 2:
        return Estimate(value, value, value)  # a single seed has no spread
    # SciPy wants two values at least. The same value twice has no spread either.
    samples = [np.repeat(sample, 2) if len(sample) < 2 else sample for sample in samples]
    # Percentiles, because the other methods are undefined where all resamples agree.
    bootstrap = stats.bootstrap(
        samples,
        statistic,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=True,
        rng=np.random.default_rng(0),
    )
    return Estimate(value, float(bootstrap.confidence_interval.low), float(bootstrap.confidence_interval.high))
