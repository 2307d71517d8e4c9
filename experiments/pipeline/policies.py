"""The policies that a finished run left, whatever kind of run it was."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from eairl_jax import Algorithm, Checkpoints, Config, HParams, InputError, make_rl
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline import algorithms
from eairl_jax.experiments.pipeline.learn import take_rows
from eairl_jax.experiments.pipeline.retrain import best_restarts, tail
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.recipes import make_env
from eairl_jax.storage import read_json
from eairl_jax.types import PyTree


@dataclass(frozen=True)
class Policies:
    """One policy a seed.

    Attributes:
      task, env: where they act; of a transfer its target.
      algorithm: whose `act` they act with.
      state: NumPy arrays `[seeds, ...]`.
      seeds: their numbers.
      settings: of the run.
    """

    task: str
    env: MjxTask
    algorithm: Algorithm
    state: PyTree
    seeds: list[int]
    settings: dict

    def lane(self, lane: int) -> PyTree:
        """The state of one of them, as jax arrays."""
        return jax.tree.map(lambda leaf: jax.numpy.asarray(leaf[lane]), self.state)


def load(path: Path) -> Policies:
    """Reads the policies of an expert, of an imitation, or of a transfer (those kept of its restarts).

    Raises:
      InputError: if `path` is no run's folder, or the run is not finished.
    """
    if not (path / "config.json").is_file():
        raise InputError(f"{path} is no run's folder: give one that `eairl expert`, imitate or transfer made")
    settings = read_json(path / "config.json").get("settings", {})
    if not (path / "summary.json").is_file():
        raise InputError(f"{path} holds no finished run: repeat the command that began it, and it goes on")
    if "sweep" in settings:
        raise InputError(f"{path} is a sweep: repeat its best point with `eairl imitate`, and give that run")
    transferred = "retrain_config" in settings
    prefix = "retrain_" if transferred else ""
    try:
        seeds, task = settings["seeds"], settings["target" if transferred else "task"]
        config, hparams = Config.from_json(settings[f"{prefix}config"]), HParams(**settings[f"{prefix}hparams"])
    except (KeyError, TypeError) as e:
        raise InputError(f"{path}/config.json is of another version ({e}): repeat the command that made it") from None
    seeds = list(range(seeds)) if isinstance(seeds, int) else seeds
    env = make_env(task)
    imitated = "demonstrations" in settings and not transferred
    algorithm = algorithms.make(env, config) if imitated else make_rl(env, config)
    restarts = settings.get("restarts", 1)
    keys = jax.random.split(jax.random.PRNGKey(0), restarts * len(seeds))
    like = jax.eval_shape(jax.vmap(lambda key: algorithm.init(key, hparams)), keys)
    like = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), like)
    if settings.get("rule", {}).get("kind") == "policy":
        raise InputError(f"{path} trained no policy, it moved one: give the learn-... folder beside it")
    if not (path / "checkpoints" / str(config.iterations)).is_dir():
        raise InputError(f"{path} has lost its last checkpoint ({config.iterations}), where its policies were")
    state = Checkpoints(path / "checkpoints").restore(config.iterations, like)
    if restarts > 1:
        state = take_rows(state, best_restarts(RunFolder(path, settings), restarts, len(seeds)))
    return Policies(task, env, algorithm, state, seeds, settings)


def best_expert(path: Path, task: str) -> Policies:
    """The best seed of a finished `eairl expert`, by the training returns of its last tenth.

    Raises:
      InputError: if `path` holds no such run of the task.
    """
    if not (path / "summary.json").is_file():
        raise InputError(f"{path} holds no finished expert: train one with `eairl expert {task}`")
    experts = load(path)
    if experts.task != task or {"demonstrations", "retrain_config"} & set(experts.settings):
        raise InputError(f"{path} holds no expert of {task}: train one with `eairl expert {task}`")
    best = int(np.argmax(tail(RunFolder(path, experts.settings).curve("true_return", len(experts.seeds)))))
    said = experts.settings | {"chosen_seed": best, "chosen_by": "training return of the last tenth"}
    return dataclasses.replace(
        experts, state=take_rows(experts.state, np.array([best])), seeds=[experts.seeds[best]], settings=said
    )
