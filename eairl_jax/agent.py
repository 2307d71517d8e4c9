"""What RL and IRL share: a policy that acts in its environments behind one observation normaliser."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import normalize, rollout
from eairl_jax.config import Config
from eairl_jax.gaussian import Gaussian
from eairl_jax.types import Env, Key, PolicyOptimizer, PyTree, Transition


@struct.dataclass
class Agent:
    """A policy, its environments and its normaliser: what every algorithm's state holds.

    Attributes:
      iteration: `[]` iterations done.
      rollout: the environments.
      obs_stats: the normaliser, frozen within an iteration, the same for s and s' and for every network.
      policy: pi and its value function, the policy optimiser's own state.
    """

    iteration: jax.Array
    rollout: rollout.RolloutState
    obs_stats: normalize.ObsStats
    policy: PyTree


def init(key: Key, env: Env, optimizer: PolicyOptimizer, config: Config) -> Agent:
    """A fresh policy at the start of fresh episodes."""
    env_key, policy_key = jax.random.split(key)
    environments = rollout.reset(env_key, env, config.num_envs, config.rollout_length, config.episode_length)
    stats = normalize.initial(env, config.normalize_obs)
    return Agent(jnp.zeros((), jnp.int32), environments, stats, optimizer.init(policy_key))


def restarted(key: Key, actor: Agent, optimizer: PolicyOptimizer, config: Config) -> Agent:
    """The same actor, with a fresh policy whenever `config.policy_reset_every` iterations have passed."""
    if not config.policy_reset_every:
        return actor
    due = (actor.iteration > 0) & (actor.iteration % config.policy_reset_every == 0)
    return actor.replace(  # pyright: ignore
        policy=jax.tree.map(lambda new, old: jnp.where(due, new, old), optimizer.init(key), actor.policy)
    )


def progress(actor: Agent, config: Config) -> jax.Array:
    """How much of its training the policy has behind it, in [0, 1]: what rates are annealed by."""
    whole = config.policy_reset_every or config.iterations
    done = actor.iteration % whole if config.policy_reset_every else actor.iteration
    return done / whole


def distribution(actor: Agent, obs: jax.Array, optimizer: PolicyOptimizer) -> Gaussian:
    """pi(.|s) for raw observations `[..., obs]`."""
    return optimizer.distribution(actor.policy, normalize.normalize(actor.obs_stats, obs))


def collect(key: Key, actor: Agent, env: Env, optimizer: PolicyOptimizer, config: Config) -> tuple[Agent, Transition]:
    """tau ~ pi: one iteration's raw transitions `[T, N, ...]`."""
    environments, raw = rollout.rollout(
        key,
        env,
        lambda obs: distribution(actor, obs, optimizer),
        actor.rollout,
        config.rollout_length,
        config.episode_length,
    )
    return actor.replace(rollout=environments), raw  # pyright: ignore


def seen(x: Any, env: Env, config: Config) -> Any:
    """Demonstrations or transitions with actions as `config.actions` has them: as they were drawn, or executed."""
    if config.actions == "sampled":
        return x
    limit = rollout.action_limit(env)
    return x._replace(action=jnp.clip(x.action, -limit, limit))


def normalized(actor: Agent, x: Any) -> Any:
    """The same samples with s and s' normalised."""
    return x._replace(
        obs=normalize.normalize(actor.obs_stats, x.obs), next_obs=normalize.normalize(actor.obs_stats, x.next_obs)
    )


def finish(actor: Agent, policy: PyTree, raw: Transition, config: Config) -> Agent:
    """Ends an iteration: the new policy, and the normaliser moved on if it is a running one."""
    running = config.normalize_obs == "running"
    stats = normalize.update(actor.obs_stats, raw.obs) if running else actor.obs_stats
    return Agent(actor.iteration + 1, actor.rollout, stats, policy)


def sample(actor: Agent, obs: jax.Array, key: Key | None, optimizer: PolicyOptimizer) -> jax.Array:
    """An action `[..., act]` for raw observations; the mean action if key is None."""
    pi = distribution(actor, obs, optimizer)
    return pi.mean if key is None else pi.sample(jax.random.normal(key, pi.mean.shape))
