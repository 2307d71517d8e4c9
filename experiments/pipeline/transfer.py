"""`eairl transfer`: learn a reward in one task, train a fresh policy on it alone in another, score it truly."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eairl_jax import InputError, LearnedReward, load_reward, save_reward, storage
from eairl_jax.experiments.display.plots import Curve, Row, plot, print_table, summarize
from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.pipeline import learn as imitate
from eairl_jax.experiments.pipeline.learn import Job
from eairl_jax.experiments.pipeline.retrain import Target, as_target, ceiling, score, target_settings
from eairl_jax.experiments.pipeline.run_folder import RunFolder, digest
from eairl_jax.experiments.pipeline.select import Rule, choose_reward
from eairl_jax.experiments.pipeline.train import RUNS, final_returns, say
from eairl_jax.experiments.recipes import make_env
from eairl_jax.methods import METHODS, with_method_defaults


def transfer(job: Job, rule: Rule, source: Target, target: Target, out: Path, command: str) -> dict:
    """Runs one row from demonstrations to score, or goes on with it; returns the summary that it leaves.

    The reward is learned in a folder of its own, so that rows which differ in their rule or target share it.
    """
    learning, folder = learning_of(job, out), folder_of(job, rule, target, out)
    summary = folder.summary()
    if summary is None:
        learned = learn(learning, job)
        published = job.is_published and not target.variant
        more = {"row": row_of(job, target), "is_published": published, "rule": str(rule)} | learned
        if rule.kind == "policy":
            summary = move_policy(folder, learning, job, target, command, more)
        else:
            reward, seen = choose_reward(folder, learning, job, rule, source)
            save_reward(folder.path / "reward", reward)
            curves = imitate.imitation_curves(learning, job)[:3]
            more |= seen
            summary = reuse(folder, reward, target, job.seeds, command, more["row"], curves, learning.seconds(), more)
    say(f"{row_of(job, target)}, {rule}: in {folder.path}/; the reward was learned in {learning.path}/")
    imitate.warn_if_saturated(learning, job)
    return summary


def learning_of(job: Job, out: Path) -> RunFolder:
    """Where a job's reward is learned."""
    return RunFolder(learning_path(out, job.task, job.row, job.settings()), job.settings())


def folder_of(job: Job, rule: Rule, target: Target, out: Path) -> RunFolder:
    """Where a reward is put to use."""
    settings = job.settings() | target_settings(target) | {"rule": dataclasses.asdict(rule)}
    return RunFolder(use_path(out, job.task, target.task, row_of(job, target), str(rule)), settings)


def row_of(job: Job, target: Target) -> str:
    """The name of the row: the job's, and how retraining differs from the recipe."""
    return f"{job.row}+{target.variant}" if target.variant else job.row


def learning_path(out: Path, task: str, row: str, settings: dict) -> Path:
    """The folder in `out` where a row's reward is learned; `settings` are its job's."""
    return out / f"learn-{task}-{row}-{digest(settings)}"


def use_path(out: Path, task: str, target: str, row: str, rule: str) -> Path:
    """The folder in `out` where a row's reward is put to use."""
    return out / f"transfer-{task}-to-{target}-{row}-{rule}"


def learn(folder: RunFolder, job: Job) -> dict:
    """Learns the rewards that rows share, once; returns how well their policies imitate in the source."""
    summary = folder.summary()
    if summary is None:
        algorithm, state = imitate.learn(folder, job)
        returns = final_returns(job.env, algorithm, state, job.seeds).mean(axis=1)
        summary = {"imitation_returns": returns.tolist()}
        folder.write_summary(summary)
    return summary


def move_policy(folder: RunFolder, learning: RunFolder, job: Job, target: Target, command: str, more: dict) -> dict:
    """Scores the policy that imitates in the source as it is in the target, and finishes the folder."""
    algorithm, state = imitate.learn(learning, job)
    returns = final_returns(target.env, algorithm, state, job.seeds).mean(axis=1)
    best = ceiling(target, job.seeds, folder.path.parent)
    more |= {"ceiling": best.tolist(), "chosen_iterations": []}
    summary = summarize(command, job.task, target.task, job.recipe.config.method, job.seeds, returns, 0,
                        learning.seconds(), target.reference, **more)  # fmt: skip
    folder.write_summary(summary)
    return summary


def _sum(*seconds: dict[str, float]) -> dict[str, float]:
    return {name: sum(part.get(name, 0.0) for part in seconds) for name in ("compile_seconds", "run_seconds")}


