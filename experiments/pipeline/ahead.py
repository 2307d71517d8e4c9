"""What a transfer needs after its learning. A thread compiles it while the reward is learned."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from eairl_jax import processes
from eairl_jax.experiments.pipeline import records, retraining, stages
from eairl_jax.experiments.pipeline.experiment import Experiment, Use
from eairl_jax.experiments.pipeline.retraining import Training
from eairl_jax.noise_ranking import RANKINGS
from eairl_jax.programs import CompileThread


class Ahead(NamedTuple):
    """What learns and what retrains.

    Attributes:
      learner: what learns; None if it has to be made when it is needed.
      fresh: gives the training of fresh policies in the target, still without the learned reward.
      true: gives the training on the true reward.
    """

    learner: stages.Learner | None
    fresh: Callable[[], Training]
    true: Callable[[], Training]


def of_transfer(experiment: Experiment, use: Use, out: Path, thread: CompileThread) -> Ahead:
    """Has `thread` compile the programs of a transfer, in the order in which they are needed.

    A reward that is learned by a ranking is of a kind that is not known yet. Its programs are compiled when they are
    needed, as all programs are if there are several processes.

    Args:
      out: the folder of the transfer's folder, which may hold a ceiling already.
    """
    fresh = retraining.training_of(use.target, None, experiment.seeds)
    true = retraining.ceiling_training(use.target, experiment.seeds)
    if processes.current():
        return Ahead(None, lambda: fresh, lambda: true)
    learner = stages.learner(experiment)
    stages.compile_later(experiment, learner, thread)
    if not experiment.has_reward or use.rule.kind in ("policy", *RANKINGS):
        return Ahead(learner, lambda: fresh, ceiling(true, out, thread))
    blank = fresh.with_reward(stages.blank(experiment, learner.lanes))
    return Ahead(learner, thread.later(lambda: retraining.compile_later(blank, thread)).now, ceiling(true, out, thread))


def ceiling(training: Training, out: Path, thread: CompileThread) -> Callable[[], Training]:
    """Gives a `ceiling_training`, and has `thread` compile it unless `out` holds its result."""
    if retraining.ceiling_folder(training, out).summary(records.CEILING) is not None:
        return lambda: training
    return thread.later(lambda: retraining.compile_later(training, thread)).now
