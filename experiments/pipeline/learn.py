"""`eairl imitate`: learn a policy, and with it a reward, from demonstrations of one task."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from eairl_jax import (
    Algorithm,
    Config,
    Demonstrations,
    InputError,
    Lanes,
    LearnedReward,
    demonstrations,
    learned_reward,
    load_reward,
    save_reward,
)
from eairl_jax.config import choose
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.display.plots import Curve, Row, plot, print_table, summarize
from eairl_jax.experiments.paper import published as paper
from eairl_jax.experiments.pipeline import algorithms
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.scores import Reference, reference, shipped
from eairl_jax.experiments.pipeline.train import LEARN, console, default_out, final_returns, lane_keys, say, train
from eairl_jax.experiments.recipes import Recipe, make_env, parse_overrides, recipe
from eairl_jax.methods import METHODS, names, with_method_defaults
from eairl_jax.types import PyTree

SATURATED_ACCURACY = 0.99


# How much is done, and by which optimiser: a method that is given more or less is still the paper's.
BUDGET = frozenset({"iterations", "snapshot_every", "num_envs", "rollout_length", "optimizer"})


@dataclass(frozen=True)
class Job:
    """One method with one reward form on one task, checked and ready to train."""

    task: str
    env: MjxTask
    recipe: Recipe
    demos: Demonstrations
    demos_path: Path
    reference: Reference
    seeds: range
    variant: str = ""
    """Tells the row from one of the same method and form with other settings."""
    is_changed: bool = False
    """Whether anything of the method was set, `BUDGET` apart."""

    @property
    def row(self) -> str:
        """The row's name: "eairl-separable", "eairl-sa+lambda_i=0"; of a method without a reward the method's."""
        method = self.recipe.config.method
        row = f"{method}-{with_method_defaults(self.recipe.config).reward_form}" if self.has_reward else method
        return f"{row}+{self.variant}" if self.variant else row

    @property
    def has_reward(self) -> bool:
        """Whether the method learns one."""
        return self.recipe.config.method in METHODS

    @property
    def is_published(self) -> bool:
        """Whether the row is the method as the paper has it: its own settings and reward form."""
        row = METHODS.get(self.recipe.config.method)
        own_form = row is None or with_method_defaults(self.recipe.config).reward_form == row.reward_form
        return own_form and not self.variant and not self.is_changed

    def settings(self) -> dict:
        """What makes this run this run."""
        return {
            "task": self.task,
            # What they are, not where: a folder goes on after the project has moved, never on other episodes.
            "demonstrations": f"{self.demos_path.name} {demonstrations.fingerprint(self.demos)}",
            "seeds": list(self.seeds),
            "config": dataclasses.asdict(self.recipe.config),
            "hparams": dataclasses.asdict(self.recipe.hparams),
            "snapshot_every": self.recipe.snapshot_every,
        }


def prepare(task: str, methods: tuple[str, ...], forms: tuple[str, ...], seeds: range, demos: Path | None,
            purpose: str, assignments: tuple[str, ...], tuned: bool = False) -> list[Job]:  # fmt: skip
    """Checks everything that a command was given and returns a job for each method and reward form.

    Args:
      tuned: with our settings, which `variant` then says.

    Raises:
      InputError: for anything that could not be trained.
    """
    if not seeds or min(seeds) < 0:
        raise InputError(f"--seeds {len(seeds)} --first-seed {seeds.start}: expected at least 1 seed, none negative")
    env, overrides = make_env(task), parse_overrides(assignments)
    for method in methods:
        choose("method", method, names())
    path = demos or shipped(task)
    data = demonstrations.load(path, task, env.observation_size, env.action_size)
    known = reference(task, env, path, data)
    recipes = [recipe(task, env, purpose, {"method": method, "reward_form": form} | overrides, tuned)
               for method in methods for form in (forms if method in METHODS else ("default",))]  # fmt: skip
    algorithms.refuse_meaningless([own.config for own in recipes], set(overrides))
    for own in recipes:
        algorithms.check(own.config, data)
    variant, changed = "tuned" if tuned else "", bool(set(overrides) - BUDGET)
    jobs = [Job(task, env, own, data, path, known, seeds, variant, changed) for own in recipes]
    return list({job.row: job for job in jobs}.values())


def learn(folder: RunFolder, job: Job, points: list[dict[str, float]] | None = None) -> tuple[Algorithm, PyTree]:
    """Trains a job in a folder, keeping a snapshot of every seed's reward in `snapshots/` (not of a sweep's).

    Args:
      points: of a sweep, floats of `HParams` that replace the recipe's; each is trained with every seed.

    Returns:
      The algorithm and the final state `[points * seeds, ...]`, the seeds of one point beside each other.
    """
    points = points or [{}]
    labels = [{"seed": seed} | point for point in points for seed in job.seeds]
    swept = {name: np.array([label[name] for label in labels], np.float32) for name in points[0]}
    algorithm, lanes = _lanes(job, [label["seed"] for label in labels], swept)

    def keep(iteration: int, state: PyTree) -> None:
        save_reward(snapshot_path(folder, iteration), describe(job, learned_reward(state), [iteration] * len(labels)))

    title, kept = f"{job.row} in {job.task}", keep if job.has_reward and len(points) == 1 else None
    return algorithm, train(folder, title, lanes, job.recipe, labels, kept)


def untrained(job: Job) -> PyTree:
    """The rewards `[seeds, ...]` before the first iteration: networks at random."""
    _, lanes = _lanes(job, job.seeds, {})
    return learned_reward(lanes.take(lanes.init()))


def _lanes(job: Job, seeds: Sequence[int], swept: dict[str, np.ndarray]) -> tuple[Algorithm, Lanes]:
    algorithm = algorithms.make(job.env, job.recipe.config)
    hparams = dataclasses.replace(job.recipe.hparams, **swept)
    return algorithm, Lanes(algorithm, lane_keys(LEARN, seeds), hparams, job.demos)


def snapshot_path(folder: RunFolder, iteration: int) -> Path:
    """Where the rewards of an iteration are kept."""
    return folder.path / "snapshots" / f"{iteration:06d}"


def describe(job: Job, params, iterations: list[int]) -> LearnedReward:
    """A learned reward with its description; `iterations` says from which one each seed's row was taken."""
    config: Config = job.recipe.config
    description = {
        "task": job.task,
        "obs_size": job.env.observation_size,
        "action_size": job.env.action_size,
        "action_limit": job.env.action_limit,
        "method": config.method,
        "reward_form": with_method_defaults(config).reward_form,
        "seeds": list(job.seeds),
        "iterations": iterations,
        "hparams": dataclasses.asdict(job.recipe.hparams),
    }
    return LearnedReward(description, config, params)


