"""The last stages of an experiment: train fresh policies on a reward, keep the best by that reward, score it."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from eairl_jax import (
    Algorithm,
    Config,
    Diverged,
    HParams,
    InputError,
    Lanes,
    LearnedReward,
    demonstrations,
    evaluate,
    horizon,
    make_rl,
    processes,
    random_policy,
    reward_function,
)
from eairl_jax.agent import clip_actions
from eairl_jax.environment import context_size
from eairl_jax.envs.mjx_task import Task
from eairl_jax.envs.names import file_name
from eairl_jax.evaluation import reward_per_step
from eairl_jax.experiments.pipeline import divergence, records
from eairl_jax.experiments.pipeline.places import RANDOM_SEED, Target, reward_obs_size
from eairl_jax.experiments.pipeline.run_folder import RunFolder, settings_digest
from eairl_jax.experiments.pipeline.train import (
    JUDGE,
    PLAN,
    RETRAIN,
    Lane,
    Start,
    lane_keys,
    returns_program,
    scores,
    take_lanes,
    train,
)
from eairl_jax.experiments.settings import Recipe, divisor
from eairl_jax.irl import reward_kind
from eairl_jax.lanes import KEPT_PROGRAMS, shards_for
from eairl_jax.plans import Search, make_planner
from eairl_jax.programs import Program, compile_thread, row_shapes
from eairl_jax.rl import Reward, true_reward
from eairl_jax.storage import read_json, write_json
from eairl_jax.types import PyTree

SEARCH = Search()
"""How many plans a retraining tries, and how it clones them."""
JUDGED_EPISODES = 64
"""Episodes by which the policy is chosen that is worth most to its reward."""
WORTH, PLANS = "worth.json", "plans.json"
"""The files that hold the `Worth` of a run's policies, and what the best plans of its trials are worth."""
RANDOM, EXPERT, BEST_PLAN = "random actions", "expert", "best plan"
"""Behaviours that policies are compared with."""


