"""What the policy optimisers share: the policy in training, its value function, its advantages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import train_state
from eairl_jax.config import Config
from eairl_jax.gae import gae
from eairl_jax.gaussian import Gaussian
from eairl_jax.nets import GaussianMLP, Scalar, value
from eairl_jax.types import HParams, Key, PyTree, Transition

# Decay, per iteration, of the running variance of returns.
RETURN_VAR_DECAY = 0.9


@struct.dataclass
class PolicyState:
    """A policy in training.

    Attributes:
      nets: parameters {"actor", "critic"} and their Adam moments.
      log_std_offset: `[]` added to the actor's log std: the schedule of `HParams.std_final_fraction`.
      return_var, return_count: running variance of the discounted return and the iterations behind it. Rewards are
        divided by its root, so that learned rewards of any scale train at the same rates.
    """

    nets: train_state.TrainState
    log_std_offset: jax.Array
    return_var: jax.Array
    return_count: jax.Array


class Batch(NamedTuple):
    """One iteration's samples `[T, N, ...]`, as the surrogate objective needs them."""

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    value_target: jax.Array
    penalty_data: PyTree


@dataclass(frozen=True)
class ActorCritic:
    """The networks of a policy and its value function; observations they are given are already normalised."""

    actor: GaussianMLP
    critic: Scalar

    @staticmethod
    def build(action_size: int, config: Config, action_limit: float = 1.0) -> ActorCritic:
        """Those that a configuration asks for."""
        return ActorCritic(GaussianMLP(action_size, config, action_limit), value(config))

    def init(self, key: Key, obs_size: int) -> PolicyState:
        """Fresh networks."""
        actor_key, critic_key = jax.random.split(key)
        obs = jnp.zeros((1, obs_size))
        params = {"actor": self.actor.init(actor_key, obs), "critic": self.critic.init(critic_key, obs)}
        return PolicyState(train_state.start(params), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def pi(self, actor_params: PyTree, log_std_offset: jax.Array, obs: jax.Array) -> Gaussian:
        """pi(.|s) by the parameters of an actor, `[..., obs]`."""
        raw: Gaussian = self.actor.apply(actor_params, obs)  # pyright: ignore
        return raw.replace(log_std=raw.log_std + log_std_offset)  # pyright: ignore

    def distribution(self, policy: PolicyState, obs: jax.Array) -> Gaussian:
        """pi(.|s) `[..., obs]`."""
        return self.pi(policy.nets.params["actor"], policy.log_std_offset, obs)

    def value(self, critic_params: PyTree, obs: jax.Array) -> jax.Array:
        """V(s) `[...]`, in units of the scaled reward."""
        return self.critic.apply(critic_params, obs)  # pyright: ignore

    def prepare(
        self, policy: PolicyState, batch: Transition, penalty_data: PyTree, hparams: HParams
    ) -> tuple[PolicyState, Batch, jax.Array]:
        """Scales the rewards and estimates advantages, which are then standardised.

        Returns:
          The policy with its reward scale moved on, the samples, and the share of the returns' variance that the value
          function had explained.
        """
        policy, scaled = scale_rewards(policy, batch.reward, batch.terminated + batch.truncated, hparams.gamma)
        values, next_values = (self.value(policy.nets.params["critic"], x) for x in (batch.obs, batch.next_obs))
        advantage, target = gae(
            scaled, values, next_values, batch.terminated, batch.truncated, hparams.gamma, hparams.gae_lambda
        )  # fmt: skip
        explained = 1.0 - jnp.var(target - values) / (jnp.var(target) + 1e-8)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        return policy, Batch(batch.obs, batch.action, batch.log_prob, advantage, target, penalty_data), explained


def minibatches(key: Key, batch: PyTree, config: Config) -> tuple[PyTree, jax.Array]:
    """Samples `[T, N, ...]` as `[T * N, ...]`, and the rows of every minibatch of every epoch."""
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
    return flat, shuffle(key, config.steps_per_iteration, config.ppo_epochs, config.ppo_minibatches)


def shuffle(key: jax.Array, size: int, epochs: int, minibatches: int) -> jax.Array:
    """Rows of every minibatch, `[epochs * minibatches, size / minibatches]`; every row once an epoch.

    Epoch e goes in the order of the (e+1)-th power of one random permutation: a new order for the price of a gather.
    Sorting anew each epoch took a tenth of a whole iteration on a CPU.
    """
    permutation = jnp.argsort(jax.random.bits(key, (size,)))
    _, orders = jax.lax.scan(lambda order, _: (order[permutation], order), permutation, length=epochs)
    return orders.reshape(epochs * minibatches, size // minibatches)


def scale_rewards(policy: PolicyState, reward, done, gamma) -> tuple[PolicyState, jax.Array]:
    """Divides rewards `[T, N]` by the running standard deviation of the discounted return."""

    def forward(total, step):
        reward_t, done_t = step
        total = reward_t + gamma * total
        return total * (1.0 - done_t), total

    _, totals = jax.lax.scan(forward, reward[0] * 0.0, (reward, done))
    count = policy.return_count + 1
    # The first iterations average evenly; after that the memory is 1 / (1 - RETURN_VAR_DECAY) iterations.
    weight = jnp.maximum(1.0 / count, 1.0 - RETURN_VAR_DECAY)
    var = policy.return_var + weight * (totals.var() - policy.return_var)
    policy = policy.replace(return_var=var, return_count=count)  # pyright: ignore
    return policy, reward * jax.lax.rsqrt(var + 1e-8)
