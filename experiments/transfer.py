"""`eairl transfer`: learn a reward in one task, train a fresh policy on it alone in another, score it truly."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from eairl_jax import Algorithm, InputError, Lanes, LearnedReward, load_reward, make_rl, reward_function, save_reward
from eairl_jax.types import PyTree
from envs.mjx_task import MjxTask
from experiments import imitate, paper
from experiments.folder import Folder
from experiments.imitate import Job
from experiments.reference import Reference, reference, shipped
from experiments.settings import Recipe, make_env, parse_overrides, recipe
from experiments.summary import Curve, Row, plot, print_table, summarize
from experiments.training import default_out, final_returns, say, seed_keys, train

SOURCE_RETRAIN_ITERATIONS = 50

# Each phase of an experiment draws its own random numbers.
RETRAIN_KEY, SOURCE_RETRAIN_KEY = 1, 2


@dataclass(frozen=True)
class Target:
    """The task in which rewards are put to use, and how policies are trained there."""

    task: str
    env: MjxTask
    recipe: Recipe
    reference: Reference
    restarts: int = 1
    """Policies trained for each score; the one that the reward itself rates best is kept."""


@dataclass(frozen=True)
class Rule:
    """Which iteration's reward is taken. It never looks at the target task.

    Attributes:
      kind: "last", "iteration" or "source_retrain".
      iteration: for "iteration", which one.
      repeats: for "source_retrain", policies trained on each snapshot.
      iterations: for "source_retrain", the length of each training.
    """

    kind: str
    iteration: int = 0
    repeats: int = 2
    iterations: int = 0

    @staticmethod
    def parse(text: str, job_recipe: Recipe) -> Rule:
        """Reads `last`, `source_retrain` or `iteration=N`.

        Raises:
          InputError: for anything else, or an N of which no snapshot is kept.
        """
        if text in ("last", "source_retrain"):
            return Rule(text, iterations=SOURCE_RETRAIN_ITERATIONS if text == "source_retrain" else 0)
        name, _, number = text.partition("=")
        kept = snapshots_of(job_recipe)
        if name != "iteration" or not number.isdigit():
            raise InputError(
                f"unknown rule {text!r}: choose last, source_retrain or iteration=N, e.g. iteration={kept[-1]}"
            )
        if int(number) not in kept:
            raise InputError(f"no snapshot of iteration {number} is kept; there are {', '.join(map(str, kept))}")
        return Rule("iteration", int(number))


def snapshots_of(job_recipe: Recipe) -> list[int]:
    """The iterations of which a snapshot is kept."""
    return list(range(job_recipe.snapshot_every, job_recipe.config.iterations + 1, job_recipe.snapshot_every))


def retrain(
    folder: Folder,
    title: str,
    target: Target,
    reward: LearnedReward | None,
    params: PyTree,
    labels: list[dict],
    key: int,
) -> tuple[Algorithm, PyTree]:
    """Trains a fresh policy a lane in the target task, on learned rewards `[lanes, ...]` or, if None, on the true one.

    Returns:
      The algorithm and the final states `[lanes, ...]`; the curves are in the folder's metrics.
    """
    if reward is None:
        algorithm = make_rl(target.env, target.recipe.config)
    else:
        function = reward_function(reward.config)
        algorithm = make_rl(target.env, target.recipe.config, lambda params, tau: function(params, tau.obs, tau.action))
    keys, learned = seed_keys(len(labels), key), reward is not None
    lanes = Lanes(algorithm, keys, target.recipe.hparams, params, data_per_lane=learned)
    return algorithm, train(folder, title, lanes, target.recipe, labels)


def score(
    folder: Folder, title: str, target: Target, reward: LearnedReward | None, seeds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Trains `target.restarts` policies for each seed and keeps the best *by the reward it was trained on*.

    A policy can settle before a wall that it has to walk around. Which of several did not is visible in the learned
    reward; the true reward has no say.

    Returns:
      `(curves [seeds, iterations] of true returns, final true returns [seeds])` of the kept policies.
    """
    labels = [{"restart": restart, "seed": seed} for restart in range(target.restarts) for seed in range(seeds)]
    params = jax.tree.map(lambda leaf: np.concatenate([leaf] * target.restarts), reward.params) if reward else ()
    algorithm, state = retrain(folder, title, target, reward, params, labels, RETRAIN_KEY)
    by_reward = tail(folder.curve("policy_reward", len(labels))).reshape(target.restarts, seeds)
    kept = by_reward.argmax(axis=0) * seeds + np.arange(seeds)
    returns = final_returns(target.env, algorithm, imitate.take_rows(state, kept)).mean(axis=1)
    return folder.curve("true_return", len(labels))[kept], returns