@dataclass(frozen=True)
class Training:
    """The training of policies on one or more rewards, several policies for each reward.

    Attributes:
      target: where and how the policies are trained.
      reward: learned rewards, `params` with a leading axis `[rewards, ...]`; None for the task's true reward.
      labels: what tells the rewards apart, for example their seeds. The true reward has a label for each seed too.
      phase: of `lane_keys`.
      like: for the true reward, learned rewards whose programs it shares. Their parameters are not used.
    """

    target: Target
    reward: LearnedReward | None
    labels: list[Lane]
    phase: int
    like: LearnedReward | None = None

    @property
    def config(self) -> Config:
        """The static settings of the policies. A learned reward fixes the kind of their actions."""
        # The true reward is that of the episodes as they are.
        target = (
            self.target.for_reward(self.reward.config) if self.reward else self.target.with_config(horizon="default")
        )
        return target.recipe.config

    def hparams(self, labels: list[Lane]) -> HParams:
        """The floats of the training of each policy; the first policies of a reward are the random ones."""
        recipe = self.target.recipe
        is_random = np.array([label.get("restart", recipe.random_trials) < recipe.random_trials for label in labels])
        fraction = np.where(is_random, recipe.random_std, 1.0) * recipe.hparams.std_initial_fraction
        hparams = dataclasses.replace(recipe.hparams, std_initial_fraction=fraction)
        # -temperature log pi belongs to a learned reward, which is one of maximum-entropy reinforcement learning.
        return hparams if self.reward else dataclasses.replace(hparams, temperature=0.0)

    @property
    def function(self) -> Reward:
        """The reward as `make_rl` takes it, `(Paid, transitions) -> rewards`."""
        env, kind = self.target.env, self.reward or self.like
        # Several sources are a target where `source_retrain` compares rewards: a reward sees the tasks' own entries.
        return _paid(reward_kind(kind.config) if kind else None, reward_obs_size(env) if context_size(env) else None)

    def algorithm(self, labels: list[Lane]) -> Algorithm:
        """Reinforcement learning on the reward, in as many lanes as there are labels."""
        return _algorithm(self.target.env, self.config, self.function, shards_for(len(labels), self.config))

    def paid(self, count: int) -> Paid:
        """What is paid for, `[rewards]` repeated `count` times, one after another."""
        kind = self.reward or self.like
        params = jax.tree.map(lambda leaf: np.concatenate([leaf] * count), kind.params if kind else ())
        return Paid(params, np.full(count * len(self.labels), self.reward is None))

    def lanes(self, algorithm: Algorithm, phase: int, labels: list[Lane]) -> Lanes:
        """A lane for each label; the labels name every reward equally often, all rewards one after another."""
        keys = lane_keys(phase, *([label[name] for label in labels] for name in labels[0]))
        paid = self.paid(len(labels) // len(self.labels))
        return Lanes(algorithm, keys, self.hparams(labels), paid, data_per_lane=True)

    def restarts(self, count: int) -> list[Lane]:
        """The labels of `count` policies for each reward, in the order (policy, reward)."""
        return [{"restart": restart} | label for restart in range(count) for label in self.labels]


class Paid(NamedTuple):
    """What policies are trained on.

    Attributes:
      params: of a learned reward.
      is_true: whether the environment's reward is paid instead.
    """

    params: PyTree
    is_true: PyTree


# Trainings that differ in numbers alone share these functions, hence also what `Lanes` and `jax.jit` have compiled for
# them: the ceiling, and rewards of one kind that several methods have learned.
@functools.lru_cache(KEPT_PROGRAMS)
def _paid(kind: Config | None, obs_end: int | None) -> Reward:
    """The reward of rewards of one kind (`reward_kind`); None for the true reward alone."""
    function = reward_function(kind) if kind else None

    def reward(paid: Paid, batch) -> jax.Array:
        if function is None:
            return true_reward((), batch)
        learned = function(paid.params, batch.obs[..., :obs_end], batch.action)
        return jnp.where(paid.is_true, true_reward((), batch), learned)

    return reward


@functools.lru_cache(KEPT_PROGRAMS)
def _algorithm(env: Task, config: Config, reward: Reward, shards: int) -> Algorithm:
    return make_rl(env, config, reward, shards)


@functools.lru_cache(KEPT_PROGRAMS)
def _planner(env: Task, config: Config, places: int, search: Search, reward: Reward) -> Algorithm:
    return make_planner(env, config, places, search, reward)


def retrain(folder: RunFolder, title: str, training: Training) -> tuple[Algorithm, PyTree]:
    """Trains `restarts` policies for each reward. If the recipe has trials, these are the best of the trials.

    Returns:
      The algorithm and the final states `[restarts * rewards, ...]`. The curves are in the folder's metrics; those of
      the trials are in the metrics of `trials_folder`.
    """
    recipe, start = training.target.recipe, None
    labels = training.restarts(recipe.restarts)
    algorithm = training.algorithm(labels)
    if recipe.trials:
        start = Start(recipe.trial_iterations, lambda: best_trials(folder, f"{title}, trials", training))
        rest = recipe.config.iterations - recipe.trial_iterations
        recipe = dataclasses.replace(recipe, snapshot_every=divisor(rest, recipe.snapshot_every))
    lanes = training.lanes(algorithm, training.phase, labels)
    return algorithm, train(folder, title, lanes, recipe, labels, start=start)


def best_trials(folder: RunFolder, title: str, training: Training) -> PyTree:
    """Trains many policies for a few iterations, and returns the states `[restarts * rewards, ...]` of the best.

    The first `random_trials` of each reward are random networks. The others begin in different places
    (`eairl_jax.plans`). The best are those of the highest reward, of the reward that they are trained on; but random
    trials go on before others (`Recipe.random_trials`).
    """
    recipe, inner = training.target.recipe, trials_folder(folder)
    labels = training.restarts(recipe.trials)
    config = dataclasses.replace(recipe.config, iterations=recipe.trial_iterations)
    short = dataclasses.replace(recipe, config=config, snapshot_every=recipe.trial_iterations)
    # The algorithm has the whole number of iterations: a trial is the first part of a training.
    lanes = training.lanes(training.algorithm(labels), training.phase, labels)
    start = Start(0, lambda: _first_policies(inner, training, lanes.take(lanes.init())))
    inner.drop(folder.dropped())
    state = train(inner, title, lanes, short, labels, start=start)
    folder.drop(inner.dropped())
    return take_lanes(state, kept_trials(inner, recipe, len(training.labels)).ravel())


def trials_folder(folder: RunFolder) -> RunFolder:
    """The folder in which the trials of a retraining are trained."""
    return RunFolder(folder.path / "trials", {"part": "trials"})


def kept_trials(inner: RunFolder, recipe: Recipe, rewards: int) -> np.ndarray:
    """Lanes `[restarts, rewards]` of the trials that go on: random ones first, and of either kind the best first.

    The best have the highest mean rewards over their last quarter.
    """
    curves = inner.curve("policy_reward", recipe.trials * rewards)
    late = curves[:, -max(1, curves.shape[1] // 4) :].mean(axis=1).reshape(recipe.trials, rewards)
    is_other = np.broadcast_to(np.arange(recipe.trials)[:, None] >= recipe.random_trials, late.shape)
    return np.lexsort((-late, is_other), axis=0)[: recipe.restarts] * rewards + np.arange(rewards)


def _first_policies(inner: RunFolder, training: Training, fresh: PyTree) -> PyTree:
    """The states `[trials * rewards, ...]` in which the trials begin: random ones of `fresh`, then clones of plans."""
    recipe = training.target.recipe
    if recipe.random_trials == recipe.trials:
        return fresh
    count = recipe.random_trials * len(training.labels)
    return jax.tree.map(lambda a, b: np.concatenate([a[:count], b]), fresh, planned(inner, training))


def planned(inner: RunFolder, training: Training) -> PyTree:
    """The states `[plans * rewards, ...]` of policies that begin where plans lead.

    They depend on the labels, the rewards and the environment alone, so a run that was killed computes them again.
    """
    target = training.target
    places = target.recipe.trials - target.recipe.random_trials
    planner = _planner(target.env, training.config, places, SEARCH, training.function)
    lanes = training.lanes(planner, PLAN, training.labels)
    state = lanes.init()
    inner.add_seconds(compile_seconds=lanes.compile(state, 1))
    started = time.perf_counter()
    guard = divergence.Guard(inner, "plans", training.labels, target.recipe.on_nan, lanes.take(state))
    state, metrics = lanes.run(state, 1, check=False)
    inner.add_seconds(run_seconds=time.perf_counter() - started)
    planned_state, metrics = guard.checked(0, lanes.take(state), metrics, None)
    write_json(inner.path / PLANS, {"learned_per_step": divergence.all_finite(metrics["score"][:, 0])})
    # From [rewards, plans, ...] to lanes in the order (plan, reward).
    return jax.tree.map(lambda leaf: np.swapaxes(leaf, 0, 1).reshape(-1, *leaf.shape[2:]), planned_state)


class Worth(NamedTuple):
    """What behaviours are worth to a reward in a task: mean reward a step.

    Attributes:
      policies: `[restarts, seeds]` of the policies that were trained on the reward, at the end of training.
      compared: `[seeds]` by name: of uniformly random actions, of the task's demonstrations and, if there are trials,
        of the best plan. They say how well the training did; no policy begins from the demonstrations.
    """

    policies: np.ndarray
    compared: dict[str, np.ndarray]

    @property
    def kept(self) -> np.ndarray:
        """`[seeds]` of the policy that is kept for each seed."""
        return self.policies.max(axis=0)

    @property
    def share(self) -> np.ndarray:
        """`[seeds]` of the kept policy, on a scale from 0 for random actions to 1 for the best known behaviour."""
        return share_of_best(self.kept, self.compared[RANDOM], [self.kept, *self.compared.values()])


def share_of_best(reached: np.ndarray, random: np.ndarray, known: Sequence[np.ndarray]) -> np.ndarray:
    """Rewards `[seeds]` on a scale from 0 for random actions to 1 for the best of the known behaviours.

    Where no behaviour is worth more than random actions, what is worth as much has 1, and everything else 0.
    """
    best = np.max(known, axis=0)
    span = best - random
    return np.where(span > 1e-9, (reached - random) / np.where(span > 1e-9, span, 1.0), reached >= best)


class Score(NamedTuple):
    """What the kept policies reach in the target, without the seeds that were dropped.

    Attributes:
      curves: `[seeds, iterations]` true returns while training.
      returns: `[seeds]` true returns at the end.
      worth: what the policies are worth to the reward that they were trained on.
    """

    curves: np.ndarray
    returns: np.ndarray
    worth: Worth


def score(
    folder: RunFolder,
    title: str,
    target: Target,
    reward: LearnedReward | None,
    seeds: Sequence[int],
    like: LearnedReward | None = None,
) -> Score:
    """Trains `target.recipe.restarts` policies for each seed and keeps the best by the reward it was trained on.

    A policy can settle before a wall that it has to walk around. The learned reward shows which policy did not; the
    true reward has no say.
    """
    training = Training(target, reward, [{"seed": seed} for seed in seeds], RETRAIN, like)
    with compile_thread() as thread:
        if not processes.current():
            _compile_judges(training, thread)
        algorithm, state = retrain(folder, title, training)
    if not (folder.path / WORTH).exists():
        _judge(folder, training, algorithm, state)
    best = take_lanes(state, best_restarts(folder, target.recipe.restarts, len(seeds)))
    returns = scores(folder, target.recipe, target.env, algorithm, best, training.labels)
    kept = divergence.kept_seeds(folder)
    return Score(kept_curves(folder, target, len(seeds))[kept], returns[kept], worth(folder))


def _compile_judges(training: Training, thread: Executor) -> None:
    """Has a thread compile what judges and scores policies, while they are trained."""
    env, labels = training.target.env, training.restarts(training.target.recipe.restarts)
    algorithm = training.algorithm(labels)
    state = training.lanes(algorithm, training.phase, labels).shapes()
    keys = lane_keys(JUDGE, range(len(labels)))
    judge = _judge_program(env, training.config, training.function, algorithm, JUDGED_EPISODES)
    _random_program(env, JUDGED_EPISODES).compile_later(thread, keys[0])
    judge.compile_later(thread, state, training.paid(training.target.recipe.restarts), keys)
    seeds = len(training.labels)
    returns_program(env, algorithm).compile_later(thread, row_shapes(state, seeds), keys[:seeds])


def _judge(folder: RunFolder, training: Training, algorithm: Algorithm, state: PyTree) -> None:
    """Writes what `worth` reads."""
    target, restarts = training.target, training.target.recipe.restarts
    policies = final_rewards(training, algorithm, state, training.labels * restarts)
    compared = {RANDOM: rewards_of(training, random_steps(target.env, JUDGED_EPISODES))}
    if target.demos is not None:
        compared[EXPERT] = rewards_of(training, expert_steps(training))
    if target.recipe.trials > target.recipe.random_trials:
        compared[BEST_PLAN] = np.array(
            read_json(trials_folder(folder).path / PLANS, records.PLANS)["learned_per_step"], np.float64
        )
    for name, values in {"policies": policies.reshape(restarts, -1), **compared}.items():
        _refuse_worthless(folder, training, name, values.reshape(-1, len(training.labels)))
    content = {
        "policies": [divergence.all_finite(values) for values in policies.reshape(restarts, -1)],
        "compared": {name: divergence.all_finite(values) for name, values in compared.items()},
    }
    write_json(folder.path / WORTH, content)


def _refuse_worthless(folder: RunFolder, training: Training, name: str, values: np.ndarray) -> None:
    """Stops, or drops the seeds, where a reward `[behaviours, seeds]` is not finite."""
    for lane in np.flatnonzero(~np.isfinite(values).all(axis=0)):
        label, target = training.labels[lane], training.target
        if any(divergence.matches(each, label) for each in folder.dropped()):
            continue
        wrong = float(values[:, lane][~np.isfinite(values[:, lane])][0])
        dropped = divergence.entry(
            label, divergence.EVALUATION, f"reward of {name}", target.recipe.config.iterations, wrong
        )
        if target.recipe.on_nan == "stop":
            raise Diverged(f"no score: {divergence.explain([dropped])}", name, int(lane), dropped["iteration"], wrong)
        folder.drop([dropped])


def final_rewards(training: Training, algorithm: Algorithm, state: PyTree, labels: list[Lane]) -> np.ndarray:
    """Mean reward a step `[lanes]` of policies `[lanes, ...]`, of the reward that they were trained on.

    Each policy acts for `JUDGED_EPISODES` whole episodes. All policies of one label begin in the same states and draw
    the same noise.
    """
    program = _judge_program(training.target.env, training.config, training.function, algorithm, JUDGED_EPISODES)
    keys = lane_keys(JUDGE, *([label[name] for label in labels] for name in labels[0]))
    lanes = jax.tree.map(jnp.asarray, (state, training.paid(len(labels) // len(training.labels))))
    return np.asarray(program(*lanes, keys))


@functools.lru_cache(KEPT_PROGRAMS)
def _judge_program(env: Task, config: Config, reward: Reward, algorithm: Algorithm, episodes: int) -> Program:
    """The program of `final_rewards`: `(states, Paid, keys) -> [lanes]`."""

    def lane_reward(state, paid, key):
        def act(obs, key):
            return algorithm.act(state, obs, key)

        _, steps = evaluate(key, env, act, episodes, env.episode_length)
        return reward_per_step(lambda batch: reward(paid, batch), horizon.extended(steps, config))

    return Program(jax.vmap(lane_reward))


def rewards_of(training: Training, steps: dict[str, np.ndarray]) -> np.ndarray:
    """Mean reward a step `[rewards]` of the same episodes `[E, T, ...]`, of each reward."""
    seen = horizon.extended(steps, training.config)

    def lane_reward(paid):
        return reward_per_step(lambda batch: training.function(paid, batch), seen)

    return np.asarray(jax.jit(jax.vmap(lane_reward))(jax.tree.map(jnp.asarray, training.paid(1))))


def expert_steps(training: Training) -> dict[str, np.ndarray]:
    """The target's demonstrations as episodes `[E, T, ...]`, with the actions that the reward reads."""
    target = training.target
    assert target.demos is not None
    demos = clip_actions(target.demos, target.env, training.config)
    return demonstrations.to_steps(demos, target.env.episode_length)


@functools.cache
def random_steps(env: Task, episodes: int) -> dict[str, np.ndarray]:
    """Episodes of uniformly random actions, `[E, T, ...]`; played once a process."""
    return jax.tree.map(np.asarray, _random_program(env, episodes)(lane_keys(JUDGE, [RANDOM_SEED])[0]))


@functools.lru_cache(KEPT_PROGRAMS)
def _random_program(env: Task, episodes: int) -> Program:
    return Program(lambda key: evaluate(key, env, random_policy(env), episodes, env.episode_length)[1])


def worth(folder: RunFolder) -> Worth:
    """What the policies of a folder are worth to the reward that they were trained on, without the dropped seeds.

    Raises:
      InputError: if the folder has no such file.
    """
    kept, every = divergence.kept_seeds(folder), _worth(folder)
    return Worth(every.policies[:, kept], {name: values[kept] for name, values in every.compared.items()})


def _worth(folder: RunFolder) -> Worth:
    """What `score` wrote; NaN where a dropped seed has no worth."""
    path = folder.path / WORTH
    if not path.exists():
        raise InputError(
            f"{path} is missing, which says what the policies are worth to their reward: another version made this "
            "run; repeat the command that made the run, with another --out"
        )
    content = read_json(path, records.WORTH, records.AGAIN)
    policies, seeds = content["policies"], len(content["policies"][0])
    if any(len(values) != seeds for values in (*policies, *content["compared"].values())):
        raise InputError(f"{path} holds lists of different lengths, expected {seeds} seeds in each: {records.AGAIN}")
    compared = {name: np.array(values, np.float64) for name, values in content["compared"].items()}
    return Worth(np.array(policies, np.float64), compared)


def best_restarts(folder: RunFolder, restarts: int, seeds: int) -> np.ndarray:
    """Lanes `[seeds]` of the policies that are worth most, at the end, to the reward that they were trained on."""
    if restarts == 1:
        return np.arange(seeds)
    return _worth(folder).policies.argmax(axis=0) * seeds + np.arange(seeds)


def kept_curves(folder: RunFolder, target: Target, seeds: int, metric: str = "true_return") -> np.ndarray:
    """A metric `[seeds, iterations]` of the kept policies while they were trained, from their trials on."""
    recipe, kept = target.recipe, best_restarts(folder, target.recipe.restarts, seeds)
    curves = folder.curve(metric, recipe.restarts * seeds)[kept]
    if not recipe.trials:
        return curves
    inner = trials_folder(folder)
    trials = inner.curve(metric, recipe.trials * seeds)[kept_trials(inner, recipe, seeds).ravel()[kept]]
    return np.concatenate([trials, curves], axis=1)


def last_tenth(curves: np.ndarray) -> np.ndarray:
    """Mean over the last tenth of curves `[lanes, iterations]`."""
    return curves[:, -max(1, curves.shape[1] // 10) :].mean(axis=1)


class Ceiling(NamedTuple):
    """What policies reach that are trained alike on the true reward.

    Attributes:
      returns: true returns of the seeds that were not dropped.
      dropped: entries of the others (`divergence.entry`).
    """

    returns: list[float]
    dropped: list[dict]


def ceiling(target: Target, seeds: Sequence[int], out: Path, like: LearnedReward | None = None) -> Ceiling:
    """Trains on the true reward under the same budget; once in `out`.

    Args:
      like: rewards whose programs are shared, so that nothing is compiled for the ceiling.
    """
    target = target.with_config(horizon="default")
    settings = target.settings() | {"seeds": list(seeds), "reward": "true"}
    folder = RunFolder(out / f"ceiling-{file_name(target.task)}-{settings_digest(settings)}", settings)
    summary = folder.summary(records.CEILING)
    if summary is None:
        returns = score(folder, f"ceiling: true reward in {target.task}", target, None, seeds, like).returns
        summary = {"returns": returns.tolist(), "mean": float(returns.mean()), **folder.seconds()}
        folder.write_summary(summary)
    return Ceiling(summary["returns"], folder.dropped())
