"""Results of experiments on disk, and the tables that the README shows of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eairl_jax.artefact import read_json, write_json
from experiments import paper
from experiments.reference import Reference

FOLDER = Path("experiments") / "results"
NAMES = {
    "bc": "behaviour cloning", "gail": "GAIL", "gan_gcl": "GAN-GCL", "airl_s-s": "AIRL(s)",
    "airl_sa-sa": "AIRL(s,a)", "eairl-sa": "EAIRL", "eairl_release-sa": "EAIRL (release)",
    "airl_sa-separable": "AIRL, separable", "eairl-separable": "EAIRL, separable", "gail-sa": "GAIL",
    "gan_gcl-sa": "GAN-GCL",
}  # fmt: skip


def load(path: Path) -> list[dict]:
    """The rows of a results file; none if it is not there."""
    return read_json(path)["rows"] if path.exists() else []


def add(path: Path, row: dict) -> None:
    """Puts a row into a results file, in the place of one of the same method, tasks and rule."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = {_identity(each): each for each in (*load(path), row)}  # a key keeps the place where it first stood
    write_json(path, {"rows": list(rows.values())})


def by_task(rows: list[dict]) -> dict[tuple[str, str | None], list[dict]]:
    """The rows of each `(task, target)`, in their order."""
    grouped: dict[tuple[str, str | None], list[dict]] = {}
    for row in rows:
        grouped.setdefault((row["task"], row["target"]), []).append(row)
    return grouped


def markdown(rows: list[dict], table: dict) -> str:
    """The tables of results, one for every task or pair of tasks.

    Args:
      table: the paper's figures, `paper.TRANSFER` or `paper.IMITATION`.
    """
    return "\n\n".join(_markdown(task, target, own, table) for (task, target), own in by_task(rows).items())


def _identity(row: dict) -> tuple:
    return row["row"], row["task"], row["target"], row.get("rule")


def _markdown(task: str, target: str | None, rows: list[dict], table: dict) -> str:
    rules = list(dict.fromkeys(row.get("rule", "") for row in rows))
    over = "`{}`" if target else "mean ± std"
    header = [f"{task} to {target}" if target else task, *(over.format(rule) for rule in rules), "normalized", "paper"]
    published, first = paper.row(table, target or task, "expert"), rows[0]
    known = Reference(first["expert"], first["random"])
    lines = [header, ["---"] * len(header), ["expert", f"{first['expert']:.2f}", *[""] * (len(rules) - 1), "1",
             paper.show(published)]]  # fmt: skip
    if target:
        lines.append(["ceiling", _show(first["ceiling"]), *[""] * (len(rules) - 1),
                      f"{known.normalized(np.mean(first['ceiling'])):.3f}", ""])  # fmt: skip
    for name in dict.fromkeys(row["row"] for row in rows):
        own = {row.get("rule", ""): row for row in rows if row["row"] == name}
        any_row = next(iter(own.values()))
        cells = [_show(own[rule]["returns"]) if rule in own else "" for rule in rules]
        normalized = " / ".join(f"{own[rule]['normalized']:.3f}" for rule in rules if rule in own)
        published = paper.row(table, target or task, any_row["method"]) if any_row["is_published"] else None
        lines.append([NAMES.get(name, name), *cells, normalized, paper.show(published) if published else ""])
    lines.append(["random actions", f"{first['random']:.2f}", *[""] * (len(rules) - 1), "0", ""])
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _show(returns: list[float]) -> str:
    return paper.show((float(np.mean(returns)), float(np.std(returns))))
