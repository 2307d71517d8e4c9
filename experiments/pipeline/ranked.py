"""Rules that fit a new reward to noisy episodes of the policy that imitates (`eairl_jax.noise_ranking`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from eairl_jax import Algorithm, Config, learned_reward, noise_ranking
from eairl_jax.environment import context_size
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.display.plots import plot_ranking
from eairl_jax.experiments.pipeline import divergence
from eairl_jax.experiments.pipeline.experiment import Experiment
from eairl_jax.experiments.pipeline.places import reward_obs_size
from eairl_jax.experiments.pipeline.train import RANK, lane_keys
from eairl_jax.irl import RewardParams, reward_function
from eairl_jax.methods import METHODS, with_method_defaults
from eairl_jax.noise_ranking import RANKINGS
from eairl_jax.normalize import ObsStats
from eairl_jax.storage import write_json
from eairl_jax.types import PyTree

FILE, PICTURE = "ranking.json", "ranking.png"


class Fitted(NamedTuple):
    """What a ranking has made of the policies of an experiment.

    Attributes:
      config: of the rewards.
      params: the rewards, `[seeds, ...]`.
      facts: how well they follow the noise and the true reward; for people, nothing is decided by it.
    """

    config: Config
    params: RewardParams
    facts: dict[str, Any]


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
    stats = _obs_stats(experiment, state)

    def play(state: PyTree, key: jax.Array):
        def act(obs: jax.Array, key: jax.Array) -> jax.Array:
            return algorithm.act(state, obs, key)

        return noise_ranking.play(key, env, act, env.episode_length, config)

    def fit_one(key: jax.Array, episodes: noise_ranking.Episodes, target: jax.Array, stats: ObsStats):
        return noise_ranking.fit(key, episodes, target, stats, ranking, config)

    episodes = jax.jit(jax.vmap(play))(state, play_keys)
    true = np.asarray(jnp.where(episodes.counts > 0, episodes.reward, 0.0).sum(axis=2))
    first = learned_reward(state, context_size(env)) if ranking.rates else None
    rated = np.zeros_like(true) if first is None else _rated(config, first, episodes)
    target = np.stack([noise_ranking.targets(ranking, each) for each in rated])
    if ranking.rates:
        _warn_of_flat(seeds, target)
    params, losses = jax.jit(jax.vmap(fit_one))(fit_keys, episodes, jnp.asarray(target), stats)
    facts = {
        "noise": noise_ranking.noise_of_episodes().tolist(),
        "true_returns": [divergence.all_finite(each) for each in true],
        "ratings_before": None if first is None else [divergence.all_finite(each) for each in rated],
        "ratings_fitted": None if first is None else [divergence.all_finite(each) for each in target],
        "ratings_after": [divergence.all_finite(each) for each in _rated(config, params, episodes)],
        "losses": divergence.all_finite(np.asarray(losses)),
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
    facts = {name: None if values is None else np.array(values, np.float64) for name, values in fitted.facts.items()}
    write_json(path / FILE, fitted.facts)
    rated = {
        "the learned reward, standardised": facts["ratings_before"],
        "the new reward, standardised": facts["ratings_after"],
    }
    known = {name: values for name, values in rated.items() if values is not None}
    plot_ranking(path / PICTURE, path.name, facts["noise"], facts["true_returns"], known, facts["ratings_fitted"])


def _obs_stats(experiment: Experiment, state: PyTree) -> ObsStats:
    """The normaliser `[seeds, ...]` of a task's observations, without the entries that name one of several sources."""
    stats, size = state.agent.obs_stats, reward_obs_size(experiment.source.env)
    return stats.replace(mean=stats.mean[..., :size], var=stats.var[..., :size])


def _rated(config: Config, params: RewardParams, episodes: noise_ranking.Episodes) -> np.ndarray:
    """Ratings `[seeds, N]` of each seed's episodes by its reward."""
    function = reward_function(config)

    def of_seed(params: RewardParams, episodes: noise_ranking.Episodes) -> jax.Array:
        return noise_ranking.ratings(lambda obs, action: function(params, obs, action), episodes)

    return np.asarray(jax.jit(jax.vmap(of_seed))(params, episodes))
