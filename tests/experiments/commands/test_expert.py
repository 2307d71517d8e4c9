"""`eairl expert`: what it leaves, and that it is trained once."""

import json
import shutil

import pytest

from eairl_jax import load_policy


def test_an_expert_leaves_its_returns(expert, tiny, rl_settings, run, table, capsys, monkeypatch):
    summary = json.loads((expert / "summary.json").read_text())
    assert summary["env_steps"] == 4 * 2 * 20
    assert len(summary["returns"]) == len(summary["returns_mean_action"]) == 2
    assert (expert / "curves.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr("eairl_jax.Lanes.run", lambda *_: pytest.fail("trained again"))
    assert run("expert", "pendulum", "--seeds", 2, "--out", expert, "--set", *rl_settings) == 0
    printed = table(capsys)
    assert f"{summary['mean']:.2f} ± {summary['std']:.2f}" in printed
    assert "eairl demos pendulum" in printed


def test_an_expert_reads_no_setting_of_a_discriminator(run, capsys, tmp_path):
    assert run("expert", "pendulum", "--out", tmp_path / "expert", "--set", "lambda_i=1") == 2
    assert "not a setting of reinforcement learning" in capsys.readouterr().err


def test_an_expert_goes_on_beyond_its_plan(expert, tiny, rl_settings, run, capsys, tmp_path):
    folder = shutil.copytree(expert, tmp_path / "expert")
    assert run("expert", "pendulum", "--seeds", 2, "--more", 2, "--out", folder, "--set", *rl_settings) == 0
    assert "2 iterations beyond the plan" in capsys.readouterr().out
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["more_iterations"], summary["env_steps"]) == (2, 6 * 2 * 20)
    assert load_policy(folder / "policy").description["iterations"] == [6, 6]
