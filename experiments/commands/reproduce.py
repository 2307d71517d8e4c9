"""`eairl reproduce`: the paper's tables, trained to the end or gone on with; every seed's return is kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import InputError
from eairl_jax.environment import context_size
from eairl_jax.experiments.display import page, score_page
from eairl_jax.experiments.display.console import Line, print_table, say, table_of
from eairl_jax.experiments.display.plots import Dots
from eairl_jax.experiments.options import Imitate, Reproduce, Transfer
from eairl_jax.experiments.paper import figures, plan, published, results, reward_distance
from eairl_jax.experiments.paper.plan import EXPERIMENTS, FIGURES, FIRST_SEED, Planned, retrain_variant
from eairl_jax.experiments.pipeline import cluster, divergence, retraining
from eairl_jax.experiments.pipeline.diagnosis import FILE, Diagnosis, diagnose, played
from eairl_jax.experiments.pipeline.experiment import Experiment, imitations, transfers
from eairl_jax.experiments.pipeline.places import shipped_demonstrations
from eairl_jax.experiments.pipeline.run import Result, learning_folder
from eairl_jax.experiments.pipeline.run import run as run_experiment
from eairl_jax.experiments.pipeline.run_folder import RunFolder, settings_digest
from eairl_jax.experiments.pipeline.train import RUNS
from eairl_jax.storage import read_json

CURVE_POINTS = 50

Plan = dict[str, list[Planned]]
Scores = dict[str, list[Line]]


def run(options: Reproduce, command_line: str) -> None:
    """Runs the planned experiments, writes `TABLE.json` after every result, and prints the tables."""
    planned_of = wanted(options)
    seeds = plan.QUICK_SEEDS if options.quick else options.seeds
    out = options.out or RUNS / ("reproduce-quick" if options.quick else "reproduce")
    folder = options.results or (out if options.quick else results.FOLDER)
    # Everything is checked before anything is trained.
    experiments = {
        planned: build(planned, seeds, options.quick, options.on_nan)
        for planned_all in planned_of.values()
        for planned in planned_all
    }
    for table, planned_all in planned_of.items():
        refuse_other_results(folder / f"{table}.json", {p.identity: experiments[p] for p in planned_all})
    finished: list[tuple[str, Experiment, Result]] = []
    jobs = cluster.groups(plan.cheapest_first(planned_of), lambda each: learning_folder(experiments[each[1]], out).path)
    for table, planned in cluster.mine(options, jobs, out / "jobs", command_line):
        result = train(experiments[planned], out, command_line)
        results.add(folder / f"{table}.json", result)
        finished.append((table, experiments[planned], result))
    if not finished or options.program is not None:
        return
    for table, result in diagnosed(finished, out):
        results.add(folder / f"{table}.json", result)
    shown: Scores = {}
    for table in planned_of:
        scores = scores_of(table, results.load(folder / f"{table}.json"), options.task)
        for title, lines in scores.items():
            print_table(title, lines)
        say(f"every seed, setting and budget: {folder}/{table}.json")
        shown |= scores
    write_page(out, shown, command_line)
    say(f"{out}/index.html shows all tables")
    for figure, table in FIGURES.items():
        if options.name in ("all", figure):
            figures.DRAWN[figure](results.load(folder / f"{table}.json"), out, folder, options.task)


def wanted(options: Reproduce) -> Plan:
    """The planned experiments of each table that the options ask for.

    Raises:
      InputError: for a task of which the tables have no experiment.
    """
    tables = list(EXPERIMENTS) if options.name == "all" else [FIGURES.get(options.name, options.name)]
    quick_tasks = plan.QUICK_TASKS if options.quick else ()
    tasks = {planned.task for table in tables for planned in EXPERIMENTS[table]}
    unknown = sorted(set(options.task) - tasks - set(quick_tasks))
    if unknown:
        raise InputError(f"--task {', '.join(unknown)}: {options.name} has {', '.join(sorted(tasks))}")
    chosen = options.task or quick_tasks
    planned_of = {
        table: [planned for planned in EXPERIMENTS[table] if plan.is_wanted(planned, chosen, options.quick)]
        for table in tables
    }
    if not any(planned_of.values()):
        raise InputError(
            f"--quick --task {', '.join(chosen)}: {options.name} has no quick experiment of it; choose another task"
        )
    return planned_of


def short(quick: bool) -> tuple[str, ...]:
    """The settings that make a training a matter of seconds."""
    iterations = plan.QUICK_ITERATIONS
    return (f"iterations={iterations}", f"snapshot_every={iterations}") if quick else ()


def build(planned: Planned, seeds: int, quick: bool, on_nan: str = "stop") -> Experiment:
    """Checks a planned experiment and makes it ready to run; `on_nan` is that of `Recipe`."""
    learning: dict[str, Any] = {
        "method": (planned.method,),
        "reward_form": (planned.form,),
        "tuned": planned.tuned,
        "seeds": seeds,
        "first_seed": FIRST_SEED,
        "on_nan": on_nan,
        "set": (*planned.settings, *short(quick)),
        "demos": shipped_demonstrations(planned.task, planned.quality) if planned.quality else None,
    }
    if planned.target is None:
        (experiment,) = imitations(Imitate(planned.task, **learning))
        return dataclasses.replace(experiment, variant=planned.variant)
    retrain_set = (*planned.retrain_settings, *short(quick))
    options = Transfer(planned.task, planned.target, rule=(planned.rule,), retrain_set=retrain_set, **learning)
    (experiment,) = transfers(options)
    return dataclasses.replace(experiment, variant=planned.variant).with_target_variant(
        retrain_variant(planned.retrain_settings)
    )


def refuse_other_results(path: Path, experiments: dict[tuple, Experiment]) -> None:
    """Raises `InputError` if new results would replace results of other seeds or settings."""
    for result in results.load(path):
        experiment = experiments.get(result.identity)
        if experiment is None:
            continue
        if result.trained_seeds != set(experiment.seeds):
            there, here = (f"seeds {seeds[0]} to {seeds[-1]}" for seeds in (result.seeds, experiment.seeds))
        elif _digest(result.settings, result.retrain_settings) != _digest(*_settings(experiment)):
            there, here = "other settings", "these settings"
        else:
            continue
        raise InputError(
            f"{path} holds {result.name} of {result.task} with {there}, which {here} would replace: give another "
            "--results DIR to keep both"
        )


def _settings(experiment: Experiment) -> tuple[dict, dict | None]:
    """How an experiment learns and, for a transfer, how it retrains."""
    use = experiment.use
    return experiment.learning_settings(), use.target.for_reward(experiment.config).settings() if use else None


def _digest(learning: dict, retraining: dict | None) -> str:
    return settings_digest(learning | (retraining or {}))


def train(experiment: Experiment, out: Path, command_line: str) -> Result:
    """Runs an experiment, or goes on with it; returns its result with a curve, distances and the machine."""
    path, seeds = out / experiment.folder_name(), len(experiment.seeds)
    result = run_experiment(experiment, path, command_line)
    result = dataclasses.replace(result, command_line=command_line)
    folder, use = RunFolder(path, experiment.settings()), experiment.use
    if use is None:
        returns = folder.curve("true_return", seeds)
        return dataclasses.replace(result, curve=thinned(returns, experiment.config.steps_per_iteration))
    if use.rule.kind == "policy":
        return result
    if use.rule.kind == "last" and use.target.task != experiment.source.task:
        # With several sources there is no one source in which the learned and the true reward could be compared.
        is_several = context_size(experiment.source.env) > 0
        distances = None if is_several else reward_distance.of_transfer(learning_folder(experiment, out).path, path)
        # The diagnosis of an earlier call, until `diagnosed` makes a new one.
        diagnosis = read_json(path / FILE) if (path / FILE).exists() else None
        if diagnosis is not None:
            Diagnosis.from_json(diagnosis, path / FILE)  # refuses a damaged one
        result = dataclasses.replace(result, closeness=distances, diagnosis=diagnosis)
    returns = retraining.kept_curves(folder, use.target, seeds)
    return dataclasses.replace(result, curve=thinned(returns, use.target.recipe.config.steps_per_iteration))


def diagnosed(finished: list[tuple[str, Experiment, Result]], out: Path) -> Iterator[tuple[str, Result]]:
    """The transfers by the last iteration's reward with their diagnosis, each with the table that it belongs to.

    Each reward judges the policies of all these transfers to the same target too. So the diagnosis comes last.
    """
    used = {
        out / experiment.folder_name(): (table, experiment.use.target, result)
        for table, experiment, result in finished
        if experiment.use and experiment.use.rule.kind == "last" and experiment.use.target.task != result.task
    }
    all_played = {path: played(path) for path in used}
    for path, (table, target, result) in used.items():
        others = [each for other, each in all_played.items() if each.task == target.task and other != path]
        yield table, dataclasses.replace(result, diagnosis=diagnose(path, target, others).to_json())


def thinned(curves: np.ndarray, steps_per_iteration: int) -> dict[str, list]:
    """Curves `[seeds, iterations]` as at most `CURVE_POINTS` means over equally many iterations (`Result.curve`)."""
    points = next((n for n in range(CURVE_POINTS, 0, -1) if curves.shape[1] % n == 0), 1)
    iterations = curves.shape[1] // points
    means = np.ma.masked_invalid(curves.reshape(len(curves), points, iterations)).mean(axis=2)
    steps = (1 + np.arange(points)) * iterations * steps_per_iteration
    values = [[None if np.ma.is_masked(value) else round(float(value), 3) for value in lane] for lane in means]
    return {"env_steps": steps.tolist(), "true_return": values}


def scores_of(table: str, loaded: list[Result], tasks: tuple[str, ...]) -> Scores:
    """A title and lines for every task, and for every pair of source and target. The first line is the expert's."""
    paper, scores = published.TABLES[table], {}
    for (task, target), group in results.by_task(loaded).items():
        if tasks and task not in tasks:
            continue
        expert = published.figure(paper, target or task, "expert")
        lines = [Line("expert", np.array([group[0].expert]), expert, 1.0)]
        for retrain_settings, result in results.ceilings(group).items():
            name = ", ".join(filter(None, ("ceiling", retrain_settings)))
            lines.append(Line(name, np.array(result.ceiling), note="trained alike on the true reward"))
        for result in group:
            figure = published.figure(paper, target or task, result.method) if result.is_published else None
            name = f"{result.name}, {result.rule}" if target else result.name
            note = divergence.note(result.dropped, result.count)
            lines.append(Line(name, np.array(result.returns), figure, result.normalized, note))
        scores[f"{table}: {results.pair(group[0])}, {group[0].count} seeds"] = lines
    return scores


def write_page(out: Path, scores: Scores, command_line: str) -> None:
    """Writes the page of all tables, with one figure."""
    tables, panels = [], []
    for title, (expert, *lines) in scores.items():
        tables.append(page.Table(title, *table_of([expert, *lines])))
        colors = [results.color(line.name.split(",")[0]) for line in lines]
        dots = {line.name: line.returns for line in lines}
        panels.append(Dots(title, "true return, a dot a seed", dots, colors, ("expert", float(expert.returns[0]))))
    score_page.write(out, "The paper's tables", "true return of every seed", tables, panels, {"command": command_line})
