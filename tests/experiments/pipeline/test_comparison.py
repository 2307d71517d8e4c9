"""Runs beside each other: what is read, what can be compared."""

import json

import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import comparison


def test_a_run_is_read_with_its_scores_and_its_curve(finished, metrics_lines):
    (read,) = comparison.read(finished, "accuracy")
    summary = json.loads((finished / "summary.json").read_text())
    assert read.scores.tolist() == summary["returns"]
    assert (read.iterations, read.steps, read.is_finished) == (4, 40, True)
    rows = [row for row in metrics_lines(finished) if row["seed"] == "1"]
    np.testing.assert_allclose(read.curve[1], [float(row["accuracy"]) for row in rows])
    np.testing.assert_allclose(read.normalized("accuracy").scores.mean(), summary["normalized"])


def test_a_run_that_trains_has_the_scores_of_its_last_tenth(finished):
    path = finished / "metrics.csv"
    header = path.read_text().splitlines()[0].split(",")
    at = header.index("true_return")
    lines = [",".join(header)]
    for iteration in range(1, 21):
        for seed in (0, 1):
            row = [str(seed), str(iteration), str(iteration * 40), *["0.5"] * (len(header) - 3)]
            row[at] = str(iteration * 10 + seed) if seed == 0 or iteration < 20 else "nan"
            lines.append(",".join(row))
    path.write_text("\n".join(lines) + "\n0,21,8")  # the last line is torn
    (finished / "summary.json").unlink()
    (read,) = comparison.read(finished, "true_return")
    assert read.scores.tolist() == [195.0, 191.0]
    assert read.curve.shape == (2, 20)
    with pytest.raises(InputError, match="has no normalised score"):
        read.normalized("true_return")


def test_points_of_a_sweep_are_compared(finished):
    settings = json.loads((finished / "config.json").read_text())
    settings["settings"]["sweep"] = [{"beta": 1.0}, {"beta": 2.0}]
    (finished / "config.json").write_text(json.dumps(settings))
    rows = [line.split(",") for line in (finished / "metrics.csv").read_text().splitlines()]
    rows = [[rows[0][0], "beta", *rows[0][1:]]] + [[r[0], b, *r[1:]] for b in "12" for r in rows[1:]]
    (finished / "metrics.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    summary = json.loads((finished / "summary.json").read_text())
    dropped = {"seed": 0, "beta": 1.0, "training": "t", "quantity": "kl", "iteration": 1, "value": "nan"}
    changed = {"points": [{"beta": 1.0}, {"beta": 2.0}], "returns": [1.0, 2.0, 3.0], "dropped": [dropped]}
    (finished / "summary.json").write_text(json.dumps(summary | changed))
    first, second = comparison.read(finished, "true_return")
    assert (first.name, second.name) == ("run, beta 1", "run, beta 2")
    assert (first.scores.tolist(), second.scores.tolist()) == ([1.0], [2.0, 3.0])
    assert first.curve.shape == (2, 4)
    assert comparison.improvement(second, first).value == 1.0


def test_a_long_curve_is_thinned():
    curve = np.arange(400.0)[None].repeat(2, axis=0)
    curve[0, :3] = np.nan
    thin, steps = comparison.thinned(curve, 10)
    assert (thin.shape, steps) == ((2, 133), 30)
    assert np.isnan(thin[0, 0])
    assert thin[1, :2].tolist() == [1.0, 4.0]


def test_what_cannot_be_compared_is_refused(finished):
    (read,) = comparison.read(finished, "true_return")
    with pytest.raises(InputError, match="at least two runs"):
        comparison.check_comparable([read], "true_return")
    with pytest.raises(InputError, match="--metric kll"):
        comparison.read(finished, "kll")
    with pytest.raises(InputError, match="is no run's folder"):
        comparison.read(finished / "policy", "true_return")
    (finished / "metrics.csv").write_text("")
    with pytest.raises(InputError, match="is no table of metrics"):
        comparison.read(finished, "true_return")
    (finished / "metrics.csv").unlink()
    with pytest.raises(InputError, match="no metrics yet"):
        comparison.read(finished, "true_return")
