"""`eairl runs`: what folders hold, whatever they hold."""

import json
import os
import shutil
import time
from pathlib import Path

import pytest

from eairl_jax.experiments.commands.runs import age

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "v1"


@pytest.fixture
def folders(tmp_path):
    """A finished run, one that still trains, and what is no run."""
    shutil.copytree(GOLDEN / "finished", tmp_path / "sets" / "a [run]")
    shutil.copytree(GOLDEN / "unfinished", tmp_path / "going on")
    metrics = tmp_path / "going on" / "metrics.csv"
    metrics.write_text(metrics.read_text().replace("nan", "-6"))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "text.txt").write_text("x")
    for folder, hours in (("sets/a [run]", 2), ("going on", 1)):
        written = time.time() - 3600 * hours
        for path in (tmp_path / folder).iterdir():
            os.utime(path, (written, written))
    return tmp_path


def test_runs_are_listed_with_what_is_done(folders, run, capsys, tmp_path):
    assert run("runs", folders, "--json", tmp_path / "runs.json") == 0
    printed = capsys.readouterr().out
    assert "a [run]" in printed
    new, old = json.loads((tmp_path / "runs.json").read_text())["runs"]
    summary = json.loads((GOLDEN / "finished" / "summary.json").read_text())
    assert (old["folder"], old["is_finished"], old["done"], old["planned"]) == ("sets/a [run]", True, 4, 4)
    assert old["score"] == pytest.approx(summary["mean"])
    assert old["normalized"] == pytest.approx(summary["normalized"])
    assert (new["folder"], new["is_finished"], new["done"], new["planned"]) == ("going on", False, 2, 4)
    assert (new["task"], new["method"], new["seeds"]) == ("pendulum", "eairl", 2)
    assert new["score"] == -6.0
    assert new["size"] == sum(p.stat().st_size for p in (folders / "going on").rglob("*") if p.is_file())
    assert 7000 < time.time() - old["changed"] < 8000


def test_damaged_and_foreign_folders_are_listed_as_such(folders, run, capsys):
    broken = {
        "empty": "",
        "text": "x",
        "list": "[]",
        "odd": '{"settings": {"seeds": "many"}}',
        "bare": '{"settings": {}}',
    }
    for name, content in broken.items():
        (folders / name).mkdir()
        (folders / name / "config.json").write_text(content)
    shutil.copytree(GOLDEN / "finished", folders / "half")
    (folders / "half" / "summary.json").write_text('{"returns": "high"}')
    shutil.copytree(GOLDEN / "unfinished", folders / "torn")
    (folders / "torn" / "metrics.csv").write_bytes(b"seed,iteration,true_return\n0,1,x\n\xff\xfe0,2")
    assert run("runs", folders) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for name in ("empty", "text", "list", "odd"):
        assert f"{name}: {folders / name / 'config.json'}" in printed
    assert f"half: {folders / 'half' / 'summary.json'}" in printed
    assert "torn" in printed


def test_a_folder_without_runs(tmp_path, run, capsys):
    assert run("runs", tmp_path) == 0
    assert "no runs in" in capsys.readouterr().out
    assert run("runs", tmp_path / "nowhere") == 2
    assert "no folder" in capsys.readouterr().err
    assert run("runs", tmp_path, "--json", tmp_path / "no" / "x.json") == 2
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.parametrize(("seconds", "text"), [(3, "now"), (90, "2 min"), (7200, "2 h"), (200_000, "2 d")])
def test_age(seconds, text):
    assert age(seconds) == text
