"""`eairl expert`, `demos`, `evaluate` and `view`: each reads what the one before wrote."""

import json
import shutil

import numpy as np


def test_expert_and_demos_make_what_imitate_reads(tmp_path, tiny, monkeypatch, capsys, run, rl_settings):
    assert run("expert", "pendulum", "--seeds", 2, "--out", tmp_path / "expert", "--set", *rl_settings) == 0
    path = tmp_path / "pendulum.npz"
    assert run("demos", "pendulum", "--expert", tmp_path / "expert", "--episodes", 3, "--out", path) == 0
    provenance = json.loads(path.with_suffix(".json").read_text())
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["obs"].shape == (3, 200, 3)
        np.testing.assert_allclose(arrays["reward"].sum(axis=1), provenance["returns"], rtol=1e-5)
    assert provenance["expert"]["chosen_seed"] in (0, 1)
    arguments = ["imitate", "pendulum", "--seeds", 2, "--demos", path, "--out", tmp_path / "run", "--set", *tiny]
    assert run(*arguments) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["expert"] == provenance["expert_return"]
    figures = tmp_path / "figures.json"
    assert run("evaluate", tmp_path / "run", "--episodes", 2, "--json", figures) == 0
    returns = json.loads(figures.read_text())["returns"]
    assert list(returns) == ["MJX"]
    np.testing.assert_allclose(np.mean(returns["MJX"], axis=1), summary["returns"], rtol=1e-5)
    # An episode of it can be looked at, with pictures or, where nothing can draw, without.
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert run("view", tmp_path / "run", "--seed", 1, "--out", tmp_path / "view") == 0
    assert "no pictures: this machine cannot draw with OpenGL" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "view").iterdir()] == ["episode.html"]
    assert run("view", tmp_path / "run", "--seed", 7) == 2
    assert "--seed 7: the run has seeds 0, 1" in capsys.readouterr().err
    assert run("evaluate", tmp_path / "run", "--json", tmp_path) == 2
    assert "cannot write" in capsys.readouterr().err
    # An imitator is no expert.
    assert run("demos", "pendulum", "--expert", tmp_path / "run", "--out", tmp_path / "no.npz") == 2
    assert "no expert of pendulum" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "run" / "checkpoints")
    assert run("evaluate", tmp_path / "run") == 2
    assert "has lost its last checkpoint" in capsys.readouterr().err
