"""`eairl search`: values of a method's floats that have a high score in the task that is demonstrated."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import Diverged, InputError
from eairl_jax.envs.names import file_name
from eairl_jax.experiments.display import page
from eairl_jax.experiments.display.console import console, mean_and_std, print_rows, say, say_if_no_expert
from eairl_jax.experiments.display.plots import Axis, plot_search
from eairl_jax.experiments.options import SOURCE_ALONE, Search
from eairl_jax.experiments.pipeline import points, ranges, run_page
from eairl_jax.experiments.pipeline.default_folder import default_path
from eairl_jax.experiments.pipeline.experiment import Experiment, searched
from eairl_jax.experiments.pipeline.points import Point
from eairl_jax.experiments.pipeline.ranges import Interval
from eairl_jax.experiments.pipeline.run_folder import flat
from eairl_jax.experiments.pipeline.search import Plan, Trial, best, generation_folder, load_optuna, search, settings
from eairl_jax.storage import write_json

OBJECTIVE = "true_return"
SHOWN = 10
"""Lines of the table in the terminal."""


def run(options: Search, command_line: str) -> None:
    """Runs a search, prints its best trials, and writes `search.json`, `search.png` and the page."""
    if options.objective != OBJECTIVE:
        raise InputError(f"--objective {options.objective}: expected {OBJECTIVE}; {SOURCE_ALONE}")
    space = ranges.split(options.set)
    plan = Plan(space.domains, options.trials, options.generation, options.first_seed)
    load_optuna()
    experiment = searched(options, space)
    identity = settings(experiment, plan)
    out = options.out or default_path(options, f"search-{file_name(options.task)}-{experiment.name}", identity)
    trials = search(experiment, plan, out, command_line)
    ranked = best(trials)
    again = imitate_command(options, space.fixed, ranked[0].point) if ranked else ""
    content = {
        "command_line": command_line,
        "objective": OBJECTIVE,
        "expert": experiment.source.reference.expert,
        "random": experiment.source.reference.random,
        "trials": [_described(trial, plan) for trial in trials],
        "best": _described(ranked[0], plan) if ranked else None,
        "best_command": again,
    }
    write_json(out / "search.json", content)
    _draw(out / "search.png", experiment, plan, trials)
    _write_page(out, experiment, plan, trials, content)
    _tell(experiment, plan, trials, out, again)


def imitate_command(options: Search, fixed: Sequence[str], point: Point) -> str:
    """The command that trains a setting with seeds that the search has not seen.

    Args:
      fixed: `name=value` of the settings that were not searched.
      point: values of those that were.
    """
    words = ["eairl", "imitate", options.task]
    defaults = {field.name: field.default for field in dataclasses.fields(Search)}
    for name in ("method", "reward_form", "horizon", "optimizer", "demos"):
        value = getattr(options, name)
        if value != defaults[name]:
            words += [f"--{name.replace('_', '-')}", str(value)]
    words += ["--first-seed", str(options.first_seed + options.seeds)]
    return shlex.join([*words, "--set", *fixed, *(f"{name}={value:g}" for name, value in point.items())])


def _described(trial: Trial, plan: Plan) -> dict[str, Any]:
    folder = generation_folder(Path(), trial.number // plan.generation) / "points" / points.folder_name(trial.point)
    return trial._asdict() | {"folder": folder.as_posix() if trial.returns else None}


def _label(experiment: Experiment) -> str:
    return "true return" if experiment.source.reference.expert is None else "normalised true return"


def _draw(path: Path, experiment: Experiment, plan: Plan, trials: Sequence[Trial]) -> None:
    axes = [
        Axis(name, np.array([trial.point[name] for trial in trials]), isinstance(domain, Interval) and domain.is_log)
        for name, domain in plan.domains.items()
    ]
    scores = np.array([np.nan if trial.score is None else trial.score for trial in trials])
    title = f"{experiment.name} in {experiment.source.task}: {_counted(experiment, trials)}"
    expert = None if experiment.source.reference.expert is None else 1.0
    plot_search(path, title, axes, scores, _label(experiment), expert)


def _rows(experiment: Experiment, trials: Sequence[Trial]) -> list[list[str]]:
    """A row for each trial: its values, its true return and, where the expert is known, its score."""
    has_expert = experiment.source.reference.expert is not None
    rows = []
    for trial in trials:
        returns = _spread(trial.returns)
        score = [f"{trial.score:.3f}" if trial.score is not None else ""] if has_expert else []
        rows.append([f"trial {trial.number}", *(f"{value:g}" for value in trial.point.values()), returns, *score])
    return rows


def _spread(returns: Sequence[float]) -> str:
    if len(returns) > 1:
        return mean_and_std(np.mean(returns), np.std(returns))
    return f"{returns[0]:.2f}" if returns else "diverged"


def _counted(experiment: Experiment, trials: Sequence[Trial]) -> str:
    seeds = len(experiment.seeds)
    return f"{len(trials)} trials of {seeds} seed{'' if seeds == 1 else 's'}"


def _titles(experiment: Experiment, plan: Plan) -> list[str]:
    score = [] if experiment.source.reference.expert is None else ["normalized"]
    return ["", *plan.domains, "true return", *score]


def _note(experiment: Experiment, trials: Sequence[Trial]) -> str:
    lost = sum(trial.score is None for trial in trials)
    diverged = f"; {lost} of {len(trials)} trials have diverged, and have no score" if lost else ""
    return (
        f"the score of the best of {_counted(experiment, trials)} is optimistic: it is the highest of many. Its "
        f"setting with other seeds has a score that can be reported{diverged}"
    )


def _write_page(
    out: Path, experiment: Experiment, plan: Plan, trials: Sequence[Trial], content: dict[str, Any]
) -> None:
    ordered = [*best(trials), *(trial for trial in trials if trial.score is None)]
    generations = range(-(-len(trials) // plan.generation))
    pages = [generation_folder(Path(), number) / run_page.PAGE for number in generations]
    shown = page.Page(
        title=out.resolve().name,
        subtitle=f"{_label(experiment)} of {experiment.name} in {experiment.source.task}, {len(trials)} trials",
        tables=[
            page.Table("Trials", _titles(experiment, plan), _rows(experiment, ordered), _note(experiment, trials)),
        ],
        pictures=[page.png("Score by setting", out / "search.png")],
        links=[
            page.Link("all trials", "search.json"),
            *(
                page.Link(f"generation {number + 1}", each.as_posix())
                for number, each in enumerate(pages)
                if (out / each).is_file()
            ),
        ],
        facts={"command": content["command_line"], "train the best setting": content["best_command"]},
        settings={name: str(value) for name, value in flat(settings(experiment, plan)).items()},
    )
    page.write(out / run_page.PAGE, shown)


def _tell(experiment: Experiment, plan: Plan, trials: Sequence[Trial], out: Path, again: str) -> None:
    """Prints the best trials, and what to do with them."""
    ranked = best(trials)
    if not ranked:
        raise Diverged(
            f"every trial has diverged, so none has a score ({out}/search.json lists them): search lower values, "
            "above all lower learning rates, in a new --out",
            OBJECTIVE,
            0,
            experiment.recipe.last_iteration,
            float("nan"),
        )
    title = f"{experiment.name} in {experiment.source.task}: the best of {_counted(experiment, trials)}"
    print_rows(title, _titles(experiment, plan), _rows(experiment, ranked[:SHOWN]))
    say(_note(experiment, trials))
    say_if_no_expert(experiment.source.task, experiment.source.reference.expert)
    say(
        f"in {out}/; index.html shows all trials, {_described(ranked[0], plan)['folder']} holds the best trial's reward"
    )
    say("the best setting with other seeds:")
    console.print(again, soft_wrap=True)
