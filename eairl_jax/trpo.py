"""Trust-region policy optimisation (Schulman et al. 2015), with a line search that can be vmapped over seeds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from eairl_jax import train_state
from eairl_jax.actor_critic import ActorCritic, Batch, PolicyState, minibatches
from eairl_jax.config import Config
from eairl_jax.gaussian import Gaussian
from eairl_jax.shards import ONE, Shards
from eairl_jax.types import HParams, Penalty, PolicyOptimizer
from eairl_jax.xla import prevent_loop_fusion

Vector = jax.Array


def fisher_vector_product(pi: Callable[[Vector], Gaussian], theta: Vector, v: Vector) -> Vector:
    """`F v` `[params]`, where F is the Hessian of `mean KL(pi_theta || pi)` at theta.

    The product is forward mode over reverse mode; F itself is never formed.

    Args:
      pi: theta -> distributions of a batch of states.
      theta: `[params]` parameters of the policy.
      v: `[params]` any vector.
    """
    old = jax.lax.stop_gradient(pi(theta))
    return jax.jvp(jax.grad(lambda x: old.kl(pi(x)).mean()), (theta,), (v,))[1]


def conjugate_gradient(product: Callable[[Vector], Vector], b: Vector, steps: int) -> Vector:
    """Solves `A x = b` by `steps` steps of conjugate gradients, given `product(v) = A v`; A is positive definite."""

    def step(carry, _):
        x, residual, direction, rr = carry
        rr = prevent_loop_fusion(rr)
        a_direction = product(direction)
        # After an exact solution, residual and direction are 0, and further steps change nothing.
        alpha = rr / jnp.maximum(direction @ a_direction, 1e-20)
        x, residual = x + alpha * direction, residual - alpha * a_direction
        new_rr = residual @ residual
        return (x, residual, residual + new_rr / jnp.maximum(rr, 1e-20) * direction, new_rr), None

    (x, *_), _ = jax.lax.scan(step, (jnp.zeros_like(b), b, b, b @ b), length=steps)
    return x


def line_search(
    objective: Callable[[Vector], tuple[jax.Array, jax.Array]], theta: Vector, full_step: Vector, kl_limit, steps: int
) -> tuple[Vector, jax.Array]:
    """Takes the largest of the steps 1, 1/2, 1/4... that lowers the loss and keeps the KL within its limit.

    All step sizes are tried, so that no lane of a vmap has to wait for another.

    Args:
      objective: theta -> (loss, KL from the old policy).
      theta: `[params]` parameters before the step.
      full_step: `[params]` the step of size 1.
      kl_limit: the largest KL that is allowed, in nats.
      steps: number of step sizes.

    Returns:
      The new parameters (theta itself if no step is good), and the fraction of the full step.
    """
    fractions = 0.5 ** jnp.arange(steps)
    loss, kl = jax.lax.map(lambda fraction: objective(theta + prevent_loop_fusion(fraction) * full_step), fractions)
    good = (loss < objective(theta)[0]) & (kl <= kl_limit)  # NaN compares as false and is never good
    fraction = jnp.where(good.any(), fractions[good.argmax()], 0.0)
    return jnp.where(fraction > 0, theta + fraction * full_step, theta), fraction


def trpo(
    obs_size: int, action_size: int, config: Config, action_limit: float = 1.0, shards: Shards = ONE
) -> PolicyOptimizer:
    """TRPO: one natural-gradient step in an iteration for the policy; Adam on minibatches for the value function.

    The natural step is one of the whole batch, which every device takes.
    """
    nets = ActorCritic.build(action_size, config, action_limit)

    def natural_step(policy: PolicyState, samples: Batch, penalty: Penalty, hparams: HParams):
        """The actor's new parameters, and metrics."""
        theta, unravel = ravel_pytree(policy.nets.params["actor"])

        def pi(theta):
            return nets.pi(unravel(theta), policy.log_std_offset, samples.obs)

        old = pi(theta)

        def policy_loss(log_prob):
            return -(jnp.exp(log_prob - samples.log_prob) * samples.advantage).mean()

        def surrogate(new: Gaussian):
            log_prob = new.log_prob(samples.action)
            cost = penalty(new, log_prob, samples.penalty_data).mean()
            return policy_loss(log_prob) + cost - hparams.entropy_weight * new.entropy().mean()

        gradient = jax.grad(lambda x: surrogate(pi(x)))(theta)

        def damped(v):
            return fisher_vector_product(pi, theta, v) + hparams.cg_damping * v

        direction = conjugate_gradient(damped, -gradient, config.cg_iterations)
        curvature = jnp.maximum(direction @ damped(direction), 1e-20)
        full_step = jnp.sqrt(2.0 * hparams.kl_limit / curvature) * direction

        def objective(theta):
            new = pi(theta)
            return surrogate(new), old.kl(new).mean()

        reached, fraction = line_search(objective, theta, full_step, hparams.kl_limit, config.line_search_steps)
        return unravel(reached), {
            "policy_loss": policy_loss(pi(reached).log_prob(samples.action)),
            "entropy": old.entropy().mean(),
            "kl": objective(reached)[1],
            "step_fraction": fraction,
        }

    def value_loss(params, minibatch: Batch):
        error = nets.value(params["critic"], minibatch.obs) - minibatch.value_target
        loss = 0.5 * jnp.mean(error**2)
        return loss, {"value_loss": loss}

    def update(key, policy: PolicyState, batch, penalty, penalty_data, hparams):
        policy, prepared, explained = nets.prepare(policy, batch, penalty_data, hparams)
        samples, indices = minibatches(key, prepared, config)
        actor, metrics = natural_step(policy, samples, penalty, hparams)
        # The value loss has no gradient for the actor, so Adam does not move the actor.
        drawn = jax.tree.map(lambda x: x[indices], samples)
        state, value_metrics = train_state.fit(policy.nets, value_loss, drawn, hparams.policy_lr, shards)
        state = dataclasses.replace(state, params=state.params | {"actor": actor})
        policy = dataclasses.replace(policy, nets=state, log_std_offset=jnp.log(hparams.std_final_fraction))
        return policy, metrics | value_metrics | {"explained_variance": explained}

    return PolicyOptimizer(lambda key: nets.init(key, obs_size), update, nets.distribution)
