"""Variational empowerment: the inverse model q(a|s,s'), the potential Phi(s), and the loss that ties them to pi.

Section 2.3 of the paper, after Mohamed and Rezende (2015).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import train_state
from eairl_jax.config import Config
from eairl_jax.gaussian import Gaussian
from eairl_jax.nets import GaussianMLP, scalar
from eairl_jax.types import HParams, Key, Metrics, PyTree, Transition, no_penalty


def potential_target(log_q: jax.Array, log_prob: jax.Array, beta: float | jax.Array) -> jax.Array:
    """`beta log q(a|s,s') - log pi(a|s)`: what Phi(s) is regressed on. Any equal shapes."""
    return beta * log_q - log_prob


def l_i(log_q: jax.Array, log_prob: jax.Array, phi: jax.Array, beta: float | jax.Array, power: int) -> jax.Array:
    """`l_I = |beta log q(a|s,s') - (log pi(a|s) + Phi(s))|^p`, Eq. 7, on the actions that were taken.

    Zero where pi is the empowerment-maximising policy w* = exp(beta E log q) / Z and Phi = log Z.

    Args:
      log_q, log_prob, phi: of any one shape.
      power: p, 1 or 2.
    """
    return jnp.abs(potential_target(log_q, log_prob, beta) - phi) ** power


def l_q(q: Gaussian, action: jax.Array, loss: str) -> jax.Array:
    """The inverse model's loss `[...]` on actions `[..., act]`.

    "likelihood": `-log q(a|s,s')`, section 2.3. "mse": `|mean_q(s,s') - a|^2`, Eq. 8, which leaves q's std alone.
    """
    if loss == "mse":
        return jnp.sum((q.mean - action) ** 2, axis=-1)
    return -q.log_prob(action)


@struct.dataclass
class Empowerment:
    """The inverse model q, the potential Phi and its slow copy Phi', with their optimisers."""

    inverse: train_state.TrainState
    phi: train_state.TrainState
    phi_target: PyTree


def init(key: Key, obs_size: int, action_size: int, config: Config) -> Empowerment:
    """Fresh networks; Phi' starts as a copy of Phi."""
    q_key, phi_key = jax.random.split(key)
    obs = jnp.zeros((1, obs_size))
    phi = scalar(config).init(phi_key, obs)
    inverse = GaussianMLP(action_size, config).init(q_key, obs, obs)
    return Empowerment(train_state.start(inverse), train_state.start(phi), jax.tree.map(jnp.copy, phi))


def q_distribution(params: PyTree, x, config: Config, limit: float = 1.0) -> Gaussian:
    """q(.|s,s'), observations normalised; `limit` is the environment's bound of actions."""
    return GaussianMLP(x.action.shape[-1], config, limit).apply(params, x.obs, x.next_obs)  # pyright: ignore


def phi(params: PyTree, obs: jax.Array, config: Config) -> jax.Array:
    """Phi(s) `[...]`, observations normalised."""
    return scalar(config).apply(params, obs)  # pyright: ignore


class Terms(NamedTuple):
    """What l_I needs of transitions beside Phi(s), `[...]` each.

    Attributes:
      log_q: log q(a|s,s').
      log_prob: log pi(a|s), of the same action, or, drawn anew, of another one.
      action: `[..., act]` the action of `log_prob`.
    """

    log_q: jax.Array
    log_prob: jax.Array
    action: jax.Array


def terms(key: Key, q_params: PyTree, pi: Gaussian, x: Transition, config: Config, limit: float = 1.0) -> Terms:
    """log q and log pi of the actions taken, or of actions drawn from q and from pi, each on its own (the release)."""
    q = q_distribution(q_params, x, config, limit)
    if config.l_i_actions == "stored":
        return Terms(q.log_prob(x.action), x.log_prob, x.action)
    q_noise, pi_noise = jax.random.normal(key, (2, *x.action.shape))
    action = pi.sample(pi_noise)
    return jax.lax.stop_gradient(Terms(q.log_prob(q.sample(q_noise)), pi.log_prob(action), action))


def fit(
    key: Key, state: Empowerment, batch: Transition, pi: Callable, hparams: HParams, config: Config, limit: float = 1.0
) -> tuple[Empowerment, Metrics]:
    """Fits q by l_q, then Phi by l_I against the q just fitted, on the policy's own transitions `[T, N, ...]`.

    Args:
      pi: `obs -> Gaussian`, the policy that acted.
      limit: the largest magnitude of an executed action.
    """
    q_key, phi_key = jax.random.split(key)
    count = (2, config.empowerment_updates, config.empowerment_batch)

    def q_loss(params, x: Transition):
        loss = l_q(q_distribution(params, x, config, limit), x.action, config.inverse_loss).mean()
        return loss, {"l_q": loss}

    inverse, q_metrics = train_state.fit(
        state.inverse, q_loss, train_state.draw(q_key, batch, *count), hparams.inverse_lr
    )

    def phi_loss(params, minibatch):
        obs, own = minibatch
        potential = phi(params, obs, config)
        loss = l_i(own.log_q, own.log_prob, potential, hparams.beta, config.l_i_power).mean()
        return loss, {"l_i": loss, "empowerment": potential.mean(), "empowerment_std": potential.std()}

    x = train_state.draw(phi_key, batch, *count)
    own = terms(jax.random.fold_in(phi_key, 1), inverse.params, pi(x.obs), x, config, limit)
    fitted, phi_metrics = train_state.fit(state.phi, phi_loss, (x.obs, own), hparams.phi_lr)
    return Empowerment(inverse, fitted, state.phi_target), q_metrics | phi_metrics


def sync(state: Empowerment, iteration: jax.Array, config: Config) -> Empowerment:
    """Copies Phi into Phi' at every `phi_sync_interval`-th iteration."""
    due = iteration % config.phi_sync_interval == 0
    copied = jax.tree.map(lambda new, slow: jnp.where(due, new, slow), state.phi.params, state.phi_target)
    return Empowerment(state.inverse, state.phi, copied)


def with_l_i(key: Key, tau: Transition, pi, emp, hparams: HParams, config: Config, limit: float = 1.0):
    """lambda_I l_I where `config.l_i_in` says: in the reward, or as a cost on the policy (Eq. 11).

    Returns:
      The transitions, the penalty, and what the penalty needs of each transition.
    """
    if not emp:
        return tau, no_penalty, ()
    own = terms(key, emp.inverse.params, pi(tau.obs), tau, config, limit)
    potential = phi(emp.phi.params, tau.obs, config)

    def cost(log_prob, log_q, potential):
        return hparams.lambda_i * l_i(log_q, log_prob, potential, hparams.beta, config.l_i_power)

    if config.l_i_in == "reward":
        return tau._replace(reward=tau.reward - cost(own.log_prob, own.log_q, potential)), no_penalty, ()

    def penalty(now, log_prob, data):
        log_q, potential, *drawn = data
        return cost(now.log_prob(drawn[0]) if drawn else log_prob, log_q, potential)

    drawn = (own.action,) if config.l_i_actions == "resampled" else ()
    return tau, penalty, (own.log_q, potential, *drawn)
