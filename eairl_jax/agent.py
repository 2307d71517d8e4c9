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


def restarted(key: Key, agent: Agent, optimizer: PolicyOptimizer, config: Config) -> Agent:
    """The same agent, with a fresh policy whenever `config.policy_reset_every` iterations have passed."""
    if not config.policy_reset_every:
        return agent
    due = (agent.iteration > 0) & (agent.iteration % config.policy_reset_every == 0)
    return agent.replace(  # pyright: ignore
        policy=jax.tree.map(lambda new, old: jnp.where(due, new, old), optimizer.init(key), agent.policy)
    )


def progress(agent: Agent, config: Config) -> jax.Array:
    """How much of its training the policy has behind it, in [0, 1]: what rates are annealed by."""
    whole = config.policy_reset_every or config.iterations
    done = agent.iteration % whole if config.policy_reset_every else agent.iteration
    return done / whole


def distribution(agent: Agent, obs: jax.Array, optimizer: PolicyOptimizer) -> Gaussian:
    """pi(.|s) for raw observations `[..., obs]`."""
    return optimizer.distribution(agent.policy, normalize.normalize(agent.obs_stats, obs))


def collect(key: Key, agent: Agent, env: Env, optimizer: PolicyOptimizer, config: Config) -> tuple[Agent, Transition]:
    """tau ~ pi: one iteration's raw transitions `[T, N, ...]`."""
    environments, raw = rollout.rollout(
        key,
        env,
        lambda obs: distribution(agent, obs, optimizer),
        agent.rollout,
        config.rollout_length,
        config.episode_length,
    )
    return agent.replace(rollout=environments), raw  # pyright: ignore


def seen(x: Any, env: Env, config: Config) -> Any:
    """Demonstrations or transitions with actions as `config.actions` has them: as they were drawn, or executed."""
    if config.actions == "sampled":
        return x
    limit = rollout.action_limit(env)
    return x._replace(action=jnp.clip(x.action, -limit, limit))


def normalized(agent: Agent, x: Any) -> Any:
    """The same samples with s and s' normalised."""
    return x._replace(
        obs=normalize.normalize(agent.obs_stats, x.obs), next_obs=normalize.normalize(agent.obs_stats, x.next_obs)
    )


def finish(agent: Agent, policy: PyTree, raw: Transition, config: Config) -> Agent:
    """Ends an iteration: the new policy, and the normaliser moved on if it is a running one."""
    running = config.normalize_obs == "running"
    stats = normalize.update(agent.obs_stats, raw.obs) if running else agent.obs_stats
    return Agent(agent.iteration + 1, agent.rollout, stats, policy)


def sample(agent: Agent, obs: jax.Array, key: Key | None, optimizer: PolicyOptimizer) -> jax.Array:
    """An action `[..., act]` for raw observations; the mean action if key is None."""
    pi = distribution(agent, obs, optimizer)
    return pi.mean if key is None else pi.sample(jax.random.normal(key, pi.mean.shape))
