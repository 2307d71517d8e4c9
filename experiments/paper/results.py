"""Results of experiments on disk, and the tables that the README and the report show of them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import filelock
import numpy as np
from eairl_jax.experiments.pipeline.scores import Reference

from eairl_jax import InputError
from eairl_jax.experiments.paper import published as paper
from eairl_jax.storage import read_json, write_json

FOLDER = Path("experiments") / "results"
NAMES = {
    "bc": "behaviour cloning", "gail-sa": "GAIL", "gan_gcl-sa": "GAN-GCL", "airl_s-s": "AIRL(s)",
    "airl_sa-sa": "AIRL(s,a)", "eairl-sa": "EAIRL", "eairl_release-sa": "EAIRL (release)",
    "airl_sa-separable": "AIRL, separable", "eairl-separable": "EAIRL, separable", "eairl-s": "EAIRL(s)",
}  # fmt: skip
# One colour for each row, in every figure.
COLORS = {
    "eairl-sa": "C0", "airl_s-s": "C1", "eairl-separable": "C2", "airl_sa-sa": "C3", "airl_sa-separable": "C4",
    "eairl_release-sa": "C5", "gan_gcl-sa": "C6", "bc": "C7", "gail-sa": "C8", "eairl-s": "C9",
}  # fmt: skip
# What every row has.
NEEDED = ("row", "method", "task", "target", "seeds", "returns", "normalized", "expert", "random", "is_published",
          "settings", "machine")  # fmt: skip
RULES = ("last", "source_retrain", "policy")  # a column each
HOME = "back in the source"  # the column of rewards that are retrained where they were learned
IMITATING = "imitating, in the source"  # that of the policies that learned the rewards, where they did


def load(path: Path) -> list[dict]:
    """The rows of a results file; none if it is not there.

    Raises:
      InputError: if the file holds no rows, or only a part of one.
    """
    rows = read_json(path).get("rows") if path.exists() else []
    if not isinstance(rows, list):
        raise InputError(f"{path} holds no rows of `eairl reproduce`: give the folder that it wrote")
    for number, row in enumerate(rows):
        missing = [name for name in NEEDED if name not in row]
        if missing:
            raise InputError(f"row {number} of {path} lacks {', '.join(missing)}: write it anew with `eairl reproduce`")
    return rows


def add(path: Path, row: dict) -> None:
    """Puts a row into a results file, in the place of one of the same method, tasks and rule."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with filelock.FileLock(path.with_suffix(".lock")):  # of two processes neither loses the other's row
        rows = {identity(each): each for each in (*load(path), row)}  # a key keeps the place where it first stood
        write_json(path, {"rows": list(rows.values())})


def identity(row: dict) -> tuple[str, str, str | None, str | None]:
    """What tells a row from every other of its experiment."""
    return row["row"], row["task"], row["target"], row.get("rule")


def name(row: str) -> str:
    """How a row is called in tables: "EAIRL, lambda_i=0" of "eairl-sa+lambda_i=0"."""
    own, *variant = row.split("+")
    return ", ".join([NAMES.get(own, own), *variant])


def place(row: str) -> tuple[int, str]:
    """Where a row is listed, whichever was trained first; variants follow what they vary."""
    known, own = list(NAMES), row.split("+")[0]
    return known.index(own) if own in known else len(known), row


def in_order(rows: list[dict]) -> list[str]:
    """The names of rows as they are listed everywhere."""
    return sorted({row["row"] for row in rows}, key=place)


def listed(rows: list[dict]) -> list[dict]:
    """Rows in the order in which they are listed everywhere."""
    return sorted(rows, key=lambda row: place(row["row"]))


def color(row: str) -> str:
    """The colour of a row and of its variants."""
    return COLORS.get(row.split("+")[0], "black")


def by_task(rows: list[dict]) -> dict[tuple[str, str | None], list[dict]]:
    """The rows of each `(task, target)`, in their order."""
    grouped: dict[tuple[str, str | None], list[dict]] = {}
    for row in rows:
        grouped.setdefault((row["task"], row["target"]), []).append(row)
    return grouped


def moved(rows: list[dict]) -> list[dict]:
    """Those whose reward went to another task."""
    return [row for row in rows if row["target"] and row["target"] != row["task"]]


def normalized(row: dict) -> np.ndarray:
    """Each seed's score `[seeds]`: 0 for random actions, 1 for the expert."""
    return Reference(row["expert"], row["random"]).normalized(np.array(row["returns"]))


def ceilings(rows: list[dict]) -> dict[str, dict]:
    """A row of transfer for each budget of retraining: its ceiling is that of all rows of that budget."""
    return {row["row"].partition("+retrain_")[2]: row for row in reversed(rows) if row["target"]}


def ceiling(row: dict) -> float:
    """The normalised score of the true reward, retrained under the budget of a row of transfer."""
    return Reference(row["expert"], row["random"]).normalized(float(np.mean(row["ceiling"])))


