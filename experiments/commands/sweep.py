"""`eairl sweep`: one method with many values of its settings; all floats in one compiled program."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from eairl_jax.envs.names import file_name
from eairl_jax.experiments.commands.saturation import warn_if_saturated
from eairl_jax.experiments.display import page
from eairl_jax.experiments.display.console import (
    Line,
    print_table,
    say,
    say_if_no_expert,
    table_of,
    with_references,
)
from eairl_jax.experiments.options import Sweep
from eairl_jax.experiments.pipeline import cluster, divergence
from eairl_jax.experiments.pipeline.default_folder import default_path
from eairl_jax.experiments.pipeline.experiment import Experiment, sweeps
from eairl_jax.experiments.pipeline.run import Result, draw_sweeps, point_name
from eairl_jax.experiments.pipeline.run import run as run_experiment


def run(options: Sweep, command_line: str) -> None:
    """Trains every combination of the listed values with every seed, and prints one table."""
    experiments, done, lines = sweeps(options), [], []
    first = experiments[0]
    name = first.folder_name() if len(experiments) == 1 else f"sweep-{file_name(options.task)}-{options.method}"
    out = options.out or default_path(options, name, first.settings())
    for experiment in cluster.mine(options, [[each] for each in experiments], cluster.beside(out), command_line):
        path = out if len(experiments) == 1 else out / experiment.name
        result = run_experiment(experiment, path, command_line)
        warn_if_saturated(result)
        done.append((experiment, path, result))
        lines += _lines(experiment, result, options.seeds)
    if not done or options.program is not None:
        return
    result = done[0][2]
    if len(done) > 1:
        draw_sweeps(out / "curves.png", f"{options.method} in {options.task}", done)
    lines = with_references(lines, result.expert, result.random)
    title = first.name if len(done) == 1 else options.method
    described = f"true return, {options.seeds} seeds for each setting"
    print_table(f"{title} in {result.task}: {described}", lines)
    if len(done) > 1:
        runs = [path.name for _, path, _ in done]
        _write_page(out, f"{title} in {result.task}", described, lines, runs, command_line)
    say_if_no_expert(result.task, result.expert)
    say(f"in {out}/; index.html shows the settings side by side")


def _write_page(out: Path, title: str, subtitle: str, lines: list[Line], runs: list[str], command_line: str) -> None:
    """Writes the page of several programs, with a link to the page of each."""
    picture = page.png("The settings side by side", out / "curves.png")
    links = [page.Link(name, f"{quote(name)}/index.html") for name in runs]
    table = page.Table("Result", *table_of(lines))
    page.write(out / "index.html", page.Page(title, subtitle, [table], [picture], links, {"command": command_line}))


def _lines(experiment: Experiment, result: Result, seeds: int) -> list[Line]:
    """A line for each point that has a score; the others are said."""
    lines = []
    for point, returns in zip(result.points, result.returns_by_point, strict=True):
        note = divergence.note([each for each in result.dropped if divergence.matches(each, point)], seeds)
        name = point_name(experiment, point)
        if len(returns):
            lines.append(Line(name, returns, None, result.reference.normalized(returns.mean()), note))
        else:
            say(f"{name}: no score; {note}")
    return lines
