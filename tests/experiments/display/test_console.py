"""Tables of scores on wide, narrow and ASCII terminals, and remarks that are never wrapped."""

import functools
import io

import numpy as np
import pytest
from rich.console import Console

from eairl_jax.experiments.display import console as module
from eairl_jax.experiments.display.console import Line, print_table, with_references

LINES = [
    Line("expert", np.array([-4.98]), (-4.98, 0.29), 1.0),
    Line("eairl-separable+gradient_penalty=0.1, source_retrain", np.array([-5.0, -7.0]), None, 0.5, "a note [of 2]"),
]


@pytest.fixture
def printed(monkeypatch):
    """A function that prints a table on a terminal of some width and returns the text."""

    def on(width, encoding="utf-8", lines=LINES):
        stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="")
        terminal = Console(file=stream, width=width)
        monkeypatch.setattr(module, "console", terminal)
        monkeypatch.setattr(module, "say", functools.partial(terminal.print, **module.say.keywords))
        print_table("two seeds of [a title]", lines)
        stream.flush()
        return stream.buffer.getvalue().decode(encoding)

    return on


def test_without_an_expert_a_table_has_no_scores(printed):
    without = with_references([Line("gail", np.array([3.0]))], None, 1.0)
    assert [line.name for line in without] == ["gail", "random actions"]
    assert "normalized" not in printed(100, lines=without)
    whole = with_references([Line("gail", np.array([3.0]), None, 0.5)], 5.0, 1.0)
    assert [(line.name, line.normalized) for line in whole] == [("expert", 1.0), ("gail", 0.5), ("random actions", 0.0)]
    assert "normalized" in printed(100, lines=whole)


def test_a_table_shows_means_the_papers_figures_and_every_seed(printed):
    text = printed(100)
    lines = text.splitlines()
    assert "two seeds of [a title]" in lines[0]
    (expert,) = (line for line in lines if "expert" in line)
    assert [cell.strip() for cell in expert.strip("│").split("│")] == ["expert", "-4.98", "-4.98 ± 0.29", "1.000"]
    assert "-6.00 ± 1.00" in text
    assert lines[-1] == f"{LINES[1].name}: every seed -5.00  -7.00; a note [of 2]"


@pytest.mark.parametrize("width", [30, 62, 80])
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_narrow_or_ascii_terminal_loses_no_name_and_no_figure(printed, width, encoding):
    table, _, remark = printed(width, encoding).partition("every seed")
    rows = table.splitlines()[:-1] if width > 62 else table.splitlines()
    border = "│" if encoding == "utf-8" else "|"
    is_table = any(row.startswith(border) for row in rows)
    assert is_table == (width == 80)
    # A long name is folded over several rows: without spaces and borders it stands in one piece again.
    names = "".join(row.split(border)[1] if is_table and row.count(border) > 1 else row for row in rows)
    assert all(line.name.replace(" ", "") in "".join(names.split()) for line in LINES)
    plus_minus = "±" if encoding == "utf-8" else "+-"
    for figure in ("-4.98", f"-6.00 {plus_minus} 1.00", f"-4.98 {plus_minus} 0.29", "0.500", "1.000"):
        assert figure in table
    assert max(map(len, rows[:-1])) <= width
    assert "a note [of 2]" in remark


def test_a_table_without_the_papers_figures_has_no_column_for_them(printed):
    assert "paper" in printed(80)
    assert "paper" not in printed(80, lines=[LINES[1]])


def test_a_remark_is_never_wrapped(capsys):
    module.say("a/path" * 100)
    assert capsys.readouterr().out == "a/path" * 100 + "\n"
