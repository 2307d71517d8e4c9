"""What `eairl reproduce` trains: the experiments behind the paper's tables, behind its figures, and our ablations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from eairl_jax.experiments.paper import results
from eairl_jax.experiments.paper.tables import HOME
from eairl_jax.experiments.pipeline.result import Result
from eairl_jax.methods import METHODS

FIRST_SEED = 20
"""The seeds below were used while the settings were chosen."""
QUICK_ITERATIONS, QUICK_SEEDS = 20, 2
QUICK_TASKS = ("pendulum", "point_maze_left")


@dataclass(frozen=True)
class Planned:
    """A planned experiment: a method imitates `task` and, if there is a target, its reward is used there.

    Attributes:
      task: the task that is demonstrated.
      method: key of `METHODS`, or "bc".
      form: reward form; "default" for the method's.
      target: the task in which the reward is used, which may be `task` itself; None for an imitation.
      rule: from which iteration the reward is taken.
      settings: `name=value` of learning that differ from the recipe.
      retrain_settings: `name=value` of retraining that differ from the recipe.
      tuned: whether our settings replace the paper's.
    """

    task: str
    method: str
    form: str = "default"
    target: str | None = None
    rule: str = "last"
    settings: tuple[str, ...] = ()
    retrain_settings: tuple[str, ...] = ()
    tuned: bool = False

    @property
    def variant(self) -> str:
        """What distinguishes how this experiment learns from others with the same method and form."""
        return "+".join([*self.settings, *(["tuned"] if self.tuned else [])])

    @property
    def name(self) -> str:
        """The name of the result."""
        default_form = METHODS[self.method].reward_form if self.method in METHODS else ""
        method = f"{self.method}-{self.form.replace('default', default_form)}" if default_form else self.method
        return "+".join([method, *filter(None, (self.variant, retrain_variant(self.retrain_settings)))])

    @property
    def identity(self) -> tuple[str, str, str | None, str | None]:
        """The identity of the result."""
        return self.name, self.task, self.target, self.rule if self.target else None

    @property
    def purpose(self) -> str:
        """For which purpose the recipe is chosen."""
        return "reward" if self.target else "imitate"


def retrain_variant(retrain_settings: tuple[str, ...]) -> str:
    """What distinguishes a retraining from the recipe's, as a part of a result's name."""
    return "+".join(f"retrain_{setting}" for setting in retrain_settings)


Pair = tuple[str, str]  # source and target
MethodForm = tuple[str, str]  # a method and a reward form

TASKS_BY_COST = ("point_maze_left", "point_maze_right", "pendulum", "swimmer", "half_cheetah", "ant")
MAZES: tuple[Pair, Pair] = (("point_maze_left", "point_maze_right"), ("point_maze_right", "point_maze_left"))
ANTS: Pair = ("ant", "crippled_ant")
IMITATED = ("pendulum", "swimmer", "half_cheetah", "ant")
IMITATORS = ("bc", "gail", "gan_gcl", "airl_s", "airl_sa", "eairl", "eairl_release")
# The methods whose rewards the paper transfers, the variant in the authors' release, and two separable rewards of ours.
TRANSFERRED: tuple[MethodForm, ...] = (
    ("airl_s", "default"),
    ("airl_sa", "default"),
    ("eairl", "default"),
    ("eairl_release", "default"),
    ("airl_sa", "separable"),
    ("eairl", "separable"),
)
# Methods whose rewards the paper does not transfer.
ALSO_TRANSFERRED: tuple[MethodForm, ...] = (("gail", "default"), ("gan_gcl", "default"))
ABLATIONS = (
    ("shaping=none",),
    ("shaping=learned",),
    ("lambda_i=0",),
    ("lambda_i=0.001",),
    ("lambda_i=0.1",),
    ("l_i_actions=resampled",),
    ("history_length=1",),
)
# Of the separable reward in the mazes: Phi without the learned potential h, and the paper's lambda_I.
SEPARABLE_ABLATIONS = (("shaping=empowerment",), ("lambda_i=1",))
# Of the separable reward of the ant: the penalty on slopes in place of sparsity, less sparsity, other potentials.
ANT_ABLATIONS = (
    ("gradient_penalty=0.1", "input_sparsity=0"),
    ("input_sparsity=0.03",),
    ("shaping=none",),
    ("shaping=empowerment",),
)
# 10M steps of retraining, as in the paper's protocol. They would take too long for every method.
LONG = ("iterations=1600",)


def _transfers(pair: Pair, source_retrained: tuple[MethodForm, ...] = TRANSFERRED) -> list[Planned]:
    """All methods by the last iteration and as moved policies, some by `source_retrain`, and a random reward."""
    source, target = pair
    methods_of_rule = {
        "last": (*ALSO_TRANSFERRED, *TRANSFERRED),
        "policy": (("bc", "default"), *ALSO_TRANSFERRED, *TRANSFERRED),
        "source_retrain": source_retrained,
    }
    learned = [
        Planned(source, method, form, target, rule)
        for rule, methods in methods_of_rule.items()
        for method, form in methods
    ]
    return [*learned, Planned(source, "eairl", "default", target, "random")]


def _back_home(pair: Pair) -> list[Planned]:
    """Rewards that train fresh policies in the task where they were learned."""
    return [Planned(pair[0], method, form, pair[0]) for method, form in TRANSFERRED]


def _iterations(pair: Pair, iterations: tuple[int, ...]) -> list[Planned]:
    """EAIRL's reward of several iterations. The authors' release reports the one that scores best in the target."""
    return [Planned(pair[0], "eairl", "default", pair[1], f"iteration={iteration}") for iteration in iterations]


def _maze_ablations(pair: Pair) -> list[Planned]:
    """EAIRL and its separable form with one setting changed, and a state-only reward with empowerment."""
    source, target = pair
    changes = [(form, settings) for form in ("default", "separable") for settings in ABLATIONS]
    changes += [("separable", settings) for settings in SEPARABLE_ABLATIONS]
    changed = [Planned(source, "eairl", form, target, settings=settings) for form, settings in changes]
    return [*changed, Planned(source, "eairl", "s", target)]


def _ant_ablations(pair: Pair) -> list[Planned]:
    source, target = pair
    changed = [Planned(source, "eairl", "separable", target, settings=settings) for settings in ANT_ABLATIONS]
    return [*changed, Planned(source, "eairl", "separable", target, retrain_settings=LONG)]


def _table1() -> list[Planned]:
    planned = []
    for pair in MAZES:
        planned += [*_transfers(pair), *_back_home(pair), *_iterations(pair, (40, 80))]
    planned += _transfers(ANTS, source_retrained=(("eairl", "default"), ("eairl", "separable")))
    planned += [*_back_home(ANTS), *_iterations(ANTS, (100, 200, 300))]
    return planned + [Planned(ANTS[0], method, form, ANTS[1], tuned=True) for method, form in TRANSFERRED[:3]]


def _table2() -> list[Planned]:
    return [
        *(Planned(task, method) for task in IMITATED for method in IMITATORS),
        Planned("half_cheetah", "eairl", tuned=True),
        # Tests whether the expert's actions beyond their bounds are why the paper's settings fall short.
        Planned("half_cheetah", "eairl", settings=("actions=clipped",)),
        *(Planned("ant", method, tuned=True) for method in ("eairl", "gail", "airl_sa", "airl_s")),
    ]


EXPERIMENTS: dict[str, list[Planned]] = {
    "table1": _table1(),
    "table2": _table2(),
    "ablations": [*_maze_ablations(MAZES[0]), *_ant_ablations(ANTS)],
}
# The experiment whose results each figure shows.
FIGURES = {"figure2": "table1", "appendix-c": "table1"}


def is_wanted(planned: Planned, tasks: tuple[str, ...], quick: bool) -> bool:
    """Whether the experiment's task is asked for (no `tasks`: all are).

    A quick run is too short for rules that name an iteration.
    """
    return (not tasks or planned.task in tasks) and not (quick and planned.rule.startswith("iteration="))


def cheapest_first(plan: dict[str, list[Planned]]) -> list[tuple[str, Planned]]:
    """Pairs of table and planned experiment: by task, imitations before transfers, and all ablations last."""

    def cost(pair: tuple[str, Planned]) -> tuple[bool, int, bool]:
        table, planned = pair
        return table == "ablations", TASKS_BY_COST.index(planned.task), planned.target is not None

    return sorted(((table, planned) for table, experiments in plan.items() for planned in experiments), key=cost)


class Missing(NamedTuple):
    """Experiments of one table and task that have no result, and the command that trains them."""

    experiment: str
    task: str
    names: list[str]
    command_line: str


def missing(results_of: dict[str, list[Result]]) -> list[Missing]:
    """What is planned and has no result.

    Args:
      results_of: the results of each table.
    """
    names: dict[tuple[str, str], list[str]] = {}
    for experiment, experiments in EXPERIMENTS.items():
        trained = {result.identity for result in results_of[experiment]}
        for planned in experiments:
            if planned.identity not in trained:
                names.setdefault((experiment, planned.task), []).append(_title(planned))
    return [
        Missing(experiment, task, titles, f"eairl reproduce {experiment} --task {task}")
        for (experiment, task), titles in names.items()
    ]


def _title(planned: Planned) -> str:
    """For example "GAIL" of an imitation, "EAIRL (random)" and "EAIRL (back in the source)" of transfers."""
    rule = HOME if planned.target == planned.task else planned.rule
    return results.title(planned.name) + (f" ({rule})" if planned.target else "")


# -> commands/reproduce.py

import dataclasses  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from eairl_jax import InputError  # noqa: E402
from eairl_jax.experiments.display.console import Line, print_table, say  # noqa: E402
from eairl_jax.experiments.paper import figures, published, reward_distance  # noqa: E402
from eairl_jax.experiments.pipeline import learn, transfer  # noqa: E402
from eairl_jax.experiments.pipeline.learn import Job  # noqa: E402
from eairl_jax.experiments.pipeline.retrain import (  # noqa: E402
    Target,
    as_target,
    kept_curves,
    on_reward,
    target_settings,
)
from eairl_jax.experiments.pipeline.run_folder import RunFolder, digest, machine  # noqa: E402
from eairl_jax.experiments.pipeline.select import Rule  # noqa: E402
from eairl_jax.experiments.pipeline.train import RUNS  # noqa: E402
from eairl_jax.experiments.recipes import make_env  # noqa: E402

CURVE_POINTS = 50


def command(
    name: str, quick: bool, seeds: int, tasks: tuple[str, ...], out: Path | None, folder: Path | None, line: str
) -> None:
    """Runs the experiments of a name, writes `NAME.json` after every result, and prints their tables."""
    wanted = list(EXPERIMENTS) if name == "all" else [FIGURES.get(name, name)]
    tasks = tasks or (QUICK_TASKS if quick else ())
    known = {planned.task for experiment in wanted for planned in EXPERIMENTS[experiment]}
    unknown = set(tasks) - known - set(QUICK_TASKS if quick else ())
    if unknown:
        raise InputError(f"--task {', '.join(sorted(unknown))}: {name} has {', '.join(sorted(known))}")
    out = out or RUNS / ("reproduce-quick" if quick else "reproduce")
    folder = folder or (out if quick else results.FOLDER)
    seeds = QUICK_SEEDS if quick else seeds
    plan = {
        experiment: [planned for planned in EXPERIMENTS[experiment] if is_wanted(planned, tasks, quick)]
        for experiment in wanted
    }
    # Everything is checked before anything is trained.
    if not any(plan.values()):
        raise InputError(f"--quick --task {', '.join(tasks)}: {name} has no quick row of it; choose another task")
    jobs = {planned: prepare(planned, seeds, quick) for experiments in plan.values() for planned in experiments}
    for experiment, experiments in plan.items():
        refuse_another(folder / f"{experiment}.json", {planned.identity: jobs[planned] for planned in experiments})
    used = {
        (task, planned.retrain_settings)
        for planned in jobs
        if planned.target
        for task in (planned.task, planned.target)
    }
    places = {where: as_place(*where, quick) for where in used}
    for experiment, planned in cheapest_first(plan):
        content = train(planned, jobs[planned], places, out, line) | {"machine": machine()}
        results.add(folder / f"{experiment}.json", Result.from_json(content, planned.name))
    for experiment in plan:
        show(experiment, results.load(folder / f"{experiment}.json"), tasks)
        say(f"every seed, setting and budget: {folder}/{experiment}.json")
    for figure, experiment in FIGURES.items():
        if name in ("all", figure):
            figures.DRAWN[figure](results.load(folder / f"{experiment}.json"), out, folder, tasks)


def refuse_another(path: Path, jobs: dict[tuple, Job]) -> None:
    """Raises `InputError` if new results would replace results of other seeds or settings."""
    for result in results.load(path):
        job = jobs.get(result.identity)
        if job is None:
            continue
        if result.seeds != list(job.seeds):
            there, here = (f"seeds {seeds[0]} to {seeds[-1]}" for seeds in (result.seeds, job.seeds))
        elif digest(result.settings) != digest(job.settings()):
            there, here = "other settings", "these settings"
        else:
            continue
        raise InputError(
            f"{path} holds {result.name} of {result.task} with {there}, which {here} would replace: give another "
            "--results DIR to keep yours apart"
        )


def short(quick: bool) -> tuple[str, ...]:
    """The assignments that make a training a matter of seconds."""
    return (f"iterations={QUICK_ITERATIONS}", f"snapshot_every={QUICK_ITERATIONS}") if quick else ()


def prepare(planned: Planned, seeds: int, quick: bool) -> Job:
    """Checks a planned experiment and makes it ready to train."""
    settings = (*planned.settings, *short(quick))
    lanes = range(FIRST_SEED, FIRST_SEED + seeds)
    (job,) = learn.prepare(
        planned.task, (planned.method,), (planned.form,), lanes, None, planned.purpose, settings, planned.tuned
    )
    return dataclasses.replace(job, variant=planned.variant)


Places = dict[tuple[str, tuple[str, ...]], Target]  # by task and settings of retraining


def as_place(task: str, retrain: tuple[str, ...], quick: bool) -> Target:
    """A task in which rewards are put to use, by the recipe but for some settings."""
    place = as_target(task, make_env(task), (*retrain, *short(quick)))
    return dataclasses.replace(place, variant=retrain_variant(retrain))


def train(planned: Planned, job: Job, places: Places, out: Path, line: str) -> dict:
    """Trains a planned experiment, or goes on with it; returns the content of its result."""
    content = {"name": planned.name, "is_published": job.is_published, "settings": job.settings()}
    if planned.target is None:
        where = out / f"imitate-{job.task}-{job.row}"
        summary = learn.imitate(job, where, line)
        curves, steps = RunFolder(where, job.settings()).curve("true_return", len(job.seeds)), job.recipe.config
    else:
        source, target = (places[task, planned.retrain_settings] for task in (planned.task, planned.target))
        rule = Rule.parse(planned.rule, job.recipe, source.recipe)
        summary = transfer.transfer(job, rule, source, target, out, line)
        folder = transfer.folder_of(job, rule, target, out)
        content["retrain_settings"] = target_settings(on_reward(target, job.recipe.config))
        if rule.kind == "policy":
            return content | summary | {"command_line": line}
        curves, steps = kept_curves(folder, target, len(job.seeds)), target.recipe.config
        if rule.kind == "last" and planned.task != planned.target:
            content["closeness"] = reward_distance.of_transfer(transfer.learning_of(job, out).path, folder.path)
    return content | summary | {"command_line": line, "curve": thinned(curves, steps.steps_per_iteration)}


def thinned(curves: np.ndarray, steps_per_iteration: int) -> dict:
    """Curves `[seeds, iterations]` as at most `CURVE_POINTS` means over equally many iterations (`Result.curve`)."""
    points = next((n for n in range(CURVE_POINTS, 0, -1) if curves.shape[1] % n == 0), 1)
    iterations = curves.shape[1] // points
    means = np.ma.masked_invalid(curves.reshape(len(curves), points, iterations)).mean(axis=2)
    steps = (1 + np.arange(points)) * iterations * steps_per_iteration
    values = [[None if np.ma.is_masked(value) else round(float(value), 3) for value in lane] for lane in means]
    return {"env_steps": steps.tolist(), "true_return": values}


def show(experiment: str, loaded: list[Result], tasks: tuple[str, ...]) -> None:
    """Prints a table for every task, and for every pair of source and target."""
    paper = published.TABLES[experiment]
    for (task, target), group in results.by_task(loaded).items():
        if tasks and task not in tasks:
            continue
        expert = published.figure(paper, target or task, "expert")
        lines = [Line("expert", np.array([group[0].expert]), expert, 1.0)]
        for retrain_settings, result in results.ceilings(group).items():
            note = ", ".join(["the true reward, retrained", *filter(None, (retrain_settings,))])
            lines.append(Line("ceiling", np.array(result.ceiling), note=note))
        for result in group:
            figure = published.figure(paper, target or task, result.method) if result.is_published else None
            name = f"{result.name}, {result.rule}" if target else result.name
            lines.append(Line(name, np.array(result.returns), figure, result.normalized))
        print_table(f"{experiment}: {results.pair(group[0])}, {len(group[0].seeds)} seeds", lines)