def imitate(job: Job, out: Path, command: str) -> dict:
    """Runs a job to its end, or goes on with it; returns the summary that it leaves."""
    folder = RunFolder(out, job.settings())
    summary = folder.summary()
    if summary is None:
        algorithm, state = learn(folder, job)
        returns = final_returns(job.env, algorithm, state, job.seeds).mean(axis=1)
        config = job.recipe.config
        if job.has_reward:
            save_reward(folder.path / "reward", load_reward(snapshot_path(folder, config.iterations)))
        summary = summarize(command, job.task, None, config.method, job.seeds, returns,
                            config.env_steps, folder.seconds(), job.reference, row=job.row)  # fmt: skip
        plot(folder.path / "curves.png", f"{job.row}: imitation of {job.task}", imitation_curves(folder, job))
        folder.write_summary(summary)
    say(f"{job.row}: in {folder.path}/")
    warn_if_saturated(folder, job)
    return summary


def warn_if_saturated(folder: RunFolder, job: Job, lanes: list[str] | None = None) -> None:
    """Says so if a discriminator was right about nearly everything for most of the run: it then teaches little.

    Args:
      lanes: what to call each lane; its seed, unless told.
    """
    lanes = lanes or [f"seed {seed}" for seed in job.seeds]
    if not job.has_reward:
        return
    share = (folder.curve("accuracy", len(lanes)) > SATURATED_ACCURACY).mean(axis=1)
    saturated = [lane for lane, s in zip(lanes, share, strict=True) if s > 0.5]
    if saturated:
        console.print(
            f"[yellow]{job.row}: the discriminator was above {SATURATED_ACCURACY:.0%} accuracy in most iterations "
            f"({', '.join(saturated)}), where its reward says little. Try --set discriminator_lr=0.0003, "
            "discriminator_updates=3, gradient_penalty=1 or a larger entropy_weight[/yellow]",
            soft_wrap=True,
        )


def imitation_curves(folder: RunFolder, job: Job) -> list[Curve]:
    """True return, discriminator accuracy and reward of a run in `folder`."""
    steps = job.recipe.config.steps_per_iteration

    def curve(panel, label, name, level=None):
        return Curve(panel, label, folder.curve(name, len(job.seeds)), steps, level)

    true = curve("true return", "", "true_return", ("expert", job.reference.expert))
    if not job.has_reward:
        return [true, curve("log-likelihood", "of the expert's actions", "log_prob_expert")]
    return [
        true,
        curve("discriminator accuracy", "on the expert", "accuracy_expert", ("chance", 0.5)),
        curve("discriminator accuracy", "on the policy", "accuracy_policy"),
        curve("learned reward", "on the expert", "reward_expert"),
        curve("learned reward", "on the policy", "reward_policy"),
    ]


def command(task: str, methods: tuple[str, ...], forms: tuple[str, ...], seeds: range, demos: Path | None,
            out: Path | None, assignments: tuple[str, ...], line: str, tuned: bool = False) -> None:  # fmt: skip
    """Runs every job of `eairl imitate` and prints one table."""
    jobs = prepare(task, methods, forms, seeds, demos, "imitate", assignments, tuned)
    expert = np.array([jobs[0].reference.expert])
    rows = [Row("expert", expert, paper.row(paper.IMITATION, task, "expert"), 1.0)]
    for job in jobs:
        where = row_out(out, f"imitate-{task}-{job.row}", job.row, len(jobs))
        summary = imitate(job, where, line)
        published = paper.row(paper.IMITATION, task, job.recipe.config.method) if job.is_published else None
        rows.append(Row(job.row, np.array(summary["returns"]), published, summary["normalized"]))
    rows.append(Row("random actions", np.array([jobs[0].reference.random]), None, 0.0))
    print_table(f"Imitation of {task}: true return of the sampled policy, {len(seeds)} seeds", rows)


def row_out(out: Path | None, name: str, row: str, count: int) -> Path:
    """The folder of one row: `runs/NAME`, or --out, or a folder in it when there are several rows."""
    if out is None:
        return default_out(name)
    return out if count == 1 else out / row


def take_rows(tree: PyTree, rows: np.ndarray) -> PyTree:
    """Rows of every leaf."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], tree)
