"""What a command that scores policies leaves beside its table: one figure and one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from eairl_jax.experiments.display import page, plots


def write(
    folder: Path,
    title: str,
    subtitle: str,
    tables: Sequence[page.Table],
    panels: Sequence[plots.Dots],
    facts: Mapping[str, str],
) -> None:
    """Writes `scores.png`, and `index.html` with the tables and the figure.

    Args:
      facts: how the scores were made, by name.
    """
    plots.plot_dots(folder / "scores.png", title, panels)
    picture = page.png("Every score", folder / "scores.png", is_wide=False)
    page.write(folder / "index.html", page.Page(title, subtitle, tables, [picture], facts=facts))
