"""The discriminator's data: minibatches of the expert and the policy, and the samples that the logit depends on."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from eairl_jax import agent, discriminator, empowerment, exact_empowerment, horizon, methods, replay, train_state
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.gaussian import Gaussian
from eairl_jax.types import Demonstrations, Env, HParams, Key, PyTree, Transition

Steps = Transition | Demonstrations


def check_whole_trajectories(env: Env, config: Config) -> None:
    """Checks that every trajectory is an episode of full length if the method discriminates trajectories.

    Raises:
      InputError: if episodes of the environment, as learning treats them, may end early, or if a rollout does not
        consist of whole episodes.
    """
    check_segments(config)
    if config.discriminates == "trajectories" and horizon.can_end(env):
        raise InputError(
            f"{config.method} discriminates whole trajectories of {config.episode_length} steps, and with horizon "
            "variable an episode may end early: choose the horizon fixed or absorbing, or another method"
        )


def check_segments(config: Config, demo_length: int | None = None) -> None:
    """Checks that rollouts and demonstrations consist of whole episodes if the method discriminates trajectories.

    Args:
      demo_length: steps of an episode of the demonstrations, or of all of them.

    Raises:
      InputError: if a length is not a multiple of `config.episode_length`.
    """
    for name, length in (("rollout_length", config.rollout_length), ("the length of the demonstrations", demo_length)):
        is_checked = config.discriminates == "trajectories" and config.episode_length > 0
        if is_checked and length and length % config.episode_length:
            raise InputError(
                f"{config.method} discriminates whole trajectories: {name} = {length} must be a multiple of "
                f"episode_length = {config.episode_length}; change one of the two"
            )


def draw_minibatches(
    key: Key, demos: Demonstrations, past: replay.Replay, raw: Transition, hparams: HParams, config: Config
) -> tuple[Demonstrations, Transition]:
    """Raw minibatches `[updates, batch, length, ...]` of the expert, and as many of the policy.

    Args:
      past: the policy's samples of this iteration and of previous iterations.
      raw: `[T, N, ...]` the policy's samples of this iteration.

    Raises:
      InputError: see `check_segments`; or if the method needs actions of the expert and there are none.
    """
    stay = horizon.stay(hparams, config)
    steps = horizon.step_count(demos, config, stay)
    check_segments(config, steps if isinstance(steps, int) else None)
    length = config.episode_length if config.discriminates == "trajectories" else 1
    updates, batch = config.discriminator_updates, -(-config.discriminator_batch // length)
    expert_key, policy_key = jax.random.split(key)
    if demos.action is None and methods.needs_expert_actions(config):
        raise InputError(
            f"{config.method} with the reward form {config.reward_form} needs the expert's actions, and these "
            f"demonstrations hold none: {methods.STATE_ONLY_ADVICE}"
        )
    segments = jax.random.randint(expert_key, (updates, batch), 0, steps // length)
    expert = horizon.take_steps(demos, train_state.segment_indices(segments, length), config, stay)
    return expert, replay.draw_segments(policy_key, past, raw, (updates, batch, length), config, stay)


def for_loss(
    raw: Steps,
    pi: Callable[[jax.Array], Gaussian],
    emp: empowerment.Empowerment | None,
    exact_phi: exact_empowerment.Potential | tuple[()],
    acting: agent.Agent,
    hparams: HParams,
    config: Config,
) -> discriminator.Samples:
    """Samples for the discriminator's loss: log pi(a|s) is that of the current policy `pi`, Phi(s') is Phi'(s')."""
    x = horizon.without_ends(agent.normalize_obs(acting, raw), config)
    action_pi = pi(x.obs)
    if x.action is None:  # a method that needs no actions of the expert reads neither of the two
        x = x._replace(action=jnp.zeros_like(action_pi.mean))
        log_prob = jnp.zeros(x.terminated.shape)
    else:
        log_prob = action_pi.log_prob(x.action)
    next_params = emp.phi_target if emp else None
    phi_shaping = _phi_shaping(raw, x, emp, next_params, exact_phi, hparams, config)
    return _samples(raw, x, log_prob, phi_shaping, config)


def for_policy_reward(
    raw: Transition,
    emp: empowerment.Empowerment | None,
    exact_phi: exact_empowerment.Potential | tuple[()],
    acting: agent.Agent,
    hparams: HParams,
    config: Config,
) -> discriminator.Samples:
    """Samples for the policy's reward: log pi(a|s) as stored, Phi(s') as `config.policy_phi` says."""
    x = horizon.without_ends(agent.normalize_obs(acting, raw), config)
    next_params = None
    if emp:
        next_params = emp.phi.params if config.policy_phi == "online" else emp.phi_target
    phi_shaping = _phi_shaping(raw, x, emp, next_params, exact_phi, hparams, config)
    return _samples(raw, x, x.log_prob, phi_shaping, config)


def _samples(raw: Steps, x: Steps, log_prob: jax.Array, phi_shaping, config: Config) -> discriminator.Samples:
    """Joins the parts; `x` is `raw` with normalised observations."""
    reward_input = raw if config.reward_obs == "raw" else x
    return discriminator.Samples(
        obs=reward_input.obs,
        action=horizon.executed(raw.obs, x.action, config),
        next_obs=reward_input.next_obs,
        terminated=x.terminated,
        log_prob=log_prob * horizon.alive(raw.obs, config),
        phi_shaping=phi_shaping,
    )


def _phi_shaping(
    raw: Steps,
    x: Steps,
    emp: empowerment.Empowerment | None,
    next_params: PyTree,
    exact_phi: exact_empowerment.Potential | tuple[()],
    hparams: HParams,
    config: Config,
) -> jax.Array:
    """`gamma Phi(s') - Phi(s)` `[...]`, a learned Phi(s') by `next_params`; 0 if Phi does not shape the reward.

    The result is a constant: no gradient of the discriminator's loss reaches Phi.
    """
    if exact_phi:
        phi, next_phi = exact_empowerment.phi(exact_phi, raw.obs), exact_empowerment.phi(exact_phi, raw.next_obs)
    elif emp is None or config.shaping not in methods.LEARNED_PHI:
        return jnp.zeros(x.terminated.shape)
    else:
        phi, next_phi = empowerment.phi(emp.phi.params, x.obs, config), empowerment.phi(next_params, x.next_obs, config)
    discount = discriminator.shaping_discount(hparams, config)
    return jax.lax.stop_gradient(discriminator.shaping(phi, next_phi, x.terminated, discount))
