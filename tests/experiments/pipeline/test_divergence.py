"""Lanes that are dropped because a value is not finite."""

import numpy as np
import pytest

from eairl_jax import Diverged
from eairl_jax.experiments.pipeline import divergence
from eairl_jax.experiments.pipeline.run_folder import RunFolder


def test_without_any_seed_there_is_no_score(tmp_path):
    folder, labels = RunFolder(tmp_path, {"seeds": 2}), [{"seed": 0}, {"seed": 1}]
    good = {"net": np.ones((2, 3), np.float32)}
    guard = divergence.Guard(folder, "a training", labels, "skip", good)
    both = {"loss": np.array([[1.0, np.nan], [np.inf, 1.0]])}
    with pytest.raises(
        Diverged, match=r"every seed has diverged.*seed 0 \(loss became nan at iteration 2 of a training"
    ):
        guard.checked(0, good, both, None)
    with pytest.raises(Diverged, match="every seed has diverged"):
        divergence.kept_seeds(folder)


def test_a_dropped_lane_keeps_its_last_good_state(tmp_path):
    """And the others their own; a lane of a restart drops its seed."""
    labels = [{"restart": restart, "seed": seed} for restart in (0, 1) for seed in (5, 6)]
    folder = RunFolder(tmp_path, {"seeds": [5, 6]})
    states = [{"net": np.full((4, 2), float(chunk), np.float32)} for chunk in range(3)]
    states[2]["net"][1, 0] = np.inf
    guard = divergence.Guard(folder, "a training", labels, "skip", states[0])
    metrics = {"loss": np.zeros((4, 2))}
    assert guard.checked(0, states[1], metrics, None)[0] is states[1]
    state, metrics = guard.checked(2, states[2], metrics, 2)
    np.testing.assert_array_equal(state["net"][:, 0], [2, 1, 2, 2])
    np.testing.assert_array_equal(np.isnan(metrics["loss"]), [[0, 0], [0, 1], [0, 0], [0, 0]])
    state, metrics = guard.checked(4, {"net": states[2]["net"] + 1}, {"loss": np.zeros((4, 2))}, 4)
    np.testing.assert_array_equal(state["net"][:, 0], [3, 1, 3, 3])
    np.testing.assert_array_equal(np.isnan(metrics["loss"]).all(axis=1), [False, True, False, False])
    assert divergence.kept_seeds(folder).tolist() == [0]
    assert divergence.kept(folder, labels).tolist() == [0, 2, 3]
