"""How the adversarial methods differ: a row each.

Every method gives one number a transition, `logit = log D - log(1 - D)`, high for the expert. The discriminator's
loss is binary cross-entropy on it; the policy's reward is a function of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax

from eairl_jax.config import Config, choose


def airl_logit(f: jax.Array, log_prob: jax.Array) -> jax.Array:
    """`logit = f - log pi`, since `D = exp f / (exp f + pi)` (Eq. 9): D / (1 - D) = exp f / pi."""
    return f - log_prob


def gail_logit(f: jax.Array, _log_prob: jax.Array) -> jax.Array:
    """`logit = g(s,a)`: GAIL's discriminator is a plain classifier (Ho and Ermon 2016)."""
    return f


def log_d_ratio(logit: jax.Array) -> jax.Array:
    """`log D - log(1 - D)`: the policy's reward in AIRL and EAIRL, equal to f - log pi (Appendix B.1)."""
    return logit


def neg_log_one_minus_d(logit: jax.Array) -> jax.Array:
    """`-log(1 - D)`: the policy's reward in GAIL, always positive."""
    return jax.nn.softplus(logit)


@dataclass(frozen=True)
class Method:
    """One adversarial method.

    Attributes:
      summary: a line for the help text.
      logit_expert_high: `(f, log_prob) -> logit`.
      policy_reward: `logit -> reward` that the policy is trained on.
      reward_form: what the transferable reward sees, unless `Config.reward_form` says otherwise.
      shaping: what shapes it into f, unless `Config.shaping` says otherwise.
      empowerment: whether q and Phi are trained and l_I regularises the policy.
    """

    summary: str
    logit_expert_high: Callable[[jax.Array, jax.Array], jax.Array]
    policy_reward: Callable[[jax.Array], jax.Array]
    reward_form: str
    shaping: str
    empowerment: bool = False


METHODS: dict[str, Method] = {
    "eairl": Method("reward r(s,a) shaped by empowerment (Qureshi et al. 2019)",
                    airl_logit, log_d_ratio, "sa", "empowerment", empowerment=True),
    "airl_sa": Method("reward r(s,a) with learned shaping", airl_logit, log_d_ratio, "sa", "learned"),
    "airl_s": Method("reward r(s) with learned shaping (Fu et al. 2018)", airl_logit, log_d_ratio, "s", "learned"),
    "gail": Method("a classifier of (s,a) (Ho and Ermon 2016)", gail_logit, neg_log_one_minus_d, "sa", "none"),
}  # fmt: skip


def resolve(config: Config) -> Method:
    """The row that a configuration names, its "default" choices filled in.

    Raises:
      InputError: for an unknown method.
    """
    choose("method", config.method, METHODS)
    row = METHODS[config.method]
    reward_form = row.reward_form if config.reward_form == "default" else config.reward_form
    shaping = row.shaping if config.shaping == "default" else config.shaping
    if config.shaping == "default" and reward_form == "separable" and shaping == "empowerment":
        # g(s) has to explain every action by itself, and Phi is too flat to help it: h carries the value, as in AIRL.
        shaping = "both"
    needs_phi = row.empowerment or shaping in ("empowerment", "both")
    return Method(row.summary, row.logit_expert_high, row.policy_reward, reward_form, shaping, needs_phi)
