"""Is a learned reward mistaken, or was the training on it not good enough?

A policy that was trained on a learned reward may have a low true return for two reasons. The reward pays more for
something else than for the task: the reward is mistaken. Or the training has not found what the reward pays most for:
it was not optimised. To tell the two apart, other behaviours are judged by the same reward. Policies that begin as the
target's expert are trained on the reward; they show what the reward asks for near the expert. They serve the diagnosis
alone, and are never scored.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from eairl_jax import InputError, evaluate, horizon, load_reward, plans
from eairl_jax.agent import clip_actions
from eairl_jax.envs.names import file_name
from eairl_jax.experiments.pipeline import policies, records, user_networks
from eairl_jax.experiments.pipeline.places import DEMOS, Reference, Target, measured
from eairl_jax.experiments.pipeline.retraining import (
    BEST_PLAN,
    EXPERT,
    JUDGED_EPISODES,
    RANDOM,
    Training,
    expert_steps,
    final_rewards,
    random_steps,
    rewards_of,
    share_of_best,
    worth,
)
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import DIAGNOSE, JUDGE, Start, final_returns, lane_keys, train
from eairl_jax.plans import Search
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.rollout import action_limit
from eairl_jax.storage import check, read_json, write_json
from eairl_jax.types import PyTree

FOUND = 0.98
"""A training has found what a reward pays for if it reaches this share of the best known behaviour's reward."""
BETTER = 0.05
"""A behaviour is better if its true return is higher by this share of the way from random actions to the expert."""
TRAINED, FROM_EXPERT = "trained on the reward", "trained from the expert"
"""The policies that were scored, and policies that began as the target's expert."""
EXPERT_CLONE = Search(updates=2000)
"""How the expert is cloned."""
FILE = "diagnosis.json"
VERDICTS = ("agrees", "mistaken", "not optimised")


