"""`eairl diagnose`: behaviours in the target, judged by the learned and by the true reward."""

import json

import numpy as np
import pytest


@pytest.fixture
def transferred(finished, tiny, tmp_path, run, retrain_settings):
    """The folder of a tiny use of a saved reward of two seeds, in the task where it was learned."""
    arguments = ["transfer", "pendulum", "pendulum", "--reward", finished / "reward", "--restarts", 1]
    assert run(*arguments, "--out", tmp_path / "used", "--retrain-set", *retrain_settings) == 0
    (folder,) = (tmp_path / "used").glob("reuse-*")
    return folder


def test_a_transfer_is_judged_beside_other_behaviours(transferred, run, table, capsys, tmp_path):
    capsys.readouterr()
    assert run("diagnose", transferred, "--policies", transferred) == 0
    printed = table(capsys)
    assert "not optimised: below 0.98" in printed
    content = json.loads((transferred / "diagnosis.json").read_text())
    summary = json.loads((transferred / "summary.json").read_text())
    behaviours = content["behaviours"]
    assert behaviours["trained on the reward"] == {"learned": summary["learned_rewards"], "true": summary["returns"]}
    for name, behaviour in behaviours.items():
        assert np.isfinite(behaviour["learned"] + behaviour["true"]).all(), name
        assert len(behaviour["learned"]) == len(behaviour["true"]) == 2, name
    # The same policies as another run act in the same episodes, and each reward takes the better of the two.
    own, other = (behaviours[name] for name in ("trained on the reward", f"policies of {transferred.name}"))
    assert (np.array(other["learned"]) >= np.array(own["learned"]) - 1e-5).all()
    assert max(other["learned"]) > min(behaviours["random actions"]["learned"])
    assert (transferred / "diagnosis.png").stat().st_size > 10_000
    assert "What the learned reward is worth" in (transferred / "index.html").read_text()
    assert max(content["share"]) <= 1.0
    # A run that cannot be written is diagnosed elsewhere, and only read.
    before = {path: path.stat().st_mtime_ns for path in transferred.rglob("*")}
    elsewhere = tmp_path / "elsewhere"
    assert run("diagnose", transferred, "--policies", transferred, "--out", elsewhere) == 0
    assert json.loads((elsewhere / "diagnosis.json").read_text()) == content
    assert (elsewhere / "diagnosis.png").is_file()
    assert {path: path.stat().st_mtime_ns for path in transferred.rglob("*")} == before


def test_what_is_no_transfer_is_refused(finished, run, capsys):
    assert run("diagnose", finished) == 2
    assert "is no transfer" in capsys.readouterr().err
