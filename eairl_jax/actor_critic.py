"""The part that PPO and TRPO share: the policy in training, its value function, its advantages."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import nets, train_state
from eairl_jax.config import Config
from eairl_jax.gae import gae
from eairl_jax.gaussian import Gaussian
from eairl_jax.types import HParams, Key, PyTree, Transition

# Decay of the running variance of returns in one iteration.
RETURN_VAR_DECAY = 0.9


@struct.dataclass
class PolicyState:
    """A policy in training.

    Attributes:
      nets: parameters {"actor", "critic"} and their Adam moments.
      log_std_offset: `[]` log of the present factor of the std (`HParams.std_initial_fraction`, `std_final_fraction`);
        it is added to the actor's log std.
      return_var: `[]` running variance of the discounted return. Rewards are divided by its root, so that learned
        rewards of any scale train with the same learning rates.
      return_count: `[]` number of iterations that `return_var` has seen.
    """

    nets: train_state.TrainState
    log_std_offset: jax.Array
    return_var: jax.Array
    return_count: jax.Array


class Batch(NamedTuple):
    """The samples of one iteration, `[T, N, ...]`, in the form that the loss needs.

    Attributes:
      obs: `[T, N, obs]` s, normalised.
      action: `[T, N, act]` a.
      log_prob: `[T, N]` log pi(a|s) under the policy that acted.
      advantage: `[T, N]` standardised advantages.
      value_target: `[T, N]` regression targets of the value function.
      penalty_data: pytree of `[T, N, ...]`, see `PolicyOptimizer.update`.
    """

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    value_target: jax.Array
    penalty_data: PyTree


@dataclass(frozen=True)
class ActorCritic:
    """The networks of a policy and of its value function. All observations are normalised."""

    actor: nets.GaussianMLP
    critic: nets.Scalar

    @staticmethod
    def build(action_size: int, config: Config, action_limit: float = 1.0) -> ActorCritic:
        """The networks of a configuration."""
        return ActorCritic(nets.GaussianMLP(action_size, config, action_limit), nets.value(config))

    def init(self, key: Key, obs_size: int) -> PolicyState:
        """Fresh networks."""
        actor_key, critic_key = jax.random.split(key)
        obs = jnp.zeros((1, obs_size))
        params = {"actor": self.actor.init(actor_key, obs), "critic": self.critic.init(critic_key, obs)}
        return PolicyState(train_state.init(params), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def pi(self, actor_params: PyTree, log_std_offset: jax.Array, obs: jax.Array) -> Gaussian:
        """pi(.|s) of an actor's parameters, for observations `[..., obs]`."""
        raw: Gaussian = nets.apply(self.actor, actor_params, obs)
        return dataclasses.replace(raw, log_std=raw.log_std + log_std_offset)

    def distribution(self, policy: PolicyState, obs: jax.Array) -> Gaussian:
        """pi(.|s) for observations `[..., obs]`."""
        return self.pi(policy.nets.params["actor"], policy.log_std_offset, obs)

    def value(self, critic_params: PyTree, obs: jax.Array) -> jax.Array:
        """V(s) `[...]`, in units of the scaled reward."""
        return nets.apply(self.critic, critic_params, obs)

    def prepare(
        self, policy: PolicyState, batch: Transition, penalty_data: PyTree, hparams: HParams
    ) -> tuple[PolicyState, Batch, jax.Array]:
        """Scales the rewards, estimates the advantages and standardises them.

        Returns:
          The policy with an updated `return_var`, the samples, and the fraction `[]` of the returns' variance that the
          value function explained.
        """
        policy, scaled = scale_rewards(policy, batch.reward, batch.terminated + batch.truncated, hparams.gamma)
        values, next_values = (self.value(policy.nets.params["critic"], x) for x in (batch.obs, batch.next_obs))
        ends = batch.terminated, batch.truncated
        advantage, target = gae(scaled, values, next_values, *ends, hparams.gamma, hparams.gae_lambda)
        explained = 1.0 - jnp.var(target - values) / (jnp.var(target) + 1e-8)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        return policy, Batch(batch.obs, batch.action, batch.log_prob, advantage, target, penalty_data), explained


def minibatches(key: Key, batch: PyTree, config: Config) -> tuple[PyTree, jax.Array]:
    """The samples `[T, N, ...]` as `[T * N, ...]`, and an index into them: see `shuffle`."""
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
    return flat, shuffle(key, config.steps_per_iteration, config.ppo_epochs, config.ppo_minibatches)


def shuffle(key: jax.Array, size: int, epochs: int, minibatches: int) -> jax.Array:
    """Indices of the samples of every minibatch, `[epochs * minibatches, size / minibatches]`.

    Every sample is in one minibatch of each epoch. The order of epoch e is the (e+1)-th power of one random
    permutation. A new order costs only a gather; a sort in each epoch took a tenth of a whole iteration on a CPU.
    """
    permutation = jnp.argsort(jax.random.bits(key, (size,)))
    _, orders = jax.lax.scan(lambda order, _: (order[permutation], order), permutation, length=epochs)
    return orders.reshape(epochs * minibatches, size // minibatches)


def scale_rewards(policy: PolicyState, reward, done, gamma) -> tuple[PolicyState, jax.Array]:
    """Divides rewards by the running standard deviation of the discounted return `R_t = r_t + gamma R_{t-1}`.

    Args:
      reward: `[T, N]`.
      done: `[T, N]` 1 where the episode ended, by the task or by the time limit: R starts again from 0.
      gamma: discount factor.

    Returns:
      The policy with an updated variance, and the scaled rewards `[T, N]`.
    """

    def forward(discounted_return, step):
        reward_t, done_t = step
        discounted_return = reward_t + gamma * discounted_return
        return discounted_return * (1.0 - done_t), discounted_return

    _, returns = jax.lax.scan(forward, reward[0] * 0.0, (reward, done))
    count = policy.return_count + 1
    # The first iterations count equally; later iterations fade with a time constant of 1 / (1 - RETURN_VAR_DECAY).
    weight = jnp.maximum(1.0 / count, 1.0 - RETURN_VAR_DECAY)
    var = policy.return_var + weight * (returns.var() - policy.return_var)
    policy = dataclasses.replace(policy, return_var=var, return_count=count)
    return policy, reward * jax.lax.rsqrt(var + 1e-8)
