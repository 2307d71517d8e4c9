"""`eairl expert`: reinforcement learning on a task's own reward."""

from __future__ import annotations

import dataclasses
import shlex

import numpy as np

from eairl_jax import InputError, Lanes, make_rl
from eairl_jax.envs.names import file_name
from eairl_jax.experiments.display.console import Line, print_table, say
from eairl_jax.experiments.display.plots import Curve, plot
from eairl_jax.experiments.options import Expert
from eairl_jax.experiments.paper import published
from eairl_jax.experiments.pipeline import divergence, policies, records, run_page
from eairl_jax.experiments.pipeline.experiment import checked_seeds
from eairl_jax.experiments.pipeline.places import explain_defaults, make_env
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import LEARN, RUNS, Lane, lane_keys, scores, train
from eairl_jax.experiments.settings import TRIALS, Recipe, parse_overrides, recipe, refuse_unread
from eairl_jax.lanes import shards_for


def run(options: Expert, command_line: str) -> None:
    """Trains experts side by side and prints how each of them does."""
    task, seeds = options.task, options.seeds
    env = make_env(task)
    if seeds < 1:
        raise InputError(f"--seeds {seeds}: expected at least 1")
    checked_seeds(seeds)
    overrides = parse_overrides((f"optimizer={options.optimizer}", *options.set))
    training = recipe(task, env, "expert", overrides | {"on_nan": options.on_nan, "more": options.more})
    refuse_unread([training.config], overrides, reinforcement=True)
    if TRIALS & set(overrides):
        raise InputError(
            f"{', '.join(sorted(TRIALS))}: only a retraining (`eairl transfer`) has trials; leave them out"
        )
    settings = {
        "task": task,
        "seeds": seeds,
        "config": dataclasses.asdict(training.config),
        "hparams": dataclasses.asdict(training.hparams),
        "snapshot_every": training.snapshot_every,
    }
    explain_defaults(task)
    folder = RunFolder(options.out or RUNS / f"expert-{file_name(task)}", settings, options.track)
    summary = folder.summary(records.EXPERT)
    if summary is None or summary.get("more_iterations", 0) < options.more:
        folder.prepare()
        summary = {"command_line": command_line, "task": task} | _train(folder, env, training, seeds)
        run_page.forget(folder.path)
        returns = folder.curve("true_return", seeds)[divergence.kept_seeds(folder)]
        curve = Curve("true return", "", returns, training.config.steps_per_iteration)
        plot(folder.path / "curves.png", f"Experts of {task}", [curve])
        folder.write_summary(summary)
    if folder.is_writable():
        policies.keep(folder.path)
        if not (folder.path / run_page.PAGE).exists():
            run_page.write(folder.path)
    figures = [published.figure(table, task, "expert") for table in (published.IMITATION, published.TRANSFER)]
    further = summary.get("more_iterations", 0)
    note = divergence.note(summary.get("dropped", []), seeds)
    note = "; ".join(filter(None, (note, f"{further} iterations beyond the plan" if further else "")))
    lines = [
        Line("sampled policy", np.array(summary["returns"]), next(filter(None, figures), None), note=note),
        Line("its mean action", np.array(summary["returns_mean_action"]), note=note),
    ]
    print_table(f"Experts of {task} after {summary['env_steps']:,} environment steps", lines)
    say(f"in {folder.path}/; collect demonstrations with `eairl demos {shlex.quote(task)}`")


def _train(folder: RunFolder, env, training: Recipe, seeds: int) -> dict:
    """The summary of experts that are trained to the end."""
    algorithm = make_rl(env, training.config, shards=shards_for(seeds, training.config))
    lanes = Lanes(algorithm, lane_keys(LEARN, range(seeds)), training.hparams)
    labels: list[Lane] = [{"seed": seed} for seed in range(seeds)]
    state = train(folder, folder.path.name, lanes, training, labels)
    every = [scores(folder, training, env, algorithm, state, labels, sampled) for sampled in (True, False)]
    kept = divergence.kept_seeds(folder)
    returns, mean_action = (values[kept] for values in every)
    return {
        "seeds": kept.tolist(),
        **({"dropped": folder.dropped()} if folder.dropped() else {}),
        "env_steps": training.env_steps,
        **({"more_iterations": training.more} if training.more else {}),
        **folder.seconds(),
        "returns": returns.tolist(),
        "returns_mean_action": mean_action.tolist(),
        "mean": float(returns.mean()),
        "std": float(returns.std()),
    }
