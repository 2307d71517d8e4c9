"""Rules that fit a new reward to noisy episodes of the policy that imitates (`eairl_jax.noise_ranking`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from eairl_jax import Algorithm, Config, learned_reward, noise_ranking
from eairl_jax.environment import context_size
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.display.plots import plot_ranking
from eairl_jax.experiments.pipeline import divergence
from eairl_jax.experiments.pipeline.experiment import Experiment
from eairl_jax.experiments.pipeline.train import RANK, lane_keys
from eairl_jax.irl import RewardParams, reward_function
from eairl_jax.methods import METHODS, with_method_defaults
from eairl_jax.noise_ranking import RANKINGS
from eairl_jax.normalize import ObsStats, without_last
from eairl_jax.storage import write_json
from eairl_jax.types import PyTree

FILE, PICTURE = "ranking.json", "ranking.png"


class Fitted(NamedTuple):
    """What a ranking has made of the policies of an experiment.

    Attributes:
      config: of the rewards.
      params: the rewards, `[seeds, ...]`.
      facts: how well they follow the noise and the true reward, arrays `[episodes]`, `[seeds]` or `[seeds, episodes]`;
        for people, nothing is decided by it. Those of a first reward are None if there is none.
    """

    config: Config
    params: RewardParams
    facts: dict[str, np.ndarray | None]


def reward_config(config: Config) -> Config:
    """The configuration of the fitted reward. After behaviour cloning it is a reward r(s), as in D-REX."""
    if config.method in METHODS:
        return with_method_defaults(config)
    return dataclasses.replace(with_method_defaults(dataclasses.replace(config, method="airl_s")), method=config.method)


def fit(experiment: Experiment, algorithm: Algorithm, state: PyTree, kind: str) -> Fitted:
    """Plays noisy episodes of every seed's policy in the source, and fits every seed's reward to them.

    Args:
      state: `[seeds, ...]` at the end of the learning.
      kind: a name of `RANKINGS`.
    """
    ranking, env, config = RANKINGS[kind], experiment.source.env, reward_config(experiment.config)
    seeds = list(experiment.seeds)
    play_keys, fit_keys = (lane_keys(RANK, seeds, [part] * len(seeds)) for part in (0, 1))
    state = jax.tree.map(jnp.asarray, state)
    stats = without_last(state.agent.obs_stats, context_size(env))

    def play(state: PyTree, key: jax.Array):
        def act(obs: jax.Array, key: jax.Array) -> jax.Array:
            return algorithm.act(state, obs, key)

        return noise_ranking.play(key, env, act, env.episode_length, config)

    def fit_one(key: jax.Array, episodes: noise_ranking.Episodes, target: jax.Array, stats: ObsStats):
        return noise_ranking.fit(key, episodes, target, stats, ranking, config)

    episodes = jax.jit(jax.vmap(play))(state, play_keys)
    true = np.asarray(episodes.true_return)
    first = learned_reward(state, context_size(env)) if ranking.rates else None
    rated = np.zeros_like(true) if first is None else _rated(config, first, episodes)
    target = np.stack([noise_ranking.targets(ranking, each) for each in rated])
    if ranking.rates:
        _warn_of_flat(seeds, target)
    params, losses = jax.jit(jax.vmap(fit_one))(fit_keys, episodes, jnp.asarray(target), stats)
    facts = {
        "noise": noise_ranking.noise_of_episodes(),
        "true_returns": true,
        "ratings_before": None if first is None else rated,
        "ratings_fitted": None if first is None else target,
        "ratings_after": _rated(config, params, episodes),
        "losses": np.asarray(losses),
    }
    return Fitted(config, jax.tree.map(np.asarray, params), facts)


def _warn_of_flat(seeds: Sequence[int], target: np.ndarray) -> None:
    """Says of which seeds the first reward gives the ranking nothing to follow; `target` is `[seeds, N]`."""
    flat = [str(seed) for seed, each in zip(seeds, target, strict=True) if not each.any()]
    if flat:
        say(
            f"WARNING: seed {', '.join(flat)}: by the learned reward, episodes are not worse with more random actions; "
            "the new reward has nothing to follow, and means nothing"
        )


def write(path: Path, fitted: Fitted) -> None:
    """Writes the facts into the folder of a run, and draws them."""
    facts = fitted.facts
    write_json(path / FILE, {name: _listed(values) for name, values in facts.items()})
    rated = {
        "the learned reward, standardised": facts["ratings_before"],
        "the new reward, standardised": facts["ratings_after"],
    }
    known = {name: values for name, values in rated.items() if values is not None}
    plot_ranking(path / PICTURE, path.name, facts["noise"], facts["true_returns"], known, facts["ratings_fitted"])


def _listed(values: np.ndarray | None) -> list | None:
    """An array of one or two axes as a JSON file holds it."""
    if values is None or values.ndim == 1:
        return None if values is None else divergence.all_finite(values)
    return [divergence.all_finite(row) for row in values]


def _rated(config: Config, params: RewardParams, episodes: noise_ranking.Episodes) -> np.ndarray:
    """Ratings `[seeds, N]` of each seed's episodes by its reward."""
    function = reward_function(config)

    def of_seed(params: RewardParams, episodes: noise_ranking.Episodes) -> jax.Array:
        return noise_ranking.ratings(lambda obs, action: function(params, obs, action), episodes)

    return np.asarray(jax.jit(jax.vmap(of_seed))(params, episodes))
