"""`eairl reproduce`: the paper's tables, trained to the end or gone on with, every seed's return kept."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from eairl_jax.experiments.pipeline.learn import Job
from eairl_jax.experiments.pipeline.retrain import Target, as_target, kept_curves, on_reward, target_settings
from eairl_jax.experiments.pipeline.select import Rule

from eairl_jax import InputError
from eairl_jax.experiments.display.plots import Row, print_table
from eairl_jax.experiments.paper import figures, results, reward_distance
from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.pipeline import learn, transfer
from eairl_jax.experiments.pipeline.run_folder import RunFolder, digest, machine
from eairl_jax.experiments.pipeline.train import RUNS, say
from eairl_jax.experiments.recipes import make_env
from eairl_jax.methods import METHODS

FIRST_SEED = 20  # those below were seen while the settings were found
QUICK_ITERATIONS, QUICK_SEEDS = 20, 2
CURVE_POINTS = 50


@dataclass(frozen=True)
class Entry:
    """One score of a table: a method that imitates `task` or, if there is a target, whose reward is moved to it.

    Attributes:
      target: the task itself asks for a fresh policy on the learned reward where it was learned.
      settings: `name=value` that differ from the recipe.
      retrain: those of the recipe by which the reward is put to use.
      tuned: with our settings in place of the paper's.
    """

    task: str
    method: str
    form: str = "default"
    target: str | None = None
    rule: str = "last"
    settings: tuple[str, ...] = ()
    tuned: bool = False
    retrain: tuple[str, ...] = ()

    @property
    def variant(self) -> str:
        """What tells its learning from others of the method and form."""
        return "+".join([*self.settings, *(["tuned"] if self.tuned else [])])

    @property
    def row(self) -> str:
        """The name of its row, `transfer.row_of`."""
        form = METHODS[self.method].reward_form if self.method in METHODS else ""
        own = f"{self.method}-{self.form.replace('default', form)}" if form else self.method
        return "+".join([own, *filter(None, (self.variant, retrain_variant(self.retrain)))])

    @property
    def identity(self) -> tuple:
        """That of its row in the results."""
        return self.row, self.task, self.target, self.rule if self.target else None

    @property
    def purpose(self) -> str:
        """Which recipe the method is trained by."""
        return "reward" if self.target else "imitate"


def retrain_variant(retrain: tuple[str, ...]) -> str:
    """What tells a retraining from the recipe's."""
    return "+".join(f"retrain_{setting}" for setting in retrain)


# Cheapest first.
ORDER = ("point_maze_left", "point_maze_right", "pendulum", "swimmer", "half_cheetah", "ant")
MAZES = (("point_maze_left", "point_maze_right"), ("point_maze_right", "point_maze_left"))
ANTS = ("ant", "crippled_ant")
# The paper's rows, the authors' variant, and two rows of our own.
MOVED = (("airl_s", "default"), ("airl_sa", "default"), ("eairl", "default"), ("eairl_release", "default"),
         ("airl_sa", "separable"), ("eairl", "separable"))  # fmt: skip
# Methods that the paper moves no reward of: theirs, where they have one, and their policies.
OTHERS = (("gail", "default"), ("gan_gcl", "default"))
IMITATED = ("pendulum", "swimmer", "half_cheetah", "ant")
IMITATORS = ("bc", "gail", "gan_gcl", "airl_s", "airl_sa", "eairl", "eairl_release")
ABLATIONS = (("shaping=none",), ("shaping=learned",), ("lambda_i=0",), ("lambda_i=0.001",), ("lambda_i=0.1",),
             ("l_i_actions=resampled",), ("history_length=1",))  # fmt: skip


def _moved(pair: tuple[str, str], chosen: tuple[tuple[str, str], ...] = MOVED) -> list[Entry]:
    """Every row by the last iteration, as a policy, and those `chosen` by `source_retrain`; a reward at random."""
    source, target = pair
    rules = (("last", (*OTHERS, *MOVED)), ("policy", (("bc", "default"), *OTHERS, *MOVED)), ("source_retrain", chosen))
    rows = [Entry(source, method, form, target, rule) for rule, own in rules for method, form in own]
    return [*rows, Entry(source, "eairl", "default", target, "random")]


def _back_home(pair: tuple[str, str]) -> list[Entry]:
    return [Entry(pair[0], method, form, pair[0]) for method, form in MOVED]


def _picked_on_the_target(pair: tuple[str, str], kept: tuple[int, ...]) -> list[Entry]:
    """What the release's protocol chooses from: it takes the iteration that scores best in the target."""
    return [Entry(pair[0], "eairl", "default", pair[1], f"iteration={iteration}") for iteration in kept]


