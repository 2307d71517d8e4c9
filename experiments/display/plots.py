"""Curves of training as pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eairl_jax.storage import replacing


@dataclass(frozen=True)
class Curve:
    """One line of a panel.

    Attributes:
      panel: title of the panel that the line belongs to.
      label: name of the line in the legend.
      values: `[lanes, iterations]`; NaN where no episode had ended yet.
      steps_per_iteration: environment steps of one lane in one iteration.
      level: name and height of a horizontal line to compare with.
      color: a colour of matplotlib; empty for the panel's next one.
      style: a line style of matplotlib.
    """

    panel: str
    label: str
    values: np.ndarray
    steps_per_iteration: int
    level: tuple[str, float] | None = None
    color: str = ""
    style: str = "-"


@dataclass(frozen=True)
class Dots:
    """A panel of scores.

    Attributes:
      title: of the panel.
      axis: what the scores are.
      lines: `[scores]` of each line, by its name.
      colors: colours of matplotlib, one for each line; empty for one colour.
      level: name and value of a vertical line to compare with.
    """

    title: str
    axis: str
    lines: Mapping[str, np.ndarray]
    colors: Sequence[str] = ()
    level: tuple[str, float] | None = None


def figure_of(rows: int, columns: int, size: tuple[float, float], title: str):
    """Returns a figure and its axes `[rows, columns]`; `size` is the width and height of one panel in inches."""
    from matplotlib.figure import Figure  # a figure outside pyplot does not have to be closed

    figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
    figure.suptitle(literal(title))
    return figure, figure.subplots(rows, columns, squeeze=False)


def literal(text: str) -> str:
    """A text as matplotlib draws it unchanged; two dollar signs would begin and end a formula."""
    return text.replace("$", r"\$")


def save(figure, path: Path, dpi: int = 130) -> None:
    """Saves a figure as PNG, atomically: a picture that is there is whole."""
    with replacing(path) as unfinished:
        figure.savefig(unfinished, dpi=dpi, format="png")


def plot(path: Path, title: str, curves: Sequence[Curve]) -> None:
    """Saves the picture that `curve_figure` draws."""
    save(curve_figure(title, curves), path)


def curve_figure(title: str, curves: Sequence[Curve], columns: int = 4):
    """Draws the mean over seeds as a line and their range as a band; every name in `Curve.panel` gets a panel."""
    from matplotlib.ticker import EngFormatter

    panels = list(dict.fromkeys(curve.panel for curve in curves))
    columns = min(columns, len(panels))
    figure, axes = figure_of(-(-len(panels) // columns), columns, (5.2, 3.8), title)
    for spare in axes.flat[len(panels) :]:
        spare.set_visible(False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        drawn = [curve for curve in curves if curve.panel == panel]
        for number, curve in enumerate(drawn):
            values = np.ma.masked_invalid(curve.values)
            steps = (1 + np.arange(values.shape[1])) * curve.steps_per_iteration
            color = curve.color or f"C{number}"
            axis.plot(steps, values.mean(axis=0), color=color, ls=curve.style, label=literal(curve.label))
            axis.fill_between(steps, values.min(axis=0), values.max(axis=0), color=color, alpha=0.2, lw=0)
        for name, height in dict.fromkeys(curve.level for curve in drawn if curve.level):
            _mark_level(axis, name, height)
        if all(np.isnan(curve.values).all() for curve in drawn):
            axis.set_yticks([])
            axis.text(0.5, 0.5, "no episode has ended", transform=axis.transAxes, ha="center")
        axis.set_title(literal(panel), fontsize=10)
        axis.set_xlabel("environment steps of a seed; mean and range over seeds")
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.spines[["top", "right"]].set_visible(False)
        if len(drawn) > 1 or drawn[0].label:
            axis.legend(frameon=False, fontsize=8)
    return figure


def _mark_level(axis, name: str, height: float) -> None:
    axis.axhline(height, color="black", lw=0.8, ls="--")
    axis.margins(y=0.1)  # room for the name below the panel's title
    axis.annotate(literal(name), (1, height), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8)


class Axis(NamedTuple):
    """What a search chose from, as the horizontal axis of a panel.

    Attributes:
      name: of the setting.
      values: `[trials]`.
      is_log: whether the axis is logarithmic.
    """

    name: str
    values: np.ndarray
    is_log: bool


def plot_search(path: Path, title: str, axes: Sequence[Axis], scores: np.ndarray, label: str, expert: float | None):
    """Saves a panel for each setting that was searched: a dot for each trial, the later the brighter.

    Args:
      scores: `[trials]`; NaN for a trial without a score, which is a cross at the lower edge.
      label: of the scores.
      expert: the score of the demonstrator, drawn as a horizontal line; None if it is unknown.
    """
    columns = min(3, len(axes))
    figure, panels = figure_of(-(-len(axes) // columns), columns, (4.6, 3.6), title)
    for spare in panels.flat[len(axes) :]:
        spare.set_visible(False)
    has_score, dots = np.isfinite(scores), None
    for panel, axis in zip(panels.flat, axes, strict=False):
        lost = axis.values[~has_score]
        panel.plot(lost, np.full(len(lost), 0.02), "x", color="C3", transform=panel.get_xaxis_transform())
        number = np.arange(len(scores))[has_score]
        dots = panel.scatter(axis.values[has_score], scores[has_score], c=number, vmin=0, vmax=len(scores), zorder=2)
        if has_score.any():
            best = np.nanargmax(scores)
            panel.plot(axis.values[best], scores[best], "o", ms=12, mfc="none", mec="C1", mew=2, zorder=3)
        if axis.is_log:
            panel.set_xscale("log")
        if expert is not None:
            _mark_level(panel, "expert", expert)
        panel.set(xlabel=literal(axis.name), ylabel=label)
        panel.spines[["top", "right"]].set_visible(False)
    figure.colorbar(dots, ax=panels, label="trial")
    save(figure, path)


class Scale(NamedTuple):
    """Times along an axis, and the law `fixed + each * value` beside them, in seconds.

    Attributes:
      name: of the axis.
      values, seconds: `[points]`.
    """

    name: str
    values: np.ndarray
    seconds: np.ndarray
    fixed: float
    each: float


def plot_scaling(path: Path, title: str, scales: Sequence[Scale]) -> None:
    """Saves a panel for each axis, both scales logarithmic: dots are measured, the line is the law."""
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    figure, (panels,) = figure_of(1, len(scales), (4.2, 3.6), title)
    for panel, scale in zip(panels, scales, strict=True):
        line, ms = np.geomspace(scale.values.min(), scale.values.max(), 100), 1e3 * scale.seconds
        law = f"{1e3 * scale.fixed:.3g} ms + {1e3 * scale.each:.3g} ms x {scale.name}"
        panel.loglog(line, 1e3 * (scale.fixed + scale.each * line), color="C0", lw=1, label=literal(law))
        panel.loglog(scale.values, ms, "o", color="C1", label="measured")
        panel.minorticks_off()
        panel.set_xticks(scale.values, [f"{value:,}" for value in scale.values], rotation=45, ha="right")
        panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        panel.yaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
        panel.set(ylim=(ms.min() / 2, ms.max() * 2), xlabel=literal(scale.name), ylabel="ms an iteration")
        panel.legend(frameon=False, fontsize=8)
        panel.spines[["top", "right"]].set_visible(False)
    save(figure, path)


def plot_diagnosis(path: Path, title: str, behaviours: dict[str, tuple[np.ndarray, np.ndarray]], expert: float) -> None:
    """Saves two panels with a line for each behaviour and a dot for each seed; the first behaviour stands out.

    Args:
      behaviours: by name, `[seeds]` learned rewards (0 random actions, 1 the best known) and `[seeds]` true returns.
      expert: true return of the demonstrator, drawn as a vertical line.
    """
    figure, (axes,) = figure_of(1, 2, (4.6, 0.8 + 0.4 * len(behaviours)), title)
    labels = ("learned reward: 0 random actions, 1 the best known", "true return; the line is the expert's")
    colors = ["C1", *["C0"] * (len(behaviours) - 1)]
    for panel, (axis, label, level) in enumerate(zip(axes, labels, (1.0, expert), strict=True)):
        _dots(axis, {name: figures[panel] for name, figures in behaviours.items()}, colors)
        axis.axvline(level, color="black", lw=0.8, ls="--")
        axis.set_xlabel(label)
    axes[1].set_yticklabels([""] * len(behaviours))
    save(figure, path)


def plot_ranking(
    path: Path,
    title: str,
    noise: np.ndarray,
    true: np.ndarray,
    rated: Mapping[str, np.ndarray],
    fitted: np.ndarray | None,
) -> None:
    """Saves panels with a dot for each noisy episode, in another colour for each seed.

    Args:
      noise: `[episodes]` the share of random actions.
      true: `[seeds, episodes]` true returns.
      rated: by the name of a reward its ratings `[seeds, episodes]`; the last one is the new reward's.
      fitted: `[seeds, episodes]` what the new reward follows, in standard deviations; None if it follows the noise.
    """
    *before, (new, ratings) = rated.items()
    figure, (axes,) = figure_of(1, 2 + len(before), (3.4, 3.0), title)
    panels = [("true return", true), *((name, _standardised(values)) for name, values in before)]
    for axis, (label, values) in zip(axes, panels, strict=False):
        for seed, of_seed in enumerate(values):
            axis.plot(noise, of_seed, ".", color=f"C{seed % 10}", alpha=0.5, mec="none")
        axis.set_xlabel("share of random actions")
        axis.set_ylabel(label, fontsize=8)
    if before and fitted is not None:
        for seed, (of_seed, ratings_of_seed) in enumerate(zip(fitted, panels[1][1], strict=True)):
            share = np.mean(of_seed * ratings_of_seed)  # of the ratings' spread that the curve explains
            axes[1].plot(noise, share * of_seed, color=f"C{seed % 10}", lw=1)
    for seed, (of_seed, learned) in enumerate(zip(true, _standardised(ratings), strict=True)):
        axes[-1].plot(of_seed, learned, ".", color=f"C{seed % 10}", alpha=0.5, mec="none")
    axes[-1].set_xlabel("true return")
    axes[-1].set_ylabel(new, fontsize=8)
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    save(figure, path)


def _standardised(values: np.ndarray) -> np.ndarray:
    """Rows `[seeds, n]` with mean 0 and standard deviation 1; a row of one value is 0."""
    std = values.std(axis=1, keepdims=True)
    return (values - values.mean(axis=1, keepdims=True)) / np.where(std > 0, std, 1.0)


def _dots(axis: Any, lines: Mapping[str, np.ndarray], colors: Sequence[str]) -> None:
    """Draws a line for each name, from above to below: a dot for each score, and a bar at their mean."""
    for line, (values, color) in enumerate(zip(lines.values(), colors, strict=True)):
        axis.plot(values, np.full(len(values), line), "o", color=color, alpha=0.6)
        if len(values):
            axis.plot([np.mean(values)] * 2, [line - 0.3, line + 0.3], color=color, lw=2)
    axis.set_yticks(range(len(lines)), list(map(literal, lines)))
    axis.invert_yaxis()
    axis.spines[["top", "right"]].set_visible(False)


def plot_dots(path: Path, title: str, panels: Sequence[Dots]) -> None:
    """Saves the picture that `dots_figure` draws."""
    save(dots_figure(title, panels), path)


def dots_figure(title: str, panels: Sequence[Dots]):
    """Draws panels of scores, one below the other."""
    from matplotlib.figure import Figure

    names = [list(map(_broken, panel.lines)) for panel in panels]
    heights = [1.0 + 0.26 * len(each) * (1 + 0.6 * max(name.count("\n") for name in each)) for each in names]
    figure = Figure(figsize=(8.0, 0.4 + sum(heights)), layout="constrained")
    figure.suptitle(literal(title))
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)
    for axis, panel, shown in zip(axes.flat, panels, names, strict=True):
        _dots(axis, panel.lines, panel.colors or ["C0"] * len(panel.lines))
        axis.set_ylim(len(panel.lines) - 0.4, -0.6)
        if panel.level:
            name, value = panel.level
            axis.axvline(value, color="black", lw=0.8, ls="--")
            axis.annotate(literal(name), (value, 1), xycoords=("data", "axes fraction"), ha="center", fontsize=8)
        axis.set_yticklabels(list(map(literal, shown)))
        axis.set_title(literal(panel.title), fontsize=10, loc="left", pad=14)  # the level's name stands below it
        axis.set_xlabel(panel.axis, fontsize=8)
    return figure


def _broken(name: str) -> str:
    """A long name in lines, which begin with a setting: `eairl-sa` and `+entropy_weight=0.1`."""
    return textwrap.fill(name.replace("+", " +"), 26) if len(name) > 26 else name


def plot_sweep(
    path: Path,
    title: str,
    names: Sequence[str],
    returns: Sequence[np.ndarray],
    curves: Sequence[np.ndarray],
    steps_per_iteration: Sequence[int],
    expert: float | None,
) -> None:
    """Saves two panels that compare the settings of a sweep.

    Args:
      names: of the settings.
      returns: of each setting the final true returns `[seeds]`, without dropped seeds; the first panel shows each as a
        dot.
      curves: of each setting the true returns while learning, `[seeds, iterations]`; the second panel shows means over
        seeds.
      steps_per_iteration: of each setting, environment steps of one seed in one iteration.
      expert: true return of the demonstrator, drawn as a horizontal line; None if it is unknown.
    """
    from matplotlib import colormaps
    from matplotlib.ticker import EngFormatter

    figure, ((final, learning),) = figure_of(1, 2, (5.5, 4.0), title)
    colors = colormaps["viridis"](np.linspace(0.0, 0.9, len(names)))
    for i, color in enumerate(colors):
        if len(returns[i]):
            final.plot(np.full(len(returns[i]), i), returns[i], "o", color=color, alpha=0.6)
            final.plot([i - 0.2, i + 0.2], [returns[i].mean()] * 2, color=color, lw=2)
        values = np.ma.masked_invalid(curves[i]).mean(axis=0)
        learning.plot((1 + np.arange(len(values))) * steps_per_iteration[i], values, color=color, label=names[i])
    final.set_xticks(range(len(names)), names, rotation=20, ha="right")
    final.set_title("final true return, a dot a seed")
    learning.set(title="true return while learning, mean over seeds", xlabel="environment steps of a seed")
    learning.xaxis.set_major_formatter(EngFormatter(sep=""))
    learning.legend(frameon=False, fontsize=8)
    for axis in (final, learning):
        if expert is not None:
            _mark_level(axis, "expert", expert)
        axis.spines[["top", "right"]].set_visible(False)
    save(figure, path)
