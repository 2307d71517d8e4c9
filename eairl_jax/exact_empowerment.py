"""Empowerment that is computed and not learned: the capacity of the channel from plans to the observation they lead to.

`empowerment` estimates Phi with two networks, as the paper does. Here the simulator itself says where a plan of K
actions leads, and the algorithm of Blahut and Arimoto finds the capacity (Klyubin et al. 2005). So no estimator can be
blamed for what this Phi does. It needs a task of at most two observed quantities that can start at rest anywhere.

The channel of a state:

- inputs: `PLANS` random plans of K actions, the same for every state;
- output: the observation after the plan, plus Gaussian noise of `RESOLUTION`. Without noise two plans would always lead
  to different observations, and the capacity would be the logarithm of their number.

Four times as many plans raise the capacity nearly alike everywhere: at six places of a maze by 0.03 to 0.07 nats for 5
steps, by 0.31 to 0.35 for 20 (`test_more_plans_raise_the_capacity_alike_everywhere`). A shaping is a difference of two.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.methods import EXACT_PHI
from eairl_jax.rollout import action_limit
from eairl_jax.types import Env

PLANS = 512
MOST_CHANGES = 6
"""A plan changes its action at most so often."""
RESOLUTION = 1 / 32
"""Std of the channel's noise, as a share of `obs_std`: 1.1 cm in the mazes."""
NODES = 15
"""Grid nodes along each observed quantity: one in 5 cm in the mazes."""
ITERATIONS = 100
"""Iterations of Blahut and Arimoto. `capacity` says how far they are from the capacity."""


@struct.dataclass
class Potential:
    """Phi on a grid.

    Attributes:
      low, high: `[obs]` the grid's corners, in the environment's units.
      values: `[NODES] * obs` the empowerment at each node, nats.
    """

    low: jax.Array
    high: jax.Array
    values: jax.Array


def check(env: Env, config: Config) -> None:
    """Checks that empowerment can be computed, if the configuration asks for it.

    Raises:
      InputError: if the environment cannot start at rest anywhere (`at_rest`), declares no scale of observations, or
        has more than two observed quantities.
    """
    if config.shaping != EXACT_PHI:
        return
    name, asked = type(env).__name__, f"shaping = {config.shaping}"
    if not callable(getattr(env, "at_rest", None)):
        raise InputError(
            f"{asked}: {name} has no function at_rest(obs), which starts the task at rest at an observation, as the "
            "point mazes do. Use shaping = empowerment, which learns Phi"
        )
    if getattr(env, "obs_mean", None) is None or getattr(env, "obs_std", None) is None:
        raise InputError(f"{asked}: {name} declares no obs_mean and obs_std, which say where its states lie")
    if env.observation_size > 2:
        raise InputError(
            f"{asked}: {name} observes {env.observation_size} quantities, and a grid of {NODES} nodes for each would "
            "be too large; expected at most 2. Use shaping = empowerment, which learns Phi"
        )


def plans(action_size: int, steps: int, limit: float, count: int = PLANS) -> np.ndarray:
    """The channel's inputs `[count, steps, act]`: random actions, each held for a random time.

    An entry of an action is at a bound with a probability of one third, else uniform between the bounds.
    """
    rng = np.random.default_rng(0)
    changes = rng.integers(1, min(steps, MOST_CHANGES) + 1, count)
    sequences = np.empty((count, steps, action_size), np.float32)
    for sequence, change_count in zip(sequences, changes, strict=True):
        held = np.searchsorted(np.sort(rng.integers(0, steps, change_count)), np.arange(steps), side="right")
        sequence[:] = limit * np.clip(rng.uniform(-1.5, 1.5, (change_count + 1, action_size)), -1, 1)[held]
    return sequences


def outcomes(env: Any, obs: jax.Array, sequences: jax.Array) -> jax.Array:
    """The observations `[plans, obs]` to which plans `[plans, steps, act]` lead from rest at `obs`."""

    def outcome(sequence: jax.Array) -> jax.Array:
        state, _ = jax.lax.scan(lambda state, action: (env.step(state, action), None), env.at_rest(obs), sequence)
        return state.obs

    return jax.vmap(outcome)(sequences)


def channel(outcome: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`P(y_i | plan)`, `[plans, cells]`, for the two entries of an output that is independent noise around the outcome.

    Args:
      outcome: `[plans, 1 or 2]`, in units of the noise from the grid's corner. A cell is as wide as one std.
    """
    centres = jnp.arange(-3.0, 2.0 / RESOLUTION + 4.0)  # the grid and three stds around it
    density = jnp.exp(-0.5 * (outcome[:, :, None] - centres) ** 2)
    p = density / density.sum(axis=-1, keepdims=True)
    return p[:, 0], p[:, 1] if outcome.shape[1] == 2 else jnp.ones((len(outcome), 1))


def capacity(p: jax.Array, r: jax.Array, iterations: int = ITERATIONS) -> tuple[jax.Array, jax.Array]:
    """Bounds `(lower [], upper [])` in nats on the capacity of a channel, by Blahut and Arimoto.

    The distribution w of the inputs starts uniform. Each iteration multiplies it by `exp D(P(y|x) || P(y))`. The mean
    of these divergences is the information that w conveys; the largest is never below the capacity (Blahut 1972).

    Args:
      p, r: `[inputs, outputs]` distributions of two outputs that are independent of each other for each input.
    """
    neg_entropy = jax.scipy.special.xlogy(p, p).sum(axis=1) + jax.scipy.special.xlogy(r, r).sum(axis=1)

    def divergence(log_w):
        marginal = (p * jnp.exp(log_w)[:, None]).T @ r
        return neg_entropy - jnp.sum((p @ jnp.log(jnp.maximum(marginal, 1e-30))) * r, axis=1)

    log_w = jnp.full(len(p), -jnp.log(len(p)))
    log_w = jax.lax.fori_loop(0, iterations, lambda _, w: jax.nn.log_softmax(w + divergence(w)), log_w)
    d = divergence(log_w)
    return jnp.exp(log_w) @ d, d.max()


def potential(env: Any, config: Config) -> Potential | tuple[()]:
    """Empowerment of K = `config.empowerment_steps` steps on a grid over the observations; () if it is not asked."""
    if config.shaping != EXACT_PHI:
        return ()
    centre, scale = jnp.asarray(env.obs_mean, jnp.float32), jnp.asarray(env.obs_std, jnp.float32)
    low, high = centre - scale, centre + scale
    sequences = jnp.asarray(plans(env.action_size, config.empowerment_steps, action_limit(env)))
    unit = jnp.stack(jnp.meshgrid(*[jnp.linspace(0.0, 1.0, NODES)] * len(centre), indexing="ij"), axis=-1)
    # The barrier stops XLA from simulating all this while it compiles, since nothing here depends on an argument.
    start, sequences = jax.lax.optimization_barrier((low + (high - low) * unit.reshape(-1, len(centre)), sequences))

    def empowerment(start: jax.Array) -> jax.Array:
        return capacity(*channel((outcomes(env, start, sequences) - low) / (scale * RESOLUTION)))[0]

    return Potential(low, high, jax.lax.map(empowerment, start).reshape(unit.shape[:-1]))


def phi(table: Potential, obs: jax.Array) -> jax.Array:
    """Phi(s) `[...]` of raw observations `[..., obs]`, linear between the nodes and constant beyond the grid."""
    place = (obs - table.low) / (table.high - table.low) * (NODES - 1)
    return jax.scipy.ndimage.map_coordinates(table.values, list(jnp.moveaxis(place, -1, 0)), order=1, mode="nearest")
