"""`eairl runs`: a table of the runs in a folder."""

from __future__ import annotations

import dataclasses
import time

from eairl_jax import InputError
from eairl_jax.experiments.display.console import Layout, print_rows, say
from eairl_jax.experiments.options import Runs
from eairl_jax.experiments.pipeline import overview
from eairl_jax.experiments.pipeline.overview import Overview
from eairl_jax.storage import write_json

TITLES = ("run", "task", "method", "seeds", "iterations", "true return", "normalized", "age", "MB")
UNITS = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"))


def run(options: Runs, command_line: str) -> None:
    """Prints the runs, the newest first."""
    directory = options.directory
    if not directory.is_dir():
        raise InputError(f"no folder {directory}: give the folder that holds the runs")
    found = [overview.read(path, _name(path, directory)) for path in overview.find(directory)]
    found.sort(key=lambda each: -each.changed)
    if options.json:
        try:
            write_json(options.json, {"command_line": command_line, "runs": [dataclasses.asdict(x) for x in found]})
        except OSError as e:
            raise InputError(f"cannot write {options.json} ({e.strerror}): choose another --json") from None
    rows = [_row(each) for each in found if not each.problem]
    if rows:
        print_rows(f"Runs in {directory}", TITLES, rows, Layout(folded=(0, 1, 2)))
    elif not found:
        say(f"no runs in {directory}")
    for each in found:
        if each.problem:
            say(f"{each.folder}: {each.problem}")


def _name(path, directory) -> str:
    name = path.relative_to(directory).as_posix()
    return path.name if name == "." else name


def _row(run: Overview) -> list[str]:
    score = "" if run.score is None else f"{run.score:.2f}"
    return [
        run.folder,
        run.task,
        run.method,
        str(run.seeds),
        f"{run.planned}" if run.is_finished else f"{run.done} of {run.planned}",
        score if run.is_finished or not score else f"({score})",
        "" if run.normalized is None else f"{run.normalized:.3f}",
        age(time.time() - run.changed),
        f"{run.size / 1e6:.1f}",
    ]


def age(seconds: float) -> str:
    """For example "3 h"."""
    return next((f"{seconds / unit:.0f} {name}" for unit, name in UNITS if seconds >= unit), "now")
