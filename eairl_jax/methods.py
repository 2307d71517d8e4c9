"""How the adversarial methods differ: a row each.

Every method gives one number a transition, `logit = log D - log(1 - D)`, high for the expert. The discriminator's
loss is binary cross-entropy on it, or on its sum over a trajectory; the policy's reward is a function of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import jax

from eairl_jax.config import METHOD_DEFAULTS, Config, choose


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

    The fields after `policy_reward` are what "default" means in the `Config` fields of the same names; theirs is the
    documentation. Their defaults here are the paper's EAIRL, `reward_form` apart.

    Attributes:
      summary: a line for the help text.
      logit_expert_high: `(f, log_prob) -> logit`, a transition.
      policy_reward: `logit -> reward` that the policy is trained on.
      empowerment: whether l_I regularises the policy, so that q and Phi are trained even if they shape nothing.
    """

    summary: str
    logit_expert_high: Callable[[jax.Array, jax.Array], jax.Array]
    policy_reward: Callable[[jax.Array], jax.Array]
    reward_form: str
    shaping: str
    empowerment: bool = False
    discriminates: str = "transitions"
    shaping_discount: str = "gamma"
    policy_phi: str = "target"
    history: str = "iterations"
    update_order: str = "empowerment_first"
    l_i_actions: str = "stored"
    inverse_loss: str = "likelihood"
    policy_activation: str = "relu"


METHODS: dict[str, Method] = {
    "eairl": Method("reward r(s,a) shaped by empowerment (Qureshi et al. 2019)",
                    airl_logit, log_d_ratio, "sa", "empowerment", empowerment=True),
    "eairl_release": Method("EAIRL as its authors released it, where that differs from their paper",
                            airl_logit, log_d_ratio, "sa", "empowerment", empowerment=True, shaping_discount="one",
                            policy_phi="online", history="paths", update_order="discriminator_first",
                            l_i_actions="resampled", inverse_loss="mse", policy_activation="tanh"),
    "airl_sa": Method("reward r(s,a) with learned shaping", airl_logit, log_d_ratio, "sa", "learned"),
    "airl_s": Method("reward r(s) with learned shaping (Fu et al. 2018)", airl_logit, log_d_ratio, "s", "learned"),
    "gail": Method("a classifier of (s,a) (Ho and Ermon 2016)", gail_logit, neg_log_one_minus_d, "sa", "none"),
    # D = exp f(tau) / (exp f(tau) + pi(tau)), whose 1/Z is the bias of f; the policy's -log(1 - D) + log D is
    # f(tau) - log pi(tau), a sum over the trajectory and so a reward a transition.
    "gan_gcl": Method("a discriminator of whole trajectories (Finn et al. 2016)",
                      airl_logit, log_d_ratio, "sa", "none", discriminates="trajectories"),
}  # fmt: skip


def names() -> tuple[str, ...]:
    """Every method: the rows, and behaviour cloning, which has no adversary and so no row but `bc.make_bc`."""
    return (*METHODS, "bc")


def with_method_defaults(config: Config) -> Config:
    """The configuration with every "default" replaced by the method's own.

    Raises:
      InputError: for an unknown method.
    """
    choose("method", config.method, METHODS)
    row = METHODS[config.method]
    own = {name: getattr(row, name) for name in METHOD_DEFAULTS if getattr(config, name) == "default"}
    form = own.get("reward_form", config.reward_form)
    if own.get("shaping") == "empowerment" and form == "separable":
        # g(s) has to explain every action by itself, and Phi is too flat to help it: h carries the value, as in AIRL.
        own["shaping"] = "both"
    return dataclasses.replace(config, **own)


def uses_empowerment(config: Config) -> bool:
    """Whether a resolved configuration trains q and Phi."""
    return METHODS[config.method].empowerment or config.shaping in ("empowerment", "both")
