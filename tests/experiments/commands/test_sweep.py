"""`eairl sweep`: all points in one program."""

import json
import re
from urllib.parse import unquote

import numpy as np
import pytest

from eairl_jax import load_policy, load_reward


def test_a_sweep_is_its_single_runs_side_by_side(tmp_path, tiny, capsys, run, imitate, metrics_lines, table):
    arguments = ["sweep", "pendulum", "--seeds", 2, "--out", tmp_path / "sweep", "--set", *tiny]
    arguments += ["lambda_i=0,10", "gradient_penalty=0,1"]
    assert run(*arguments) == 0
    printed = table(capsys)
    summary = json.loads((tmp_path / "sweep" / "summary.json").read_text())
    points = [(i, g) for i in (0.0, 10.0) for g in (0.0, 1.0)]
    assert [(p["lambda_i"], p["gradient_penalty"]) for p in summary["points"]] == points
    by_point = np.reshape(summary["returns"], (4, 2))
    for of_seeds, (i, g) in zip(by_point, points, strict=True):
        line = next(line for line in printed.splitlines() if f"lambda_i {i:g}, gradient_penalty {g:g} " in line)
        assert f"{of_seeds.mean():.2f} ± {of_seeds.std():.2f}" in line
    assert (tmp_path / "sweep" / "curves.png").read_bytes().startswith(b"\x89PNG")
    swept = metrics_lines(tmp_path / "sweep")
    assert len(swept) == 4 * len(points) * 2
    curves, returns = {}, []
    for point, of_seeds in zip(points, by_point, strict=True):
        curves[point] = [r for r in swept if (float(r["lambda_i"]), float(r["gradient_penalty"])) == point]
        if point != points[2]:  # each single run is compiled for itself: one is enough
            continue
        single = tmp_path / f"single {point}"
        assert imitate(single, [*tiny, f"lambda_i={point[0]}"]) == 0
        alone = metrics_lines(single)
        numbers = [[[float(r[name]) for name in alone[0]] for r in rows] for rows in (curves[point], alone)]
        np.testing.assert_allclose(*numbers, rtol=1e-3, atol=1e-4)
        returns.append((of_seeds, json.loads((single / "summary.json").read_text())["returns"]))
        kept = tmp_path / "sweep" / "points" / "lambda_i=10-gradient_penalty=0"
        obs, action = np.ones(3, np.float32), np.ones(1, np.float32)
        for load, what, arguments_of in ((load_reward, "reward", (obs, action)), (load_policy, "policy", (obs,))):
            artefact, other = load(kept / what), load(single / what)
            assert artefact.description["seeds"] == [0, 1]
            values = [[each(*arguments_of, seed=seed) for seed in (0, 1)] for each in (artefact, other)]
            np.testing.assert_allclose(*values, rtol=1e-3, atol=1e-5)
        assert load_reward(kept / "reward").description["hparams"]["lambda_i"] == 10.0
    losses = {tuple(float(r["policy_loss"]) for r in rows) for rows in curves.values()}
    assert len(losses) == len(points), "every setting counts"
    # The same command again computes nothing.
    before = (tmp_path / "sweep" / "metrics.csv").stat().st_mtime_ns
    assert run(*arguments) == 0
    assert (tmp_path / "sweep" / "metrics.csv").stat().st_mtime_ns == before
    for together, alone in returns:
        np.testing.assert_allclose(together, alone, rtol=1e-3, err_msg="scored in the same episodes")
    # A seed of one point is dropped: the other points keep both.
    for name in ("summary.json", "curves.png"):
        (tmp_path / "sweep" / name).unlink()
    reason = {"training": "eairl-sa in pendulum", "quantity": "policy_loss", "iteration": 3, "value": "nan"}
    dropped = [{"seed": 1, "lambda_i": 10.0, "gradient_penalty": 0.0} | reason]
    dropped += [{"seed": seed, "lambda_i": 10.0, "gradient_penalty": 1.0} | reason for seed in (0, 1)]
    (tmp_path / "sweep" / "dropped.json").write_text(json.dumps({"dropped": dropped}))
    capsys.readouterr()
    for _ in range(2):  # scored, and read
        assert run(*arguments) == 0
        printed = " ".join(capsys.readouterr().out.split())
        assert "lambda_i 10, gradient_penalty 0: mean of 1 of 2 seeds; dropped: seed 1, lambda_i 10," in printed
        assert "lambda_i 10, gradient_penalty 1: no score" in printed
    rest = json.loads((tmp_path / "sweep" / "summary.json").read_text())
    assert (rest["seeds"], rest["returns"], rest["dropped"]) == ([0, 1], summary["returns"][:5], dropped)
    assert (tmp_path / "sweep" / "curves.png").exists()


@pytest.mark.slow
def test_a_sweep_may_go_over_names(tmp_path, tiny, capsys, run, table):
    """Each name needs a program of its own; one table and one figure show all of them."""
    arguments = ["sweep", "pendulum", "--seeds", 1, "--out", tmp_path / "sweep", "--set", *tiny]
    assert run(*arguments, "activation=relu,tanh") == 0
    printed = table(capsys)
    for name in ("relu", "tanh"):
        folder = tmp_path / "sweep" / f"eairl-sa+activation={name}"
        summary = json.loads((folder / "summary.json").read_text())
        line = next(line for line in printed.splitlines() if f"activation {name} " in line)
        assert f"{summary['mean']:.2f}" in line
        assert load_reward(folder / "points" / "all" / "reward").config.activation == name
    assert (tmp_path / "sweep" / "curves.png").read_bytes().startswith(b"\x89PNG")
    shown = (tmp_path / "sweep" / "index.html").read_text()
    for link in re.findall('href="([^"]*)"', shown):
        assert (tmp_path / "sweep" / unquote(link)).is_file()
    assert shown.count("activation tanh") == 1
    assert run(*arguments, "activation=relu,relu") == 2
    assert "expected different values" in capsys.readouterr().err
    assert run(*arguments, "activation=relu,tan") == 2
    assert "did you mean tanh" in capsys.readouterr().err