def _ablated(pair: tuple[str, str]) -> list[Entry]:
    """The paper's EAIRL and the separable row with one setting changed; the state-only reward with empowerment."""
    rows = [Entry(pair[0], "eairl", form, pair[1], settings=settings)
            for form in ("default", "separable") for settings in ABLATIONS]  # fmt: skip
    # The separable row has Phi and a learned h by itself: Phi alone, and the paper's lambda_I.
    rows += [Entry(pair[0], "eairl", "separable", pair[1], settings=settings)
             for settings in (("shaping=empowerment",), ("lambda_i=1",))]  # fmt: skip
    return [*rows, Entry(pair[0], "eairl", "s", pair[1])]


# Of the ants, what shows why their separable reward transfers: the penalty on slopes in place of sparsity, less of it,
# and the potentials that mattered in the maze.
SPARSITY = (("gradient_penalty=0.1", "input_sparsity=0"), ("input_sparsity=0.03",), ("shaping=none",),
            ("shaping=empowerment",))  # fmt: skip
LONG = ("iterations=1600",)  # 10M steps of retraining: what the protocol wants, more than every row could have


EXPERIMENTS: dict[str, list[Entry]] = {
    "table1": [
        *(entry for pair in MAZES for rows in (_moved(pair), _back_home(pair), _picked_on_the_target(pair, (40, 80)))
          for entry in rows),
        *_moved(ANTS, chosen=(("eairl", "default"), ("eairl", "separable"))),
        *_back_home(ANTS),
        *_picked_on_the_target(ANTS, (100, 200, 300)),
        *(Entry(ANTS[0], method, form, ANTS[1], tuned=True) for method, form in MOVED[:3]),
    ],
    "table2": [
        *(Entry(task, method) for task in IMITATED for method in IMITATORS),
        Entry("half_cheetah", "eairl", tuned=True),
        # Is it the expert's actions beyond their bounds that the paper's settings fall short by?
        Entry("half_cheetah", "eairl", settings=("actions=clipped",)),
        *(Entry("ant", method, tuned=True) for method in ("eairl", "gail", "airl_sa", "airl_s")),
    ],
    "ablations": [*_ablated(MAZES[0]),
                  *(Entry(ANTS[0], "eairl", "separable", ANTS[1], settings=settings) for settings in SPARSITY),
                  Entry(ANTS[0], "eairl", "separable", ANTS[1], retrain=LONG)],
}  # fmt: skip
# What is drawn of an experiment's results.
FIGURES = {"figure2": "table1", "appendix-c": "table1"}
QUICK_TASKS = ("pendulum", "point_maze_left")


def command(name: str, quick: bool, seeds: int, tasks: tuple[str, ...], out: Path | None, folder: Path | None,
            line: str) -> None:  # fmt: skip
    """Runs the experiments of a name, writes `NAME.json` after every row, and prints their tables."""
    wanted = list(EXPERIMENTS) if name == "all" else [FIGURES.get(name, name)]
    tasks = tasks or (QUICK_TASKS if quick else ())
    known = {entry.task for experiment in wanted for entry in EXPERIMENTS[experiment]}
    unknown = set(tasks) - known - set(QUICK_TASKS if quick else ())
    if unknown:
        raise InputError(f"--task {', '.join(sorted(unknown))}: {name} has {', '.join(sorted(known))}")
    out = out or RUNS / ("reproduce-quick" if quick else "reproduce")
    folder = folder or (out if quick else results.FOLDER)
    seeds = QUICK_SEEDS if quick else seeds
    plan = {experiment: [entry for entry in EXPERIMENTS[experiment] if is_wanted(entry, tasks, quick)]
            for experiment in wanted}  # fmt: skip
    # Everything is checked before anything is trained.
    if not any(plan.values()):
        raise InputError(f"--quick --task {', '.join(tasks)}: {name} has no quick row of it; choose another task")
    jobs = {entry: prepare(entry, seeds, quick) for entries in plan.values() for entry in entries}
    for experiment, entries in plan.items():
        refuse_another(folder / f"{experiment}.json", {entry.identity: jobs[entry] for entry in entries})
    used = {(task, entry.retrain) for entry in jobs if entry.target for task in (entry.task, entry.target)}
    places = {where: as_place(*where, quick) for where in used}
    for experiment, entry in cheapest_first(plan):
        row = train(entry, jobs[entry], places, out, line)
        results.add(folder / f"{experiment}.json", row | {"machine": machine()})
    for experiment in plan:
        show(experiment, results.load(folder / f"{experiment}.json"), tasks)
        say(f"every seed, setting and budget: {folder}/{experiment}.json")
    for figure, experiment in FIGURES.items():
        if name in ("all", figure):
            figures.DRAWN[figure](results.load(folder / f"{experiment}.json"), out, folder, tasks)


def cheapest_first(plan: dict[str, list[Entry]]) -> list[tuple[str, Entry]]:
    """The experiment and entry of every row; of a task imitation comes first, and of all the ablations last."""
    every = [(experiment, entry) for experiment, entries in plan.items() for entry in entries]
    return sorted(every, key=lambda row: (row[0] == "ablations", ORDER.index(row[1].task), row[1].target is not None))


