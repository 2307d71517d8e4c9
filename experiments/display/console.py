"""The terminal: the console that everything is printed to, remarks, and tables of scores."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from eairl_jax.experiments.display.plain import encodable

# Names and paths may hold brackets and colons, so no text is markup.
console = Console(markup=False, emoji=False, highlight=False)
# A remark to the user. It is dim, and never wrapped, so that the paths in it can be copied.
say = functools.partial(console.print, style="dim", soft_wrap=True)

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
    """Prints mean and standard deviation of each line beside the paper's, then the return of every seed."""
    print_rows(title, *table_of(lines))
    for line in lines:
        seeds = "every seed " + "  ".join(f"{value:.2f}" for value in line.returns) if len(line.returns) > 1 else ""
        remarks = "; ".join(remark for remark in (seeds, line.note) if remark)
        if remarks:
            say(_printable(f"{line.name}: {remarks}"))


def table_of(lines: Sequence[Line]) -> tuple[list[str], list[list[str]]]:
    """`(titles of the columns, rows)` of a table of scores, as texts."""
    titles = [
        "mean ± std",
        *(["paper"] if any(line.paper for line in lines) else []),
        *(["normalized"] if any(line.normalized is not None for line in lines) else []),
    ]
    return ["", *titles], [[line.name, *(_cells(line)[title] for title in titles)] for line in lines]


class Layout(NamedTuple):
    """How a table is shown.

    Attributes:
      folded: the columns of texts, whose lines may be broken. The others are figures, and stand in one piece.
      lines: whether a line is drawn between all rows.
      apart: rows at the end that a line sets apart.
    """

    folded: tuple[int, ...] = (0,)
    lines: bool = False
    apart: int = 0


def print_rows(title: str, titles: Sequence[str], rows: Sequence[Sequence[str]], layout: Layout | None = None) -> None:
    """Prints a table of texts.

    A terminal that is too narrow for the columns gets a paragraph for each row instead. So nothing is ever cut off.

    Args:
      title: of the table.
      titles: of the columns; the first column holds the names of the rows.
      rows: one text for each column.
    """
    layout = layout or Layout()
    title, titles = _printable(title), [_printable(each) for each in titles]
    rows = [[_printable(text) for text in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(titles, *rows, strict=True)]
    widths = [min(width, SHORTEST_NAME) if i in layout.folded else width for i, width in enumerate(widths)]
    # Two spaces and a border belong to each column.
    console.print(title, style="italic", overflow="fold")
    if sum(widths) + 3 * len(widths) + 1 <= console.width:
        console.print(_table(titles, rows, layout))
    else:
        _print_paragraphs(titles, rows)


def _cells(line: Line) -> dict[str, str]:
    mean = f"{np.mean(line.returns):.2f}"
    return {
        "mean ± std": mean_and_std(np.mean(line.returns), np.std(line.returns)) if len(line.returns) > 1 else mean,
        "paper": "-" if line.paper is None else mean_and_std(*line.paper),
        "normalized": "" if line.normalized is None else f"{line.normalized:.3f}",
    }


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]], layout: Layout) -> Table:
    table = Table(show_lines=layout.lines)
    for i, column in enumerate(titles):
        is_text = i in layout.folded
        table.add_column(
            Text(column),
            justify="left" if is_text or i == 0 else "right",
            overflow="fold",
            no_wrap=not is_text,
            min_width=min(SHORTEST_NAME, max(map(len, (column, *(row[i] for row in rows))))) if is_text else None,
        )
    for number, row in enumerate(rows):
        if layout.apart and number == len(rows) - layout.apart:
            table.add_section()
        table.add_row(*map(Text, row))
    return table


def _print_paragraphs(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    for name, *texts in rows:
        named = zip(titles[1:], texts, strict=True)
        shown = [f"  {column}: {text}" for column, text in named if text not in ("", "-")]
        console.print("\n".join([name, *shown]), overflow="fold")


def _printable(text: str) -> str:
    """The text with substitutes for what the terminal cannot show: characters of other encodings, control characters.

    A name from a file could otherwise move the cursor or colour the terminal.
    """
    text = "".join(each if each.isprintable() or each in "\n\t" else ascii(each)[1:-1] for each in text)
    return encodable(text, console.encoding)
