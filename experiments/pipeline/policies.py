"""The policies that a finished run left, whatever kind of run it was."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from eairl_jax import (
    Algorithm,
    Checkpoints,
    Config,
    HParams,
    InputError,
    Lanes,
    LearnedPolicy,
    PolicyParams,
    load_policy,
    make_rl,
    policy_params,
    save_policy,
    save_reward,
)
from eairl_jax.envs.mjx_task import Task
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.pipeline import (
    divergence,
    more_seeds,
    overview,
    points,
    records,
    user_methods,
    user_networks,
)
from eairl_jax.experiments.pipeline.experiment import Experiment
from eairl_jax.experiments.pipeline.places import make_env
from eairl_jax.experiments.pipeline.retraining import best_restarts, last_tenth
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.stages import describe, learned_rewards, make_algorithm
from eairl_jax.experiments.pipeline.train import take_lanes
from eairl_jax.methods import with_method_defaults
from eairl_jax.storage import read_json
from eairl_jax.types import Key, PyTree


@dataclass(frozen=True)
class Policies:
    """One policy for each seed.

    Attributes:
      task, env: where the policies act; of a transfer its target.
      algorithm: its `act` is how they act.
      state: NumPy arrays `[seeds, ...]`.
      seeds: numbers of the seeds.
      settings: of the run.
      config: of the networks, without values that the method decides.
      iteration: that they have behind them; fewer than `config.iterations` if the run is not finished.
    """

    task: str
    env: Task
    algorithm: Algorithm
    state: PyTree
    seeds: list[int]
    settings: dict
    config: Config
    iteration: int

    def lane(self, lane: int) -> PyTree:
        """The state of one policy, as jax arrays."""
        return jax.tree.map(lambda leaf: jax.numpy.asarray(leaf[lane]), self.state)

    def learned(self) -> LearnedPolicy:
        """The policies as an artefact, without their optimiser, environments and value function."""
        description = {
            "task": self.task,
            "obs_size": self.env.observation_size,
            "action_size": self.env.action_size,
            "action_limit": self.env.action_limit,
            "seeds": list(self.seeds),
            "iterations": [self.iteration] * len(self.seeds),
        }
        params = self.state if isinstance(self.state, PolicyParams) else policy_params(self.state)
        return LearnedPolicy(description, self.config, params)


def load(path: Path, may_be_unfinished: bool = False) -> Policies:
    """Reads the policies of an expert, of an imitation, or of a transfer (those kept of its restarts).

    Seeds that were dropped are left out.

    Args:
      may_be_unfinished: whether the policies of an expert or an imitation that still trains will do. They are those of
        its newest checkpoint.

    Raises:
      InputError: if `path` is no run's folder, or the run is not finished.
    """
    is_finished = (path / "summary.json").is_file()
    settings = finished_settings(path) if is_finished or not may_be_unfinished else _unfinished_settings(path)
    is_transfer = "retrain_config" in settings
    prefix = "retrain_" if is_transfer else ""
    names = ["seeds", "target" if is_transfer else "task", f"{prefix}config", f"{prefix}hparams"]
    seeds, task, config, hparams = records.needed(settings, names, path)
    config = Config.from_json(config, path / "config.json")
    hparams = HParams.from_json(hparams, path / "config.json")
    seeds = list(range(seeds)) if isinstance(seeds, int) else seeds
    env = make_env(task)
    is_imitation = "demonstrations" in settings and not is_transfer
    if is_imitation:
        user_methods.register(config.method)
        user_networks.register(config.net)
    algorithm = make_algorithm(env, config) if is_imitation else make_rl(env, config)
    if is_imitation and config.method != "bc":
        config = with_method_defaults(config)
    iteration = _last_iteration(path, config) if is_finished else _newest_iteration(path)
    if not (path / "checkpoints" / str(iteration)).is_dir():
        if (path / "policy" / "policy.json").is_file():
            return _cleaned(path, task, env, settings)
        raise InputError(f"{path} has lost its last checkpoint ({iteration}), which held its policies")
    groups = more_seeds.finished(path) if is_finished and is_imitation else []
    if any(not (group / "checkpoints").is_dir() for group in groups):
        return _cleaned(path, task, env, settings)
    restarts, folder = settings.get("restarts", 1), RunFolder(path, settings)
    state = _restore(path, algorithm, iteration, hparams, restarts * len(seeds))
    if restarts > 1:
        state = take_lanes(state, best_restarts(folder, restarts, len(seeds)))
    if folder.dropped():
        kept = divergence.kept_seeds(folder)
        state, seeds = take_lanes(state, kept), [seeds[lane] for lane in kept]
    trained = Policies(task, env, algorithm, state, seeds, settings, config, iteration)
    for group in groups:
        other = load(group)
        state = jax.tree.map(lambda *leaves: np.concatenate(leaves), trained.state, other.state)
        trained = dataclasses.replace(trained, state=state, seeds=[*trained.seeds, *other.seeds])
    return trained


def _cleaned(path: Path, task: str, env: Task, settings: dict) -> Policies:
    """The policies of a finished run whose checkpoints were removed, from its `policy/`."""
    learned = load_policy(path / "policy")
    seeds, iteration = learned.description["seeds"], learned.description["iterations"][0]

    def act(params: PolicyParams, obs: jax.Array, key: Key | None = None) -> jax.Array:
        shape = (*obs.shape[:-1], env.action_size)
        return learned.act(params, obs, None if key is None else jax.random.normal(key, shape))

    def cannot_train(*_arguments):
        raise InputError(f"{path} has no checkpoints any more (`eairl clean`): its policies can act, but not train")

    algorithm = Algorithm(cannot_train, cannot_train, act)
    return Policies(task, env, algorithm, learned.params, seeds, settings, learned.config, iteration)


def keep(path: Path) -> None:
    """Writes the policies of a finished run into its folder `policy/`.

    Nothing happens if they are there, or if the run's checkpoints have been removed.
    """
    folder = path / "policy"
    if not (folder / "policy.json").exists() and (path / "checkpoints").is_dir():
        save_policy(folder, load(path).learned())


def keep_points(path: Path, experiment: Experiment, algorithm: Algorithm, state: PyTree, kept: np.ndarray) -> None:
    """Writes the reward and the policies of each point of a sweep into a folder `points/NAME`.

    Args:
      path: folder of the sweep.
      state: of all lanes, NumPy arrays `[points * seeds, ...]`.
      kept: the lanes that were not dropped.
    """
    source, count = experiment.source, len(experiment.seeds)
    config = with_method_defaults(experiment.config) if experiment.has_reward else experiment.config
    iteration, settings = experiment.recipe.last_iteration, experiment.settings()
    for number, point in enumerate(experiment.points):
        lanes = kept[kept // count == number]
        if not len(lanes):
            continue
        folder, of_point = path / "points" / points.folder_name(point), take_lanes(state, lanes)
        seeds = [experiment.seeds[lane] for lane in lanes % count]
        trained = Policies(source.task, source.env, algorithm, of_point, seeds, settings, config, iteration)
        save_policy(folder / "policy", trained.learned())
        if experiment.has_reward:
            recipe = dataclasses.replace(
                experiment.recipe, hparams=dataclasses.replace(experiment.recipe.hparams, **point)
            )
            of_recipe = dataclasses.replace(experiment, recipe=recipe, seeds=seeds)
            reward = describe(of_recipe, learned_rewards(of_recipe, of_point), [iteration] * len(seeds))
            save_reward(folder / "reward", reward)


def finished_settings(path: Path) -> dict:
    """The settings of a finished run that trained policies."""
    if not (path / "config.json").is_file():
        raise InputError(f"{path} is no run's folder: give one that `eairl expert`, imitate or transfer made")
    settings = records.settings(path)
    if not (path / "summary.json").is_file():
        raise InputError(f"{path} holds no finished run: repeat the command that began the run, and it goes on")
    return _with_policies(path, settings)


def _unfinished_settings(path: Path) -> dict:
    """The settings of an expert or an imitation that still trains."""
    if not (path / "config.json").is_file() or "retrain_config" in (settings := records.settings(path)):
        return finished_settings(path)  # which says what is missing
    return _with_policies(path, settings)


def _last_iteration(path: Path, config: Config) -> int:
    """The iteration with which a finished run ended, or the newest one of a run that goes on beyond its end."""
    last = config.iterations + _more_iterations(path)
    if (path / "checkpoints" / str(last)).is_dir() or not (path / "checkpoints").is_dir():
        return last
    return max(last, overview.newest_checkpoint(path))


def planned_iterations(path: Path, settings: dict) -> int:
    """The iterations of a finished run, those beyond its plan included.

    Raises:
      InputError: if its files are damaged.
    """
    prefix = "retrain_" if "retrain_config" in settings else ""
    (config,) = records.needed(settings, [f"{prefix}config"], path)
    return Config.from_json(config, path / "config.json").iterations + _more_iterations(path)


def _more_iterations(path: Path) -> int:
    return read_json(path / "summary.json", records.END, records.AGAIN).get("more_iterations", 0)


def _newest_iteration(path: Path) -> int:
    checkpoints = Checkpoints(path / "checkpoints", read_only=True) if (path / "checkpoints").is_dir() else None
    newest = checkpoints.latest() if checkpoints else None
    if newest is None:
        raise InputError(f"{path} has no checkpoint yet: wait until its first iterations are done")
    say(f"{path} is not finished: these are the policies of iteration {newest}")
    return newest


def _with_policies(path: Path, settings: dict) -> dict:
    """The settings of a run that trained policies."""
    if "sweep" in settings:
        raise InputError(
            f"{path} is a sweep: repeat its best point with `eairl imitate`, and give that run; the rewards and "
            f"policies of all points are in {path / 'points'}"
        )
    if settings.get("rule", {}).get("kind") == "policy":
        raise InputError(f"{path} trained no policy, it scored one: give the learn-... folder beside it")
    return settings


def _restore(path: Path, algorithm: Algorithm, iteration: int, hparams: HParams, lanes: int) -> PyTree:
    """The states `[lanes, ...]` of a checkpoint."""
    keys, checkpoints = (
        jax.random.split(jax.random.PRNGKey(0), lanes),
        Checkpoints(path / "checkpoints", read_only=True),
    )
    if not checkpoints.is_intact(iteration):
        raise InputError(
            f"the last checkpoint of {path} ({iteration}) is damaged, and it held the policies: remove "
            f"{path / 'summary.json'} and repeat the command that made the run; it goes on from the checkpoint before"
        )
    return checkpoints.restore(iteration, Lanes(algorithm, keys, hparams).blank())


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
    folder = RunFolder(path, experts.settings)
    kept, count = divergence.kept_seeds(folder), experts.settings["seeds"]
    curves = folder.curve("true_return", count if isinstance(count, int) else len(count))
    best = int(np.argmax(last_tenth(curves)[kept]))
    settings = experts.settings | {"chosen_seed": experts.seeds[best], "chosen_by": "training return of the last tenth"}
    state = take_lanes(experts.state, np.array([best]))
    return dataclasses.replace(experts, state=state, seeds=[experts.seeds[best]], settings=settings)
