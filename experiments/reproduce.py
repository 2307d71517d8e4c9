"""`eairl reproduce`: the paper's tables, trained to the end or gone on with, every seed's return kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eairl_jax import InputError
from experiments import imitate, paper, results, transfer
from experiments.folder import machine
from experiments.imitate import Job
from experiments.retrain import Target, as_target
from experiments.rules import Rule
from experiments.settings import make_env
from experiments.summary import Row, print_table
from experiments.training import RUNS, say

FIRST_SEED = 20  # those below were seen while the settings were found
QUICK_ITERATIONS, QUICK_SEEDS = 20, 2


@dataclass(frozen=True)
class Entry:
    """One score of a table: a method that imitates `task` or, if there is a target, whose reward is moved to it."""

    task: str
    method: str
    form: str = "default"
    target: str | None = None
    rule: str = "last"

    @property
    def purpose(self) -> str:
        """Which recipe the method is trained by."""
        return "reward" if self.target else "imitate"


PAIRS = (("point_maze_left", "point_maze_right"), ("point_maze_right", "point_maze_left"), ("ant", "crippled_ant"))
# The paper's rows, the authors' variant, and two rows of our own.
MOVED = (("airl_s", "default"), ("airl_sa", "default"), ("eairl", "default"), ("eairl_release", "default"),
         ("airl_sa", "separable"), ("eairl", "separable"))  # fmt: skip
IMITATED = ("pendulum", "swimmer", "half_cheetah", "ant")
IMITATORS = ("bc", "gail", "gan_gcl", "airl_s", "airl_sa", "eairl", "eairl_release")

# Cheapest first.
EXPERIMENTS: dict[str, list[Entry]] = {
    "table1": [Entry(source, method, form, target, rule) for source, target in PAIRS for method, form in MOVED
               for rule in ("last", "source_retrain")],
    "table2": [Entry(task, method) for task in IMITATED for method in IMITATORS],
}  # fmt: skip
QUICK_TASKS = ("pendulum", "point_maze_left", "point_maze_right")


def command(name: str, quick: bool, seeds: int, tasks: tuple[str, ...], out: Path | None, folder: Path | None,
            line: str) -> None:  # fmt: skip
    """Runs the experiments of a name, writes `NAME.json` after every row, and prints their tables."""
    wanted = list(EXPERIMENTS) if name == "all" else [name]
    tasks = tasks or (QUICK_TASKS if quick else ())
    known = {entry.task for experiment in wanted for entry in EXPERIMENTS[experiment]}
    unknown = set(tasks) - known - set(QUICK_TASKS if quick else ())
    if unknown:
        raise InputError(f"--task {', '.join(sorted(unknown))}: {name} has {', '.join(sorted(known))}")
    out = out or RUNS / ("reproduce-quick" if quick else "reproduce")
    folder = folder or (out if quick else results.FOLDER)
    seeds = QUICK_SEEDS if quick else seeds
    plan = {experiment: [entry for entry in EXPERIMENTS[experiment] if not tasks or entry.task in tasks]
            for experiment in wanted}  # fmt: skip
    # Everything is checked before anything is trained.
    jobs = {entry: prepare(entry, seeds, quick) for entries in plan.values() for entry in entries}
    targets = {task: as_target(task, make_env(task), short(quick)) for task in
               {name for entry in jobs if entry.target for name in (entry.task, entry.target)}}  # fmt: skip
    for experiment, entries in plan.items():
        for entry in entries:
            row = train(entry, jobs[entry], targets, out, line)
            results.add(folder / f"{experiment}.json", row | {"machine": machine()})
        show(experiment, results.load(folder / f"{experiment}.json"), tasks)
        say(f"every seed, setting and budget: {folder}/{experiment}.json")


def short(quick: bool) -> tuple[str, ...]:
    """The assignments that make a training a matter of seconds."""
    return (f"iterations={QUICK_ITERATIONS}", f"snapshot_every={QUICK_ITERATIONS}") if quick else ()


def prepare(entry: Entry, seeds: int, quick: bool) -> Job:
    """Checks an entry and makes it ready to train."""
    (job,) = imitate.prepare(entry.task, (entry.method,), (entry.form,), range(FIRST_SEED, FIRST_SEED + seeds), None,
                             entry.purpose, short(quick))  # fmt: skip
    return job


def train(entry: Entry, job: Job, targets: dict[str, Target], out: Path, line: str) -> dict:
    """Trains an entry, or goes on with it; returns its row of the results."""
    if entry.target is None:
        summary = imitate.imitate(job, out / f"imitate-{job.task}-{job.row}", line)
    else:
        rule, source, target = Rule.parse(entry.rule, job.recipe), targets[entry.task], targets[entry.target]
        summary = transfer.transfer(job, rule, source, target, out, line)
    own = {"row": job.row, "is_published": job.is_published, "settings": job.settings()}
    return own | summary | {"command": line}


def show(experiment: str, rows: list[dict], tasks: tuple[str, ...]) -> None:
    """Prints a table for every task, or pair of tasks."""
    table = paper.TABLES[experiment]
    for (task, target), own in results.by_task(rows).items():
        if tasks and task not in tasks:
            continue
        shown = [Row("expert", np.array([own[0]["expert"]]), paper.row(table, target or task, "expert"), 1.0)]
        if target:
            shown.append(Row("ceiling", np.array(own[0]["ceiling"]), None, None, "the true reward, retrained"))
        for row in own:
            published = paper.row(table, target or task, row["method"]) if row["is_published"] else None
            name = f"{row['row']}, {row['rule']}" if target else row["row"]
            shown.append(Row(name, np.array(row["returns"]), published, row["normalized"]))
        title = f"{experiment}: {task}" + (f" to {target}" if target else "")
        print_table(f"{title}, {len(own[0]['seeds'])} seeds", shown)
