"""The figure and the page of scores."""

import numpy as np

from eairl_jax.experiments.display import page, score_page
from eairl_jax.experiments.display.plots import Dots


def test_the_page_holds_tables_figure_and_command(tmp_path):
    table = page.Table("Scores", ["", "mean"], [["a <b>", "1.50"]], "a note")
    panel = Dots("of a", "true return", {"a": np.array([1.0, 2.0])})
    score_page.write(tmp_path, "title", "subtitle", [table], [panel], {"command": "eairl evaluate run"})
    assert (tmp_path / "scores.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "index.html").read_text()
    for shown in ("title", "subtitle", "a &lt;b&gt;", "1.50", "a note", "eairl evaluate run", "data:image/png;base64,"):
        assert shown in text
