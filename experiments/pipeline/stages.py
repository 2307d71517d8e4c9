"""The first stages of an experiment: learn a reward, and choose of which iteration. `retraining` has the others."""

from __future__ import annotations

import dataclasses
import functools
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from eairl_jax import (
    Algorithm,
    Config,
    HParams,
    Lanes,
    LearnedReward,
    horizon,
    learned_reward,
    load_reward,
    make_bc,
    make_irl,
    save_reward,
)
from eairl_jax.environment import context_size
from eairl_jax.envs.mjx_task import Task
from eairl_jax.experiments.pipeline import divergence, ranked
from eairl_jax.experiments.pipeline.experiment import Experiment, Rule, Use, snapshot_iterations
from eairl_jax.experiments.pipeline.places import Target, reward_obs_size
from eairl_jax.experiments.pipeline.retraining import Training, last_tenth, retrain
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import (
    EVALUATE,
    LEARN,
    SOURCE_RETRAIN,
    Lane,
    lane_keys,
    returns_program,
    scores,
    take_lanes,
    train,
)
from eairl_jax.experiments.settings import divisor
from eairl_jax.irl import RewardParams
from eairl_jax.lanes import KEPT_PROGRAMS, shards_for
from eairl_jax.methods import METHODS, with_method_defaults
from eairl_jax.noise_ranking import RANKINGS
from eairl_jax.programs import compile_thread
from eairl_jax.types import PyTree

SATURATED_ACCURACY = 0.99


@functools.lru_cache(KEPT_PROGRAMS)
def make_algorithm(env: Task, config: Config, shards: int = 1) -> Algorithm:
    """The algorithm that `config.method` names. It is the same one for the same arguments, and so is what is compiled.

    Args:
      shards: how many devices compute one lane together. Behaviour cloning has no use for several.

    Raises:
      InputError: for a setting that the algorithm cannot work with.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", horizon.HorizonWarning)  # the commands say it in their own words
        return make_irl(env, config, shards) if config.method in METHODS else make_bc(env, config)


# 1. Learn ------------------------------------------------------------------------------------------------------------


def learner(experiment: Experiment) -> tuple[Algorithm, Lanes]:
    """The method of an experiment, and a lane for each point and seed; nothing is compiled yet."""
    labels, config = lanes_of(experiment), experiment.config
    algorithm = make_algorithm(experiment.source.env, config, shards_for(len(labels), config))
    keys = lane_keys(LEARN, [lane["seed"] for lane in labels])
    return algorithm, Lanes(algorithm, keys, _hparams(experiment), experiment.source.demos)


def learn(folder: RunFolder, experiment: Experiment) -> tuple[Algorithm, PyTree]:
    """Trains the method of an experiment, and keeps snapshots of every seed's reward (not of a sweep's).

    Returns:
      The algorithm and the final states `[points * seeds, ...]`; the seeds of one point of a sweep lie side by side.
    """
    algorithm, lanes = learner(experiment)
    return algorithm, _learn(folder, experiment, lanes)


def _learn(folder: RunFolder, experiment: Experiment, lanes: Lanes) -> PyTree:
    labels = lanes_of(experiment)

    def save_snapshot(iteration: int, state: PyTree) -> None:
        reward = describe(experiment, learned_rewards(experiment, state), [iteration] * len(labels))
        save_reward(snapshot_path(folder, iteration), reward)

    title = f"{experiment.learning_name} in {experiment.source.task}"
    on_snapshot = save_snapshot if experiment.has_reward and not experiment.points else None
    return train(folder, title, lanes, experiment.recipe, labels, on_snapshot)


def learn_and_score(folder: RunFolder, experiment: Experiment) -> tuple[Algorithm, PyTree, np.ndarray]:
    """`learn`, and the mean true return `[points * seeds]` of every policy; NaN where it was dropped."""
    labels, env = lanes_of(experiment), experiment.source.env
    algorithm, lanes = learner(experiment)
    with compile_thread() as thread:
        keys = lane_keys(EVALUATE, [label["seed"] for label in labels])
        returns_program(env, algorithm).compile_later(thread, lanes.shapes(), keys)
        state = _learn(folder, experiment, lanes)
    return algorithm, state, scores(folder, experiment.recipe, env, algorithm, state, labels)


def lanes_of(experiment: Experiment) -> list[Lane]:
    """What tells the lanes of learning apart: the seed and, in a sweep, the values of the point."""
    points = experiment.points or ({},)
    return [{"seed": seed} | point for point in points for seed in experiment.seeds]


def _hparams(experiment: Experiment) -> HParams:
    """The floats of learning; those of a sweep are `[points * seeds]`."""
    labels = lanes_of(experiment)
    swept = {name: np.array([lane[name] for lane in labels], np.float32) for name in labels[0] if name != "seed"}
    return dataclasses.replace(experiment.recipe.hparams, **swept)


def untrained(experiment: Experiment) -> PyTree:
    """The rewards `[seeds, ...]` before the first iteration: networks with random weights."""
    _, lanes = learner(experiment)
    return learned_rewards(experiment, lanes.take(lanes.init()))


def learned_rewards(experiment: Experiment, state: PyTree) -> RewardParams:
    """The learned rewards of states, as functions of one task's observations, also if there are several sources."""
    return learned_reward(state, context_size(experiment.source.env))


