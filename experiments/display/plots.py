"""What a run ends with: `summary.json`, a table beside the paper's row, and its curves as a picture."""

from __future__ import annotations

import resource
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.pipeline.scores import Reference
from eairl_jax.experiments.pipeline.train import console


@dataclass(frozen=True)
class Curve:
    """One panel's line: values `[lanes, iterations]` over environment steps."""

    panel: str
    label: str
    values: np.ndarray
    steps_per_iteration: int
    level: tuple[str, float] | None = None
    """A horizontal line to compare with: its name and height."""
    color: str = ""
    """The panel's next one, unless told."""
    style: str = "-"


def summarize(command: str, task: str, target: str | None, method: str, seeds: Sequence[int], returns: np.ndarray,
              env_steps: int, seconds: dict, known: Reference, **more) -> dict:  # fmt: skip
    """The content of `summary.json`; `returns [seeds]`, one true return a seed."""
    mean = float(np.mean(returns))
    return {
        "command": command,
        "task": task,
        "target": target,
        "method": method,
        "seeds": list(seeds),
        "env_steps": env_steps,
        **seconds,
        "expert": known.expert,
        "random": known.random,
        "returns": [float(r) for r in returns],
        "mean": mean,
        "std": float(np.std(returns)),
        "normalized": known.normalized(mean),
        "peak_memory_gb": peak_memory_gb(),
    } | more


def peak_memory_gb() -> float:
    """The most memory this process has held, in GB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


class Row(NamedTuple):
    """A row of a table of returns: `returns` holds one true return a seed."""

    name: str
    returns: np.ndarray
    published: paper.Row | None = None
    normalized: float | None = None
    note: str = ""


def print_table(title: str, rows: list[Row]) -> None:
    """Prints mean and std of each row beside the paper's, then every seed. Fits 80 columns."""
    table = Table(title=title, title_justify="left")
    table.add_column("", overflow="fold")
    with_paper = any(row.published for row in rows)
    for name in ("mean ± std", *(["paper"] if with_paper else []), "normalized"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        mean = f"{np.mean(row.returns):.2f}" + (f" ± {np.std(row.returns):.2f}" if len(row.returns) > 1 else "")
        normalized = "" if row.normalized is None else f"{row.normalized:.3f}"
        table.add_row(row.name, mean, *([paper.show(row.published)] if with_paper else []), normalized)
    console.print(table)
    for row in rows:
        each = "every seed " + "  ".join(f"{r:.2f}" for r in row.returns) if len(row.returns) > 1 else ""
        told = "; ".join(part for part in (each, row.note) if part)
        if told:
            console.print(f"[dim]{row.name}: {told}[/dim]", soft_wrap=True, highlight=False)


def figure_of(rows: int, columns: int, size: tuple[float, float], title: str):
    """A figure of `rows x columns` panels, each of `size` inches: `(figure, axes [rows, columns])`."""
    from matplotlib.figure import Figure  # on its own: nothing has to be closed

    figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
    figure.suptitle(title)
    return figure, figure.subplots(rows, columns, squeeze=False)


def plot(path: Path, title: str, curves: list[Curve]) -> None:
    """Saves `curve_figure`."""
    curve_figure(title, curves).savefig(path, dpi=130)


def curve_figure(title: str, curves: list[Curve], columns: int = 4):
    """The mean and the range over seeds, a panel for each name of `Curve.panel`."""
    from matplotlib.ticker import EngFormatter

    panels = list(dict.fromkeys(curve.panel for curve in curves))
    columns = min(columns, len(panels))
    figure, axes = figure_of(-(-len(panels) // columns), columns, (5.2, 3.8), title)
    for spare in axes.flat[len(panels) :]:
        spare.set_visible(False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        drawn = [curve for curve in curves if curve.panel == panel]
        for number, curve in enumerate(drawn):
            values = np.ma.masked_invalid(curve.values)  # no episode may have ended yet
            steps = (1 + np.arange(values.shape[1])) * curve.steps_per_iteration
            color = curve.color or f"C{number}"
            axis.plot(steps, values.mean(axis=0), color=color, ls=curve.style, label=curve.label)
            axis.fill_between(steps, values.min(axis=0), values.max(axis=0), color=color, alpha=0.2, lw=0)
        for name, height in dict.fromkeys(curve.level for curve in drawn if curve.level):
            axis.axhline(height, color="black", lw=0.8, ls="--")
            axis.annotate(name, (1, height), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8)
        axis.set_title(panel, fontsize=10)
        axis.set_xlabel("environment steps of a seed; mean and range over seeds")
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.spines[["top", "right"]].set_visible(False)
        if len(drawn) > 1 or drawn[0].label:
            axis.legend(frameon=False, fontsize=8)
    return figure


def plot_sweep(path: Path, title: str, names: list[str], returns: np.ndarray, curves: np.ndarray,
               steps_per_iteration: int, expert: float) -> None:  # fmt: skip
    """Draws final returns `[settings, seeds]`, a dot a seed, and mean curves `[settings, seeds, iterations]`."""
    from matplotlib import colormaps
    from matplotlib.ticker import EngFormatter

    figure, ((final, learning),) = figure_of(1, 2, (5.5, 4.0), title)
    colors = colormaps["viridis"](np.linspace(0.0, 0.9, len(names)))
    for i, color in enumerate(colors):
        final.plot(np.full(returns.shape[1], i), returns[i], "o", color=color, alpha=0.6)
        final.plot([i - 0.2, i + 0.2], [returns[i].mean()] * 2, color=color, lw=2)
        values = np.ma.masked_invalid(curves[i]).mean(axis=0)
        learning.plot((1 + np.arange(len(values))) * steps_per_iteration, values, color=color, label=names[i])
    final.set_xticks(range(len(names)), names, rotation=20, ha="right")
    final.set_title("final true return, a dot a seed")
    learning.set(title="true return while learning, mean over seeds", xlabel="environment steps of a seed")
    learning.xaxis.set_major_formatter(EngFormatter(sep=""))
    learning.legend(frameon=False, fontsize=8)
    for axis in (final, learning):
        axis.axhline(expert, color="black", lw=0.8, ls="--")
        axis.annotate("expert", (1, expert), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
