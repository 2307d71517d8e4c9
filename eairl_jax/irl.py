"""One iteration of adversarial inverse reinforcement learning: Algorithm 1 of Qureshi et al. (2019).

Every method of `methods.METHODS` runs this loop. Read `step` in `make_irl` first.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import jax
from flax import struct

from eairl_jax import (
    agent,
    arguments,
    discriminator,
    discriminator_data,
    empowerment,
    exact_empowerment,
    horizon,
    methods,
    normalize,
    replay,
    rollout,
    train_state,
)
from eairl_jax.config import OWN_PART, Config
from eairl_jax.environment import check_env, context_size
from eairl_jax.errors import InputError
from eairl_jax.hparams import check_hparams
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.shards import of_count
from eairl_jax.types import Algorithm, Demonstrations, Env, HParams, Key, PyTree


@struct.dataclass
class IRLState:
    """The whole state of a run between two iterations. Every leaf is an array: a run can go on from a saved state.

    Attributes:
      key: source of all randomness.
      agent: the policy (theta), its environments and the normaliser.
      empowerment: the inverse model q(a|s,s') (phi), Phi(s) (varphi) and its slow copy Phi'(s) (varphi'); None for
        methods without empowerment.
      discriminator: the reward and the learned part of its shaping (xi).
      replay: raw samples of this iteration and of previous iterations.
      exact_phi: Phi(s) by the simulator, which never changes; () unless the configuration asks for it.
    """

    key: Key
    agent: agent.Agent
    empowerment: empowerment.Empowerment | None
    discriminator: train_state.TrainState
    replay: replay.Replay
    exact_phi: exact_empowerment.Potential | tuple[()] = ()


@struct.dataclass
class RewardParams:
    """A learned reward, which can be transferred to another task.

    Attributes:
      params: parameters of the reward's networks.
      obs_stats: the normaliser of the reward's observations.
    """

    params: PyTree
    obs_stats: normalize.ObsStats


def make_irl(env: Env, config: Config, shards: int = 1) -> Algorithm:
    """Builds the adversarial method that `config.method` names; the `data` of its `step` is `Demonstrations`.

    Args:
      shards: how many devices compute one lane together, in `Lanes`.

    Raises:
      InputError: if the method or the network is unknown, if the environment does not fit (`environment.check_env`,
        `check_whole_trajectories`, `exact_empowerment.check`), or if its copies do not split evenly over the devices.
    """
    env, config = _learned_in(env, config)
    obs_size, action_size = normalize.flat_size(env), env.action_size
    parts = of_count(shards, config.num_envs)
    optimizer, limit = make_optimizer(env, config, parts), rollout.action_limit(env)

    def init(key: Key, hparams: HParams) -> IRLState:
        check_hparams(hparams)
        key, agent_key, emp_key, d_key = jax.random.split(arguments.one_key(key), 4)
        emp = empowerment.init(emp_key, obs_size, action_size, config) if methods.uses_empowerment(config) else None
        return IRLState(
            key=key,
            agent=agent.init(agent_key, env, optimizer, hparams, config),
            empowerment=emp,
            discriminator=train_state.init(discriminator.init(d_key, obs_size, action_size, config)),
            replay=replay.empty(obs_size, action_size, config),
            exact_phi=exact_empowerment.potential(env, config),
        )

    def step(state: IRLState, hparams: HParams, demos: Demonstrations):
        hparams = hparams.at(agent.progress(state.agent, config))
        key, tau_key, emp_key, d_key, pi_key = jax.random.split(state.key, 5)
        reset_key, replay_key = (jax.random.fold_in(tau_key, i) for i in (1, 2))

        # Collect trajectories tau with the policy pi_theta.
        acting = agent.reset_policy_if_due(reset_key, state.agent, optimizer, hparams, config)
        acting, raw = agent.collect(tau_key, acting, env, optimizer, config, parts)
        past, tau = replay.add(replay_key, state.replay, raw, config), agent.normalize_obs(acting, raw)
        pi, exact = functools.partial(optimizer.distribution, acting.policy), state.exact_phi

        # Update the inverse model q (phi) by l_q, then the empowerment Phi (varphi) by l_I.
        def update_empowerment(emp):
            return empowerment.fit(emp_key, emp, tau, pi, hparams, config, limit) if emp else (None, {})

        # Update the discriminator D (xi), and hence the reward, by the cross-entropy of D.
        def update_discriminator(emp):
            demonstrated = agent.clip_actions(demos, env, config)
            pair = discriminator_data.draw_minibatches(d_key, demonstrated, past, raw, hparams, config)
            expert, policy = (discriminator_data.for_loss(x, pi, emp, exact, acting, hparams, config) for x in pair)
            return discriminator.fit(state.discriminator, expert, policy, hparams, config)

        if config.update_order == "discriminator_first":
            d, d_metrics = update_discriminator(state.empowerment)
            emp, metrics = update_empowerment(state.empowerment)
        else:
            emp, metrics = update_empowerment(state.empowerment)
            d, d_metrics = update_discriminator(emp)

        # Update the policy (theta) by PPO or TRPO on the updated reward and on lambda_I l_I.
        samples = discriminator_data.for_policy_reward(raw, emp, exact, acting, hparams, config)
        tau = tau._replace(reward=discriminator.policy_reward(d.params, samples, hparams, config))
        tau, *cost = empowerment.with_l_i(jax.random.fold_in(pi_key, 1), tau, pi, emp, hparams, config, limit)
        paid = tau._replace(reward=horizon.rest_paid(tau.reward, raw.obs, hparams, config))
        policy, pi_metrics = optimizer.update(pi_key, acting.policy, paid, *cost, hparams)

        # Every n iterations: copy the empowerment into the target empowerment Phi' (varphi').
        acting = agent.end_iteration(acting, policy, raw, config)
        emp = empowerment.sync(emp, acting.iteration, config) if emp else None

        returns = {"true_return": acting.rollout.mean_return, "policy_reward": tau.reward.mean()}
        return IRLState(key, acting, emp, d, past, exact), metrics | d_metrics | pi_metrics | returns

    def act(state: IRLState, obs, key=None):
        return agent.sample_action(state.agent, obs, key, optimizer)

    return Algorithm(init, step, act, shards)


def _learned_in(env: Env, config: Config) -> tuple[Env, Config]:
    """The environment and the configuration as learning sees them, checked."""
    check_env(env)
    config = _with_context(env, methods.of_known_method(horizon.learning_config(env, config)))
    horizon.warn_if_variable(env, config)
    env = horizon.learning_env(env, config)
    exact_empowerment.check(env, config)
    discriminator_data.check_whole_trajectories(env, config)
    discriminator.check_network(normalize.flat_size(env), env.action_size, config)
    return env, config


def _with_context(env: Env, config: Config) -> Config:
    """The configuration with the environment's `context_size`."""
    size = context_size(env)
    if config.context_size not in (0, size):
        raise InputError(f"context_size = {config.context_size}: this task has {size}; leave the setting out")
    if size and config.horizon == "absorbing":
        raise InputError(
            "the horizon absorbing is not possible with several sources: the entry of the absorbing state would come "
            "after those of the sources; choose --horizon fixed or variable"
        )
    if OWN_PART in config.penalties and (not size or methods.METHODS[config.method].reward_loss):
        why = f"the reward of {config.method} is no part of its discriminator" if size else "there is one source"
        raise InputError(
            f"own_part: {why}, so no part of the reward belongs to one of several sources; leave the setting out"
        )
    return dataclasses.replace(config, context_size=size)


def learned_reward(state: IRLState, context_size: int = 0) -> RewardParams:
    """The reward of a run, without its shaping and without log pi. If the state has a lane axis, the result has it.

    Args:
      context_size: of the environment, if it is several tasks as one (`envs.several`): the reward is of the observation
        without these entries.
    """
    reward_params = {name: params for name, params in state.discriminator.params.items() if name in ("g", "k")}
    return RewardParams(reward_params, normalize.without_last(state.agent.obs_stats, context_size))


REWARD_FIELDS = (
    "net",
    "hidden",
    "activation",
    "layer_norm",
    "reward_form",
    "action_part",
    "reward_obs",
    "horizon",
    "context_size",
)
"""What the function of a reward depends on. The method that has learned it is not among them."""


def reward_kind(config: Config) -> Config:
    """The configuration with the usual values in all fields that `reward_function` does not read.

    Rewards of one kind are one function, with other parameters.
    """
    config = methods.with_method_defaults(config)
    return Config(**{name: getattr(config, name) for name in REWARD_FIELDS})


def reward_function(config: Config) -> Callable[[RewardParams, jax.Array, jax.Array], jax.Array]:
    """`(RewardParams, raw obs [..., obs], action [..., act]) -> reward [...]`, of the form that `config` names.

    With the horizon "absorbing", observations are those of the task, or those with the entry of the absorbing state.

    Raises:
      InputError: if no adversarial method has the name `config.method`.
    """
    config = methods.with_method_defaults(config)

    def reward(learned: RewardParams, obs, action):
        obs = horizon.living(obs, learned.obs_stats.mean.shape[-1])
        reward_obs = obs if config.reward_obs == "raw" else normalize.normalize(learned.obs_stats, obs)
        return discriminator.reward(learned.params, reward_obs, horizon.executed(obs, action, config), config)

    return reward
