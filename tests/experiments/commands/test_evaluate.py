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


@pytest.mark.parametrize(
    "lost, hint", [("checkpoints", "has lost its last checkpoint"), ("summary.json", "no finished run")]
)
def test_a_run_without_policies_is_refused(finished, run, capsys, lost, hint):
    path = finished / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert run("evaluate", finished) == 2
    assert hint in capsys.readouterr().err


def test_figures_that_cannot_be_written_are_refused_first(finished, tmp_path, run, capsys, monkeypatch):
    monkeypatch.setattr("eairl_jax.experiments.commands.evaluate.final_returns", lambda *_: pytest.fail("computed"))
    assert run("evaluate", finished, "--json", tmp_path) == 2
    assert "cannot write" in capsys.readouterr().err
