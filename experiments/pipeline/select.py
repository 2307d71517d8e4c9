"""Which iteration's reward is put to use. No rule looks at the target task."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from eairl_jax import InputError, LearnedReward, load_reward
from eairl_jax.experiments.pipeline.learn import Job, describe, snapshot_path, untrained
from eairl_jax.experiments.pipeline.retrain import Target, retrain, tail, target_settings
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import SOURCE_RETRAIN
from eairl_jax.experiments.recipes import Recipe, divisor


@dataclass(frozen=True)
class Rule:
    """One of them.

    Attributes:
      kind: "last", "iteration", "source_retrain"; or, to compare with: "random", the networks as they were before
        learning, and "policy", no reward but the policy that was learned with it, as it is.
      iteration: for "iteration", which one.
      repeats: for "source_retrain", policies trained on each snapshot.
      iterations: for "source_retrain", the length of each training.
    """

    kind: str
    iteration: int = 0
    repeats: int = 2
    iterations: int = 0

    def __str__(self) -> str:
        return f"iteration={self.iteration}" if self.kind == "iteration" else self.kind

    @staticmethod
    def parse(text: str, job_recipe: Recipe, back_home: Recipe) -> Rule:
        """Reads `last`, `source_retrain`, `iteration=N`, `random` or `policy`.

        Args:
          job_recipe: how the reward is learned.
          back_home: how policies are trained on a reward in the source task.

        Raises:
          InputError: for anything else, or an N of which no snapshot is kept.
        """
        if text == "source_retrain":
            return Rule(text, repeats=min(2, back_home.restarts), iterations=back_home.source_retrain_iterations)
        if text in ("last", "random", "policy"):
            return Rule(text)
        name, _, number = text.partition("=")
        kept = snapshots_of(job_recipe)
        if name != "iteration" or not number.isdigit():
            raise InputError(
                f"unknown rule {text!r}: choose last, source_retrain, random, policy or iteration=N, e.g. "
                f"iteration={kept[-1]}"
            )
        if int(number) not in kept:
            raise InputError(f"no snapshot of iteration {number} is kept; there are {', '.join(map(str, kept))}")
        return Rule("iteration", int(number))


def snapshots_of(job_recipe: Recipe) -> list[int]:
    """The iterations of which a snapshot is kept."""
    return list(range(job_recipe.snapshot_every, job_recipe.config.iterations + 1, job_recipe.snapshot_every))


def choose_reward(
    folder: RunFolder, learning: RunFolder, job: Job, rule: Rule, source: Target
) -> tuple[LearnedReward, dict[str, Any]]:
    """Takes each seed's reward from the snapshots of `learning`; also says what the rule saw."""
    if rule.kind == "random":
        before = [0] * len(job.seeds)
        return describe(job, untrained(job), before), {"chosen_iterations": before}
    kept = snapshots_of(job.recipe)
    if rule.kind != "source_retrain":
        iteration = kept[-1] if rule.kind == "last" else rule.iteration
        seen = {"chosen_iterations": [iteration] * len(job.seeds)}
        return load_reward(snapshot_path(learning, iteration)), seen
    rewards = [load_reward(snapshot_path(learning, iteration)) for iteration in kept]
    # Lanes in the order (repeat, snapshot, seed).
    params = jax.tree.map(lambda *leaves: np.concatenate(leaves * rule.repeats), *(r.params for r in rewards))
    labels = [{"repeat": repeat, "snapshot": iteration, "seed": seed}
              for repeat in range(rule.repeats) for iteration in kept for seed in job.seeds]  # fmt: skip
    config = dataclasses.replace(source.recipe.config, iterations=rule.iterations)
    chunk = divisor(rule.iterations, max(1, rule.iterations // 2))
    short = dataclasses.replace(source, recipe=dataclasses.replace(source.recipe, config=config, snapshot_every=chunk))
    inner = RunFolder(folder.path / "source_retrain", {"rule": dataclasses.asdict(rule)} | target_settings(short))
    title = f"{job.row}: retraining on {len(kept)} snapshots in {job.task}"
    retrain(inner, title, short, rewards[0], params, labels, SOURCE_RETRAIN)
    # As in the target: of the repeats the one that its own reward rates best. Not their mean, which is low where one
    # policy settled before a wall, whatever the reward.
    learned, true = (tail(inner.curve(name, len(labels))).reshape(rule.repeats, len(kept), len(job.seeds))
                     for name in ("policy_reward", "true_return"))  # fmt: skip
    scores = np.take_along_axis(true, learned.argmax(axis=0)[None], axis=0)[0]
    best = scores.argmax(axis=0)
    rows = [jax.tree.map(lambda leaf, lane=lane: leaf[lane], rewards[b].params) for lane, b in enumerate(best)]
    chosen = [kept[b] for b in best]
    reward = describe(job, jax.tree.map(lambda *leaves: np.stack(leaves), *rows), chosen)
    seen = {"chosen_iterations": chosen, "snapshots": kept, "source_returns": scores.round(3).tolist()}
    return reward, seen
