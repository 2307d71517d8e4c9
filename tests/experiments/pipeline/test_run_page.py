"""The page of a run: its figures are those of its files."""

import json
import re
import shutil

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import run_page


def test_a_finished_run_has_its_page(finished, tiny, imitate):
    shown = run_page.of_run(finished)
    summary = json.loads((finished / "summary.json").read_text())
    (table,) = shown.tables
    rows = {row[0]: row[1] for row in table.rows}
    assert rows["seed 1"] == f"{summary['returns'][1]:.2f}"
    assert rows["mean ± std"] == f"{summary['mean']:.2f} ± {summary['std']:.2f}"
    assert rows["expert"] == f"{summary['expert']:.2f}"
    assert f"{summary['normalized']:.3f}" in shown.subtitle
    assert [picture.title for picture in shown.pictures] == ["While it trained"]
    assert shown.settings["config.hidden"] == "4"
    assert shown.facts["command"] == summary["command_line"]
    before = (finished / "index.html").read_text()
    assert "data:image/png;base64," in before
    (finished / "index.html").unlink()
    assert imitate(finished, tiny) == 0
    assert (finished / "index.html").read_text() == before


def test_a_name_is_no_html_and_the_episode_is_linked(finished, tmp_path):
    folder = shutil.move(finished, tmp_path / "<script>alert(1)<")
    (folder / "view").mkdir()
    (folder / "view" / "episode.html").write_text("x")
    run_page.write(folder)
    text = (folder / "index.html").read_text()
    assert "<script" not in text
    assert 'href="view/episode.html"' in text


def test_an_experts_page_has_both_its_returns(expert):
    (table,) = run_page.of_run(expert).tables
    assert table.columns == ["", "true return", "of its mean action"]
    assert (expert / "index.html").is_file()


def test_a_sweep_has_a_row_for_each_point(finished):
    summary = json.loads((finished / "summary.json").read_text())
    dropped = {"seed": 1, "beta": 2.0, "training": "t", "quantity": "kl", "iteration": 1, "value": "nan"}
    changed = {"points": [{"beta": 1.0}, {"beta": 2.0}], "returns": [1.0, 2.0, 5.0], "dropped": [dropped]}
    (finished / "summary.json").write_text(json.dumps(summary | changed | {"more_iterations": 6}))
    (table,) = run_page.of_run(finished).tables
    assert table.rows == [["beta 1", "1.50 ± 0.50", "1.00  2.00"], ["beta 2", "5.00 ± 0.00", "5.00"]]
    assert re.search(r"dropped: seed 1, beta 2 \(kl became nan .*; 6 iterations beyond the plan", table.note)


@pytest.mark.parametrize("change", [{"returns": "many"}, {"seeds": [-1]}, {"points": [{"beta": "x"}]}])
def test_a_damaged_result_is_refused(finished, change):
    summary = json.loads((finished / "summary.json").read_text())
    (finished / "summary.json").write_text(json.dumps(summary | change))
    with pytest.raises(InputError, match=r"summary\.json"):
        run_page.of_run(finished)
