"""What the report shows as tables: records made of the results."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from eairl_jax.experiments.paper import published, results, tables
from eairl_jax.experiments.paper.claims import scores
from eairl_jax.experiments.paper.figures import SHOWN
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.experiments.pipeline.statistics import Estimate, interquartile_mean


class OverviewLine(NamedTuple):
    """A method in the overview.

    Attributes:
      name: of its results.
      title: how the method is called.
      middle: interquartile mean of its scores over all tasks and seeds.
      mean: mean of its scores over the tasks.
      paper: mean of the paper's scores over the tasks, if it has any.
      tasks: how many tasks the method was run on.
    """

    name: str
    title: str
    middle: Estimate
    mean: float
    paper: float | None
    tasks: int


class Panel(NamedTuple):
    """A part of the overview: its methods, the number of its tasks, and the score of the true reward in transfers."""

    title: str
    lines: list[OverviewLine]
    tasks: int
    ceiling: float | None


def overview(results_of: dict[str, list[Result]]) -> list[Panel]:
    """Panels of the imitations, and of the transfers to each kind of target; none for what was not run."""
    last = [result for result in results.transfers(results_of["table1"]) if result.rule == "last"]
    mazes = [result for result in last if result.task.startswith("point_maze")]
    ants = [result for result in last if result.task.startswith("ant")]
    panels = (
        ("imitation", results_of["table2"], None, published.IMITATION),
        ("the reward in the other maze", mazes, "last", published.TRANSFER),
        ("the reward in the crippled ant", ants, "last", published.TRANSFER),
    )
    return [_panel(*panel) for panel in panels if panel[1]]


def _panel(title: str, chosen: list[Result], rule: str | None, figures: published.Table) -> Panel:
    by_task = results.by_task(chosen)
    # A result with one changed setting answers a question. It belongs into the tables.
    names = [name for name in results.names_in_order(chosen) if "=" not in name]
    ceiling = float(np.mean([tables.ceiling(group[0]) for group in by_task.values()])) if rule else None
    lines = [_overview_line(name, chosen, rule, figures) for name in names]
    return Panel(f"{title}, {len(by_task)} task{'s' * (len(by_task) > 1)}", lines, len(by_task), ceiling)


def _overview_line(name: str, chosen: list[Result], rule: str | None, figures: published.Table) -> OverviewLine:
    by_task = list(scores(chosen, name, rule).values())
    cells = [tables.cell(result, figures) for result in chosen if result.name == name]
    paper = [cell.paper_score for cell in cells if cell.paper_score is not None]
    return OverviewLine(
        name=name,
        title=results.title(name),
        middle=interquartile_mean(by_task),
        mean=float(np.mean([seeds.mean() for seeds in by_task])),
        paper=float(np.mean(paper)) if paper else None,
        tasks=len(by_task),
    )


def closeness(measured: Iterable[Result]) -> list[dict]:
    """EPIC distance and rank correlations of each result, as means over the seeds."""
    lines = []
    for result in measured:
        measures = {
            f"{place}: {name}": _mean(values)
            for place, of_place in (result.closeness or {}).items()
            for name, values in of_place.items()
            if not name.startswith("worth")
        }
        lines.append(_named(result) | {"measures": measures})
    return lines


def worth(measured: Iterable[Result]) -> list[dict]:
    """The mean learned reward of a step of `results.WORTH` in the target, for each result, as a mean over the seeds."""
    lines = []
    for result in measured:
        in_target = (result.closeness or {})["target"]
        lines.append(_named(result) | {"worth": [_mean(in_target[f"worth, {who}"]) for who in results.WORTH]})
    return lines


def _named(result: Result) -> dict:
    return {"pair": results.pair(result), "title": results.title(result.name), "score": result.normalized}


def _mean(values: list[float | None]) -> float | None:
    """The mean of the values that are defined; None if there are none."""
    defined = [value for value in values if value is not None]
    return float(np.mean(defined)) if defined else None


def budget(experiment: str, result: Result) -> dict:
    """What a result cost, and where it was made."""
    config, hparams, machine = result.settings["config"], result.settings["hparams"], result.machine or {}
    return {
        "experiment": experiment,
        "title": results.title(result.name),
        "tasks": results.pair(result),
        "rule": result.rule or "",
        "seeds": f"{result.seeds[0]} to {result.seeds[-1]}",
        "learned": config["iterations"] * config["num_envs"] * config["rollout_length"],
        "retrained": result.env_steps if result.target else None,
        "minutes": result.run_seconds / 60,
        "date": machine["date"],
        "device": f"{machine['devices']} x {machine['device']}",
        "jax": machine["versions"]["jax"],
        "entropy_weight": hparams["entropy_weight"],
        "lambda_i": hparams["lambda_i"],
    }


def hours(results_of: dict[str, list[Result]]) -> list[dict]:
    """How long each experiment took, compilation included."""
    return [
        {
            "experiment": name,
            "results": len(group),
            "hours": sum(result.run_seconds + result.compile_seconds for result in group) / 3600,
        }
        for name, group in results_of.items()
        if group
    ]


def caption(picture: str, transfers: Iterable[Result]) -> str:
    """What a picture of Appendix C shows.

    Args:
      picture: a task, followed by "-ways" if the picture shows paths of the torso.
      transfers: the results that the picture may show.
    """
    task = picture.removesuffix("-ways")
    if task.startswith("point_maze"):
        return (
            f"{task}: the reward that each method learned (of the first seed and action 0; bright is high) and the "
            "paths of every seed. Above: the policies that learned beside the reward. Below: fresh policies trained on "
            "it in the other maze."
        )
    if picture != task:
        return (
            f"{task}: the paths of every seed. Above: the policies that learned beside each reward. Below: fresh "
            "policies trained on it."
        )
    title = results.title(SHOWN)
    for result in (each for each in transfers if each.name == SHOWN and each.rule == "last"):
        seed = result.seeds[0]
        if result.target == task:
            return f"{task}: a fresh policy on the reward of {title}, seed {seed}: true return {result.returns[0]:.0f}"
        if result.task == task:
            return (
                f"{task}: the policy that learned beside the reward of {title}, seed {seed}: true return "
                f"{result.imitation_returns[0]:.0f} (the first table says how well each method imitates)"
            )
    return task