def reuse(folder: RunFolder, reward: LearnedReward, target: Target, seeds: Sequence[int], command: str, row: str,
          curves: list[Curve], seconds: dict, more: dict[str, Any]) -> dict:  # fmt: skip
    """Trains fresh policies on a learned reward in the target task and finishes the folder with their score."""
    returned, returns = score(folder, f"{row} in {target.task}", target, reward, seeds)
    best = ceiling(target, seeds, folder.path.parent)
    config = target.recipe.config
    summary = summarize(command, reward.description["task"], target.task, reward.config.method, seeds, returns,
                        config.env_steps, _sum(seconds, folder.seconds()),
                        target.reference, ceiling=best.tolist(), **more)  # fmt: skip
    title = f"true return in {target.task}, trained on the learned reward"
    level = ("ceiling: true reward", float(best.mean()))
    panel = Curve(title, "", returned, config.steps_per_iteration, level)
    curves = [dataclasses.replace(c, panel=f"{c.panel} while learning") for c in curves]
    plot(folder.path / "curves.png", f"{row}: {reward.description['task']} to {target.task}", [*curves, panel])
    folder.write_summary(summary)
    return summary


def command(source: str, target: str, methods: tuple[str, ...], forms: tuple[str, ...], seeds: range,
            rules: tuple[str, ...], demos: Path | None, reward: Path | None, out: Path | None,
            assignments: tuple[str, ...], retrain_assignments: tuple[str, ...], restarts: int | None, line: str,
            tuned: bool = False) -> None:  # fmt: skip
    """Runs every row of `eairl transfer` and prints one table."""
    source_env, target_env = make_env(source), make_env(target)
    if (source_env.observation_size, source_env.action_size) != (target_env.observation_size, target_env.action_size):
        raise InputError(
            f"a reward of {source} (observations of {source_env.observation_size}, actions of "
            f"{source_env.action_size}) does not fit {target} ({target_env.observation_size} and "
            f"{target_env.action_size}): choose tasks of the same sizes"
        )
    put_to_use = as_target(target, target_env, retrain_assignments, restarts)
    if reward is not None:
        learned = load_reward(reward, target_env.observation_size, target_env.action_size)
        if learned.description["task"] != source:
            raise InputError(f"{reward} was learned in {learned.description['task']}, not in {source}: name that task")
        summaries = [from_artefact(learned, reward, put_to_use, out, line)]
    else:
        jobs = imitate.prepare(source, methods, forms, seeds, demos, "reward", assignments, tuned)
        for job in jobs:
            if not job.has_reward:
                raise InputError(f"{job.row} learns no reward to transfer: choose one of {', '.join(METHODS)}")
        back_home = as_target(source, source_env, retrain_assignments)
        pairs = [(job, Rule.parse(rule, job.recipe, back_home.recipe)) for job in jobs for rule in rules]
        summaries = [transfer(job, rule, back_home, put_to_use, out or RUNS, line) for job, rule in pairs]
    known, best = put_to_use.reference, np.array(summaries[0]["ceiling"])
    rows = [
        Row("expert", np.array([known.expert]), paper.row(paper.TRANSFER, target, "expert"), 1.0),
        Row("ceiling", best, None, known.normalized(best.mean()), "the true reward, retrained under the same budget"),
    ]
    for summary in summaries:
        published = paper.row(paper.TRANSFER, target, summary["method"]) if summary["is_published"] else None
        taken = " ".join(map(str, summary["chosen_iterations"]))
        note = f"rule {summary['rule']}" + (f", reward of iteration {taken}" if taken else "")
        name = summary["row"] if len(rules) == 1 else f"{summary['row']}, {summary['rule']}"
        rows.append(Row(name, np.array(summary["returns"]), published, summary["normalized"], note))
    rows.append(Row("random actions", np.array([known.random]), None, 0.0))
    count = len(best)
    print_table(f"Reward learned in {source}, used in {target}: true return, {count} seeds", rows)
    compiled, ran = (sum(s[f"{name}_seconds"] for s in summaries) for name in ("compile", "run"))
    peak = max(summary["peak_memory_gb"] for summary in summaries)
    tries = put_to_use.recipe.restarts
    if tries > 1:
        say(f"every score is the best of {tries} policies by the reward that they were trained on")
    say(f"compiled {compiled:.0f} s, ran {ran:.0f} s, peak memory {peak:.1f} GB")


def from_artefact(reward: LearnedReward, path: Path, target: Target, out: Path | None, line: str) -> dict:
    """`--reward DIR`: puts a saved reward to use, a policy for each of its seeds."""
    row, seeds = (
        f"{reward.config.method}-{with_method_defaults(reward.config).reward_form}",
        reward.description["seeds"],
    )
    where = (out or RUNS) / f"reuse-{path.resolve().parent.name}-in-{target.task}"
    # What it is, not where: another reward at the same place is another run.
    folder = RunFolder(where, target_settings(target) | {"reward": storage.fingerprint(reward.params), "seeds": seeds})
    summary = folder.summary()
    if summary is None:
        taken = reward.description.get("iterations", [])  # of one that was saved by hand, nobody knows
        more = {"row": row, "is_published": False, "rule": "as saved", "chosen_iterations": taken}
        summary = reuse(folder, reward, target, seeds, line, row, [], {}, more)
    return summary
