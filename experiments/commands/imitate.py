"""`eairl imitate`: learn a policy, and with it a reward, from demonstrations of one task."""

from __future__ import annotations

import numpy as np

from eairl_jax.experiments.commands.saturation import warn_if_saturated
from eairl_jax.experiments.display.console import Line, print_table, say, say_if_no_expert, with_references
from eairl_jax.experiments.options import Imitate
from eairl_jax.experiments.paper import published
from eairl_jax.experiments.pipeline import cluster, divergence
from eairl_jax.experiments.pipeline.default_folder import default_path
from eairl_jax.experiments.pipeline.experiment import imitations
from eairl_jax.experiments.pipeline.run import run as run_experiment
from eairl_jax.experiments.pipeline.train import RUNS


def run(options: Imitate, command_line: str) -> None:
    """Runs an experiment for each method and reward form, and prints one table."""
    experiments, results = imitations(options), []
    jobs = [[experiment] for experiment in experiments]
    logs = cluster.beside(options.out) if options.out else RUNS / "jobs"
    for experiment in cluster.mine(options, jobs, logs, command_line):
        # --out is the run's folder; where several runs share it, each has a folder in it.
        path = default_path(options, experiment.folder_name(), experiment.settings())
        if options.out:
            path = options.out if len(experiments) == 1 else options.out / experiment.name
        results.append(run_experiment(experiment, path, command_line))
        say(f"{experiment.name}: in {path}/")
        warn_if_saturated(results[-1])
    if not results or options.program is not None:
        return
    task, reference = options.task, experiments[0].source.reference
    expert = published.figure(published.IMITATION, task, "expert")
    lines, count = [], options.seeds
    for result in results:
        figure = published.figure(published.IMITATION, task, result.method) if result.is_published else None
        count = max(options.seeds, len(result.seeds) + len({each["seed"] for each in result.dropped}))
        further = f"{result.more_iterations} iterations beyond the plan, at the final rates"
        note = divergence.note(result.dropped, count)
        note = "; ".join(filter(None, (note, further if result.more_iterations else "")))
        lines.append(Line(result.name, np.array(result.returns), figure, result.normalized, note))
    lines = with_references(lines, reference.expert, reference.random, expert)
    print_table(f"Imitation of {task}: true return of the sampled policy, {count} seeds", lines)
    say_if_no_expert(task, reference.expert)
