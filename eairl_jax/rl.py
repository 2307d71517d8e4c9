"""Reinforcement learning on a reward: the environment's own (an expert) or a learned one (transfer)."""

from __future__ import annotations

from collections.abc import Callable

import jax
from flax import struct

from eairl_jax import agent
from eairl_jax.config import Config
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.types import Algorithm, Env, HParams, Key, PyTree, Transition, no_penalty


@struct.dataclass
class RLState:
    """A run between two iterations."""

    key: Key
    agent: agent.Agent


def true_reward(_data: PyTree, batch: Transition) -> jax.Array:
    """The environment's own reward `[T, N]`."""
    return batch.reward


def make_rl(
    env: Env, config: Config, reward: Callable[[PyTree, Transition], jax.Array] = true_reward
) -> Algorithm:  # fmt: skip
    """Builds PPO or TRPO on `reward(data, raw transitions [T, N, ...]) -> [T, N]`; `data` is what `step` is given.

    The metric `true_return` is the environment's own, whatever the reward.

    Raises:
      InputError: for an environment without flat observations.
    """
    optimizer = make_optimizer(env, config)

    def init(key: Key, hparams: HParams) -> RLState:
        del hparams  # no rate is part of the state
        key, actor_key = jax.random.split(key)
        return RLState(key, agent.init(actor_key, env, optimizer, config))

    def step(state: RLState, hparams: HParams, data: PyTree):
        hparams = hparams.at(agent.progress(state.agent, config))
        key, rollout_key, update_key = jax.random.split(state.key, 3)
        acting, raw = agent.collect(rollout_key, state.agent, env, optimizer, config)
        given = reward(data, raw)
        batch = agent.normalized(acting, raw)._replace(reward=given - hparams.temperature * raw.log_prob)
        policy, metrics = optimizer.update(update_key, acting.policy, batch, no_penalty, (), hparams)
        metrics |= {"true_return": acting.rollout.mean_return, "policy_reward": given.mean()}
        return RLState(key, agent.finish(acting, policy, raw, config)), metrics

    def act(state: RLState, obs, key=None):
        return agent.sample(state.agent, obs, key, optimizer)

    return Algorithm(init, step, act)
