"""`eairl expert`: PPO on the task's own reward."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from eairl_jax import InputError, Lanes, make_rl
from eairl_jax.experiments.display.plots import Curve, Row, plot, print_table
from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.pipeline.algorithms import refuse_meaningless
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import LEARN, default_out, final_returns, lane_keys, say, train
from eairl_jax.experiments.recipes import make_env, parse_overrides, recipe


def command(task: str, seeds: int, out: Path | None, assignments: tuple[str, ...], line: str) -> None:
    """Trains `seeds` experts side by side and prints how each of them does."""
    env = make_env(task)
    if seeds < 1:
        raise InputError(f"--seeds {seeds}: expected at least 1")
    overrides = parse_overrides(assignments)
    own = recipe(task, env, "expert", overrides)
    refuse_meaningless([own.config], set(overrides), "reinforcement learning")
    settings = {
        "task": task,
        "seeds": seeds,
        "config": dataclasses.asdict(own.config),
        "hparams": dataclasses.asdict(own.hparams),
        "snapshot_every": own.snapshot_every,
    }
    folder = RunFolder(out or default_out(f"expert-{task}"), settings)
    summary = folder.summary()
    if summary is None:
        algorithm = make_rl(env, own.config)
        lanes = Lanes(algorithm, lane_keys(LEARN, range(seeds)), own.hparams)
        state = train(folder, f"expert of {task}", lanes, own, [{"seed": seed} for seed in range(seeds)])
        sampled = final_returns(env, algorithm, state, range(seeds)).mean(axis=1)
        mean_action = final_returns(env, algorithm, state, range(seeds), sampled=False).mean(axis=1)
        summary = {
            "command": line,
            "task": task,
            "seeds": list(range(seeds)),
            "env_steps": own.config.env_steps,
            **folder.seconds(),
            "returns": sampled.tolist(),
            "returns_mean_action": mean_action.tolist(),
            "mean": float(sampled.mean()),
            "std": float(sampled.std()),
        }
        curve = Curve("true return", "", folder.curve("true_return", seeds), own.config.steps_per_iteration)
        plot(folder.path / "curves.png", f"Experts of {task}", [curve])
        folder.write_summary(summary)
    published = [paper.row(table, task, "expert") for table in (paper.IMITATION, paper.TRANSFER)]
    rows = [
        Row("sampled policy", np.array(summary["returns"]), next((p for p in published if p), None)),
        Row("its mean action", np.array(summary["returns_mean_action"])),
    ]
    print_table(f"Experts of {task} after {summary['env_steps']:,} environment steps", rows)
    say(f"in {folder.path}/; collect demonstrations with `eairl demos {task}`")
