"""Rewards from noise: the more of its actions a policy leaves to chance, the worse its episodes are.

A policy that imitates demonstrations plays episodes in which a share of its actions is replaced by random ones. A new
reward is fitted to what this share, the noise, says of an episode. The reward need not hold the demonstrations for the
best: it can extrapolate beyond an imperfect demonstrator.

- D-REX (Brown et al. 2019): of two pieces of episodes that differ enough in noise, the one with less has the higher
  return.
- SSRR (Chen et al. 2020): a first reward, such as AIRL's, rates every episode. A sigmoid of the noise is fitted to
  these ratings, and the new reward to the sigmoid. The sigmoid averages away what the first reward holds of the
  expert's habits, and says by how much an episode is better, not only that it is.

Differences from the authors' programs: a reward is one network and no ensemble; observations are normalised like those
of the first reward; SSRR fits the mean reward of a piece instead of its sum, so that long pieces weigh no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from eairl_jax import discriminator, horizon, train_state
from eairl_jax.agent import clip_actions
from eairl_jax.config import Config
from eairl_jax.environment import context_size
from eairl_jax.evaluation import Act, evaluate, random_policy
from eairl_jax.irl import RewardParams, reward_function
from eairl_jax.normalize import ObsStats
from eairl_jax.types import Env, Key, PyTree

LEVELS = 20
"""How many amounts of noise are played: 0, 1/20, ..., 19/20, as in both papers' programs."""
EPISODES = 5
"""Episodes of each amount of noise."""


class Pieces(NamedTuple):
    """Pieces of episodes, as the loss of a ranking sees them.

    Attributes:
      reward: `[batch, length]` of the reward that is fitted; 0 where `counts` is 0.
      counts: `[batch, length]` 1 for the steps of the piece, 0 for the padding after it.
      target: `[batch]` of the piece's episode (`targets`).
    """

    reward: jax.Array
    counts: jax.Array
    target: jax.Array


def ranking_loss(pieces: Pieces) -> jax.Array:
    """`-log P(better > worse)`, `[]`, with `P = exp R_better / (exp R_better + exp R_worse)` (Bradley and Terry 1952).

    R is the return of a piece. The first half of the batch are the better ones.
    """
    better, worse = jnp.split(pieces.reward.sum(axis=1), 2)
    return jax.nn.softplus(worse - better).mean()


def regression_loss(pieces: Pieces) -> jax.Array:
    """`E (mean reward of a piece - target)^2`, `[]` (Chen et al. 2020, for means instead of sums)."""
    mean = pieces.reward.sum(axis=1) / jnp.maximum(pieces.counts.sum(axis=1), 1.0)
    return ((mean - pieces.target) ** 2).mean()


@dataclass(frozen=True)
class Ranking:
    """How a reward is fitted to episodes of different noise."""

    summary: str
    """One line for the help text."""
    loss: Callable[[Pieces], jax.Array]
    """Of a batch of pieces, `[]`."""
    rates: bool
    """Whether a first reward rates the episodes. Else the noise alone says which are better."""
    margin: float
    """Least difference in noise of two compared pieces. 0: pieces are not compared, and drawn one by one."""
    shortest: float
    """Length of the shortest piece, as a share of an episode."""
    longest: float
    """Length of the longest piece, as a share of an episode."""
    updates: int
    """Adam steps."""
    batch: int = 64
    """Pieces of one Adam step; pairs of pieces if they are compared."""
    lr: float = 1e-3
    """Learning rate of the first Adam step. The rate falls linearly to 0."""
    weight_decay: float = 1e-3
    """Weight of the sum of all squared weights of the network, in the loss."""


