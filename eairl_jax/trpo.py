"""Trust-region policy optimisation (Schulman et al. 2015), with a line search that vmaps over seeds."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from eairl_jax import train_state
from eairl_jax.actor_critic import Batch, ActorCritic, PolicyState, minibatches
from eairl_jax.config import Config
from eairl_jax.gaussian import Gaussian
from eairl_jax.types import PolicyOptimizer

Vector = jax.Array


def fisher_vector_product(pi: Callable[[Vector], Gaussian], theta: Vector, v: Vector) -> Vector:
    """`F v`, F the Hessian of `mean KL(pi_theta || pi)` at theta: forward over reverse, F is never formed.

    Args:
      pi: theta -> distributions of a batch of states.
      theta, v: `[params]`.
    """
    old = jax.lax.stop_gradient(pi(theta))
    return jax.jvp(jax.grad(lambda x: old.kl(pi(x)).mean()), (theta,), (v,))[1]


def conjugate_gradient(product: Callable[[Vector], Vector], b: Vector, steps: int) -> Vector:
    """Solves `A x = b` for a symmetric positive definite A, given `product(v) = A v`, in `steps` steps."""

    def step(carry, _):
        x, residual, direction, rr = carry
        rr = train_state.prevent_loop_fusion(rr)
        a_direction = product(direction)
        # Once solved, residual and direction are 0 and so is every further step.
        alpha = rr / jnp.maximum(direction @ a_direction, 1e-20)
        x, residual = x + alpha * direction, residual - alpha * a_direction
        new_rr = residual @ residual
        return (x, residual, residual + new_rr / jnp.maximum(rr, 1e-20) * direction, new_rr), None

    (x, *_), _ = jax.lax.scan(step, (jnp.zeros_like(b), b, b, b @ b), length=steps)
    return x


def line_search(
    objective: Callable[[Vector], tuple[jax.Array, jax.Array]], theta: Vector, full_step: Vector, kl_limit, steps: int
) -> tuple[Vector, jax.Array]:
    """The longest of the steps 1, 1/2, 1/4... that lowers the loss and keeps the KL within its limit.

    All are tried, so that lanes of a vmap never wait for one another.

    Args:
      objective: theta -> (loss, KL from the old policy).

    Returns:
      The parameters reached (theta itself if no step will do) and the fraction of the full step taken.
    """
    fractions = 0.5 ** jnp.arange(steps)
    loss, kl = jax.lax.map(
        lambda fraction: objective(theta + train_state.prevent_loop_fusion(fraction) * full_step), fractions
    )
    good = (loss < objective(theta)[0]) & (kl <= kl_limit)  # a NaN is not good
    fraction = jnp.where(good.any(), fractions[good.argmax()], 0.0)
    return jnp.where(fraction > 0, theta + fraction * full_step, theta), fraction


def trpo(obs_size: int, action_size: int, config: Config, action_limit: float = 1.0) -> PolicyOptimizer:
    """TRPO: one natural-gradient step an iteration for the policy, Adam on minibatches for the value function."""
    nets = ActorCritic.build(action_size, config, action_limit)

    def update(key, policy: PolicyState, batch, penalty, penalty_data, hparams):
        policy, prepared, explained = nets.prepare(policy, batch, penalty_data, hparams)
        samples, rows = minibatches(key, prepared, config)
        theta, unravel = ravel_pytree(policy.nets.params["actor"])

        def pi(theta):
            return nets.pi(unravel(theta), policy.log_std_offset, samples.obs)

        old = pi(theta)

        def policy_loss(log_prob):
            return -(jnp.exp(log_prob - samples.log_prob) * samples.advantage).mean()

        def surrogate(now: Gaussian):
            log_prob = now.log_prob(samples.action)
            cost = penalty(now, log_prob, samples.penalty_data).mean()
            return policy_loss(log_prob) + cost - hparams.entropy_weight * now.entropy().mean()

        gradient = jax.grad(lambda x: surrogate(pi(x)))(theta)

        def damped(v):
            return fisher_vector_product(pi, theta, v) + hparams.cg_damping * v

        direction = conjugate_gradient(damped, -gradient, config.cg_iterations)
        curvature = jnp.maximum(direction @ damped(direction), 1e-20)
        full_step = jnp.sqrt(2.0 * hparams.kl_limit / curvature) * direction

        def objective(theta):
            now = pi(theta)
            return surrogate(now), old.kl(now).mean()

        reached, fraction = line_search(objective, theta, full_step, hparams.kl_limit, config.line_search_steps)
        _, kl = objective(reached)

        def value_loss(params, minibatch: Batch):
            error = nets.value(params["critic"], minibatch.obs) - minibatch.value_target
            loss = 0.5 * jnp.mean(error**2)
            return loss, {"value_loss": loss}

        # The actor has no gradient here, hence no Adam step; it moves by the natural gradient alone.
        drawn = jax.tree.map(lambda x: x[rows], samples)
        fitted, metrics = train_state.fit(policy.nets, value_loss, drawn, hparams.policy_lr)
        moved = fitted.params | {"actor": unravel(reached)}
        fitted = fitted.replace(params=moved)  # pyright: ignore
        policy = policy.replace(nets=fitted, log_std_offset=jnp.log(hparams.std_final_fraction))  # pyright: ignore
        return policy, {
            "policy_loss": policy_loss(pi(reached).log_prob(samples.action)),
            "value_loss": metrics["value_loss"],
            "entropy": old.entropy().mean(),
            "kl": kl,
            "explained_variance": explained,
            "step_fraction": fraction,
        }

    return PolicyOptimizer(lambda key: nets.init(key, obs_size), update, nets.distribution)