class Behaviour(NamedTuple):
    """What a behaviour is worth, `[seeds]` each.

    Attributes:
      learned: mean reward a step by each seed's learned reward.
      true: true returns.
    """

    learned: np.ndarray
    true: np.ndarray


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Behaviours in the target, judged by the learned and by the true reward.

    Attributes:
      behaviours: by name; at least `TRAINED`, `FROM_EXPERT` and `RANDOM`.
      reference: expert's and random actions' true returns.
    """

    behaviours: dict[str, Behaviour]
    reference: Reference

    @property
    def share(self) -> np.ndarray:
        """`[seeds]` learned reward of the trained policy: 0 random actions, 1 the best known behaviour."""
        return self.share_of(TRAINED)

    def share_of(self, name: str) -> np.ndarray:
        """`[seeds]` learned reward of a behaviour: 0 random actions, 1 the best known behaviour."""
        known = [behaviour.learned for behaviour in self.behaviours.values()]
        return share_of_best(self.behaviours[name].learned, self.behaviours[RANDOM].learned, known)

    @property
    def best_true(self) -> np.ndarray:
        """`[seeds]` the highest true return of any of the behaviours."""
        return np.max([behaviour.true for behaviour in self.behaviours.values()], axis=0)

    @property
    def is_optimised(self) -> bool:
        """Whether the trainings found the best known, on average over the seeds."""
        return bool(self.share.mean() >= FOUND)

    @property
    def verdicts(self) -> list[str]:
        """One of `VERDICTS` for each seed.

        "not optimised": another behaviour is worth clearly more to the reward than the trained policy. "mistaken": the
        training found the best known, and a behaviour of a higher true return is worth less. "agrees": else.
        """
        assert self.reference.expert is not None  # `diagnose` refuses a target without an expert
        margin = BETTER * (self.reference.expert - self.reference.random)
        is_worse = self.best_true > self.behaviours[TRAINED].true + margin
        return [
            "not optimised" if share < FOUND else "mistaken" if worse else "agrees"
            for share, worse in zip(self.share, is_worse, strict=True)
        ]

    def to_json(self) -> dict:
        """All figures, and what follows from them."""
        behaviours = {
            name: {"learned": behaviour.learned.tolist(), "true": behaviour.true.tolist()}
            for name, behaviour in self.behaviours.items()
        }
        derived = {"share": self.share.tolist(), "verdicts": self.verdicts}
        return {"behaviours": behaviours, **self.reference._asdict(), **derived}

    @classmethod
    def from_json(cls, content: Any, where: Path | str = "the diagnosis") -> Diagnosis:
        """Reads what `to_json` gave.

        Args:
          where: what to call the content in an error message.

        Raises:
          InputError: if it is damaged.
        """
        content = check(content, records.diagnosis(TRAINED, FROM_EXPERT, RANDOM), where, "repeat `eairl diagnose`")
        behaviours = {
            name: Behaviour(np.array(each["learned"]), np.array(each["true"]))
            for name, each in content["behaviours"].items()
        }
        return cls(behaviours, Reference(content["expert"], content["random"]))


class Played(NamedTuple):
    """Episodes of the policies of a finished run, to be judged by any reward.

    Attributes:
      name: of the run's folder.
      task: in which the policies acted.
      steps: `[lanes, E, T, ...]`, as `evaluate` returns them.
      returns: `[lanes]` mean true returns.
    """

    name: str
    task: str
    steps: dict[str, np.ndarray]
    returns: np.ndarray


def played(path: Path) -> Played:
    """Plays the policies of a finished run.

    Raises:
      InputError: if the folder holds no finished run.
    """
    trained = policies.load(path)
    env, algorithm = trained.env, trained.algorithm

    @jax.jit
    @jax.vmap
    def play(key, state):
        def act(obs, key):
            return algorithm.act(state, obs, key)

        returns, steps = evaluate(key, env, act, JUDGED_EPISODES, env.episode_length)
        return steps, returns.mean()

    lanes = lane_keys(JUDGE, trained.seeds), jax.tree.map(jnp.asarray, trained.state)
    return Played(path.name, trained.task, *jax.tree.map(np.asarray, play(*lanes)))


def diagnose(path: Path, target: Target, others: Sequence[Played] = (), out: Path | None = None) -> Diagnosis:
    """Judges behaviours by the rewards of a finished transfer, and writes `FILE`.

    Args:
      path: the folder of the transfer.
      target: where and how its policies were trained.
      others: other finished runs in the same target, whose policies are judged too.
      out: the folder to write into; by default, that of the transfer.

    Raises:
      InputError: if the folder holds no finished transfer, if the target has no demonstrations, or if the policies of
        another run act in another task.
    """
    if not (path / "reward").is_dir():
        raise InputError(f"{path} holds no reward/: give the folder of a finished `eairl transfer`")
    demos, expert_return = target.demos, target.reference.expert
    if demos is None or demos.action is None or expert_return is None:
        raise InputError(
            f"{target.task} has no expert to compare with: put demonstrations with actions and rewards at "
            f"{DEMOS / file_name(target.task)}.npz (`eairl demos` writes them)"
        )
    for other in others:
        if other.task != target.task:
            raise InputError(
                f"{other.name}: its policies act in {other.task}, not in {target.task}: give runs of one task"
            )
    target, out = measured(target), out or path
    trained = policies.load(path)
    user_networks.register(trained.settings.get("config", {}).get("net"))
    reward = load_reward(path / "reward")
    labels = [{"seed": seed} for seed in trained.seeds]
    training = Training(target, reward, labels, DIAGNOSE)
    scored = read_json(path / "summary.json", records.CEILING, records.AGAIN)["returns"]
    random = random_steps(target.env, JUDGED_EPISODES)
    behaviours = {
        TRAINED: Behaviour(worth(RunFolder(path, trained.settings)).kept, np.array(scored)),
        FROM_EXPERT: _from_expert(RunFolder(out / "from_expert", {"part": "from the expert"}), training),
        EXPERT: _of_steps(training, expert_steps(training), expert_return),
        BEST_PLAN: _best_plan(training),
        **{f"policies of {other.name}": _of_policies(training, other) for other in others},
        RANDOM: _of_steps(training, random, target.reference.random),
    }
    diagnosis = Diagnosis(behaviours, target.reference)
    write_json(out / FILE, diagnosis.to_json())
    return diagnosis


def _of_steps(training: Training, steps: dict[str, np.ndarray], true: float) -> Behaviour:
    """The same episodes by every reward; `true` is their true return."""
    return Behaviour(rewards_of(training, steps), np.full(len(training.labels), true))


def _from_expert(folder: RunFolder, training: Training) -> Behaviour:
    """Policies that begin as clones of the target's expert, one for each reward, trained on for a whole training."""
    target = training.target
    recipe = dataclasses.replace(target.recipe, restarts=1, trials=0, trial_iterations=0, random_trials=0)
    alone = dataclasses.replace(training, target=dataclasses.replace(target, recipe=recipe))
    labels = training.labels
    algorithm = alone.algorithm(labels)
    lanes = alone.lanes(algorithm, DIAGNOSE, labels)
    start = Start(0, lambda: _clones(alone, lanes.take(lanes.init())))
    title = f"diagnosis: training from the expert in {target.task}"
    state = train(folder, title, lanes, recipe, labels, start=start)
    learned = final_rewards(alone, algorithm, state, labels)
    seeds = [label["seed"] for label in labels]
    return Behaviour(learned, final_returns(target.env, algorithm, state, seeds).mean(axis=1))


