"""`eairl imitate`: what it leaves, and how it goes on."""

import json
import os
import shutil

import numpy as np
import pytest

from eairl_jax import load_reward


def test_imitate_leaves_what_it_promises(finished, tiny, capsys, imitate, metrics_lines, table):
    folder, before = finished, (finished / "metrics.csv").stat().st_mtime_ns
    assert imitate(folder, tiny) == 0  # computes nothing, and prints the same score
    assert (folder / "metrics.csv").stat().st_mtime_ns == before
    summary = json.loads((folder / "summary.json").read_text())
    promised = ["command_line", "task", "method", "seeds", "env_steps", "compile_seconds", "run_seconds",
                "expert", "random", "returns", "mean", "std", "normalized"]  # fmt: skip
    assert set(promised) <= set(summary)
    assert summary["env_steps"] == 4 * 2 * 20
    scale = summary["expert"] - summary["random"]
    assert summary["normalized"] == pytest.approx((np.mean(summary["returns"]) - summary["random"]) / scale)
    rows = metrics_lines(folder)
    assert [(r["seed"], r["iteration"]) for r in rows] == [(str(s), str(i)) for i in range(1, 5) for s in range(2)]
    wanted = {"true_return", "discriminator_loss", "accuracy", "reward_policy", "reward_expert", "empowerment", "l_i",
              "l_q", "kl", "entropy", "value_loss"}  # fmt: skip
    assert wanted <= set(rows[0])
    assert (folder / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "normalized" in table(capsys)
    reward = load_reward(folder / "reward", 3, 1)
    assert np.isfinite(reward(np.ones(3), np.ones(1), seed=1))


def test_a_run_that_does_not_fit_into_the_memory_leaves_nothing(tmp_path, tiny, imitate, capsys, monkeypatch):
    monkeypatch.setattr("eairl_jax.memory.host_free", lambda: 1000)
    assert imitate(tmp_path / "large", tiny) == 2
    assert "the states of 2 lanes need" in capsys.readouterr().err
    assert not (tmp_path / "large").exists()


def test_a_finished_run_can_lie_where_nobody_may_write(finished, tiny, imitate, capsys, monkeypatch, unchanged):
    """What its command would have added is left out: the picture and the policy, of a run that has lost them."""
    (finished / "curves.png").unlink()
    shutil.rmtree(finished / "policy")
    with monkeypatch.context() as patch, unchanged(finished):
        patch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
        assert imitate(finished, tiny) == 0
    assert "eairl-sa" in capsys.readouterr().out
    assert imitate(finished, tiny) == 0
    assert (finished / "curves.png").exists()
    assert (finished / "policy" / "policy.json").exists()


def test_methods_side_by_side(tmp_path, tiny, capsys, imitate, metrics_lines, table):
    """One table, a folder a row; behaviour cloning is a method like any other, but learns no reward."""
    assert imitate(tmp_path, tiny, "--method", "eairl", "bc") == 0
    printed = table(capsys)
    assert printed.count("Imitation of pendulum") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"eairl-sa", "bc"}
    for name in ("eairl-sa", "bc"):
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["name"] == name
        line = next(line for line in printed.splitlines() if line.startswith(f"│ {name} "))
        assert f"{summary['mean']:.2f} ± {summary['std']:.2f}" in line
        assert f"{summary['normalized']:.3f}" in line
        assert (tmp_path / name / "curves.png").is_file()
        for reward in ("reward", "snapshots"):
            assert (tmp_path / name / reward).exists() == (name != "bc")
    assert {"log_prob_expert", "true_return"} <= set(metrics_lines(tmp_path / "bc")[0])
    assert "accuracy" not in metrics_lines(tmp_path / "bc")[0]


def test_the_policy_by_trpo(tmp_path, tiny, imitate, metrics_lines):
    own = [a for a in tiny if not a.startswith("empowerment")]
    assert imitate(tmp_path / "run", [*own, "kl_limit=0.003"], "--method", "gail", "--optimizer", "trpo") == 0
    settings = json.loads((tmp_path / "run" / "config.json").read_text())["settings"]
    assert settings["config"]["optimizer"] == "trpo"
    rows = metrics_lines(tmp_path / "run")
    assert all(0 <= float(r["kl"]) <= 0.003 * 1.001 for r in rows)
    assert max(float(r["kl"]) for r in rows) > 1e-3
    assert all(float(r["step_fraction"]) in (0.0, *(0.5 ** np.arange(10))) for r in rows)


def test_another_first_seed(finished, tmp_path, tiny, run, metrics_lines):
    """A run's random numbers are those of its seed, not of its place among the others."""
    assert run("imitate", "pendulum", "--seeds", 2, "--first-seed", 1, "--out", tmp_path / "other", "--set", *tiny) == 0
    first, second = ([r for r in metrics_lines(path) if r["seed"] == "1"] for path in (finished, tmp_path / "other"))
    assert len(first) == 4
    np.testing.assert_allclose(
        *([[float(x) for x in r.values()] for r in lines] for lines in (first, second)), rtol=1e-3
    )
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (finished, tmp_path / "other")]
    assert [s["seeds"] for s in summaries] == [[0, 1], [1, 2]]
