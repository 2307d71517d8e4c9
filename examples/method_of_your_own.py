"""Add a method, FAIRL, and imitate the pendulum's expert with the method.

    python examples/method_of_your_own.py [ITERATIONS]

FAIRL (Ghasemipour et al. 2019) is GAIL's classifier with the reward of the forward KL divergence.
"""

import sys
from importlib.resources import files

import jax
import jax.numpy as jnp

import eairl_jax
from eairl_jax import envs
from eairl_jax.methods import METHODS, Method, gail_logit

iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 150


def forward_kl(logit: jax.Array) -> jax.Array:
    """`-exp(h) h` of `h = log D - log(1 - D)`: the policy's reward in FAIRL, positive where D < 1/2."""
    return -jnp.exp(logit) * logit


METHODS["fairl"] = Method(
    summary="a classifier of (s,a), forward KL (Ghasemipour et al. 2019)",
    logit_expert_high=gail_logit,  # (f, log pi) -> logit, high for the expert
    policy_reward=forward_kl,  # logit -> what the policy is paid
    reward_form="sa",
    shaping="none",
)

env = envs.make("pendulum")
demos = eairl_jax.demonstrations.load(files("eairl_jax.experiments") / "data/pendulum.npz")
config = eairl_jax.Config(
    method="fairl",
    num_envs=10,
    rollout_length=200,
    episode_length=env.episode_length,
    iterations=iterations,
    log_std_init=0.0,
    log_std_max=1.0,
)
keys = jax.random.split(jax.random.PRNGKey(0), 2)
# exp(h) is unbounded: a penalty on the classifier's slopes would keep the reward tame (gradient_penalty).
lanes = eairl_jax.Lanes(eairl_jax.make_irl(env, config), keys, eairl_jax.HParams(), demos)
state, metrics = lanes.run(lanes.init(), iterations)
print("true return of the imitating policies:", metrics["true_return"][:, -1])
