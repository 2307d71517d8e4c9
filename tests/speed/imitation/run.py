"""Our GAIL, AIRL and EAIRL beside the GAIL and AIRL of `imitation`, on half-cheetah: true return over minutes.

    make bench-imitation

All learn from the shipped demonstrations. Every training has one core for itself, and there are as many at a time as
cores. Ours have an empty compilation cache. A training's minutes count from the start of its command. Both libraries
have tuned settings: ours were found on the ant, those of `imitation` on its own half-cheetah. The returns are those of
the policy that explores.
"""

from __future__ import annotations

import csv
import json
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from eairl_jax.experiments.display.plots import figure_of, save
from eairl_jax.experiments.pipeline.places import shipped_demonstrations
from eairl_jax.experiments.pipeline.run_folder import machine
from eairl_jax.storage import read_json, write_json

THEIRS = Path(__file__).with_name("theirs.py")
TASK, SEED = "half_cheetah", 20
SHARE = 0.9
"""Of the expert's return: the goal."""
WINDOW = 16
"""Episodes of `imitation` in a mean, two of each environment."""


class Trained(NamedTuple):
    """A training that has ended.

    Attributes:
      minutes, true_return: `[points]`, of the training so far.
      env_steps: in all.
      steps_per_second: while it trained; starting and compiling are not counted.
    """

    minutes: np.ndarray
    true_return: np.ndarray
    env_steps: int
    steps_per_second: float


@dataclass(frozen=True)
class Job:
    """A training: its line in the figure, its command, its folder, and how `(folder, seconds)` is read."""

    name: str
    color: str
    style: str
    command: list[str]
    folder: Path
    read: Callable[[Path, float], Trained]


def jobs(python: Path, seconds: float, folder: Path) -> list[Job]:
    """The trainings, ours first."""
    demonstrations = shipped_demonstrations(TASK)
    eairl = [sys.executable, "-m", "eairl_jax.experiments.cli", "imitate", TASK, "--tuned", "--seeds", "1"]
    eairl += ["--first-seed", str(SEED)]
    ours = {"GAIL": ("gail", "C0"), "AIRL": ("airl_sa", "C1"), "EAIRL": ("eairl", "C2")}
    theirs = {"GAIL": ("gail", "C0"), "AIRL": ("airl", "C1")}
    own = {method: folder / method for method, _ in ours.values()}
    other = {method: folder / f"theirs-{method}" for method, _ in theirs.values()}
    trained = [str(python), str(THEIRS), str(demonstrations), str(seconds)]
    return [
        *(
            Job(
                f"{name}, eairl_jax",
                color,
                "-",
                [*eairl, "--method", each, "--out", str(own[each])],
                own[each],
                of_ours,
            )
            for name, (each, color) in ours.items()
        ),
        *(
            Job(f"{name}, imitation", color, ":", [*trained, each, str(other[each])], other[each], of_theirs)
            for name, (each, color) in theirs.items()
        ),
    ]


