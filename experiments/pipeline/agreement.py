"""How well the returns of a learned reward agree with the true returns of the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from eairl_jax import InputError, LearnedReward, demonstrations
from eairl_jax.types import Demonstrations

FEWEST = 3
"""Episodes: any two lie on a line."""


class Agreement(NamedTuple):
    """The agreement of each seed's reward with the true one.

    Attributes:
      pearson: `[seeds]` linear correlation of learned and true returns.
      spearman: `[seeds]` correlation of their ranks.
      learned: `[seeds, episodes]` returns by the learned reward.
      true: `[episodes]` true returns.
    """

    pearson: np.ndarray
    spearman: np.ndarray
    learned: np.ndarray
    true: np.ndarray


def agreement(reward: LearnedReward, files: Sequence[tuple[Path, Demonstrations]]) -> Agreement:
    """Correlates the returns of all episodes of some files, which hold actions and true rewards.

    A return is the sum of an episode's rewards up to its end. What a reward of the horizon "absorbing" pays after the
    end is left out.

    Raises:
      InputError: if there are fewer than three episodes, if their returns do not differ by a seed's reward or by the
        true one, or if a return is not finite.
    """
    true = np.concatenate([_returns(demos) for _, demos in files])
    where = ", ".join(str(path) for path, _ in files)
    if len(true) < FEWEST:
        raise InputError(f"{where}: {len(true)} episodes; expected at least {FEWEST}, of good and bad policies")
    _refuse_alike(true, f"the true returns of {where}")
    seeds = reward.description["seeds"]
    learned = np.stack(
        [np.concatenate([_returns(_paid(reward, lane, demos)) for _, demos in files]) for lane in range(len(seeds))]
    )
    for seed, returns in zip(seeds, learned, strict=True):
        _refuse_alike(returns, f"the returns of {where} by the reward of seed {seed}")
    pearson = np.array([stats.pearsonr(each, true).statistic for each in learned])
    spearman = np.array([stats.spearmanr(each, true).statistic for each in learned])
    return Agreement(pearson, spearman, learned, true)


def _paid(reward: LearnedReward, lane: int, demos: Demonstrations) -> Demonstrations:
    """The same episodes, paid by the reward of one seed."""
    paid = jax.jit(reward.function(lane))(jnp.asarray(demos.obs), jnp.asarray(demos.action))
    return demos._replace(reward=np.asarray(paid))


def _returns(demos: Demonstrations) -> np.ndarray:
    returns = demonstrations.returns(demos)
    assert returns is not None
    return returns.astype(np.float64)


def _refuse_alike(returns: np.ndarray, what: str) -> None:
    """Raises `InputError` unless returns `[episodes]` are finite and differ."""
    if not np.isfinite(returns).all() or np.ptp(returns) <= 1e-9 * np.abs(returns).max():
        raise InputError(f"{what} are {returns.min():g} to {returns.max():g}: expected finite numbers that differ")
