"""Fresh policies on a given reward: in the target task of a transfer, or back in the source."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from eairl_jax import Algorithm, Config, InputError, Lanes, LearnedReward, demonstrations, make_rl, reward_function
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline.algorithms import refuse_meaningless
from eairl_jax.experiments.pipeline.learn import take_rows
from eairl_jax.experiments.pipeline.run_folder import RunFolder, digest
from eairl_jax.experiments.pipeline.scores import Reference, reference, shipped
from eairl_jax.experiments.pipeline.train import RETRAIN, final_returns, lane_keys, train
from eairl_jax.experiments.recipes import Recipe, parse_overrides, recipe
from eairl_jax.types import PyTree


@dataclass(frozen=True)
class Target:
    """The task in which rewards are put to use, and how policies are trained there."""

    task: str
    env: MjxTask
    recipe: Recipe
    reference: Reference
    variant: str = ""
    """Tells the row from one of the same reward, retrained by another recipe."""


def as_target(task: str, env: MjxTask, assignments: tuple[str, ...], restarts: int | None = None) -> Target:
    """A task with its retraining recipe and its reference returns (of the demonstrations we ship).

    Args:
      assignments: a user's `name=value` for the recipe.
      restarts: a user's number of them.

    Raises:
      InputError: for a setting that retraining does not have.
    """
    path = shipped(task)
    known = reference(task, env, path, demonstrations.load(path, task))
    overrides = parse_overrides(assignments)
    own = recipe(task, env, "retrain", overrides | ({} if restarts is None else {"restarts": restarts}))
    refuse_meaningless([own.config], set(overrides), "reinforcement learning")
    if "actions" in overrides:
        raise InputError("--retrain-set actions: they are what the reward came to know; give --set actions=...")
    return Target(task, env, own, known)


def on_reward(target: Target, learned: Config) -> Target:
    """The target as policies are trained there on a reward that was learned so: with actions as it came to know them.

    Their log pi, too, is that of those actions.
    """
    config = dataclasses.replace(target.recipe.config, actions=learned.actions)
    return dataclasses.replace(target, recipe=dataclasses.replace(target.recipe, config=config))


def target_settings(target: Target) -> dict:
    """What decides how policies are trained in the target task."""
    own = target.recipe
    return {
        "target": target.task,
        "retrain_config": dataclasses.asdict(own.config),
        "retrain_hparams": dataclasses.asdict(own.hparams),
        "retrain_snapshot_every": own.snapshot_every,
        "restarts": own.restarts,
    }


def retrain(folder: RunFolder, title: str, target: Target, reward: LearnedReward | None, params: PyTree,
            labels: list[dict], phase: int) -> tuple[Algorithm, PyTree]:  # fmt: skip
    """Trains a fresh policy a lane in the target task, on learned rewards `[lanes, ...]` or, if None, on the true one.

    Returns:
      The algorithm and the final states `[lanes, ...]`; the curves are in the folder's metrics.
    """
    if reward is None:
        algorithm = make_rl(target.env, target.recipe.config)
    else:
        function = reward_function(reward.config)
        config = on_reward(target, reward.config).recipe.config
        algorithm = make_rl(target.env, config, lambda params, tau: function(params, tau.obs, tau.action))
    keys = lane_keys(phase, *([label[name] for label in labels] for name in labels[0]))
    # A learned reward is one of maximum-entropy reinforcement learning; the true one is not.
    hparams = target.recipe.hparams if reward else dataclasses.replace(target.recipe.hparams, temperature=0.0)
    lanes = Lanes(algorithm, keys, hparams, params, data_per_lane=reward is not None)
    return algorithm, train(folder, title, lanes, target.recipe, labels)


def score(
    folder: RunFolder, title: str, target: Target, reward: LearnedReward | None, seeds: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Trains `target.recipe.restarts` policies for each seed and keeps the best *by the reward it was trained on*.

    A policy can settle before a wall that it has to walk around. Which of several did not is visible in the learned
    reward; the true reward has no say.

    Returns:
      `(curves [seeds, iterations] of true returns, final true returns [seeds])` of the kept policies.
    """
    labels = [{"restart": restart, "seed": seed} for restart in range(target.recipe.restarts) for seed in seeds]
    params = jax.tree.map(lambda leaf: np.concatenate([leaf] * target.recipe.restarts), reward.params) if reward else ()
    algorithm, state = retrain(folder, title, target, reward, params, labels, RETRAIN)
    kept = best_restarts(folder, target.recipe.restarts, len(seeds))
    returns = final_returns(target.env, algorithm, take_rows(state, kept), seeds).mean(axis=1)
    return kept_curves(folder, target, len(seeds)), returns


def kept_curves(folder: RunFolder, target: Target, seeds: int, metric: str = "true_return") -> np.ndarray:
    """A metric `[seeds, iterations]` of the kept policies while they were trained."""
    restarts = target.recipe.restarts
    return folder.curve(metric, restarts * seeds)[best_restarts(folder, restarts, seeds)]


def best_restarts(folder: RunFolder, restarts: int, seeds: int) -> np.ndarray:
    """Lanes `[seeds]` of the policies that their own reward rates best at the end."""
    by_reward = tail(folder.curve("policy_reward", restarts * seeds)).reshape(restarts, seeds)
    return by_reward.argmax(axis=0) * seeds + np.arange(seeds)


def tail(curves: np.ndarray) -> np.ndarray:
    """Mean of the last tenth of curves `[lanes, iterations]`."""
    return curves[:, -max(1, curves.shape[1] // 10) :].mean(axis=1)


def ceiling(target: Target, seeds: Sequence[int], out: Path) -> np.ndarray:
    """True returns `[seeds]` of policies trained on the true reward under the very same budget; trained once."""
    settings = target_settings(target) | {"seeds": list(seeds), "reward": "true"}
    folder = RunFolder(out / f"ceiling-{target.task}-{digest(settings)}", settings)
    summary = folder.summary()
    if summary is None:
        _, returns = score(folder, f"ceiling: true reward in {target.task}", target, None, seeds)
        summary = {"returns": returns.tolist(), "mean": float(returns.mean()), **folder.seconds()}
        folder.write_summary(summary)
    return np.array(summary["returns"])