def tail(curves: np.ndarray) -> np.ndarray:
    """Mean of the last tenth of curves `[lanes, iterations]`."""
    return curves[:, -max(1, curves.shape[1] // 10) :].mean(axis=1)


def choose_reward(folder: Folder, job: Job, rule: Rule, source: Target) -> tuple[LearnedReward, dict[str, Any]]:
    """Takes each seed's reward by the rule; also says what the rule saw."""
    kept = snapshots_of(job.recipe)
    if rule.kind != "source_retrain":
        iteration = kept[-1] if rule.kind == "last" else rule.iteration
        return load_reward(imitate.snapshot_path(folder, iteration)), {"chosen_iterations": [iteration] * job.seeds}
    rewards = [load_reward(imitate.snapshot_path(folder, iteration)) for iteration in kept]
    # Lanes in the order (repeat, snapshot, seed).
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves * rule.repeats), *(r.params for r in rewards))
    labels = [{"repeat": repeat, "snapshot": iteration, "seed": seed}
              for repeat in range(rule.repeats) for iteration in kept for seed in range(job.seeds)]  # fmt: skip
    config = dataclasses.replace(source.recipe.config, iterations=rule.iterations)
    short = dataclasses.replace(
        source, recipe=dataclasses.replace(source.recipe, config=config, snapshot_every=rule.iterations // 2)
    )
    inner = Folder(folder.path / "source_retrain", {"rule": dataclasses.asdict(rule)})
    title = f"{job.row}: retraining on {len(kept)} snapshots in {job.task}"
    retrain(inner, title, short, rewards[0], params, labels, SOURCE_RETRAIN_KEY)
    last = tail(inner.curve("true_return", len(labels)))
    scores = last.reshape(rule.repeats, len(kept), job.seeds).mean(axis=0)
    best = scores.argmax(axis=0)
    rows = [jax.tree.map(lambda leaf, seed=seed: leaf[seed], rewards[best[seed]].params) for seed in range(job.seeds)]
    chosen = [kept[b] for b in best]
    reward = imitate.describe(job, jax.tree.map(lambda *leaves: np.stack(leaves), *rows), chosen)
    seen = {"chosen_iterations": chosen, "snapshots": kept, "source_returns": scores.round(3).tolist()}
    return reward, seen


def ceiling(target: Target, seeds: int, out: Path) -> np.ndarray:
    """True returns `[seeds]` of policies trained on the true reward under the very same budget; trained once."""
    settings = target_settings(target) | {"seeds": seeds, "reward": "true"}
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True, default=str).encode()).hexdigest()[:6]
    folder = Folder(out / f"ceiling-{target.task}-{digest}", settings)
    summary = folder.summary()
    if summary is None:
        _, returns = score(folder, f"ceiling: true reward in {target.task}", target, None, seeds)
        summary = {"returns": returns.tolist(), "mean": float(returns.mean()), **folder.seconds()}
        folder.finish(summary)
    return np.array(summary["returns"])


def target_settings(target: Target) -> dict:
    """What decides how policies are trained in the target task."""
    own = target.recipe
    return {
        "target": target.task,
        "retrain_config": dataclasses.asdict(own.config),
        "retrain_hparams": dataclasses.asdict(own.hparams),
        "retrain_snapshot_every": own.snapshot_every,
        "restarts": target.restarts,
    }


def transfer(job: Job, rule: Rule, source: Target, target: Target, out: Path, command: str) -> dict:
    """Runs one row from demonstrations to score, or goes on with it; returns the summary that it leaves."""
    folder = Folder(out, job.settings() | target_settings(target) | {"rule": dataclasses.asdict(rule)})
    summary = folder.summary()
    if summary is None:
        learning = Folder(folder.path / "imitate", job.settings())
        algorithm, state = imitate.learn(learning, job)
        imitation = final_returns(job.env, algorithm, state).mean(axis=1)
        reward, seen = choose_reward(learning, job, rule, source)
        save_reward(folder.path / "reward", reward)
        reused = imitate.imitation_curves(learning, job)[:3]
        more = {"row": job.row, "rule": rule.kind, "imitation_returns": imitation.tolist()} | seen
        summary = reuse(folder, reward, target, job.seeds, command, job.row, reused, out.parent, more)
    say(f"{job.row}: {folder.path}/ holds config, metrics, checkpoints, reward, curves, summary")
    return summary


def reuse(folder: Folder, reward: LearnedReward, target: Target, seeds: int, command: str, row: str,
          curves: list[Curve], ceilings: Path, more: dict[str, Any]) -> dict:  # fmt: skip
    """Trains fresh policies on a learned reward in the target task and finishes the folder with their score."""
    returned, returns = score(folder, f"{row} in {target.task}", target, reward, seeds)
    best = ceiling(target, seeds, ceilings)
    config = target.recipe.config
    summary = summarize(command, reward.description["task"], target.task, reward.description["method"], returns,
                        config.iterations * config.steps_per_iteration, folder.seconds(), target.reference,
                        ceiling=best.tolist(), **more)  # fmt: skip
    panel = Curve(f"true return in {target.task}, on the learned reward", "", returned, config.steps_per_iteration,
                  ("ceiling: true reward", float(best.mean())))  # fmt: skip
    curves = [dataclasses.replace(c, panel=f"{c.panel} while learning") for c in curves]
    plot(folder.path / "curves.png", f"{row}: {reward.description['task']} to {target.task}", [*curves, panel])
    folder.finish(summary)
    return summary


