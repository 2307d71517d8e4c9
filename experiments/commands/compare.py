"""`eairl compare`: runs beside each other, as a table, a figure and a page."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from eairl_jax import InputError
from eairl_jax.experiments.display import page
from eairl_jax.experiments.display.console import Layout, print_rows, say
from eairl_jax.experiments.display.plots import Curve, plot
from eairl_jax.experiments.options import Compare
from eairl_jax.experiments.pipeline import comparison
from eairl_jax.experiments.pipeline.comparison import Compared
from eairl_jax.experiments.pipeline.run_folder import check_writable
from eairl_jax.experiments.pipeline.train import RUNS
from eairl_jax.storage import write_json

TITLES = ("run", "task", "method", "seeds", "iterations", "mean ± std", "interquartile mean", "P(better than first)")
NOTE = (
    "interquartile mean: of the middle half of the seeds, with the 95 % interval of a bootstrap over the seeds. "
    "P(better than first): the probability that a seed of this run scores above a seed of the first run, with its "
    "interval (Agarwal et al. 2021)"
)
LONGEST = 80  # characters of a folder's name


def run(options: Compare, command_line: str) -> None:
    """Prints a line for each run, and writes the figure and the page."""
    compared = [each for path in options.run_folders for each in comparison.read(path, options.metric)]
    are_of_one_task = len({each.task for each in compared}) == 1
    compared = comparison.check_comparable(compared, options.metric)
    if len({each.name for each in compared}) < len(compared):
        raise InputError("two of the runs have the same name: give folders of different names, each once")
    folder = options.out or RUNS / _folder_name([each.name for each in compared])
    check_writable(folder / "index.html")
    score = "true return" if are_of_one_task else "normalised true return"
    figures = [_figures(each, compared[0]) for each in compared]
    rows = [_row(each, of_run) for each, of_run in zip(compared, figures, strict=True)]
    rows[0][-1] = ""  # the first run is not compared with itself
    print_rows(f"{score} of {len(compared)} runs", TITLES, rows, Layout(folded=(0, 1, 2)))
    say(NOTE)
    for each in compared:
        if not each.is_finished:
            say(f"{each.name} is not finished: its scores are means of the last tenth so far")
    title = options.metric.replace("_", " ") if options.metric != comparison.METRIC else score
    level = _level(compared[0]) if options.metric == comparison.METRIC and are_of_one_task else None
    curves = [Curve(title, each.name, *comparison.thinned(each.curve, each.steps), level) for each in compared]
    plot(folder / "curves.png", "", curves)
    write_json(folder / "comparison.json", {"command_line": command_line, "runs": figures})
    table = page.Table("Scores", TITLES, rows, NOTE)
    picture = page.png("While they trained", folder / "curves.png", is_wide=False)
    link = page.Link("all figures of this page", "comparison.json")
    subtitle = f"{score}; mean and range over the seeds"
    shown = page.Page(f"{len(compared)} runs compared", subtitle, [table], [picture], [link], {"command": command_line})
    page.write(folder / "index.html", shown)
    say(f"in {folder}/; index.html shows all of it")


def _folder_name(names: Sequence[str]) -> str:
    """A name that tells this comparison from others."""
    text = "-".join(["compare", *names])
    if len(text) <= LONGEST and "/" not in text:
        return text
    return f"compare-{len(names)}-runs-{hashlib.sha256(text.encode(errors='surrogatepass')).hexdigest()[:6]}"


def _level(first: Compared) -> tuple[str, float] | None:
    return None if first.expert is None else ("expert", first.expert)


def _row(each: Compared, figures: dict) -> list[str]:
    return [
        each.name,
        each.task,
        each.method,
        str(len(each.scores)),
        f"{each.iterations}",
        f"{_short(each.scores.mean())} ± {_short(each.scores.std())}",
        _with_interval(figures["interquartile_mean"], None),
        _with_interval(figures["probability_of_improvement"], 2),
    ]


def _with_interval(estimate: dict[str, float], digits: int | None) -> str:
    value, low, high = (_short(x) if digits is None else f"{x:.{digits}f}" for x in estimate.values())
    return f"{value} ({low} to {high})"


def _short(value: float) -> str:
    return f"{value:.1f}" if abs(value) >= 100 else f"{value:.3f}"


def _figures(each: Compared, first: Compared) -> dict:
    curve = np.ma.masked_invalid(each.curve).mean(axis=0)
    return {
        "name": each.name,
        "task": each.task,
        "method": each.method,
        "iterations": each.iterations,
        "is_finished": each.is_finished,
        "scores": each.scores.tolist(),
        "interquartile_mean": comparison.middle(each)._asdict(),
        "probability_of_improvement": comparison.improvement(each, first)._asdict(),
        "curve": [None if np.ma.is_masked(value) else float(value) for value in curve],
    }