def refuse_another(path: Path, jobs: dict[tuple, Job]) -> None:
    """Raises `InputError` if rows would take the place of ones of other seeds or settings, as those that we ship."""
    for row in results.load(path):
        job = jobs.get(results.identity(row))
        if job is None:
            continue
        if row["seeds"] != list(job.seeds):
            there, here = (f"seeds {own[0]} to {own[-1]}" for own in (row["seeds"], job.seeds))
        elif digest(row["settings"]) != digest(job.settings()):
            there, here = "other settings", "these settings"
        else:
            continue
        raise InputError(
            f"{path} holds {row['row']} of {row['task']} with {there}, which {here} would replace: give another "
            "--results DIR to keep yours apart"
        )


def is_wanted(entry: Entry, tasks: tuple[str, ...], quick: bool) -> bool:
    """Whether an entry is one of the tasks asked for; a quick run is too short for rules of later iterations."""
    return (not tasks or entry.task in tasks) and not (quick and entry.rule.startswith("iteration="))


def short(quick: bool) -> tuple[str, ...]:
    """The assignments that make a training a matter of seconds."""
    return (f"iterations={QUICK_ITERATIONS}", f"snapshot_every={QUICK_ITERATIONS}") if quick else ()


def prepare(entry: Entry, seeds: int, quick: bool) -> Job:
    """Checks an entry and makes it ready to train."""
    (job,) = learn.prepare(entry.task, (entry.method,), (entry.form,), range(FIRST_SEED, FIRST_SEED + seeds), None,
                             entry.purpose, (*entry.settings, *short(quick)), entry.tuned)  # fmt: skip
    return dataclasses.replace(job, variant=entry.variant)


Places = dict[tuple[str, tuple[str, ...]], Target]  # by task and settings of retraining


def as_place(task: str, retrain: tuple[str, ...], quick: bool) -> Target:
    """A task in which rewards are put to use, by the recipe but for some settings."""
    place = as_target(task, make_env(task), (*retrain, *short(quick)))
    return dataclasses.replace(place, variant=retrain_variant(retrain))


def train(entry: Entry, job: Job, places: Places, out: Path, line: str) -> dict:
    """Trains an entry, or goes on with it; returns its row of the results."""
    own = {"row": entry.row, "is_published": job.is_published, "settings": job.settings()}
    if entry.target is None:
        where = out / f"imitate-{job.task}-{job.row}"
        summary = learn.imitate(job, where, line)
        curves, steps = RunFolder(where, job.settings()).curve("true_return", len(job.seeds)), job.recipe.config
    else:
        source, target = (places[task, entry.retrain] for task in (entry.task, entry.target))
        rule = Rule.parse(entry.rule, job.recipe, source.recipe)
        summary = transfer.transfer(job, rule, source, target, out, line)
        folder = transfer.folder_of(job, rule, target, out)
        own["retrain_settings"] = target_settings(on_reward(target, job.recipe.config))
        if rule.kind == "policy":
            return own | summary | {"command": line}
        curves, steps = kept_curves(folder, target, len(job.seeds)), target.recipe.config
        if rule.kind == "last" and entry.task != entry.target:
            own["closeness"] = reward_distance.of_transfer(folder, transfer.learning_of(job, out), job, target)
    return own | summary | {"command": line} | thinned(curves, steps.steps_per_iteration)


def thinned(curves: np.ndarray, steps_per_iteration: int) -> dict:
    """Curves `[seeds, iterations]` as at most `CURVE_POINTS` means over as many iterations each, for the results."""
    points = next((n for n in range(CURVE_POINTS, 0, -1) if curves.shape[1] % n == 0), 1)
    each = curves.shape[1] // points
    means = np.ma.masked_invalid(curves.reshape(len(curves), points, each)).mean(axis=2)
    steps = (1 + np.arange(points)) * each * steps_per_iteration
    values = [[None if np.ma.is_masked(value) else round(float(value), 3) for value in lane] for lane in means]
    return {"curve": {"env_steps": steps.tolist(), "true_return": values}}


def show(experiment: str, rows: list[dict], tasks: tuple[str, ...]) -> None:
    """Prints a table for every task, or pair of tasks."""
    table = paper.TABLES[experiment]
    for (task, target), own in results.by_task(rows).items():
        if tasks and task not in tasks:
            continue
        shown = [Row("expert", np.array([own[0]["expert"]]), paper.row(table, target or task, "expert"), 1.0)]
        for retrained, row in results.ceilings(own).items():
            note = ", ".join(["the true reward, retrained", *filter(None, (retrained,))])
            shown.append(Row("ceiling", np.array(row["ceiling"]), None, None, note))
        for row in own:
            published = paper.row(table, target or task, row["method"]) if row["is_published"] else None
            name = f"{row['row']}, {row['rule']}" if target else row["row"]
            shown.append(Row(name, np.array(row["returns"]), published, row["normalized"]))
        title = f"{experiment}: {task}" + (f" to {target}" if target else "")
        print_table(f"{title}, {len(own[0]['seeds'])} seeds", shown)
