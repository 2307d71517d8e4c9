"""Behaviour cloning: the policy by maximum likelihood on the demonstrations, and nothing else."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from eairl_jax import agent, train_state
from eairl_jax.config import Config
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.rl import RLState, make_rl
from eairl_jax.types import Algorithm, Demonstrations, Env, HParams


def make_bc(env: Env, config: Config) -> Algorithm:
    """Builds behaviour cloning; its `data` is `Demonstrations`.

    An iteration is `discriminator_updates` minibatches of `discriminator_batch` expert samples. It also acts for one
    rollout, which only the metric `true_return` uses. The std is fitted too: `HParams.std_final_fraction` has no say.

    Raises:
      InputError: for an environment without flat observations.
    """
    optimizer = make_optimizer(env, config)

    def step(state: RLState, hparams: HParams, demos: Demonstrations):
        hparams = hparams.at(agent.progress(state.agent, config))
        key, rollout_key, draw_key = jax.random.split(state.key, 3)
        acting, raw = agent.collect(rollout_key, state.agent, env, optimizer, config)
        policy = acting.policy

        def loss(params, x: Demonstrations):
            pi = optimizer.distribution(policy.replace(nets=policy.nets.replace(params=params)), x.obs)
            log_prob = pi.log_prob(x.action).mean()
            return -log_prob, {"log_prob_expert": log_prob, "entropy": pi.entropy().mean()}

        drawn = train_state.draw(
            draw_key, agent.seen(demos, env, config), 2, config.discriminator_updates, config.discriminator_batch
        )
        nets, metrics = train_state.fit(policy.nets, loss, agent.normalized(acting, drawn), hparams.policy_lr)
        metrics |= {"true_return": acting.rollout.mean_return, "policy_reward": jnp.zeros(())}
        return RLState(key, agent.finish(acting, policy.replace(nets=nets), raw, config)), metrics

    # It begins and acts as any policy in training does; what it learns from is all that differs.
    return make_rl(env, config)._replace(step=step)