RANKINGS: MappingProxyType[str, Ranking] = MappingProxyType(
    {
        "d_rex": Ranking(
            summary="a reward by which episodes of less noise are better (Brown et al. 2019)",
            loss=ranking_loss,
            rates=False,
            margin=0.3,
            shortest=0.05,
            longest=0.05,
            updates=3000,
        ),
        "ssrr": Ranking(
            summary="a reward that follows the first one's ratings of episodes of more and more noise "
            "(Chen et al. 2020)",
            loss=regression_loss,
            rates=True,
            margin=0.0,
            shortest=0.05,
            longest=0.5,
            updates=3000,
        ),
    }
)


class Episodes(NamedTuple):
    """Episodes `[N, T, ...]` of a policy whose actions are partly random.

    Attributes:
      obs: `[N, T, obs]` as the reward sees them, raw.
      action: `[N, T, act]` as the reward sees them.
      counts: `[N, T]` 1 up to the end of the episode, 0 afterwards.
      true_return: `[N]` true returns. Nothing is fitted to them.
    """

    obs: jax.Array
    action: jax.Array
    counts: jax.Array
    true_return: jax.Array


def noise_of_episodes() -> np.ndarray:
    """`[N]` the share of random actions in each episode of `play`, in ascending order."""
    return np.repeat(np.arange(LEVELS) / LEVELS, EPISODES).astype(np.float32)


def noisy(env: Env, act: Act, noise: jax.Array) -> Act:
    """The policy `act` with every action replaced by a uniformly random one with probability `noise [episodes]`."""
    random = random_policy(env)

    def noisy_act(obs: jax.Array, key: Key) -> jax.Array:
        act_key, random_key, draw_key = jax.random.split(key, 3)
        is_random = jax.random.uniform(draw_key, noise.shape) < noise
        return jnp.where(is_random[:, None], random(obs, random_key), act(obs, act_key))

    return noisy_act


def play(key: Key, env: Env, act: Act, episode_length: int, config: Config) -> Episodes:
    """Plays whole episodes with the noise `noise_of_episodes`.

    Args:
      act: the policy.
      config: of the reward that will be fitted. It says how actions and the steps after an end are seen.
    """
    noise = jnp.asarray(noise_of_episodes())
    returns, steps = evaluate(key, env, noisy(env, act, noise), len(noise), episode_length)
    seen = horizon.extended(steps, config)
    end = seen["obs"].shape[-1] - context_size(env)
    return clip_actions(Episodes(seen["obs"][..., :end], seen["action"], seen["valid"], returns), env, config)


def ratings(reward: Callable[[jax.Array, jax.Array], jax.Array], episodes: Episodes) -> jax.Array:
    """Mean reward a step `[N]` of each episode, by any reward `(obs, action) -> reward`."""
    paid = jnp.where(episodes.counts > 0, reward(episodes.obs, episodes.action), 0.0)
    return paid.sum(axis=1) / jnp.maximum(episodes.counts.sum(axis=1), 1.0)


class Sigmoid(NamedTuple):
    """How ratings fall with noise: `low + fall / (1 + exp(steepness (noise - middle)))`."""

    middle: float
    steepness: float
    fall: float
    low: float

    def __call__(self, noise: np.ndarray) -> np.ndarray:
        """The rating at an amount of noise, of any shape."""
        return self.low + self.fall / (1.0 + np.exp(self.steepness * (noise - self.middle)))


def fit_sigmoid(noise: np.ndarray, rating: np.ndarray) -> Sigmoid:
    """Fits a falling sigmoid to ratings `[N]` of episodes with noise `[N]`, by least squares.

    Less noise is never worse: `steepness` and `fall` are at least 0.
    """
    span = float(np.ptp(rating)) or 1.0
    result = least_squares(
        lambda p: (Sigmoid(*p)(noise) - rating) / span,
        x0=[0.5, 10.0, span, float(rating.min())],
        x_scale=[1.0, 10.0, span, span],
        bounds=([0.0, 0.0, 0.0, -np.inf], [1.0, 100.0, 4.0 * span, np.inf]),
    )
    return Sigmoid(*map(float, result.x))


