"""How close a learned reward is to the true one: EPIC distance (Gleave et al. 2021) and rank correlation.

These figures stand beside the score. No rule chooses a reward by them. Both rewards are compared as functions of state
and action. If a learned r(s,a) holds a shaping of the next state, which is where the action leads, that part counts as
distance.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from eairl_jax import (
    Config,
    Demonstrations,
    LearnedReward,
    demonstrations,
    load_reward,
    random_policy,
    reward_function,
    schema,
)
from eairl_jax.agent import clip_actions
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.places import shipped_demonstrations
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.retraining import worth
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import CLOSENESS, lane_keys
from eairl_jax.horizon import can_end
from eairl_jax.rollout import where_ended
from eairl_jax.storage import read_json, write_json
from eairl_jax.types import Key, PyTree

EPISODES = 8
"""Episodes of the policy, and as many of random actions."""
TRANSITIONS = 512
"""Transitions that EPIC compares."""
ACTIONS = 16
"""Actions sampled at each state to make a reward canonical."""
GAMMA = 0.99
MEASURES = schema.table_of(schema.list_of(schema.optional(schema.number())))
"""Of the content of closeness.json: measures of each seed by name."""
RewardOfState = Callable[[PyTree, jax.Array], jax.Array]
"""`(state of the environment, action [act]) -> reward []`."""


class Transitions(NamedTuple):
    """Transitions `[n, ...]` with the environment's whole states; the true reward is `after.reward`."""

    before: PyTree
    action: jax.Array
    after: PyTree


def walk(key: Key, env: MjxTask, act: Callable[[jax.Array, Key], jax.Array], config: Config) -> Transitions:
    """Transitions of `EPISODES` whole episodes of a policy.

    Args:
      act: `(obs [EPISODES, obs], key) -> action [EPISODES, act]`.
      config: of the reward, which decides whether it is given sampled or clipped actions.

    Returns:
      `[T * EPISODES, ...]`, the first step of every episode first. An episode that ends begins again.
    """
    reset_key, key = jax.random.split(key)
    start = jax.vmap(env.reset)(jax.random.split(reset_key, EPISODES))

    def step(before, key):
        action = act(before.obs, key)
        after = jax.vmap(env.step)(before, action)  # which clips the action
        goes_on = jax.tree.map(functools.partial(where_ended, after.done > 0), start, after) if can_end(env) else after
        return goes_on, clip_actions(Transitions(before, action, after), env, config)

    _, transitions = jax.lax.scan(step, start, jax.random.split(key, env.episode_length))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), transitions)


def canonical(reward: RewardOfState, x: Transitions, actions: jax.Array) -> jax.Array:
    """The canonically shaped reward `[n]` without its constant: `R(s,a) + gamma E R(s',A) - E R(s,A)`.

    It is equation 1 of Gleave et al. (2021).

    Args:
      actions: the actions A, `[ACTIONS, act]`.
    """

    def mean(states):
        return jax.vmap(lambda state: jax.vmap(lambda action: reward(state, action))(actions).mean())(states)

    return jax.vmap(reward)(x.before, x.action) + GAMMA * mean(x.after) - mean(x.before)


def epic(learned: np.ndarray, true: np.ndarray) -> float | None:
    """The distance of two canonical rewards, `sqrt((1 - rho) / 2)` with their correlation rho.

    Returns:
      0 if the rewards order all policies alike, 1 if they are opposed, None if one of them is constant.
    """
    rho = _finite(np.corrcoef(learned, true)[0, 1])
    return None if rho is None else float(np.sqrt(max(0.0, 1.0 - rho) / 2))


def rank_correlation(learned: np.ndarray, true: np.ndarray) -> float | None:
    """Spearman's rank correlation; None if one of the rewards is constant."""
    return _finite(stats.spearmanr(learned, true).statistic)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def measures(reward: LearnedReward, agents: Policies, env: MjxTask, expert: Demonstrations) -> dict[str, list]:
    """Compares learned rewards with the true reward of one task, one number for each seed.

    Half of EPIC's transitions are the policy's and half are of random actions. Rank correlations are those on the
    expert's demonstrations, on the policy's episodes and on random episodes. "worth" is the mean learned reward of a
    step in each of these.

    Args:
      reward: of every seed.
      agents: the policies that imitate, in the same order.
      env: the task; that of `agents` or another one.
      expert: demonstrations of the task.
    """
    expert = clip_actions(expert, env, reward.config)
    function, act = reward_function(reward.config), agents.algorithm.act

    def true(state, action):
        return env.step(state, action).reward

    @jax.jit
    @jax.vmap
    def rewards(key, params, state):
        policy_key, random_key, pick_key, action_key = jax.random.split(key, 4)

        def learned(state, action):
            return function(params, state.obs, action)

        walks = {
            "policy": walk(policy_key, env, lambda obs, key: act(state, obs, key), reward.config),
            "random": walk(random_key, env, random_policy(env), reward.config),
        }
        both = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *walks.values())
        picked = jax.random.randint(pick_key, (TRANSITIONS,), 0, both.action.shape[0])
        x = jax.tree.map(lambda leaf: leaf[picked], both)
        actions = jax.random.uniform(action_key, (ACTIONS, env.action_size), minval=-1, maxval=1) * env.action_limit
        pairs = {name: (function(params, w.before.obs, w.action), w.after.reward) for name, w in walks.items()}
        pairs["expert"] = function(params, expert.obs, expert.action), expert.reward
        return (canonical(learned, x, actions), canonical(true, x, actions)), pairs

    keys = lane_keys(CLOSENESS, reward.description["seeds"])
    lanes = jax.tree.map(jnp.asarray, (reward.params, agents.state))
    shaped, pairs = jax.tree.map(np.asarray, rewards(keys, *lanes))
    measured = {"epic": [epic(*lane) for lane in zip(*shaped, strict=True)]}
    for name, (learned_reward, true_reward) in pairs.items():
        measured[f"rank correlation, {name}"] = [
            rank_correlation(a.ravel(), b.ravel()) for a, b in zip(learned_reward, true_reward, strict=True)
        ]
        measured[f"worth, {name}"] = [float(lane.mean()) for lane in learned_reward]
    return measured


def of_transfer(learned: Path, used: Path) -> dict[str, dict[str, list]]:
    """Measures a transfer's reward in its source and in its target, once; `used` keeps the outcome.

    In the target, "worth, retrained" says what the policies that were trained on the reward are worth to it in the
    end. If they are worth more than the expert, the reward is mistaken. If they are worth less, they have not found
    what the reward pays for.

    Args:
      learned: the finished run folder in which the reward was learned.
      used: the finished run folder in which policies were trained on it.
    """
    path = used / "closeness.json"
    if not path.exists():
        reward = load_reward(used / "reward")
        imitating, retrained = policies.load(learned), policies.load(used)
        tasks = {"source": imitating, "target": retrained}
        measured = {
            place: measures(reward, imitating, there.env, _expert(there.task)) for place, there in tasks.items()
        }
        kept = worth(RunFolder(used, retrained.settings)).kept
        measured["target"]["worth, retrained"] = kept.tolist()
        write_json(path, measured)
    expected = schema.table_of(MEASURES)
    return read_json(path, expected, "remove the file, and the distances are measured again")


def _expert(task: str) -> Demonstrations:
    return demonstrations.load(shipped_demonstrations(task), task)
