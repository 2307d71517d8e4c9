"""f-IRL (Ni et al. 2020): a reward of states that is learned beside a classifier, as a method of a user's own.

    eairl imitate pendulum --method examples/f_irl.py:f_irl --set history_length=0 discriminator_batch=2000

The classifier estimates how much more often the expert visits a state than the policy. The gradient of a divergence
between the two distributions of states is a covariance over trajectories of the policy. As in the authors' code, it is
estimated from trajectories of policy and expert together. The settings above leave out the replay of past policies, and
put ten trajectories of each into a minibatch.
"""

import jax
import jax.numpy as jnp

from eairl_jax.methods import Method, gail_logit


def reverse_kl(reward: jax.Array, log_ratio: jax.Array) -> jax.Array:
    """`cov(sum_t h_t, sum_t r_t) / T` `[]` of inputs `[trajectories, T]`, with h = 1 - log(rho_E / rho).

    Its gradient is that of KL(rho | rho_E), if the policy is optimal for r (Ni et al. 2020, Theorem 4.1).
    """
    h, r = (1.0 - log_ratio).sum(axis=1), reward.sum(axis=1)
    return jnp.mean((h - h.mean()) * (r - r.mean())) / reward.shape[1]


f_irl = Method(
    summary="a reward r(s) by state-marginal matching, reverse KL (Ni et al. 2020)",
    logit_expert_high=gail_logit,  # of the classifier: log(rho_E / rho)
    policy_reward=lambda r: r,  # the policy is paid the reward itself
    reward_form="s",
    shaping="none",
    reward_loss=reverse_kl,  # (rewards, logits) of whole trajectories -> loss of the reward
    discriminates="trajectories",
)
