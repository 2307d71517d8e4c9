"""Statistics over tasks and seeds, against values worked out by hand and SciPy's own."""

import numpy as np
import pytest
from scipy import stats

from eairl_jax.experiments.pipeline.statistics import difference, interquartile_mean, probability_of_improvement


def test_the_middle_half_decides():
    scores = [np.array([-100.0, 1.0, 2.0]), np.array([3.0, 4.0, 5.0, 6.0, 1e6])]
    assert interquartile_mean(scores).value == np.mean([2.0, 3.0, 4.0, 5.0])


def test_the_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    estimates = [interquartile_mean([rng.normal(0, 1, 10), rng.normal(0, 1, 10)]) for _ in range(60)]
    covered = np.mean([estimate.low <= 0 <= estimate.high for estimate in estimates])
    assert 0.8 < covered <= 1.0  # percentile intervals of 20 samples are slightly too narrow
    assert all(estimate.low <= estimate.value <= estimate.high for estimate in estimates)


def test_probability_of_improvement_is_mann_whitneys():
    rng = np.random.default_rng(1)
    ours, theirs = rng.normal(0.5, 1, (2, 6)), rng.normal(0, 1, (2, 5))
    expected = np.mean([stats.mannwhitneyu(x, y).statistic / 30 for x, y in zip(ours, theirs, strict=True)])
    assert probability_of_improvement(ours, theirs).value == pytest.approx(expected)


@pytest.mark.parametrize(("shift", "expected"), [(10.0, (1.0, 1.0, 1.0)), (-10.0, (0.0, 0.0, 0.0))])
def test_scores_that_do_not_overlap(shift, expected):
    scores = np.arange(5.0)
    assert probability_of_improvement([scores + shift], [scores]) == expected


def test_scores_beside_themselves_are_even():
    assert probability_of_improvement([np.arange(5.0)], [np.arange(5.0)]).value == 0.5


def test_resampling_keeps_every_task():
    assert interquartile_mean([np.zeros(3), np.full(3, 10.0)]) == (5.0, 5.0, 5.0)


def test_the_difference_of_means():
    ours, theirs = [np.array([1.0, 3.0]), np.array([5.0, 5.0])], [np.array([1.0, 1.0]), np.array([2.0, 2.0])]
    assert difference(ours, theirs) == (2.0, 1.5, 2.5)


def test_one_seed_has_no_interval():
    assert interquartile_mean([np.array([3.0]), np.array([5.0])]) == (4.0, 4.0, 4.0)
    beside = interquartile_mean([np.array([4.0]), np.array([3.0, 5.0])])
    assert beside.low < beside.value == 4.0 < beside.high
