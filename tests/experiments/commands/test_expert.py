"""`eairl expert`: what it leaves, and that it is trained once."""

import json

import pytest


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