def _clones(training: Training, fresh: PyTree) -> PyTree:
    """The states `[seeds, ...]` with policies that act as the target's demonstrations; only their means differ."""
    target, config = training.target, training.config
    assert target.demos is not None
    env = horizon.learning_env(target.env, config)
    optimizer, demos = make_optimizer(env, config), clip_actions(target.demos, target.env, config)
    obs = horizon.living(jnp.asarray(demos.obs), env.observation_size)
    samples = obs[None], jnp.asarray(demos.action)[None], jnp.ones((1, len(obs)))

    @jax.jit
    @jax.vmap
    def clone(key, state):
        cloned = plans.fit(key, optimizer, state.agent, samples, EXPERT_CLONE)
        return dataclasses.replace(state, agent=cloned)

    keys = lane_keys(DIAGNOSE, [label["seed"] for label in training.labels], [1] * len(training.labels))
    return jax.tree.map(np.asarray, clone(keys, jax.tree.map(jnp.asarray, fresh)))


def _best_plan(training: Training) -> Behaviour:
    """For each reward the plan that it pays most for, of the same random plans."""
    env, count = horizon.learning_env(training.target.env, training.config, whole=True), JUDGED_EPISODES * 16
    length = training.target.env.episode_length

    @jax.jit
    def judge(key, every):
        draw_key, simulate_key = jax.random.split(key)
        drawn = plans.draw(draw_key, count, length, env.action_size, action_limit(env))
        raw = plans.simulate(simulate_key, env, drawn)
        true = (raw.reward * (1.0 - raw.truncated)).sum(axis=0)
        paid = jax.vmap(lambda each: plans.scores(lambda batch: training.function(each, batch), raw))(every)
        return paid.max(axis=1), true[paid.argmax(axis=1)]

    every = jax.tree.map(jnp.asarray, training.paid(1))
    return Behaviour(*map(np.asarray, judge(lane_keys(JUDGE, [DIAGNOSE])[0], every)))


def _of_policies(training: Training, other: Played) -> Behaviour:
    """For each reward the policy of another run that is worth most to it."""
    learned = np.stack(
        [
            rewards_of(training, jax.tree.map(lambda leaf, i=lane: leaf[i], other.steps))
            for lane in range(len(other.returns))
        ]
    )
    return Behaviour(learned.max(axis=0), other.returns[learned.argmax(axis=0)])
