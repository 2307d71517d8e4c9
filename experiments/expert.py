"""`eairl expert`: PPO on the task's own reward."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import numpy as np

from eairl_jax import Algorithm, Checkpoints, Config, HParams, InputError, Lanes, make_rl
from eairl_jax.artefact import read_json
from eairl_jax.types import PyTree
from envs.mjx_task import MjxTask
from experiments import paper
from experiments.algorithms import refuse_meaningless
from experiments.folder import Folder
from experiments.settings import make_env, parse_overrides, recipe
from experiments.summary import Curve, Row, plot, print_table
from experiments.training import LEARN, default_out, final_returns, lane_keys, say, train


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
    folder = Folder(out or default_out(f"expert-{task}"), settings)
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
            "env_steps": own.config.iterations * own.config.steps_per_iteration,
            **folder.seconds(),
            "returns": sampled.tolist(),
            "returns_mean_action": mean_action.tolist(),
            "mean": float(sampled.mean()),
            "std": float(sampled.std()),
        }
        curve = Curve("true return", "", folder.curve("true_return", seeds), own.config.steps_per_iteration)
        plot(folder.path / "curves.png", f"Experts of {task}", [curve])
        folder.finish(summary)
    published = [paper.row(table, task, "expert") for table in (paper.IMITATION, paper.TRANSFER)]
    rows = [
        Row("sampled policy", np.array(summary["returns"]), next((p for p in published if p), None)),
        Row("its mean action", np.array(summary["returns_mean_action"])),
    ]
    print_table(f"Experts of {task} after {summary['env_steps']:,} environment steps", rows)
    say(f"in {folder.path}/; collect demonstrations with `eairl demos {task}`")


def load_expert(path: Path, task: str, env: MjxTask) -> tuple[Algorithm, PyTree, dict]:
    """The best seed of a finished expert run, by the training returns of its last tenth.

    Returns:
      The algorithm, the seed's state, and what to say of it.

    Raises:
      InputError: if there is no finished expert of the task in `path`.
    """
    if not (path / "summary.json").is_file():
        raise InputError(f"{path} holds no finished expert: train one with `eairl expert {task}`")
    settings = read_json(path / "config.json")["settings"]
    if settings["task"] != task:
        raise InputError(f"{path} holds an expert of {settings['task']}, not of {task}")
    config = Config.from_json(settings["config"])
    algorithm = make_rl(env, config)
    lanes = Lanes(algorithm, lane_keys(LEARN, range(settings["seeds"])), HParams(**settings["hparams"]))
    state = Checkpoints(path / "checkpoints").restore(config.iterations, lanes.take(lanes.init()))
    curve = Folder(path, settings).curve("true_return", settings["seeds"])
    best = int(np.argmax(curve[:, -max(1, config.iterations // 10) :].mean(axis=1)))
    said = settings | {"chosen_seed": best, "chosen_by": "training return of the last tenth"}
    return algorithm, jax.tree.map(lambda leaf: leaf[best], state), said
