"""`eairl compare`: a table, a figure and a page."""

import json
import shutil

import pytest


def test_two_runs_side_by_side(finished, tmp_path, run, capsys, unchanged):
    other = shutil.copytree(finished, tmp_path / "<script>other")
    summary = json.loads((other / "summary.json").read_text())
    (other / "summary.json").write_text(json.dumps(summary | {"returns": [-5.0, -3.0]}))
    with unchanged(finished):
        assert run("compare", finished, other, "--out", tmp_path / "cmp") == 0
    printed = capsys.readouterr().out
    assert "-4.000 ± 1.000" in printed
    assert "1.00 (1.00 to 1.00)" in printed
    assert (tmp_path / "cmp" / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert "<script" not in (tmp_path / "cmp" / "index.html").read_text()
    figures = json.loads((tmp_path / "cmp" / "comparison.json").read_text())["runs"]
    assert figures[1]["scores"] == [-5.0, -3.0]
    assert figures[1]["probability_of_improvement"]["value"] == 1.0


@pytest.mark.parametrize(
    ("count", "more", "message"),
    [(1, [], "at least two runs"), (2, [], "the same name"), (2, ["--metric", "kll"], "--metric kll")],
)
def test_what_cannot_be_compared_is_refused(finished, tmp_path, run, capsys, count, more, message):
    assert run("compare", *[finished] * count, *more, "--out", tmp_path / "cmp") == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "cmp").exists()
