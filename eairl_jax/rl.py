"""Reinforcement learning on a fixed reward: the environment's reward (an expert) or a learned reward (transfer)."""

from __future__ import annotations

from collections.abc import Callable

import jax
from flax import struct

from eairl_jax import agent, arguments, horizon
from eairl_jax.config import Config
from eairl_jax.environment import check_env
from eairl_jax.hparams import check_hparams
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.shards import of_count
from eairl_jax.types import Algorithm, Env, HParams, Key, PyTree, Transition, no_penalty

# (data, raw transitions [T, N, ...]) -> reward [T, N]
Reward = Callable[[PyTree, Transition], jax.Array]


@struct.dataclass
class RLState:
    """The whole state of a run between two iterations.

    Attributes:
      key: source of all randomness.
      agent: the policy, its environments and the normaliser.
    """

    key: Key
    agent: agent.Agent


def true_reward(_data: PyTree, batch: Transition) -> jax.Array:
    """The environment's reward `[T, N]`."""
    return batch.reward


def make_rl(env: Env, config: Config, reward: Reward = true_reward, shards: int = 1) -> Algorithm:
    """Builds PPO or TRPO (`config.optimizer`) on a reward. The metric `true_return` is about the environment's reward.

    Args:
      reward: `(data, raw transitions [T, N, ...]) -> reward [T, N]`; `data` is the `data` of `step`.
      shards: how many devices compute one lane together, in `Lanes`.

    Raises:
      InputError: if the environment's observations are not flat vectors, if there is no time limit, or if the
        environments cannot be split evenly over the devices.
    """
    check_env(env)
    config = horizon.resolved(env, config, "variable")
    env = horizon.learning_env(env, config)
    parts = of_count(shards, config.num_envs)
    optimizer = make_optimizer(env, config, parts)

    def init(key: Key, hparams: HParams) -> RLState:
        check_hparams(hparams)
        key = arguments.one_key(key)
        key, agent_key = jax.random.split(key)
        return RLState(key, agent.init(agent_key, env, optimizer, hparams, config))

    def step(state: RLState, hparams: HParams, data: PyTree):
        hparams = hparams.at(agent.progress(state.agent, config))
        key, rollout_key, update_key = jax.random.split(state.key, 3)
        acting, raw = agent.collect(rollout_key, state.agent, env, optimizer, config, parts)
        rewards = reward(data, raw)
        log_prob = raw.log_prob * horizon.alive(raw.obs, config)
        paid = horizon.rest_paid(rewards - hparams.temperature * log_prob, raw.obs, hparams, config)
        batch = agent.normalize_obs(acting, raw)._replace(reward=paid)
        policy, metrics = optimizer.update(update_key, acting.policy, batch, no_penalty, (), hparams)
        metrics |= {"true_return": acting.rollout.mean_return, "policy_reward": rewards.mean()}
        return RLState(key, agent.end_iteration(acting, policy, raw, config)), metrics

    def act(state: RLState, obs, key=None):
        return agent.sample_action(state.agent, obs, key, optimizer)

    return Algorithm(init, step, act, shards)
