"""Behaviour cloning: the policy by maximum likelihood on the demonstrations alone."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from eairl_jax import agent, horizon, train_state
from eairl_jax.config import Config
from eairl_jax.environment import check_env
from eairl_jax.errors import InputError
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.rl import RLState, make_rl
from eairl_jax.types import Algorithm, Demonstrations, Env, HParams


def make_bc(env: Env, config: Config) -> Algorithm:
    """Builds behaviour cloning; the `data` of its `step` is `Demonstrations`.

    An iteration takes `discriminator_updates` Adam steps on minibatches of `discriminator_batch` expert samples. The
    policy also acts for one rollout, which only the metric `true_return` uses. The std is a fitted parameter:
    `HParams.std_final_fraction` has no effect.

    Raises:
      InputError: if the environment's observations are not flat vectors; from `step`, if the demonstrations hold no
        actions.
    """
    check_env(env)
    # The policy acts for the metric alone, so it acts in the task as it is.
    config = dataclasses.replace(horizon.resolved(env, config, "variable"), horizon="variable")
    optimizer = make_optimizer(env, config)

    def step(state: RLState, hparams: HParams, demos: Demonstrations):
        if demos.action is None:
            raise InputError("behaviour cloning needs the expert's actions, and these demonstrations hold none")
        hparams = hparams.at(agent.progress(state.agent, config))
        key, rollout_key, draw_key = jax.random.split(state.key, 3)
        acting, raw = agent.collect(rollout_key, state.agent, env, optimizer, config)
        policy = acting.policy

        def loss(params, x: Demonstrations):
            fitted = dataclasses.replace(policy, nets=dataclasses.replace(policy.nets, params=params))
            pi = optimizer.distribution(fitted, x.obs)
            log_prob = pi.log_prob(x.action).mean()
            return -log_prob, {"log_prob_expert": log_prob, "entropy": pi.entropy().mean()}

        count = (1, config.discriminator_updates, config.discriminator_batch)
        samples = agent.clip_actions(demos._replace(lengths=None), env, config)
        drawn = train_state.draw_minibatches(draw_key, samples, *count)
        nets, metrics = train_state.fit(policy.nets, loss, agent.normalize_obs(acting, drawn), hparams.policy_lr)
        metrics |= {"true_return": acting.rollout.mean_return, "policy_reward": jnp.zeros(())}
        policy = dataclasses.replace(policy, nets=nets)
        return RLState(key, agent.end_iteration(acting, policy, raw, config)), metrics

    # `init` and `act` are those of reinforcement learning; only the update differs.
    return make_rl(env, config)._replace(step=step)
