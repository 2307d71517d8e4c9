"""Two methods that are not part of the library, and the pendulum's expert imitated with one of them.

    python examples/method_of_your_own.py [ITERATIONS]
    eairl imitate pendulum --method examples/method_of_your_own.py:fairl
    eairl imitate pendulum --method examples/method_of_your_own.py:critic --set gradient_penalty=10

FAIRL (Ghasemipour et al. 2019) is GAIL's classifier with the reward of the forward KL divergence. The critic estimates
the Wasserstein distance between expert and policy, and its output is the reward (as in Xiao et al. 2019).
"""

import sys
from importlib.resources import files

import jax
import jax.numpy as jnp

import eairl_jax
from eairl_jax import envs
from eairl_jax.methods import METHODS, Method, gail_logit, log_d_ratio, wasserstein


def forward_kl(logit: jax.Array) -> jax.Array:
    """`-exp(h) h` of `h = log D - log(1 - D)`: the policy's reward in FAIRL, positive where D < 1/2."""
    return -jnp.exp(logit) * logit


fairl = Method(
    summary="a classifier of (s,a), forward KL (Ghasemipour et al. 2019)",
    logit_expert_high=gail_logit,  # (f, log pi) -> logit, high for the expert
    policy_reward=forward_kl,  # logit -> what the policy is paid
    reward_form="sa",
    shaping="none",
)
critic = Method(
    summary="a critic of (s,a), Wasserstein distance (Xiao et al. 2019)",
    logit_expert_high=gail_logit,
    policy_reward=log_d_ratio,  # the critic's output itself
    reward_form="sa",
    shaping="none",
    loss=wasserstein,  # (logits of the expert, logits of the policy) -> loss; without a row it is the cross-entropy
)

if __name__ == "__main__":
    METHODS["fairl"] = fairl
    iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 150
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
    lanes = eairl_jax.Lanes(eairl_jax.make_irl(env, config), keys, eairl_jax.HParams(), demos)
    state, metrics = lanes.run(lanes.init(), iterations)
    print("true return of the imitating policies:", metrics["true_return"][:, -1])
