"""Scores of several tasks as one figure with its uncertainty (Agarwal et al. 2021), on SciPy's statistics.

`scores` are normalised ones, an array `[seeds]` for each task. Resampling is stratified: every task keeps its number of
seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    """Mean of the middle half of all tasks' and seeds' scores."""
    return _bootstrap(
        lambda *tasks, axis=-1: stats.trim_mean(np.concatenate(tasks, axis=axis), 0.25, axis=axis), scores
    )


def difference(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Estimate:
    """Of the means over seeds, ours less theirs, a mean over the tasks."""

    def statistic(*both, axis=-1):
        means = [np.mean(each, axis=axis) for each in both]
        return np.mean(means[: len(ours)], axis=0) - np.mean(means[len(ours) :], axis=0)

    return _bootstrap(statistic, [*ours, *theirs])


def probability_of_improvement(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Estimate:
    """That a seed of ours scores above a seed of theirs, a mean over the tasks; ties count half."""

    def statistic(*both, axis=-1):
        del axis  # the last
        halves = both[: len(ours)], both[len(ours) :]
        each = [_above(x, y) for x, y in zip(*halves, strict=True)]
        return np.mean(each, axis=0)

    return _bootstrap(statistic, [*ours, *theirs])


def _above(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Mann-Whitney's U over the number of pairs."""
    x, y = x[..., :, None], y[..., None, :]
    return np.mean((x > y) + 0.5 * (x == y), axis=(-2, -1))


def _bootstrap(statistic, samples: Sequence[np.ndarray]) -> Estimate:
    value = float(statistic(*samples))
    if max(len(sample) for sample in samples) < 2:
        return Estimate(value, value, value)  # one seed says nothing of its spread
    samples = [np.repeat(sample, 2) if len(sample) < 2 else sample for sample in samples]  # nor does it beside others
    # Percentiles: the other methods are undefined where all resamples agree.
    interval = stats.bootstrap(samples, statistic, n_resamples=RESAMPLES, method="percentile", vectorized=True,
                               rng=np.random.default_rng(0)).confidence_interval  # fmt: skip
    return Estimate(value, float(interval.low), float(interval.high))
