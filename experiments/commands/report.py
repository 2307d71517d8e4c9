"""`eairl report`: one page of all results, the paper's beside them."""

from __future__ import annotations

from eairl_jax.experiments.options import Report
from eairl_jax.experiments.paper import report


def run(options: Report, command_line: str) -> None:
    """Writes the page."""
    del command_line
    report.write(options.results, options.out)
