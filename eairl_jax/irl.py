"""THE loop: one iteration of adversarial inverse reinforcement learning, Algorithm 1 of the paper.

Every method of `methods.METHODS` is this loop; read `step` in `make_irl` first.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
from flax import struct

from eairl_jax import (
    agent,
    discriminator,
    discriminator_data,
    empowerment,
    methods,
    normalize,
    replay,
    rollout,
    train_state,
)
from eairl_jax.config import Config
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.types import Algorithm, Demonstrations, Env, HParams, Key, PyTree


@struct.dataclass
class IRLState:
    """Everything a run is, between two iterations. Each leaf is an array: save it and you can go on.

    Attributes:
      key: drives every random choice.
      agent: the policy, its environments, the normaliser.
      empowerment: q(a|s,s'), Phi(s) and Phi'(s); None for methods without.
      discriminator: the reward and what is learned of its shaping.
      replay: raw samples of this and the previous iterations.
    """

    key: Key
    agent: agent.Agent
    empowerment: empowerment.Empowerment | None
    discriminator: train_state.TrainState
    replay: replay.Replay


@struct.dataclass
class RewardParams:
    """A learned reward, the artefact that is transferred: its networks and the normaliser they stand behind."""

    params: PyTree
    obs_stats: normalize.ObsStats


def make_irl(env: Env, config: Config) -> Algorithm:
    """Builds the adversarial method that `config.method` names; its `data` is `Demonstrations`.

    Raises:
      InputError: for an unknown method, an environment without flat observations, or trajectories that rollouts cut.
    """
    config = methods.with_method_defaults(config)
    discriminator_data.check_segments(config)
    obs_size, action_size = normalize.flat_size(env), env.action_size
    optimizer = make_optimizer(env, config)
    limit = rollout.action_limit(env)
    uses_empowerment = methods.uses_empowerment(config)

    def init(key: Key, hparams: HParams) -> IRLState:
        del hparams  # no rate is part of the state
        key, actor_key, empowerment_key, d_key = jax.random.split(key, 4)
        return IRLState(
            key=key,
            agent=agent.init(actor_key, env, optimizer, config),
            empowerment=empowerment.init(empowerment_key, obs_size, action_size, config) if uses_empowerment else None,
            discriminator=train_state.start(discriminator.init(d_key, obs_size, action_size, config)),
            replay=replay.empty(obs_size, action_size, config),
        )

    def step(state: IRLState, hparams: HParams, demos: Demonstrations):
        hparams = hparams.at(agent.progress(state.agent, config))
        key, tau_key, emp_key, d_key, pi_key = jax.random.split(state.key, 5)
        fresh_key, past_key = (jax.random.fold_in(tau_key, i) for i in (1, 2))

        # tau ~ pi
        acting = agent.restarted(fresh_key, state.agent, optimizer, config)
        acting, raw = agent.collect(tau_key, acting, env, optimizer, config)
        past, tau = replay.add(past_key, state.replay, raw, config), agent.normalized(acting, raw)
        pi = functools.partial(optimizer.distribution, acting.policy)

        # phi, varphi: the inverse model by l_q, then the empowerment by l_I
        def fit_empowerment(emp):
            return empowerment.fit(emp_key, emp, tau, pi, hparams, config, limit) if emp else (None, {})

        # xi: the discriminator, hence the reward
        def fit_discriminator(emp):
            expert, policy = discriminator_data.draw(d_key, agent.seen(demos, env, config), past, raw, config)
            pair = (discriminator_data.prepare(x, pi, emp, acting, hparams, config) for x in (expert, policy))
            return discriminator.fit(state.discriminator, *pair, hparams, config)

        if config.update_order == "discriminator_first":
            d, d_metrics = fit_discriminator(state.empowerment)
            emp, metrics = fit_empowerment(state.empowerment)
        else:
            emp, metrics = fit_empowerment(state.empowerment)
            d, d_metrics = fit_discriminator(emp)

        # theta: the policy, on the reward as it now is, and on l_I
        seen = discriminator_data.prepare(raw, None, emp, acting, hparams, config, scoring=True)
        logit = discriminator.logit_expert_high(d.params, seen, discriminator.shaping_discount(hparams, config), config)
        tau = tau._replace(reward=methods.METHODS[config.method].policy_reward(logit))
        l_i_key = jax.random.fold_in(pi_key, 1)
        tau, penalty, penalty_data = empowerment.with_l_i(l_i_key, tau, pi, emp, hparams, config, limit)
        policy, pi_metrics = optimizer.update(pi_key, acting.policy, tau, penalty, penalty_data, hparams)

        # varphi': the slow copy of the empowerment
        acting = agent.finish(acting, policy, raw, config)
        emp = empowerment.sync(emp, acting.iteration, config) if emp else None

        metrics |= d_metrics | pi_metrics
        metrics |= {"true_return": acting.rollout.mean_return, "policy_reward": tau.reward.mean()}
        return IRLState(key, acting, emp, d, past), metrics

    def act(state: IRLState, obs, key=None):
        return agent.sample(state.agent, obs, key, optimizer)

    return Algorithm(init, step, act)


def learned_reward(state: IRLState) -> RewardParams:
    """What is transferred: the reward alone, without shaping and without log pi. Lanes are kept, if there are any."""
    kept = {name: params for name, params in state.discriminator.params.items() if name in ("g", "k")}
    return RewardParams(kept, state.agent.obs_stats)


def reward_function(config: Config) -> Callable[[RewardParams, jax.Array, jax.Array], jax.Array]:
    """`(RewardParams, raw obs [..., obs], action [..., act]) -> reward [...]` of the form that `config` names."""
    config = methods.with_method_defaults(config)

    def reward(learned: RewardParams, obs, action):
        seen = obs if config.reward_obs == "raw" else normalize.normalize(learned.obs_stats, obs)
        return discriminator.reward(learned.params, seen, action, config)

    return reward
