"""The stages of an experiment: learn a reward, choose its iteration, train fresh policies on it, score them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from eairl_jax import (
    Algorithm,
    Config,
    Lanes,
    LearnedReward,
    learned_reward,
    load_reward,
    make_bc,
    make_irl,
    make_rl,
    reward_function,
    save_reward,
)
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline.experiment import Experiment, Rule, Target, Use, snapshot_iterations
from eairl_jax.experiments.pipeline.run_folder import RunFolder, settings_digest
from eairl_jax.experiments.pipeline.train import (
    LEARN,
    RETRAIN,
    SOURCE_RETRAIN,
    Lane,
    final_returns,
    lane_keys,
    take_lanes,
    train,
)
from eairl_jax.experiments.settings import divisor
from eairl_jax.methods import METHODS, with_method_defaults
from eairl_jax.types import PyTree

SATURATED_ACCURACY = 0.99


def make_algorithm(env: MjxTask, config: Config) -> Algorithm:
    """The algorithm that `config.method` names.

    Raises:
      InputError: for a setting that the algorithm cannot work with.
    """
    return make_irl(env, config) if config.method in METHODS else make_bc(env, config)


# 1. Learn ------------------------------------------------------------------------------------------------------------


def learn(folder: RunFolder, experiment: Experiment) -> tuple[Algorithm, PyTree]:
    """Trains the method of an experiment, and keeps snapshots of every seed's reward (not of a sweep's).

    Returns:
      The algorithm and the final states `[points * seeds, ...]`; the seeds of one point of a sweep lie side by side.
    """
    labels = lanes_of(experiment)
    algorithm, lanes = _learning_lanes(experiment, labels)

    def save_snapshot(iteration: int, state: PyTree) -> None:
        reward = describe(experiment, learned_reward(state), [iteration] * len(labels))
        save_reward(snapshot_path(folder, iteration), reward)

    title = f"{experiment.learning_name} in {experiment.source.task}"
    on_snapshot = save_snapshot if experiment.has_reward and not experiment.points else None
    return algorithm, train(folder, title, lanes, experiment.recipe, labels, on_snapshot)


def lanes_of(experiment: Experiment) -> list[Lane]:
    """What tells the lanes of learning apart: the seed and, in a sweep, the values of the point."""
    points = experiment.points or ({},)
    return [{"seed": seed} | point for point in points for seed in experiment.seeds]


def _learning_lanes(experiment: Experiment, labels: list[Lane]) -> tuple[Algorithm, Lanes]:
    algorithm = make_algorithm(experiment.source.env, experiment.config)
    swept = {name: np.array([lane[name] for lane in labels], np.float32) for name in labels[0] if name != "seed"}
    hparams = dataclasses.replace(experiment.recipe.hparams, **swept)
    keys = lane_keys(LEARN, [lane["seed"] for lane in labels])
    return algorithm, Lanes(algorithm, keys, hparams, experiment.source.demos)


def untrained(experiment: Experiment) -> PyTree:
    """The rewards `[seeds, ...]` before the first iteration: networks with random weights."""
    _, lanes = _learning_lanes(experiment, lanes_of(experiment))
    return learned_reward(lanes.take(lanes.init()))


def snapshot_path(folder: RunFolder, iteration: int) -> Path:
    """Where the rewards of an iteration are kept."""
    return folder.path / "snapshots" / f"{iteration:06d}"


def describe(experiment: Experiment, params: PyTree, iterations: list[int]) -> LearnedReward:
    """Learned rewards with their description.

    Args:
      params: `RewardParams` of every seed, `[seeds, ...]`.
      iterations: the iteration that each seed's reward was taken from.
    """
    source, config = experiment.source, experiment.config
    description = {
        "task": source.task,
        "obs_size": source.env.observation_size,
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
        ", ".join(f"{name} {value:g}" for name, value in lane.items())
        for lane, lane_share in zip(labels, share, strict=True)
        if lane_share > 0.5
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
    iteration = kept[-1] if rule.kind == "last" else rule.iteration
    facts = {"chosen_iterations": [iteration] * len(seeds)}
    return Choice(load_reward(snapshot_path(learning, iteration)), facts)


def _by_source_retrain(folder: RunFolder, learning: RunFolder, experiment: Experiment, use: Use) -> Choice:
    """Trains policies on every snapshot in the source; each seed's best snapshot is the one with the best true return.

    Of the repeats of a snapshot the one counts that its own reward rates best, as in the target. Their mean would be
    low wherever one policy settled before a wall, whatever the reward.
    """
    kept, seeds = snapshot_iterations(experiment.recipe), list(experiment.seeds)
    rule, source = use.rule, shortened(use.back_home, use.rule)
    rewards = [load_reward(snapshot_path(learning, iteration)) for iteration in kept]
    # Lanes in the order (repeat, snapshot, seed).
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves * rule.repeats), *(each.params for each in rewards))
    labels: list[Lane] = [
        {"repeat": repeat, "snapshot": iteration, "seed": seed}
        for repeat in range(rule.repeats)
        for iteration in kept
        for seed in seeds
    ]
    inner = RunFolder(folder.path / "source_retrain", {"rule": dataclasses.asdict(rule)} | source.settings())
    title = f"{experiment.name}: retraining on {len(kept)} snapshots in {source.task}"
    retrain(inner, title, source, with_params(rewards[0], params), labels, SOURCE_RETRAIN)
    shape = (rule.repeats, len(kept), len(seeds))
    learned, true = (
        last_tenth(inner.curve(name, len(labels))).reshape(shape) for name in ("policy_reward", "true_return")
    )
    scores = np.take_along_axis(true, learned.argmax(axis=0)[None], axis=0)[0]
    best = scores.argmax(axis=0)
    chosen = [kept[index] for index in best]
    of_seeds = [jax.tree.map(lambda leaf, s=seed: leaf[s], rewards[i].params) for seed, i in enumerate(best)]
    reward = describe(experiment, jax.tree.map(lambda *leaves: np.stack(leaves), *of_seeds), chosen)
    return Choice(reward, {"chosen_iterations": chosen, "snapshots": kept, "source_returns": scores.round(3).tolist()})


def with_params(reward: LearnedReward, params: PyTree) -> LearnedReward:
    """The reward with other parameters."""
    return LearnedReward(reward.description, reward.config, params)


def shortened(back_home: Target, rule: Rule) -> Target:
    """The source as a target, with the short training by which `source_retrain` compares snapshots."""
    target = back_home.with_config(iterations=rule.iterations)
    chunk = divisor(rule.iterations, max(1, rule.iterations // 2))
    return dataclasses.replace(target, recipe=dataclasses.replace(target.recipe, snapshot_every=chunk))


# 3. Retrain ----------------------------------------------------------------------------------------------------------


def retrain(
    folder: RunFolder, title: str, target: Target, reward: LearnedReward | None, labels: list[Lane], phase: int
) -> tuple[Algorithm, PyTree]:
    """Trains a fresh policy in each lane.

    Args:
      reward: learned rewards, `params` with a leading axis `[lanes, ...]`; None for the task's true reward.
      labels: what tells the lanes apart.
      phase: of `lane_keys`.

    Returns:
      The algorithm and the final states `[lanes, ...]`. The curves are in the folder's metrics.
    """
    hparams, params = target.recipe.hparams, ()
    if reward is None:
        algorithm = make_rl(target.env, target.recipe.config)
        # -temperature log pi belongs to a learned reward, which is one of maximum-entropy reinforcement learning.
        hparams = dataclasses.replace(hparams, temperature=0.0)
    else:
        function, params = reward_function(reward.config), reward.params
        config = target.for_reward(reward.config).recipe.config
        algorithm = make_rl(target.env, config, lambda params, batch: function(params, batch.obs, batch.action))
    keys = lane_keys(phase, *([label[name] for label in labels] for name in labels[0]))
    lanes = Lanes(algorithm, keys, hparams, params, data_per_lane=reward is not None)
    return algorithm, train(folder, title, lanes, target.recipe, labels)


class Score(NamedTuple):
    """What the kept policies reach in the target.

    Attributes:
      curves: `[seeds, iterations]` true returns while training.
      returns: `[seeds]` true returns at the end.
    """

    curves: np.ndarray
    returns: np.ndarray


def score(folder: RunFolder, title: str, target: Target, reward: LearnedReward | None, seeds: Sequence[int]) -> Score:
    """Trains `target.recipe.restarts` policies for each seed and keeps the best by the reward it was trained on.

    A policy can settle before a wall that it has to walk around. The learned reward shows which policy did not; the
    true reward has no say.
    """
    restarts = target.recipe.restarts
    labels: list[Lane] = [{"restart": restart, "seed": seed} for restart in range(restarts) for seed in seeds]
    if reward is not None:
        params = jax.tree.map(lambda leaf: np.concatenate([leaf] * restarts), reward.params)
        reward = with_params(reward, params)
    algorithm, state = retrain(folder, title, target, reward, labels, RETRAIN)
    kept = best_restarts(folder, restarts, len(seeds))
    returns = final_returns(target.env, algorithm, take_lanes(state, kept), seeds).mean(axis=1)
    return Score(kept_curves(folder, target, len(seeds)), returns)


def kept_curves(folder: RunFolder, target: Target, seeds: int, metric: str = "true_return") -> np.ndarray:
    """A metric `[seeds, iterations]` of the kept policies while they were trained."""
    restarts = target.recipe.restarts
    return folder.curve(metric, restarts * seeds)[best_restarts(folder, restarts, seeds)]


def best_restarts(folder: RunFolder, restarts: int, seeds: int) -> np.ndarray:
    """Lanes `[seeds]` of the policies that their own reward rates best at the end."""
    by_reward = last_tenth(folder.curve("policy_reward", restarts * seeds)).reshape(restarts, seeds)
    return by_reward.argmax(axis=0) * seeds + np.arange(seeds)


def last_tenth(curves: np.ndarray) -> np.ndarray:
    """Mean over the last tenth of curves `[lanes, iterations]`."""
    return curves[:, -max(1, curves.shape[1] // 10) :].mean(axis=1)


def ceiling(target: Target, seeds: Sequence[int], out: Path) -> list[float]:
    """True return of each seed's policy trained on the true reward under the same budget; trained once in `out`."""
    settings = target.settings() | {"seeds": list(seeds), "reward": "true"}
    folder = RunFolder(out / f"ceiling-{target.task}-{settings_digest(settings)}", settings)
    summary = folder.summary()
    if summary is None:
        returns = score(folder, f"ceiling: true reward in {target.task}", target, None, seeds).returns
        summary = {"returns": returns.tolist(), "mean": float(returns.mean()), **folder.seconds()}
        folder.write_summary(summary)
    return summary["returns"]
