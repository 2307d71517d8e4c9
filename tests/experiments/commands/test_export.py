"""`eairl export` of a run's folder; what it writes is tested in `test_exported`."""

import json
import shutil
from pathlib import Path

import pytest

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "v1"


@pytest.fixture
def finished(tmp_path):
    """A run with a reward and a policy."""
    folder = tmp_path / "a run"
    shutil.copytree(GOLDEN / "finished", folder)
    shutil.copytree(GOLDEN / "policies" / "plain", folder / "policy")
    return folder


def test_all_that_a_run_holds_is_written(tmp_path, finished, run, capsys, unchanged):
    assert run("export", finished, "--out", tmp_path / "out", "--seed", 1) == 2
    assert "--seed 1: " in capsys.readouterr().err
    assert run("export", finished, "--out", tmp_path / "out", "--what", "reward", "--seed", 1) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"reward.stablehlo", "reward.export.json"}
    about = json.loads((tmp_path / "out" / "reward.export.json").read_text())
    assert (about["run"], about["seed"], about["task"]) == ("a run", 1, "pendulum")
    with unchanged(finished):  # reading writes nothing
        assert run("export", finished, "--out", tmp_path / "out") == 0
    assert (tmp_path / "out" / "policy.stablehlo").exists()


def test_what_a_run_does_not_hold_is_refused(tmp_path, finished, run, capsys):
    shutil.rmtree(finished / "policy")
    assert run("export", finished, "--out", tmp_path / "out", "--what", "policy") == 2
    assert "holds no policy: an expert learns no reward" in capsys.readouterr().err
    shutil.rmtree(finished / "reward")
    assert run("export", finished, "--out", tmp_path / "out") == 2
    assert "holds no reward, policy" in capsys.readouterr().err
    assert run("export", tmp_path, "--out", tmp_path / "out") == 2
    assert "is no run's folder" in capsys.readouterr().err
