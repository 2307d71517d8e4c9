"""The part that RL and IRL share: a policy that acts in its environments behind one observation normaliser."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import horizon, normalize, rollout
from eairl_jax.config import Config
from eairl_jax.gaussian import Gaussian
from eairl_jax.shards import ONE, Shards
from eairl_jax.types import Env, HParams, Key, PolicyOptimizer, PyTree, Transition

Steps = TypeVar("Steps", bound=Any)  # a NamedTuple with obs, action and next_obs, as Transition


@struct.dataclass
class Agent:
    """A policy, its environments and its normaliser. The state of every algorithm holds one `Agent`.

    Attributes:
      iteration: `[]` number of finished iterations.
      rollout: the environments.
      obs_stats: the normaliser. It is constant within an iteration, and the same for s, for s' and for all networks.
      policy: the state of the policy optimiser: pi and its value function.
    """

    iteration: jax.Array
    rollout: rollout.RolloutState
    obs_stats: normalize.ObsStats
    policy: PyTree


def init(key: Key, env: Env, optimizer: PolicyOptimizer, hparams: HParams, config: Config) -> Agent:
    """A fresh policy at the start of fresh episodes.

    Raises:
      InputError: if the environment's observations are not flat vectors.
    """
    env_key, policy_key = jax.random.split(key)
    environments = rollout.reset(env_key, env, config.num_envs, config.rollout_length, config.episode_length)
    stats = normalize.initial(env, config.normalize_obs)
    return Agent(jnp.zeros((), jnp.int32), environments, stats, fresh_policy(policy_key, optimizer, hparams))


def fresh_policy(key: Key, optimizer: PolicyOptimizer, hparams: HParams) -> PyTree:
    """A policy with random weights and the std of the first iteration."""
    fraction = jnp.asarray(hparams.std_initial_fraction, jnp.float32)
    return dataclasses.replace(optimizer.init(key), log_std_offset=jnp.log(fraction))


def reset_policy_if_due(key: Key, agent: Agent, optimizer: PolicyOptimizer, hparams: HParams, config: Config) -> Agent:
    """The agent, with a fresh policy at every `config.policy_reset_every`-th iteration (never, if that is 0)."""
    if not config.policy_reset_every:
        return agent
    due = (agent.iteration > 0) & (agent.iteration % config.policy_reset_every == 0)
    fresh = fresh_policy(key, optimizer, hparams)
    policy = jax.tree.map(lambda new, old: jnp.where(due, new, old), fresh, agent.policy)
    return dataclasses.replace(agent, policy=policy)


def progress(agent: Agent, config: Config) -> jax.Array:
    """The finished fraction `[]` of the policy's training, from 0 to 1; annealed rates follow it."""
    iterations = config.policy_reset_every or config.iterations
    done = agent.iteration % iterations if config.policy_reset_every else agent.iteration
    return done / iterations


def distribution(agent: Agent, obs: jax.Array, optimizer: PolicyOptimizer) -> Gaussian:
    """pi(.|s) for raw observations `[..., obs]`."""
    return optimizer.distribution(agent.policy, normalize.normalize(agent.obs_stats, obs))


def collect(
    key: Key, agent: Agent, env: Env, optimizer: PolicyOptimizer, config: Config, shards: Shards = ONE
) -> tuple[Agent, Transition]:
    """tau ~ pi: acts for one iteration, in a part of the environments on each of the devices.

    Returns:
      The agent with its environments after the iteration, and the raw transitions `[T, N, ...]`.
    """
    environments, raw = rollout.rollout(
        key,
        env,
        lambda obs: distribution(agent, obs, optimizer),
        agent.rollout,
        config.rollout_length,
        config.episode_length,
        shards,
    )
    return dataclasses.replace(agent, rollout=environments), raw


def clip_actions(steps: Steps, env: Env, config: Config) -> Steps:
    """Clips actions to the environment's bounds if `config.actions` is "clipped"; else returns `steps` unchanged."""
    if config.actions == "sampled" or steps.action is None:
        return steps
    limit = rollout.action_limit(env)
    return steps._replace(action=jnp.clip(steps.action, -limit, limit))


def normalize_obs(agent: Agent, steps: Steps) -> Steps:
    """Normalises s and s' by the agent's statistics."""
    return steps._replace(
        obs=normalize.normalize(agent.obs_stats, steps.obs),
        next_obs=normalize.normalize(agent.obs_stats, steps.next_obs),
    )


def end_iteration(agent: Agent, policy: PyTree, raw: Transition, config: Config) -> Agent:
    """The agent after an iteration: with the new policy, and with updated statistics if they are running ones."""
    running = config.normalize_obs == "running"
    stats = horizon.update_stats(agent.obs_stats, raw.obs, config) if running else agent.obs_stats
    return Agent(agent.iteration + 1, agent.rollout, stats, policy)


def sample_action(agent: Agent, obs: jax.Array, key: Key | None, optimizer: PolicyOptimizer) -> jax.Array:
    """Actions `[..., act]` for raw observations `[..., obs]`: samples of the policy, or its means if key is None."""
    pi = distribution(agent, horizon.living(obs, agent.obs_stats.mean.shape[-1]), optimizer)
    return pi.mean if key is None else pi.sample(jax.random.normal(key, pi.mean.shape))
