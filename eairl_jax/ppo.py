"""Proximal policy optimisation (Schulman et al. 2017)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from eairl_jax import train_state
from eairl_jax.actor_critic import ActorCritic, Batch, PolicyState, minibatches
from eairl_jax.config import Config
from eairl_jax.shards import ONE, Shards
from eairl_jax.types import PolicyOptimizer


def ppo(
    obs_size: int, action_size: int, config: Config, action_limit: float = 1.0, shards: Shards = ONE
) -> PolicyOptimizer:
    """PPO with a clipped objective; one loss contains the policy and the value function."""
    nets = ActorCritic.build(action_size, config, action_limit)

    def loss(params, log_std_offset, minibatch: Batch, penalty, hparams):
        pi = nets.pi(params["actor"], log_std_offset, minibatch.obs)
        log_prob = pi.log_prob(minibatch.action)
        ratio = jnp.exp(log_prob - minibatch.log_prob)
        clipped = jnp.clip(ratio, 1.0 - hparams.clip_eps, 1.0 + hparams.clip_eps)
        policy_loss = -jnp.minimum(ratio * minibatch.advantage, clipped * minibatch.advantage).mean()
        value_loss = 0.5 * jnp.mean((nets.value(params["critic"], minibatch.obs) - minibatch.value_target) ** 2)
        cost = penalty(pi, log_prob, minibatch.penalty_data).mean()
        entropy = pi.entropy().mean()
        total = policy_loss + cost - hparams.entropy_weight * entropy + value_loss
        return total, {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy}

    def update(key, policy: PolicyState, batch, penalty, penalty_data, hparams):
        before = nets.distribution(policy, batch.obs)
        policy, prepared, explained = nets.prepare(policy, batch, penalty_data, hparams)
        samples, indices = minibatches(key, prepared, config)

        def step(state, index):
            minibatch = jax.tree.map(lambda x: x[index], samples)
            gradient, metrics = shards.mean(
                jax.grad(loss, has_aux=True)(state.params, policy.log_std_offset, minibatch, penalty, hparams)
            )
            gradient = train_state.clip_norm(gradient, hparams.max_grad_norm)
            return train_state.adam_step(state, gradient, hparams.policy_lr), metrics

        state, metrics = jax.lax.scan(step, policy.nets, shards.part(indices, axis=1))
        policy = dataclasses.replace(policy, nets=state)
        metrics = jax.tree.map(lambda m: m.mean(), metrics)
        kl = before.kl(nets.distribution(policy, batch.obs)).mean()
        policy = dataclasses.replace(policy, log_std_offset=jnp.log(hparams.std_final_fraction))
        return policy, metrics | {"kl": kl, "explained_variance": explained}

    return PolicyOptimizer(lambda key: nets.init(key, obs_size), update, nets.distribution)