def targets(ranking: Ranking, rating: np.ndarray) -> np.ndarray:
    """What the mean reward of pieces of each episode should be, `[N]`; 0 if no first reward rates the episodes.

    They have mean 0 and standard deviation 1 over the episodes: the units of the first reward are left behind. If the
    ratings do not fall with noise, all are 0.

    Args:
      rating: `[N]` of the first reward.
    """
    noise = noise_of_episodes()
    if not ranking.rates:
        return np.zeros_like(noise)
    if not np.isfinite(rating).all():  # of a seed that was dropped
        return np.full_like(noise, np.nan)
    fitted = fit_sigmoid(noise, np.asarray(rating, np.float64))(noise)
    centred = fitted - fitted.mean()
    std = centred.std()
    return (centred / std if std > 1e-6 * max(np.ptp(rating), 1e-12) else 0.0 * centred).astype(np.float32)


def fit(
    key: Key, episodes: Episodes, target: jax.Array, obs_stats: ObsStats, ranking: Ranking, config: Config
) -> tuple[RewardParams, jax.Array]:
    """Fits a fresh reward of the form that `config` names.

    Args:
      target: `[N]` of `targets`.
      obs_stats: the normaliser of the reward's observations.

    Returns:
      The reward, and the mean loss of the last tenth of the updates, without the weight decay.
    """
    init_key, draw_key = jax.random.split(key)
    reward, draw = reward_function(config), _draws(ranking, episodes)
    size = obs_stats.mean.shape[-1]
    params = discriminator.init_reward(init_key, size, episodes.action.shape[-1], config)

    def loss(params: PyTree, index: tuple[jax.Array, jax.Array, jax.Array]):
        row, step, counts = index
        obs, action = episodes.obs[row[:, None], step], episodes.action[row[:, None], step]
        paid = jnp.where(counts > 0, reward(RewardParams(params, obs_stats), obs, action), 0.0)
        value = ranking.loss(Pieces(paid, counts, target[row]))
        squares = sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(params) if leaf.ndim > 1)
        return value + ranking.weight_decay * squares, value

    def update(state: train_state.TrainState, number: jax.Array):
        gradient, value = jax.grad(loss, has_aux=True)(state.params, draw(jax.random.fold_in(draw_key, number)))
        lr = ranking.lr * (1.0 - number / ranking.updates)
        return train_state.adam_step(state, gradient, lr), value

    state, values = jax.lax.scan(update, train_state.init(params), jnp.arange(ranking.updates))
    return RewardParams(state.params, obs_stats), values[-(ranking.updates // 10 or 1) :].mean()


def _draws(ranking: Ranking, episodes: Episodes) -> Callable[[Key], Any]:
    """`key -> (row [batch], step [batch, length], counts [batch, length])` of pieces, at random places of episodes."""
    noise, count, length = noise_of_episodes(), *episodes.counts.shape
    longest = max(1, round(ranking.longest * length))
    shortest = min(longest, max(1, round(ranking.shortest * length)))
    pairs = jnp.asarray(np.argwhere(noise[None, :] - noise[:, None] >= ranking.margin - 1e-6))
    played = episodes.counts.sum(axis=1).astype(jnp.int32)  # steps of each episode

    def draw(key: Key) -> tuple[jax.Array, jax.Array, jax.Array]:
        row_key, length_key, start_key = jax.random.split(key, 3)
        if ranking.margin:
            better, worse = pairs[jax.random.randint(row_key, (ranking.batch,), 0, len(pairs))].T
            row = jnp.concatenate([better, worse])
        else:
            row = jax.random.randint(row_key, (ranking.batch,), 0, count)
        wanted = jax.random.randint(length_key, row.shape, shortest, longest + 1)
        taken = jnp.minimum(wanted, played[row])
        start = jnp.floor(jax.random.uniform(start_key, row.shape) * (played[row] - taken + 1)).astype(jnp.int32)
        offset = jnp.arange(longest)
        step = jnp.minimum(start[:, None] + offset, length - 1)
        return row, step, (offset < taken[:, None]).astype(jnp.float32)

    return draw