def snapshot_path(folder: RunFolder, iteration: int) -> Path:
    """Where the rewards of an iteration are kept."""
    return folder.path / "snapshots" / f"{iteration:06d}"


def of_kept(reward: LearnedReward, lanes: np.ndarray) -> LearnedReward:
    """The rewards of some seeds, `lanes` of all."""
    chosen = {
        name: [reward.description[name][lane] for lane in lanes]
        for name in ("seeds", "iterations")
        if name in reward.description
    }
    return LearnedReward(reward.description | chosen, reward.config, take_lanes(reward.params, lanes))


def describe(experiment: Experiment, params: PyTree, iterations: list[int]) -> LearnedReward:
    """Learned rewards with their description.

    Args:
      params: `RewardParams` of every seed, `[seeds, ...]`.
      iterations: the iteration that each seed's reward was taken from.
    """
    source, config = experiment.source, experiment.config
    description = {
        "task": source.task,
        "obs_size": reward_obs_size(source.env),
        "action_size": source.env.action_size,
        "action_limit": source.env.action_limit,
        "method": config.method,
        "reward_form": with_method_defaults(config).reward_form,
        "seeds": list(experiment.seeds),
        "iterations": iterations,
        "hparams": dataclasses.asdict(experiment.recipe.hparams),
    }
    return LearnedReward(description, config, params)


def saturated_lanes(folder: RunFolder, experiment: Experiment) -> list[str]:
    """The lanes whose discriminator was right about nearly everything in most iterations: its reward says little."""
    if not experiment.has_reward:
        return []
    labels = lanes_of(experiment)
    share = (folder.curve("accuracy", len(labels)) > SATURATED_ACCURACY).mean(axis=1)
    return [
        ", ".join(f"{name} {value:g}" for name, value in labels[lane].items())
        for lane in divergence.kept(folder, labels)
        if share[lane] > 0.5
    ]


# 2. Choose -----------------------------------------------------------------------------------------------------------


class Choice(NamedTuple):
    """The reward that a rule takes.

    Attributes:
      reward: each seed's reward.
      facts: fields of `Result`: the iterations, and what `source_retrain` compared.
    """

    reward: LearnedReward
    facts: dict[str, Any]


def choose_reward(folder: RunFolder, learning: RunFolder, experiment: Experiment, use: Use) -> Choice:
    """Takes each seed's reward from the snapshots in `learning` by the rule of `use`."""
    rule, seeds, kept = use.rule, experiment.seeds, snapshot_iterations(experiment.recipe)
    if rule.kind == "random":
        before = [0] * len(seeds)
        return Choice(describe(experiment, untrained(experiment), before), {"chosen_iterations": before})
    if rule.kind == "source_retrain":
        return _by_source_retrain(folder, learning, experiment, use)
    if rule.kind in RANKINGS:
        return _by_ranking(folder, learning, experiment, rule.kind)
    iteration = kept[-1] if rule.kind == "last" else rule.iteration
    facts = {"chosen_iterations": [iteration] * len(seeds)}
    return Choice(load_reward(snapshot_path(learning, iteration)), facts)