def picked_on_the_target(rows: list[dict]) -> dict | None:
    """The row that the release's protocol takes: the iteration of EAIRL's reward that scores best *in the target*."""
    tried = [row for row in rows if row["row"] == "eairl-sa" and row["rule"].startswith(("iteration=", "last"))]
    return max(tried, key=lambda row: row["mean"]) if len(tried) > 1 else None


class Cell(NamedTuple):
    """A figure and the paper's: as text, and as a share of the way from random actions to the expert."""

    ours: str = ""
    share: float | None = None
    published: str = ""
    published_share: float | None = None


class Table(NamedTuple):
    """A table: `lines` hold a name and a cell for each column, or fewer."""

    title: str
    columns: list[str]
    lines: list[tuple[str, list[Cell]]]

    def has_paper(self, column: int) -> bool:
        """Whether the paper has any figure for a column."""
        return any(len(cells) > column and cells[column].published for _, cells in self.lines)


def cell(row: dict | None, table: dict) -> Cell:
    """The cell of a row of the results; an empty one if there is none."""
    if row is None:
        return Cell()
    task = row["target"] or row["task"]
    ours, published = _show(row["returns"]), paper.row(table, task, row["method"]) if row["is_published"] else None
    expert = paper.row(table, task, "expert")
    if published is None or expert is None:
        return Cell(ours, row["normalized"])
    # What random actions score in the paper's tasks is not known: ours stand in for them.
    return Cell(ours, row["normalized"], paper.show(published),
                Reference(expert[0], row["random"]).normalized(published[0]))  # fmt: skip


def tables(rows: list[dict], table: dict) -> list[Table]:
    """Those of an experiment: one of all imitations, and one for each pair of tasks.

    Args:
      table: the paper's figures, `paper.TRANSFER` or `paper.IMITATION`.
    """
    imitations = [row for row in rows if row["target"] is None]
    pairs = by_task(moved(rows)).values()
    return [*([_imitation(imitations, table)] if imitations else []), *(_transfer(own, rows, table) for own in pairs)]


def _imitation(rows: list[dict], table: dict) -> Table:
    own = {(row["row"], row["task"]): row for row in rows}
    tasks, names = list(dict.fromkeys(row["task"] for row in rows)), in_order(rows)
    first = [next(row for row in rows if row["task"] == task) for task in tasks]
    return Table("imitation", tasks, [
        ("expert", [_expert(row, table) for row in first]),
        *((name(each), [cell(own.get((each, task)), table) for task in tasks]) for each in names),
        ("random actions", [_random(row) for row in first]),
    ])  # fmt: skip


def _transfer(rows: list[dict], everything: list[dict], table: dict) -> Table:
    first, own = rows[0], {(row["row"], row["rule"]): row for row in rows}
    own |= {(row["row"], HOME): row for row in everything if row["task"] == row["target"] == first["task"]}
    columns = [rule for rule in (*RULES, HOME) if any(rule == used for _, used in own)]
    best = ceiling(first)
    lines = [("expert", [_expert(first, table)]), ("ceiling", [Cell(_show(first["ceiling"]), best)])]
    for each in in_order([row for row in rows if row["rule"] in RULES]):
        cells = [cell(own.get((each, rule)), table if rule == "last" else {}) for rule in columns]
        learned = next(row for row in rows if row["row"] == each)["imitation_returns"]
        lines.append((name(each), [*cells, Cell(_show(learned))]))
    picked = picked_on_the_target(rows)
    if picked:
        lines.append(("EAIRL, iteration picked by its score in the target", [cell(picked, {})]))
    lines += [("random reward", [cell(row, {})]) for row in rows if row["rule"] == "random"]
    title = f"{first['task']} to {first['target']}"
    return Table(title, [*columns, IMITATING], [*lines, ("random actions", [_random(first)])])


def _expert(row: dict, table: dict) -> Cell:
    published = paper.row(table, row["target"] or row["task"], "expert")
    return Cell(f"{row['expert']:.2f}", 1.0, *((paper.show(published), 1.0) if published else ()))


def _random(row: dict) -> Cell:
    return Cell(f"{row['random']:.2f}", 0.0)


def markdown(table: Table) -> str:
    """A table as Markdown: every figure with its share, the paper's column beside ours where it has one."""
    with_paper = [table.has_paper(column) for column in range(len(table.columns))]

    def line(cells: list[Cell]) -> list[str]:
        padded = [*cells, *[Cell()] * (len(table.columns) - len(cells))]
        return [text for each, also in zip(padded, with_paper, strict=True)
                for text in (_with_share(each.ours, each.share),
                             *([_with_share(each.published, each.published_share)] if also else []))]  # fmt: skip

    titles = [text for column, also in zip(table.columns, with_paper, strict=True)
              for text in (column, *(["paper"] if also else []))]  # fmt: skip
    lines = [
        [table.title, *titles],
        ["---"] * (1 + len(titles)),
        *([each, *line(cells)] for each, cells in table.lines),
    ]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _with_share(figure: str, share: float | None) -> str:
    return figure if share is None else f"{figure} ({share:.2f})"


def _show(returns: list[float]) -> str:
    return paper.show((float(np.mean(returns)), float(np.std(returns))))