def of_ours(folder: Path, seconds: float) -> Trained:
    """Reads a run of ours. All that is not training is counted before the first iteration."""
    training = read_json(folder / "seconds.json")["run_seconds"]
    with open(folder / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    iterations = 1 + np.arange(len(rows))
    minutes = (seconds - training + training * iterations / len(rows)) / 60
    true_return = np.array([float(row["true_return"]) for row in rows])
    ended = np.isfinite(true_return)
    steps = int(rows[-1]["env_steps"])
    return Trained(minutes[ended], true_return[ended], steps, steps / training)


def of_theirs(folder: Path, _seconds: float) -> Trained:
    """Reads the episodes of all environments, in the order in which they ended."""
    summary, episodes = read_json(folder / "summary.json"), []
    for path in folder.glob("*.monitor.csv"):
        header, _, *lines = path.read_text().splitlines()
        first = json.loads(header[1:])["t_start"] - summary["started"]
        episodes += [(first + float(line.split(",")[2]), float(line.split(",")[0])) for line in lines]
    ended = np.array(sorted(episodes))
    whole = len(ended) // WINDOW * WINDOW
    at, returns = ended[:whole].reshape(-1, WINDOW, 2).transpose(2, 0, 1)
    return Trained(
        at[:, -1] / 60, returns.mean(axis=1), summary["env_steps"], summary["env_steps"] / summary["training_seconds"]
    )


def train(waiting: list[Job], folder: Path) -> dict[str, Trained]:
    """Runs the jobs, one on each core at a time."""
    left, results = queue.SimpleQueue[Job](), {}
    for job in waiting:
        left.put(job)

    def work(core: int) -> None:
        while True:
            try:
                job = left.get_nowait()
            except queue.Empty:
                return
            cache = folder / f"cache-{core}"
            shutil.rmtree(cache, ignore_errors=True)
            started = time.monotonic()
            with open(folder / f"{job.name}.log", "w") as log:
                subprocess.run(
                    ["taskset", "--cpu-list", str(core), *job.command],
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    check=True,
                    env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)},
                )
            results[job.name] = job.read(job.folder, time.monotonic() - started)

    workers = [threading.Thread(target=work, args=(core,)) for core in sorted(os.sched_getaffinity(0))]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return results


def reached(trained: Trained, goal: float) -> float | None:
    """The minutes after which the true return is the goal for the first time; None if it never is."""
    above = np.flatnonzero(trained.true_return >= goal)
    return float(trained.minutes[above[0]]) if above.size else None


def draw(path: Path, all_jobs: list[Job], results: dict[str, Trained], expert: float) -> None:
    """Saves the figure."""
    figure, ((axis,),) = figure_of(1, 1, (7.0, 4.2), "Half-cheetah, one seed on one core")
    for job in all_jobs:
        axis.plot(*results[job.name][:2], color=job.color, ls=job.style, label=job.name)
    axis.axhline(expert, color="black", lw=0.8, ls="--", label="expert")
    axis.set(xlabel="minutes since the command, installation not counted", ylabel="true return", xlim=(0, None))
    axis.legend(frameon=False, fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    save(figure, path)


def main(
    python: Annotated[Path, tyro.conf.arg(help="Python of an environment with imitation 1.0.1.")],
    minutes: Annotated[float, tyro.conf.arg(help="Of each training of imitation.")] = 8.0,
    folder: Annotated[Path, tyro.conf.arg(help="For runs and logs; must not exist.")] = Path("runs/beside-imitation"),
    out: Annotated[Path, tyro.conf.arg(help="Folder of figure and figures.")] = Path("docs"),
) -> None:
    """Trains all, prints a table, and writes `beside-imitation.png` and `.json`."""
    folder.mkdir(parents=True)
    all_jobs = jobs(python.absolute(), 60 * minutes, folder.absolute())
    results = train(all_jobs, folder)
    expert = float(read_json(shipped_demonstrations(TASK).with_suffix(".json"))["expert_return"])
    figures, table = (
        {},
        Table("", "env steps", "steps/s", "minutes", "best / expert", f"minutes to {SHARE} of the expert"),
    )
    for job in all_jobs:
        each = results[job.name]
        figures[job.name] = {
            "env_steps": each.env_steps,
            "steps_per_second": each.steps_per_second,
            "minutes": float(each.minutes[-1]),
            "best_share": float(each.true_return.max() / expert),
            "minutes_to_goal": reached(each, SHARE * expert),
        }
        goal = figures[job.name]["minutes_to_goal"]
        table.add_row(
            job.name,
            f"{each.env_steps:,}",
            f"{each.steps_per_second:,.0f}",
            f"{each.minutes[-1]:.1f}",
            f"{each.true_return.max() / expert:.2f}",
            "not reached" if goal is None else f"{goal:.1f}",
        )
    Console().print(table)
    draw(out / "beside-imitation.png", all_jobs, results, expert)
    write_json(out / "beside-imitation.json", {"task": TASK, "seed": SEED, "machine": machine(), "trainings": figures})


if __name__ == "__main__":
    tyro.cli(main)
