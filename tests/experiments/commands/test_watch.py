"""`eairl watch`: curves of a run that trains, and nothing but its files is needed."""

import io
import json
import shutil
import threading

import numpy as np
import pytest
from rich.console import Console

from eairl_jax.experiments.commands import watch


def test_a_finished_run_is_shown_and_not_touched(finished, run, capsys, unchanged):
    with unchanged(finished):
        assert run("watch", finished) == 0
    (line,) = capsys.readouterr().out.splitlines()
    summary = json.loads((finished / "summary.json").read_text())
    assert "eairl in pendulum: iteration 4 of 4" in line
    assert f"finished: true return {summary['mean']:.2f}" in line
    assert "accuracy 0." in line


def test_a_run_is_followed_until_it_has_a_result(finished, tmp_path, run, capsys, monkeypatch):
    """Each look finds what another process has written meanwhile."""
    metrics = (finished / "metrics.csv").read_text().splitlines(keepends=True)
    shutil.move(finished / "summary.json", tmp_path / "summary.json")
    (finished / "metrics.csv").unlink()
    news = iter([metrics[:5], metrics[:5], metrics])

    def wait(_seconds):
        written = next(news, None)
        if written is None:
            shutil.move(tmp_path / "summary.json", finished / "summary.json")
        else:
            (finished / "metrics.csv").write_text("".join(written))

    monkeypatch.setattr(watch.time, "sleep", wait)
    assert run("watch", finished) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "has no metrics yet" in lines[0]
    assert [line.split(",")[0] for line in lines[1:3]] == [f"eairl in pendulum: iteration {i} of 4" for i in (2, 4)]


@pytest.mark.parametrize(("encoding", "bars"), [("utf-8", watch.BARS), ("ascii", watch.PLAIN_BARS)])
@pytest.mark.parametrize("columns", [30, 80])
def test_the_picture_fits_any_terminal(finished, run, monkeypatch, encoding, bars, columns):
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True)
    console = Console(file=file, force_terminal=True, width=columns, markup=False, emoji=False, highlight=False)
    monkeypatch.setattr(watch, "console", console)
    assert run("watch", finished) == 0
    printed = file.buffer.getvalue().decode(encoding)
    assert "accuracy" in printed
    assert any(bar in printed for bar in bars)
    assert threading.active_count() < 50  # the live display has ended


def test_a_curve_of_one_line():
    assert watch.sparkline(np.array([0.0, 1.0]), 10) in ("▁█", "_@")
    assert len(watch.sparkline(np.arange(1000.0), 30)) == 30
    assert watch.sparkline(np.array([np.nan, 2.0, 2.0]), 3)[0] == " "
    assert watch.sparkline(np.full(4, np.nan), 3) == "   "


@pytest.mark.parametrize(
    ("arguments", "message"), [(["--every", "0"], "--every 0"), (["--every", "nan"], "--every nan")]
)
def test_impossible_waits_are_refused(finished, run, capsys, arguments, message):
    assert run("watch", finished, *arguments) == 2
    assert message in capsys.readouterr().err
    assert run("watch", finished / "policy") == 2
    assert "is no run's folder" in capsys.readouterr().err
