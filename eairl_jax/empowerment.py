"""Variational empowerment: the inverse model q(a|s,s'), the potential Phi(s), and the loss l_I that ties them to pi.

Section 2.3 of the paper, after Mohamed and Rezende (2015).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import nets, train_state
from eairl_jax.config import Config
from eairl_jax.gaussian import Gaussian
from eairl_jax.types import HParams, Key, Metrics, Penalty, PyTree, Transition, no_penalty


def potential_target(log_q: jax.Array, log_prob: jax.Array, beta: float | jax.Array) -> jax.Array:
    """`beta log q(a|s,s') - log pi(a|s)`: the regression target of Phi(s). All shapes are equal."""
    return beta * log_q - log_prob


def l_i(log_q: jax.Array, log_prob: jax.Array, phi: jax.Array, beta: float | jax.Array, power: int) -> jax.Array:
    """`l_I = |beta log q(a|s,s') - (log pi(a|s) + Phi(s))|^p`, Eq. 7. All shapes are equal.

    The loss is 0 if pi is the empowerment-maximising policy w* = exp(beta E log q) / Z and Phi = log Z.

    Args:
      log_q: log q(a|s,s') of the actions.
      log_prob: log pi(a|s) of the actions.
      phi: Phi(s).
      power: p, 1 or 2.
    """
    return jnp.abs(potential_target(log_q, log_prob, beta) - phi) ** power


def l_q(q: Gaussian, action: jax.Array, loss: str) -> jax.Array:
    """The loss `[...]` of the inverse model for actions `[..., act]`.

    "likelihood": `-log q(a|s,s')`, section 2.3. "mse": `|mean_q(s,s') - a|^2`, Eq. 8, which does not train q's std.
    """
    if loss == "mse":
        return jnp.sum((q.mean - action) ** 2, axis=-1)
    return -q.log_prob(action)


@struct.dataclass
class Empowerment:
    """The inverse model and the potential in training.

    Attributes:
      inverse: q(a|s,s') (phi in the paper).
      phi: Phi(s) (varphi in the paper).
      phi_target: parameters of Phi'(s), the slow copy of Phi.
    """

    inverse: train_state.TrainState
    phi: train_state.TrainState
    phi_target: PyTree


def init(key: Key, obs_size: int, action_size: int, config: Config) -> Empowerment:
    """Fresh networks; Phi' is a copy of Phi."""
    q_key, phi_key = jax.random.split(key)
    obs = jnp.zeros((1, obs_size))
    phi_params = nets.scalar(config).init(phi_key, obs)
    q_params = nets.GaussianMLP(action_size, config).init(q_key, obs, obs)
    return Empowerment(train_state.init(q_params), train_state.init(phi_params), jax.tree.map(jnp.copy, phi_params))


def q_distribution(params: PyTree, x: Transition, config: Config, limit: float = 1.0) -> Gaussian:
    """q(.|s,s'), observations normalised; `limit` is the largest magnitude of an executed action."""
    return nets.apply(nets.GaussianMLP(x.action.shape[-1], config, limit), params, x.obs, x.next_obs)


def phi(params: PyTree, obs: jax.Array, config: Config) -> jax.Array:
    """Phi(s) `[...]`, observations normalised."""
    return nets.apply(nets.scalar(config), params, obs)


class Terms(NamedTuple):
    """The terms of l_I beside Phi(s), for each transition, `[...]`.

    Attributes:
      log_q: log q(a|s,s').
      log_prob: log pi(a|s) of the same action; with resampled actions, of another action.
      action: `[..., act]` the action of `log_prob`.
    """

    log_q: jax.Array
    log_prob: jax.Array
    action: jax.Array


def terms(key: Key, q_params: PyTree, pi: Gaussian, x: Transition, config: Config, limit: float = 1.0) -> Terms:
    """log q and log pi of the actions that `config.l_i_actions` names.

    "stored": the actions of the transitions. "resampled": one new action from q and another from pi (the release).
    """
    q = q_distribution(q_params, x, config, limit)
    if config.l_i_actions == "stored":
        return Terms(q.log_prob(x.action), x.log_prob, x.action)
    q_noise, pi_noise = jax.random.normal(key, (2, *x.action.shape))
    action = pi.sample(pi_noise)
    return jax.lax.stop_gradient(Terms(q.log_prob(q.sample(q_noise)), pi.log_prob(action), action))


def fit(
    key: Key,
    state: Empowerment,
    batch: Transition,
    pi: Callable[[jax.Array], Gaussian],
    hparams: HParams,
    config: Config,
    limit: float = 1.0,
) -> tuple[Empowerment, Metrics]:
    """Updates q by l_q, then Phi by l_I with the updated q.

    Args:
      batch: `[T, N, ...]` the policy's transitions, observations normalised.
      pi: `obs -> Gaussian`, the policy that acted.
      limit: the largest magnitude of an executed action.
    """
    q_key, phi_key = jax.random.split(key)
    count = (2, config.empowerment_updates, config.empowerment_batch)

    def q_loss(params, x: Transition):
        loss = l_q(q_distribution(params, x, config, limit), x.action, config.inverse_loss).mean()
        return loss, {"l_q": loss}

    q_minibatches = train_state.draw_minibatches(q_key, batch, *count)
    inverse, q_metrics = train_state.fit(state.inverse, q_loss, q_minibatches, hparams.inverse_lr)

    def phi_loss(params, minibatch):
        obs, t = minibatch
        potential = phi(params, obs, config)
        loss = l_i(t.log_q, t.log_prob, potential, hparams.beta, config.l_i_power).mean()
        return loss, {"l_i": loss, "empowerment": potential.mean(), "empowerment_std": potential.std()}

    x = train_state.draw_minibatches(phi_key, batch, *count)
    x_terms = terms(jax.random.fold_in(phi_key, 1), inverse.params, pi(x.obs), x, config, limit)
    phi_state, phi_metrics = train_state.fit(state.phi, phi_loss, (x.obs, x_terms), hparams.phi_lr)
    return Empowerment(inverse, phi_state, state.phi_target), q_metrics | phi_metrics


def sync(state: Empowerment, iteration: jax.Array, config: Config) -> Empowerment:
    """Copies Phi into Phi' at every `phi_sync_interval`-th iteration."""
    due = iteration % config.phi_sync_interval == 0
    phi_target = jax.tree.map(lambda new, old: jnp.where(due, new, old), state.phi.params, state.phi_target)
    return Empowerment(state.inverse, state.phi, phi_target)


def with_l_i(
    key: Key,
    tau: Transition,
    pi: Callable[[jax.Array], Gaussian],
    emp: Empowerment | None,
    hparams: HParams,
    config: Config,
    limit: float = 1.0,
) -> tuple[Transition, Penalty, PyTree]:
    """Adds lambda_I l_I to the policy's objective: as a cost in the loss (Eq. 11), or in the reward (`config.l_i_in`).

    Args:
      tau: `[T, N, ...]` the policy's transitions, observations normalised.
      pi: `obs -> Gaussian`, the policy that acted.
      emp: None adds nothing.
      limit: the largest magnitude of an executed action.

    Returns:
      The transitions, the penalty for the policy optimiser, and the penalty's data for each transition.
    """
    if not emp:
        return tau, no_penalty, ()
    tau_terms = terms(key, emp.inverse.params, pi(tau.obs), tau, config, limit)
    potential = phi(emp.phi.params, tau.obs, config)

    def cost(log_prob, log_q, potential):
        return hparams.lambda_i * l_i(log_q, log_prob, potential, hparams.beta, config.l_i_power)

    if config.l_i_in == "reward":
        reward = tau.reward - cost(tau_terms.log_prob, tau_terms.log_q, potential)
        return tau._replace(reward=reward), no_penalty, ()

    def penalty(pi, log_prob, data):
        log_q, potential, *resampled = data
        return cost(pi.log_prob(resampled[0]) if resampled else log_prob, log_q, potential)

    resampled = (tau_terms.action,) if config.l_i_actions == "resampled" else ()
    return tau, penalty, (tau_terms.log_q, potential, *resampled)