def command(source: str, target: str, methods: tuple[str, ...], forms: tuple[str, ...], seeds: int, rule: str,
            demos: Path | None, reward: Path | None, out: Path | None, assignments: tuple[str, ...],
            retrain_assignments: tuple[str, ...], restarts: int, line: str) -> None:  # fmt: skip
    """Runs every row of `eairl transfer` and prints one table."""
    source_env, target_env = make_env(source), make_env(target)
    if restarts < 1:
        raise InputError(f"--restarts {restarts}: expected at least 1")
    if (source_env.observation_size, source_env.action_size) != (target_env.observation_size, target_env.action_size):
        raise InputError(
            f"a reward of {source} (observations of {source_env.observation_size}, actions of "
            f"{source_env.action_size}) does not fit {target} ({target_env.observation_size} and "
            f"{target_env.action_size}): choose tasks of the same sizes"
        )
    put_to_use = as_target(target, target_env, retrain_assignments, restarts)
    if reward is not None:
        learned = load_reward(reward, target_env.observation_size, target_env.action_size)
        summaries = [from_artefact(learned, reward, put_to_use, out, line)]
    else:
        jobs = imitate.prepare(source, methods, forms, seeds, demos, "reward", assignments)
        rules = [Rule.parse(rule, job.recipe) for job in jobs]
        back_home = as_target(source, source_env, retrain_assignments)
        summaries = []
        for job, its_rule in zip(jobs, rules, strict=True):
            where = imitate.row_out(out, f"transfer-{source}-to-{target}-{job.row}", job.row, len(jobs))
            summaries.append(transfer(job, its_rule, back_home, put_to_use, where, line))
    known, best = put_to_use.reference, np.array(summaries[0]["ceiling"])
    rows = [
        Row("expert", np.array([known.expert]), paper.row(paper.TRANSFER, target, "expert"), 1.0),
        Row("ceiling", best, None, known.normalized(best.mean()), "the true reward, retrained under the same budget"),
    ]
    for summary in summaries:
        published = paper.row(paper.TRANSFER, target, summary["method"]) if is_published(summary["row"]) else None
        note = f"reward of iteration {' '.join(map(str, summary['chosen_iterations']))}"
        rows.append(Row(summary["row"], np.array(summary["returns"]), published, summary["normalized"], note))
    rows.append(Row("random actions", np.array([known.random]), None, 0.0))
    count = len(best)
    print_table(f"Reward learned in {source}, used in {target}: true return, {count} seeds", rows)
    compiled, ran = (sum(s[f"{name}_seconds"] for s in summaries) for name in ("compile", "run"))
    peak = max(summary["peak_memory_gb"] for summary in summaries)
    say(
        f"rule: {summaries[0]['rule']} (looks at the source task only); {restarts} restarts, the best by the learned reward"
    )
    say(f"compiled {compiled:.0f} s, ran {ran:.0f} s, peak memory {peak:.1f} GB")


def is_published(row: str) -> bool:
    """Whether a row is one of the paper's own, reward form included."""
    return row in ("eairl-sa", "airl_sa-sa", "airl_s-s", "gail-sa")


def as_target(task: str, env: MjxTask, assignments: tuple[str, ...], restarts: int = 1) -> Target:
    """A task with its retraining recipe and its reference returns (of the demonstrations we ship)."""
    from eairl_jax import demonstrations

    path = shipped(task)
    known = reference(task, env, path, demonstrations.load(path, task))
    return Target(task, env, recipe(task, env, "retrain", parse_overrides(assignments)), known, restarts)


def from_artefact(reward: LearnedReward, path: Path, target: Target, out: Path | None, line: str) -> dict:
    """`--reward DIR`: puts a saved reward to use, a policy for each of its seeds."""
    description = reward.description
    row, seeds = f"{description['method']}-{description['reward_form']}", len(description["seeds"])
    where = out or default_out(f"reuse-{path.resolve().parent.name}-in-{target.task}")
    folder = Folder(where, target_settings(target) | {"reward": str(path), "seeds": seeds})
    summary = folder.summary()
    if summary is None:
        more = {"row": row, "rule": "as saved", "chosen_iterations": description["iterations"]}
        summary = reuse(folder, reward, target, seeds, line, row, [], folder.path.parent, more)
    return summary
