"""What the discriminator is shown: samples of the expert and of the policy, and what its logit needs of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from eairl_jax import agent, discriminator, empowerment, replay, train_state
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.types import Demonstrations, HParams, Key, Transition


def check_segments(config: Config, demo_length: int | None = None) -> None:
    """Raises `InputError` where trajectories are judged and rollouts or demonstrations do not hold whole ones.

    Only lengths can be checked: an environment that ends episodes before `config.episode_length` is not for GAN-GCL.
    """
    for name, length in (("rollout_length", config.rollout_length), ("the demonstrations' length", demo_length)):
        if config.discriminates == "trajectories" and length and length % config.episode_length:
            raise InputError(
                f"{config.method} discriminates whole trajectories: {name} = {length} must be a multiple of episode_length = "
                f"{config.episode_length}, or episodes are cut in pieces"
            )


def draw(key: Key, demos: Demonstrations, past: replay.Replay, raw: Transition, config: Config):
    """Raw minibatches `[updates, batch, length, ...]` of the expert and of the policy's history."""
    check_segments(config, demos.reward.shape[1])
    length = config.episode_length if config.discriminates == "trajectories" else 1
    updates, batch = config.discriminator_updates, -(-config.discriminator_batch // length)
    expert_key, policy_key = jax.random.split(key)
    index = jax.random.randint(expert_key, (updates, batch), 0, demos.reward.size // length)
    expert = train_state.rows(demos, 2, train_state.segment(index, length))
    return expert, replay.draw(policy_key, past, raw, updates, batch, length, config)


def prepare(
    raw, pi, emp, acting: agent.Agent, hparams: HParams, config: Config, scoring: bool = False
) -> discriminator.Samples:
    """What the logit needs of raw samples, log pi under the current policy `pi`; None: as it was when they were taken.

    Phi is a constant in it: no gradient of the discriminator's loss reaches Phi.
    """
    x = agent.normalized(acting, raw)
    log_prob = pi(x.obs).log_prob(x.action) if pi else raw.log_prob
    phi_shaping = jnp.zeros_like(log_prob)
    if config.shaping in ("empowerment", "both"):
        next_params = emp.phi.params if scoring and config.policy_phi == "online" else emp.phi_target
        phi, next_phi = empowerment.phi(emp.phi.params, x.obs, config), empowerment.phi(next_params, x.next_obs, config)
        phi_shaping = discriminator.shaping(
            phi, next_phi, x.terminated, discriminator.shaping_discount(hparams, config)
        )
    seen = raw if config.reward_obs == "raw" else x
    return discriminator.Samples(
        seen.obs, x.action, seen.next_obs, x.terminated, log_prob, jax.lax.stop_gradient(phi_shaping)
    )  # fmt: skip
