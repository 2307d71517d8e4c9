"""Proximal policy optimisation (Schulman et al. 2017): the policy, its value function and their update."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import optimize
from eairl_jax.config import Config
from eairl_jax.gae import gae
from eairl_jax.gaussian import Gaussian
from eairl_jax.nets import GaussianMLP, value
from eairl_jax.types import PolicyOptimizer

# Decay, per iteration, of the running variance of returns.
RETURN_VAR_DECAY = 0.9


@struct.dataclass
class PolicyState:
    """A policy in training.

    Attributes:
      nets: parameters {"actor", "critic"} and their Adam moments.
      log_std_offset: `[]` added to the actor's log std: the schedule of `HParams.std_end`.
      return_var, return_count: running variance of the discounted return and the iterations behind it. Rewards are
        divided by its root, so that learned rewards of any scale train at the same rates.
    """

    nets: optimize.Fitted
    log_std_offset: jax.Array
    return_var: jax.Array
    return_count: jax.Array


def ppo(obs_size: int, action_size: int, config: Config) -> PolicyOptimizer:
    """PPO with a clipped objective; observations it is given are already normalised."""
    actor, critic = GaussianMLP(action_size, config), value(config)

    def init(key):
        actor_key, critic_key = jax.random.split(key)
        obs = jnp.zeros((1, obs_size))
        params = {"actor": actor.init(actor_key, obs), "critic": critic.init(critic_key, obs)}
        return PolicyState(optimize.start(params), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def pi(params, log_std_offset, obs) -> Gaussian:
        raw: Gaussian = actor.apply(params, obs)  # pyright: ignore
        return Gaussian(raw.mean, raw.log_std + log_std_offset)

    def distribution(policy: PolicyState, obs) -> Gaussian:
        return pi(policy.nets.params["actor"], policy.log_std_offset, obs)

    def update(key, policy: PolicyState, batch, penalty, penalty_data, hparams):
        policy, scaled = scale_rewards(policy, batch.reward, batch.terminated + batch.truncated, hparams.gamma)
        params = policy.nets.params
        before = distribution(policy, batch.obs)
        values = critic.apply(params["critic"], batch.obs)
        next_values = critic.apply(params["critic"], batch.next_obs)
        advantage, target = gae(
            scaled, values, next_values, batch.terminated, batch.truncated, hparams.gamma, hparams.gae_lambda
        )  # fmt: skip
        explained = 1.0 - jnp.var(target - values) / (jnp.var(target) + 1e-8)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)

        def loss(params, minibatch):
            obs, action, old_log_prob, advantage, target, penalty_data = minibatch
            now = pi(params["actor"], policy.log_std_offset, obs)
            log_prob = now.log_prob(action)
            ratio = jnp.exp(log_prob - old_log_prob)
            clipped = jnp.clip(ratio, 1.0 - hparams.clip_eps, 1.0 + hparams.clip_eps)
            policy_loss = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
            value_loss = 0.5 * jnp.mean((critic.apply(params["critic"], obs) - target) ** 2)  # pyright: ignore
            cost = penalty(log_prob, penalty_data).mean()
            entropy = now.entropy().mean()
            total = policy_loss + cost - hparams.entropy_weight * entropy + value_loss
            return total, {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy}

        def step(nets, minibatch):
            gradient, metrics = jax.grad(loss, has_aux=True)(nets.params, minibatch)
            gradient = optimize.clip_norm(gradient, hparams.max_grad_norm)
            return optimize.descend(nets, gradient, hparams.policy_lr), metrics

        samples = (batch.obs, batch.action, batch.log_prob, advantage, target, penalty_data)
        samples = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)
        index = shuffle(key, config.steps_per_iteration, config.ppo_epochs, config.ppo_minibatches)
        nets, metrics = jax.lax.scan(
            lambda nets, rows: step(nets, jax.tree.map(lambda x: x[rows], samples)), policy.nets, index
        )
        policy = policy.replace(nets=nets)  # pyright: ignore
        metrics = jax.tree.map(lambda m: m.mean(), metrics)
        kl = before.kl(distribution(policy, batch.obs)).mean()
        policy = policy.replace(log_std_offset=jnp.log(hparams.std_end))
        return policy, metrics | {"kl": kl, "explained_variance": explained}

    return PolicyOptimizer(init, update, distribution)


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
