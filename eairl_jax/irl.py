"""THE loop: one iteration of adversarial inverse reinforcement learning, Algorithm 1 of the paper.

Every method of `methods.METHODS` is this loop; read `step` in `make_irl` first.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

from eairl_jax import actor, discriminator, empowerment, history, methods, normalize, optimize
from eairl_jax.config import Config
from eairl_jax.ppo import ppo
from eairl_jax.types import Algorithm, Demonstrations, Env, HParams, Key, PyTree, Transition, no_penalty


@struct.dataclass
class IRLState:
    """Everything a run is, between two iterations. Each leaf is an array: save it and you can go on.

    Attributes:
      key: drives every random choice.
      actor: the policy, its environments, the normaliser.
      empowerment: q(a|s,s'), Phi(s) and Phi'(s); None for methods without.
      discriminator: the reward and what is learned of its shaping.
      history: raw samples of this and the previous iterations.
    """

    key: Key
    actor: actor.Actor
    empowerment: empowerment.Empowerment | None
    discriminator: optimize.Fitted
    history: history.History


@struct.dataclass
class RewardParams:
    """A learned reward, the artefact that is transferred: its networks and the normaliser they stand behind."""

    params: PyTree
    obs_stats: normalize.ObsStats


def make_irl(env: Env, config: Config) -> Algorithm:
    """Builds the adversarial method that `config.method` names; its `data` is `Demonstrations`.

    Raises:
      InputError: for an unknown method, or an environment without flat observations.
    """
    method = methods.resolve(config)
    obs_size, action_size = normalize.flat_size(env), env.action_size
    optimizer = ppo(obs_size, action_size, config)

    def init(key: Key, hparams: HParams) -> IRLState:
        del hparams  # no rate is part of the state
        key, actor_key, empowerment_key, d_key = jax.random.split(key, 4)
        fresh = discriminator.init(d_key, obs_size, action_size, method, config)
        return IRLState(
            key=key,
            actor=actor.init(actor_key, env, optimizer, config),
            empowerment=empowerment.init(empowerment_key, obs_size, action_size, config)
            if method.empowerment
            else None,
            discriminator=optimize.start(fresh),
            history=history.empty(obs_size, action_size, config),
        )

    def step(state: IRLState, hparams: HParams, demos: Demonstrations):
        hparams = hparams.at(state.actor.iteration / config.iterations)
        key, tau_key, emp_key, d_key, pi_key = jax.random.split(state.key, 5)

        # tau ~ pi
        acting, raw = actor.collect(tau_key, state.actor, env, optimizer, config)
        past, tau = history.add(state.history, raw), actor.normalized(acting, raw)
        # phi, varphi: the inverse model by l_q, then the empowerment by l_I
        emp, metrics = fit_empowerment(emp_key, state.empowerment, tau, hparams)
        # xi: the discriminator, hence the reward
        expert, policy = draw_samples(d_key, acting, emp, demos, past, hparams)
        d, d_metrics = discriminator.fit(state.discriminator, expert, policy, hparams, method, config)
        # theta: the policy, on the reward as it now is, and on l_I
        seen = as_samples(emp, raw, tau, tau.log_prob, hparams)
        logit = discriminator.logit_expert_high(d.params, seen, hparams.gamma, method, config)
        tau = tau._replace(reward=method.policy_reward(logit))
        pi, pi_metrics = optimizer.update(pi_key, acting.policy, tau, *l_i_penalty(emp, tau, hparams), hparams)
        # varphi': the slow copy of the empowerment
        acting = actor.finish(acting, pi, raw, config)
        emp = empowerment.sync(emp, acting.iteration, config) if emp else None

        metrics |= d_metrics | pi_metrics
        metrics |= {"true_return": acting.rollout.mean_return, "policy_reward": tau.reward.mean()}
        return IRLState(key, acting, emp, d, past), metrics

    def fit_empowerment(key, emp, tau: Transition, hparams: HParams):
        return empowerment.fit(key, emp, tau, hparams, config) if emp else (None, {})

    def draw_samples(key, acting, emp, demos: Demonstrations, past: history.History, hparams: HParams):
        """Minibatches of the expert and of the policy's history, log pi of both under the current policy."""
        count = (config.discriminator_updates, config.discriminator_batch)
        expert_key, policy_key = jax.random.split(key)
        drawn = optimize.draw(expert_key, demos, 2, *count), history.draw(policy_key, past, *count)

        def prepare(raw):
            x = actor.normalized(acting, raw)
            log_prob = optimizer.distribution(acting.policy, x.obs).log_prob(x.action)
            return as_samples(emp, raw, x, log_prob, hparams)

        return prepare(drawn[0]), prepare(drawn[1])

    def as_samples(emp, raw, x, log_prob, hparams: HParams) -> discriminator.Samples:
        """What the logit needs of `raw` samples and the same ones normalised, `x`.

        Phi is a constant in it: no gradient of the discriminator's loss reaches Phi.
        """
        phi_shaping = jnp.zeros_like(log_prob)
        if method.shaping in ("empowerment", "both"):
            phi = empowerment.phi(emp.phi.params, x.obs, config)
            next_phi = empowerment.phi(emp.phi_target, x.next_obs, config)
            phi_shaping = discriminator.shaping(phi, next_phi, x.terminated, hparams.gamma)
        seen = raw if config.reward_obs == "raw" else x
        return discriminator.Samples(
            seen.obs, x.action, seen.next_obs, x.terminated, log_prob, jax.lax.stop_gradient(phi_shaping)
        )  # fmt: skip

    def l_i_penalty(emp, tau: Transition, hparams: HParams):
        """lambda_I l_I as a cost on log pi (Eq. 11), and what it needs of each transition."""
        if not emp:
            return no_penalty, ()

        def penalty(log_prob, log_q_and_phi):
            log_q, phi = log_q_and_phi
            return hparams.lambda_i * empowerment.l_i(log_q, log_prob, phi, hparams.beta, config.l_i_power)

        log_q = empowerment.log_q(emp.inverse.params, tau, config)
        return penalty, (log_q, empowerment.phi(emp.phi.params, tau.obs, config))

    def act(state: IRLState, obs, key=None):
        return actor.sample(state.actor, obs, key, optimizer)

    return Algorithm(init, step, act)


def learned_reward(state: IRLState) -> RewardParams:
    """What is transferred: the reward alone, without shaping and without log pi. Lanes are kept, if there are any."""
    kept = {name: params for name, params in state.discriminator.params.items() if name in ("g", "k")}
    return RewardParams(kept, state.actor.obs_stats)


def reward_function(config: Config) -> Callable[[RewardParams, jax.Array, jax.Array], jax.Array]:
    """`(RewardParams, raw obs [..., obs], action [..., act]) -> reward [...]` of the form that `config` names."""
    form = methods.resolve(config).reward_form

    def reward(learned: RewardParams, obs, action):
        seen = obs if config.reward_obs == "raw" else normalize.normalize(learned.obs_stats, obs)
        return discriminator.reward(learned.params, seen, action, form, config)

    return reward
