"""What a run ends with: `summary.json`, a table beside the paper's row, and its curves as a picture."""

from __future__ import annotations

import resource
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from experiments import paper
from experiments.training import console


@dataclass(frozen=True)
class Curve:
    """One panel's line: values `[lanes, iterations]` over environment steps."""

    panel: str
    label: str
    values: np.ndarray
    steps_per_iteration: int
    level: tuple[str, float] | None = None
    """A horizontal line to compare with: its name and height."""


def summarize(command: str, task: str, target: str | None, method: str, returns: np.ndarray, env_steps: int,
              seconds: dict, expert: float, random: float, **more) -> dict:  # fmt: skip
    """The content of `summary.json`; `returns [seeds]`, one true return a seed."""
    mean = float(np.mean(returns))
    return {
        "command": command,
        "task": task,
        "target": target,
        "method": method,
        "seeds": list(range(len(returns))),
        "env_steps": env_steps,
        **seconds,
        "expert": expert,
        "random": random,
        "returns": [float(r) for r in returns],
        "mean": mean,
        "std": float(np.std(returns)),
        "normalized": (mean - random) / (expert - random),
        "peak_memory_gb": peak_memory_gb(),
    } | more


def peak_memory_gb() -> float:
    """The most memory this process has held, in GB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


def print_table(title: str, rows: list[tuple[str, np.ndarray | None, paper.Row | None, str]]) -> None:
    """Prints rows of (name, returns of every seed, the paper's row, a remark)."""
    table = Table(title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    table.add_column("mean ± std", justify="right", no_wrap=True)
    table.add_column("paper", justify="right", no_wrap=True)
    table.add_column("every seed", justify="right")
    table.add_column("", style="dim")
    for name, returns, published, remark in rows:
        if returns is None:
            mean, each = "-", ""
        else:
            mean = f"{np.mean(returns):.2f} ± {np.std(returns):.2f}" if len(returns) > 1 else f"{returns[0]:.2f}"
            each = "  ".join(f"{r:.2f}" for r in returns) if len(returns) > 1 else ""
        table.add_row(name, mean, paper.show(published), each, remark)
    console.print(table)


def plot(path: Path, title: str, curves: list[Curve]) -> None:
    """Draws the mean and the range over seeds, a panel for each name of `Curve.panel`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = list(dict.fromkeys(curve.panel for curve in curves))
    figure, axes = plt.subplots(1, len(panels), figsize=(5.2 * len(panels), 3.8), squeeze=False, layout="constrained")
    for axis, panel in zip(axes[0], panels, strict=True):
        drawn = [curve for curve in curves if curve.panel == panel]
        for number, curve in enumerate(drawn):
            values = np.ma.masked_invalid(curve.values)  # no episode may have ended yet
            steps = (1 + np.arange(values.shape[1])) * curve.steps_per_iteration
            axis.plot(steps, values.mean(axis=0), color=f"C{number}", label=curve.label)
            axis.fill_between(steps, values.min(axis=0), values.max(axis=0), color=f"C{number}", alpha=0.2, lw=0)
        for name, height in dict.fromkeys(curve.level for curve in drawn if curve.level):
            axis.axhline(height, color="black", lw=0.8, ls="--")
            axis.annotate(name, (1, height), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8)
        axis.set(title=panel, xlabel="environment steps of one seed")
        axis.spines[["top", "right"]].set_visible(False)
        if len(drawn) > 1 or drawn[0].label:
            axis.legend(frameon=False, fontsize=8)
    figure.suptitle(title)
    figure.savefig(path, dpi=130)
    plt.close(figure)
