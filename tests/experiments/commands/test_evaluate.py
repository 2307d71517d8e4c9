"""`eairl evaluate`: the same policies, scored again in either engine."""

import json
import shutil

import numpy as np
import pytest


def test_policies_score_alike_again_and_in_the_c_engine(finished, tmp_path, tiny, run, table, capsys, unchanged):
    figures = tmp_path / "figures.json"
    with unchanged(finished):  # reading writes nothing
        assert run("evaluate", finished, "--engine", "c", "--episodes", 2, "--json", figures) == 0
    assert "C over MJX" in table(capsys)
    returns = json.loads(figures.read_text())["returns"]
    summary = json.loads((finished / "summary.json").read_text())
    np.testing.assert_allclose(np.mean(returns["MJX"], axis=1), summary["returns"], rtol=1e-5)
    np.testing.assert_allclose(returns["C engine"], returns["MJX"], rtol=0.02)


def test_scores_leave_a_figure_and_a_page(finished, tmp_path, run, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("evaluate", finished, "--episodes", 2, "--mean-action") == 0
    folder = tmp_path / "runs" / f"evaluate-{finished.name}-mean"
    assert "seed 1" not in capsys.readouterr().out
    text = (folder / "index.html").read_text()
    assert "mean action, 2 episodes a seed" in text
    assert "data:image/png;base64," in text
    assert (folder / "scores.png").is_file()


def test_a_place_that_cannot_be_written_costs_the_page_alone(finished, tmp_path, run, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").write_text("no folder")
    assert run("evaluate", finished, "--episodes", 2) == 0
    assert "no figure and no page: cannot write" in capsys.readouterr().out
    assert run("evaluate", finished, "--episodes", 2, "--out", tmp_path / "runs" / "mine") == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_run_without_policies_is_refused(finished, run, capsys):
    shutil.rmtree(finished / "checkpoints")
    shutil.rmtree(finished / "policy")
    assert run("evaluate", finished) == 2
    assert "has lost its last checkpoint" in capsys.readouterr().err
    (finished / "summary.json").unlink()
    assert run("evaluate", finished) == 2
    assert "has no checkpoint yet" in capsys.readouterr().err


def test_policies_of_a_run_that_still_trains_are_those_of_its_newest_checkpoint(finished, run, capsys):
    (finished / "summary.json").unlink()
    assert run("evaluate", finished, "--episodes", 2) == 0
    last = capsys.readouterr().out
    assert "is not finished: these are the policies of iteration 4" in last
    shutil.rmtree(finished / "checkpoints" / "4")
    assert run("evaluate", finished, "--episodes", 2) == 0
    before = capsys.readouterr().out
    assert "policies of iteration 2" in before
    assert before.replace("iteration 2", "iteration 4") != last
    assert run("export", finished, "--out", finished / "out") == 2
    assert "holds no finished run" in capsys.readouterr().err


def test_figures_that_cannot_be_written_are_refused_first(finished, tmp_path, run, capsys, monkeypatch):
    monkeypatch.setattr("eairl_jax.experiments.commands.evaluate.final_returns", lambda *_: pytest.fail("computed"))
    assert run("evaluate", finished, "--json", tmp_path) == 2
    assert "cannot write" in capsys.readouterr().err
