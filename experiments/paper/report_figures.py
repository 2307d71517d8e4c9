"""The report's figures, as data URLs of SVG; an empty text stands for a figure that has nothing to show."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from eairl_jax.experiments.display.page import data_url
from eairl_jax.experiments.display.plots import curve_figure, figure_of, literal
from eairl_jax.experiments.paper import results, tables
from eairl_jax.experiments.paper.figures import learning_curves
from eairl_jax.experiments.paper.report_tables import OverviewLine, Panel
from eairl_jax.experiments.pipeline.run import Result


def overview(panels: Sequence[Panel]) -> str:
    """Each method's score with its interval, beside the paper's score."""
    if not panels:
        return ""
    figure, axes = figure_of(1, len(panels), (4.6, 3.4), "")
    for axis, panel in zip(axes[0], panels, strict=True):
        for height, line in enumerate(reversed(panel.lines)):
            _draw_overview_line(axis, height, line)
        incomplete = [f", {line.tasks} of {panel.tasks} tasks" * (line.tasks < panel.tasks) for line in panel.lines]
        _label_lines(axis, [line.title + note for line, note in zip(panel.lines, incomplete, strict=True)])
        axis.set_title(panel.title, fontsize=10)
        if panel.ceiling is not None:
            axis.axvline(panel.ceiling, color="gray", lw=1, ls=":")
        axis.set_xlabel("0 random actions, 1 expert; ◇ the paper")
    return _svg(figure)


def _draw_overview_line(axis, height: int, line: OverviewLine) -> None:
    color = results.color(line.name)
    axis.plot([line.middle.low, line.middle.high], [height] * 2, color=color, lw=3, alpha=0.5)
    axis.plot(line.middle.value, height, "o", color=color)
    if line.paper is not None:
        axis.plot(line.paper, height, "D", mfc="none", mec="black", ms=5)


def _label_lines(axis, labels: list[str]) -> None:
    """Labels the lines, the first above the others, and marks the expert's score."""
    axis.set_yticks(range(len(labels)), [literal(label) for label in reversed(labels)])
    axis.axvline(1, color="black", lw=0.8, ls="--")
    axis.set_xlim(left=min(axis.get_xlim()[0], -0.05))
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(axis="x", alpha=0.3)


def curves(title: str, chosen: list[Result]) -> str:
    """True return over environment steps."""
    drawn = learning_curves(chosen)
    return _svg(curve_figure(title, drawn, columns=2)) if drawn else ""


def ablations(results_of: dict[str, list[Result]]) -> list[str]:
    """A figure for each transfer that has ablations: every change beside the method that was changed."""
    figures = []
    for pair, ablated in results.by_task(results_of["ablations"]).items():
        names = {result.name.split("+")[0] for result in ablated} | {"airl_s-s"}
        unchanged = [
            result
            for result in results_of["table1"]
            if (result.task, result.target) == pair and result.rule == "last" and result.name in names
        ]
        if unchanged:
            figures.append(_dots(results.in_order([*unchanged, *ablated])))
    return figures


def _dots(shown: list[Result]) -> str:
    """A dot for each seed's score, their mean, and the score of the true reward."""
    figure, axes = figure_of(1, 1, (8.5, 0.32 * len(shown) + 1), "")
    axis = axes[0, 0]
    for height, result in enumerate(reversed(shown)):
        seeds, color = result.scores, results.color(result.name)
        axis.plot(seeds, [height] * len(seeds), "o", color=color, alpha=0.5, mec="none")
        axis.plot([seeds.mean()] * 2, [height - 0.3, height + 0.3], color=color, lw=2)
        axis.plot([tables.ceiling(result)] * 2, [height - 0.5, height + 0.5], color="gray", lw=1, ls=":")
    _label_lines(axis, [results.title(result.name) for result in shown])
    axis.tick_params(axis="y", labelsize=8)
    axis.set_title(literal(results.pair(shown[0])), fontsize=10)
    axis.set_xlabel("0 random actions, 1 expert: a dot for each seed, their mean; dotted: the true reward")
    return _svg(figure)


def closeness(measured: Sequence[Result]) -> str:
    """Each seed's transfer score over the EPIC distance and the rank correlations of its reward, in the target."""
    if not measured:
        return ""
    figure, axes = figure_of(1, len(results.MEASURES), (3.1, 3.0), "")
    for axis, measure in zip(axes[0], results.MEASURES, strict=True):
        for result in measured:
            values = np.array((result.closeness or {})["target"][measure], float)
            # One legend serves all panels, and all pairs of tasks.
            is_first = result.task == measured[0].task and measure == results.MEASURES[0]
            label = literal(results.title(result.name)) if is_first else None
            axis.plot(values, result.scores, "o", color=results.color(result.name), alpha=0.7, mec="none", label=label)
        axis.set_xlabel(f"{measure} (in the target)", fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("normalised return")
    figure.legend(loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return _svg(figure)


def _svg(figure) -> str:
    from matplotlib import rc_context

    image = io.BytesIO()
    # Without the fixed salt and with a date, the same figure would be another text every time.
    with rc_context({"svg.hashsalt": "eairl_jax"}):
        figure.savefig(image, format="svg", metadata={"Date": None})
    return data_url(image.getvalue(), "svg+xml")
