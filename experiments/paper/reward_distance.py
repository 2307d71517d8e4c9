"""How close a learned reward is to the true one: EPIC distance (Gleave et al. 2021) and rank correlation.

Diagnostics beside the score: no rule chooses by them, and of a target nobody may. Both rewards are compared as
functions of state and action; what a learned r(s,a) holds of a shaping, s' being where a leads, counts as distance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from eairl_jax.experiments.pipeline.learn import Job
from eairl_jax.experiments.pipeline.retrain import Target, kept_curves, tail
from eairl_jax.experiments.pipeline.scores import shipped
from scipy import stats

from eairl_jax import Config, Demonstrations, LearnedReward, demonstrations, load_reward, random_policy, reward_function
from eairl_jax.agent import clip_actions
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline import learn
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import CLOSENESS, lane_keys
from eairl_jax.storage import read_json, write_json
from eairl_jax.types import Key, PyTree

EPISODES = 8  # walked by the policy, and as many at random
TRANSITIONS = 512  # of them that EPIC compares
ACTIONS = 16  # tried at each state to make a reward canonical
GAMMA = 0.99


class Walk(NamedTuple):
    """Transitions with the environment's whole states, `[n, ...]`; the true reward is `after.reward`."""

    before: PyTree
    action: jax.Array
    after: PyTree


def walk(key: Key, env: MjxTask, act: Callable[[jax.Array, Key], jax.Array], config: Config) -> Walk:
    """`EPISODES` whole episodes of a policy, flattened; its actions as a reward of `config` knows them."""
    reset_key, key = jax.random.split(key)
    start = jax.vmap(env.reset)(jax.random.split(reset_key, EPISODES))

    def step(state, key):
        action = act(state.obs, key)
        after = jax.vmap(env.step)(state, action)  # which clips it
        return after, clip_actions(Walk(state, action, after), env, config)

    _, walked = jax.lax.scan(step, start, jax.random.split(key, env.episode_length))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), walked)


def canonical(reward: Callable[[PyTree, jax.Array], jax.Array], x: Walk, tried: jax.Array) -> jax.Array:
    """`R(s,a) + gamma E R(s',A) - E R(s,A)`, the canonically shaped reward `[n]` but for its constant (their Eq. 1).

    Args:
      reward: `(state, action [act]) -> []`.
      tried: `[ACTIONS, act]`, the actions A.
    """

    def mean(states):
        return jax.vmap(lambda state: jax.vmap(lambda action: reward(state, action))(tried).mean())(states)

    return jax.vmap(reward)(x.before, x.action) + GAMMA * mean(x.after) - mean(x.before)


def epic(learned: np.ndarray, true: np.ndarray) -> float | None:
    """`sqrt((1 - rho) / 2)` of two canonical rewards: 0 if they order all policies alike, 1 if they are opposed.

    None where one of them is constant.
    """
    rho = _defined(np.corrcoef(learned, true)[0, 1])
    return None if rho is None else float(np.sqrt(max(0.0, 1.0 - rho) / 2))


def rank_correlation(learned: np.ndarray, true: np.ndarray) -> float | None:
    """Spearman's; None where one of them is constant."""
    return _defined(stats.spearmanr(learned, true).statistic)


def _defined(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def of_task(
    reward: LearnedReward, env: MjxTask, act: Callable, state: PyTree, expert: Demonstrations
) -> dict[str, list[float | None]]:
    """The measures of every row of a reward in one task, a number a seed.

    EPIC's transitions are half the policy's, half of random actions; rank correlations are with the true reward of
    the expert's demonstrations, of the policy's walk and of the random one. "worth" is the mean learned reward of each.

    Args:
      act, state: the imitating policies, `Algorithm.act` and its states `[seeds, ...]`.
    """
    expert = clip_actions(expert, env, reward.config)
    function, true = reward_function(reward.config), lambda state, action: env.step(state, action).reward

    @jax.jit
    @jax.vmap
    def measure(key, params, state):
        policy_key, random_key, pick_key, try_key = jax.random.split(key, 4)
        walks = {"policy": walk(policy_key, env, lambda obs, key: act(state, obs, key), reward.config),
                 "random": walk(random_key, env, random_policy(env), reward.config)}  # fmt: skip
        both = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *walks.values())
        picked = jax.random.randint(pick_key, (TRANSITIONS,), 0, both.action.shape[0])
        x = jax.tree.map(lambda leaf: leaf[picked], both)
        tried = jax.random.uniform(try_key, (ACTIONS, env.action_size), minval=-1, maxval=1) * env.action_limit
        learned = lambda state, action: function(params, state.obs, action)  # noqa: E731
        pairs = {name: (function(params, w.before.obs, w.action), w.after.reward) for name, w in walks.items()}
        pairs["expert"] = function(params, expert.obs, expert.action), expert.reward
        return (canonical(learned, x, tried), canonical(true, x, tried)), pairs

    keys = lane_keys(CLOSENESS, reward.description["seeds"])
    shaped, pairs = jax.tree.map(np.asarray, measure(keys, *jax.tree.map(jnp.asarray, (reward.params, state))))
    measured = {"epic": [epic(*lane) for lane in zip(*shaped, strict=True)]}
    for name, (learned, true_reward) in pairs.items():
        measured[f"rank correlation, {name}"] = [
            rank_correlation(a.ravel(), b.ravel()) for a, b in zip(learned, true_reward, strict=True)
        ]
        measured[f"worth, {name}"] = [float(lane.mean()) for lane in learned]
    return measured


def of_transfer(folder: RunFolder, learning: RunFolder, job: Job, target: Target) -> dict[str, dict]:
    """The measures of a transfer's reward in its source and in its target; kept in the transfer's folder.

    In the target also what the policies that were trained on the reward are worth to it, in the end. Are they worth
    more than the expert, the reward is mistaken; less, they have not found what it pays for.
    """
    path = folder.path / "closeness.json"
    if not path.exists():
        reward = load_reward(folder.path / "reward")
        algorithm, state = learn.learn(learning, job)
        tasks = {job.task: job.env, target.task: target.env}
        measured = {
            place: of_task(reward, env, algorithm.act, state, demonstrations.load(shipped(task), task))
            for place, (task, env) in zip(("source", "target"), tasks.items(), strict=True)
        }
        measured["target"]["worth, retrained"] = tail(
            kept_curves(folder, target, len(job.seeds), "policy_reward")
        ).tolist()
        write_json(path, measured)
    return read_json(path)
