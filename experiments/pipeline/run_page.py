"""The page of a run, `index.html` in its folder: results, curves, pictures and settings."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import schema
from eairl_jax.experiments.display import page
from eairl_jax.experiments.pipeline import divergence, overview, points, records
from eairl_jax.experiments.pipeline.run_folder import flat
from eairl_jax.storage import read_json

PAGE = "index.html"
PICTURES = {
    "curves.png": "While it trained",
    "reward.png": "The learned reward of action 0, bright where it is high",
    "diagnosis.png": "What the learned reward is worth",
    "ranking.png": "Noisy episodes, a colour a seed: what they are worth, and what the new reward makes of them",
    "view/frames.png": "An episode",
}
LINKS = {"view/episode.html": "an episode, to be played", "metrics.csv": "all metrics", "summary.json": "the result"}
CHOSEN = "chosen_iterations"
# Lists of a summary that have a number for each seed.
OF_SEEDS = {
    "returns": "true return",
    "returns_mean_action": "of its mean action",
    "imitation_returns": "in the source",
    CHOSEN: "reward of iteration",
    "learned_share": "learned reward, 1 the best known",
    "ceiling": "trained on the true reward",
}
_perhaps = schema.list_of(schema.optional(schema.number()))
SUMMARY = schema.record(
    {},
    {name: _perhaps for name in OF_SEEDS}
    | {
        "seeds": schema.list_of(schema.whole(0)),
        "points": schema.list_of(schema.table_of(schema.number())),
        "dropped": records.DROPPED_LIST,
        "more_iterations": schema.whole(0),
        "expert": schema.optional(schema.number()),
        "random": schema.number(),
        "normalized": schema.optional(schema.number()),
        "command_line": schema.text,
    },
)


def write(path: Path) -> None:
    """Writes the page of a finished run, or writes it again.

    Raises:
      InputError: if the files of the run are damaged.
    """
    page.write(path / PAGE, of_run(path))


def forget(path: Path) -> None:
    """Removes what is made again from a new result: figures, page and policy."""
    for name in ("curves.png", "reward.png", PAGE):
        (path / name).unlink(missing_ok=True)
    shutil.rmtree(path / "policy", ignore_errors=True)


def of_run(path: Path) -> page.Page:
    """What the page shows."""
    settings, found = records.settings(path), overview.read(path, path.name)
    summary = read_json(path / "summary.json", SUMMARY, records.AGAIN)
    score = (
        "" if found.normalized is None else f" Normalised score: {found.normalized:.3f} (0 random actions, 1 expert)."
    )
    return page.Page(
        title=path.resolve().name,
        subtitle=f"{found.method} in {found.task}, {found.planned} iterations.{score}",
        tables=[_points(summary) if summary.get("points") else _seeds(summary)],
        pictures=[page.png(title, path / name) for name, title in PICTURES.items() if (path / name).is_file()],
        links=[page.Link(text, name) for name, text in LINKS.items() if (path / name).is_file()],
        facts=_facts(path, summary),
        settings={name: _text(value) for name, value in flat(settings).items()},
    )


def _seeds(summary: dict) -> page.Table:
    """A row for each seed, their mean, and what the returns are measured by."""
    seeds = summary.get("seeds") or range(len(summary.get("returns", [])))
    columns = {name: summary[name] for name in OF_SEEDS if len(summary.get(name, [])) == len(seeds)}
    rows = [
        [f"seed {seed}", *(_number(values[lane]) for values in columns.values())] for lane, seed in enumerate(seeds)
    ]
    spreads = ["" if name == CHOSEN else _spread(values) for name, values in columns.items()]
    rows.append(["mean ± std", *spreads])
    for name, shown in (("expert", "expert"), ("random", "random actions")):
        if summary.get(name) is not None:
            rows.append([shown, _number(summary[name]), *([""] * (len(columns) - 1))])
    return page.Table("Result", ["", *(OF_SEEDS[name] for name in columns)], rows, _note(summary))


def _points(summary: dict) -> page.Table:
    """A row for each point of a sweep."""
    of_points = points.returns(summary["points"], summary["seeds"], summary["returns"], summary.get("dropped", []))
    rows = [
        [points.name(point) or "all", _spread(values), "  ".join(map(_number, values))]
        for point, values in zip(summary["points"], of_points, strict=True)
    ]
    return page.Table("Result", ["", "true return, mean ± std", "every seed"], rows, _note(summary))


def _note(summary: dict) -> str:
    dropped, more = summary.get("dropped", []), summary.get("more_iterations", 0)
    further = f"{more} iterations beyond the plan, at the final rates" if more else ""
    return "; ".join(filter(None, (f"dropped: {divergence.explain(dropped)}" if dropped else "", further)))


def _facts(path: Path, summary: dict) -> dict[str, str]:
    made = read_json(path / "config.json", schema.record({}, {"machine": records.MACHINE}), records.AGAIN)
    machine = made.get("machine", {})
    facts = {"command": summary.get("command_line", "")}
    if machine:
        versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
        facts |= {"begun": f"{machine['date']} on {machine['devices']} x {machine['device']}", "versions": versions}
    return {name: text for name, text in facts.items() if text}


def _spread(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.2f} ± {np.std(known):.2f}" if known else "no score"


def _number(value: float | None) -> str:
    return "dropped" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def _text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
