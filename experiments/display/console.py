"""The terminal: the console that everything is printed to, remarks, and tables of scores."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

console = Console()
# A remark to the user. It is dim, and never wrapped, so that the paths in it can be copied.
say = functools.partial(console.print, style="dim", markup=False, soft_wrap=True, highlight=False)

SHORTEST_NAME = 16  # columns that a table leaves to the names of its lines, at least


class Line(NamedTuple):
    """A line of a table of scores.

    Attributes:
      name: of the method, or of what else was scored.
      returns: `[seeds]`, one true return for each seed.
      paper: the paper's mean and standard deviation, if it has them.
      normalized: the mean return on a scale from 0 (random actions) to 1 (the expert).
      note: a remark, printed below the table.
    """

    name: str
    returns: np.ndarray
    paper: tuple[float, float] | None = None
    normalized: float | None = None
    note: str = ""


def with_references(lines: Sequence[Line], expert: float | None, random: float, paper=None) -> list[Line]:
    """The lines between the expert's, if its return is known, and that of random actions.

    Args:
      paper: the paper's mean and standard deviation of its expert, if it has them.
    """
    first = [] if expert is None else [Line("expert", np.array([expert]), paper, 1.0)]
    return [*first, *lines, Line("random actions", np.array([random]), None, None if expert is None else 0.0)]


def say_if_no_expert(task: str, expert: float | None) -> None:
    """Says why a table has no normalised scores."""
    if expert is None:
        say(f"no expert of {task} is known, so no score is normalised")


def mean_and_std(mean: float, std: float) -> str:
    """For example `-7.01 ± 0.61`."""
    return f"{mean:.2f} ± {std:.2f}"


def print_table(title: str, lines: Sequence[Line]) -> None:
    """Prints mean and standard deviation of each line beside the paper's, then the return of every seed.

    A terminal that is too narrow for the columns gets a paragraph for each line instead.
    """
    titles = [
        "mean ± std",
        *(["paper"] if any(line.paper for line in lines) else []),
        *(["normalized"] if any(line.normalized is not None for line in lines) else []),
    ]
    cells = [[_cells(line)[title] for title in titles] for line in lines]
    widths = [max(map(len, column)) for column in zip(titles, *cells, strict=True)]
    # Two spaces and a border belong to each column.
    needed = sum(widths) + 3 * (len(widths) + 1) + 1 + min(SHORTEST_NAME, max(len(line.name) for line in lines))
    names = [line.name for line in lines]
    if needed <= console.width:
        console.print(_table(title, titles, names, cells))
    else:
        _print_paragraphs(title, titles, names, cells)
    for line in lines:
        seeds = "every seed " + "  ".join(f"{value:.2f}" for value in line.returns) if len(line.returns) > 1 else ""
        remarks = "; ".join(remark for remark in (seeds, line.note) if remark)
        if remarks:
            say(_printable(f"{line.name}: {remarks}"))


def _cells(line: Line) -> dict[str, str]:
    mean = f"{np.mean(line.returns):.2f}"
    return {
        "mean ± std": mean_and_std(np.mean(line.returns), np.std(line.returns)) if len(line.returns) > 1 else mean,
        "paper": "-" if line.paper is None else mean_and_std(*line.paper),
        "normalized": "" if line.normalized is None else f"{line.normalized:.3f}",
    }


def _table(title: str, titles: list[str], names: list[str], cells: list[list[str]]) -> Table:
    table = Table(title=Text(_printable(title)), title_justify="left")
    table.add_column("", overflow="fold")
    for column in titles:
        table.add_column(_printable(column), justify="right", no_wrap=True)
    for texts in zip(names, *zip(*cells, strict=True), strict=True):
        table.add_row(*(Text(_printable(text)) for text in texts))
    return table


def _print_paragraphs(title: str, titles: list[str], names: list[str], cells: list[list[str]]) -> None:
    console.print(_printable(title), style="italic", markup=False, highlight=False)
    for name, texts in zip(names, cells, strict=True):
        console.print(_printable(name), markup=False, highlight=False, overflow="fold")
        for column, text in zip(titles, texts, strict=True):
            if text not in ("", "-"):
                console.print(_printable(f"  {column}: {text}"), markup=False, highlight=False, overflow="fold")


def _printable(text: str) -> str:
    """The text with `+-` for ± and `?` for other characters that the terminal's encoding lacks."""
    try:
        text.encode(console.encoding)
    except UnicodeEncodeError:
        return text.replace("±", "+-").encode(console.encoding, "replace").decode(console.encoding)
    return text
