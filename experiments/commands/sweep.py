"""`eairl sweep`: one method with many values of its floats, all in one compiled program."""

from __future__ import annotations

from eairl_jax.experiments.commands.saturation import warn_if_saturated
from eairl_jax.experiments.display.console import Line, print_table, say, say_if_no_expert, with_references
from eairl_jax.experiments.options import Sweep
from eairl_jax.experiments.pipeline import divergence
from eairl_jax.experiments.pipeline.default_folder import default_path
from eairl_jax.experiments.pipeline.experiment import sweeps
from eairl_jax.experiments.pipeline.run import point_name
from eairl_jax.experiments.pipeline.run import run as run_experiment


def run(options: Sweep, command_line: str) -> None:
    """Trains every combination of the listed values with every seed, and prints one table."""
    experiment = sweeps(options)
    path = options.out or default_path(options, experiment.folder_name(), experiment.settings())
    result = run_experiment(experiment, path, command_line)
    warn_if_saturated(result)
    lines = []
    for point, returns in zip(result.points, result.returns_by_point, strict=True):
        note = divergence.note([each for each in result.dropped if divergence.matches(each, point)], options.seeds)
        if len(returns):
            lines.append(Line(point_name(point), returns, None, result.reference.normalized(returns.mean()), note))
        else:
            say(f"{point_name(point)}: no score; {note}")
    lines = with_references(lines, result.expert, result.random)
    print_table(f"{result.name} in {result.task}: true return, {options.seeds} seeds for each setting", lines)
    say_if_no_expert(result.task, result.expert)
    say(f"in {path}/; curves.png shows the settings side by side")