def _by_ranking(folder: RunFolder, learning: RunFolder, experiment: Experiment, kind: str) -> Choice:
    """Fits rewards to noisy episodes of the policies with which the learning ended, and says in a file how well."""
    algorithm, state = learn(learning, experiment)
    started = time.perf_counter()
    fitted = ranked.fit(experiment, algorithm, state, kind)
    folder.add_seconds(run_seconds=time.perf_counter() - started)
    ranked.write(folder.path, fitted)
    iterations = [experiment.recipe.last_iteration] * len(experiment.seeds)
    recipe = dataclasses.replace(experiment.recipe, config=fitted.config)
    reward = describe(dataclasses.replace(experiment, recipe=recipe), fitted.params, iterations)
    return Choice(reward, {"chosen_iterations": iterations})


def _by_source_retrain(folder: RunFolder, learning: RunFolder, experiment: Experiment, use: Use) -> Choice:
    """Trains policies on every snapshot in the source; each seed's best snapshot is the one with the best true return.

    Each snapshot has `repeats` policies. The one counts that its own reward rates best in the last tenth of training.
    Their mean would be low wherever one policy settled before a wall, whatever the reward.
    """
    kept, seeds = snapshot_iterations(experiment.recipe), list(experiment.seeds)
    rule, source = use.rule, shortened(use.back_home, use.rule)
    rewards = [load_reward(snapshot_path(learning, iteration)) for iteration in kept]
    # Rewards in the order (snapshot, seed).
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(each.params for each in rewards))
    labels: list[Lane] = [{"snapshot": iteration, "seed": seed} for iteration in kept for seed in seeds]
    all_rewards = LearnedReward(rewards[0].description, rewards[0].config, params)
    inner = RunFolder(folder.path / "source_retrain", {"rule": dataclasses.asdict(rule)} | source.settings())
    title = f"{experiment.name}: retraining on {len(kept)} snapshots in {source.task}"
    inner.drop(folder.dropped())
    retrain(inner, title, Training(source, all_rewards, labels, SOURCE_RETRAIN))
    folder.drop(inner.dropped())
    shape = (rule.repeats, len(kept), len(seeds))
    learned, true = (
        last_tenth(inner.curve(name, rule.repeats * len(labels))).reshape(shape)
        for name in ("policy_reward", "true_return")
    )
    scores = np.take_along_axis(true, learned.argmax(axis=0)[None], axis=0)[0]
    # A training in which no episode ended has no return: it is never the best.
    best = np.where(np.isfinite(scores), scores, -np.inf).argmax(axis=0)
    chosen = [kept[index] for index in best]
    of_seeds = [jax.tree.map(lambda leaf, s=seed: leaf[s], rewards[i].params) for seed, i in enumerate(best)]
    reward = describe(experiment, jax.tree.map(lambda *leaves: np.stack(leaves), *of_seeds), chosen)
    returns = [divergence.all_finite(each) for each in scores.round(3)]
    return Choice(reward, {"chosen_iterations": chosen, "snapshots": kept, "source_returns": returns})


def shortened(back_home: Target, rule: Rule) -> Target:
    """The source as a target, with the short training by which `source_retrain` compares snapshots.

    A snapshot has fewer policies than a reward in the target, and as many trials for each of them.
    """
    target = back_home.with_config(iterations=rule.iterations)
    recipe = dataclasses.replace(
        target.recipe,
        snapshot_every=divisor(rule.iterations, max(1, rule.iterations // 2)),
        restarts=rule.repeats,
        trials=target.recipe.trials * rule.repeats // target.recipe.restarts,
    )
    return dataclasses.replace(target, recipe=recipe.checked())
