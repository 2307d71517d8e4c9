"""How the adversarial methods differ: one `Method` for each.

Every method computes one number for each transition, `logit = log D - log(1 - D)`, which is high for the expert. The
discriminator's loss is a function of the logits, or of their sums over trajectories: for all methods of this file the
binary cross-entropy. The policy's reward is a function of the logit, unless the method's `reward_loss` trains a reward
beside it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from eairl_jax.config import METHOD_DEFAULTS, Config, choose
from eairl_jax.errors import InputError

if TYPE_CHECKING:
    import jax


def airl_logit(f: jax.Array, log_prob: jax.Array) -> jax.Array:
    """`logit = f - log pi`, of any shape. `D = exp f / (exp f + pi)` (Eq. 9) gives `D / (1 - D) = exp f / pi`."""
    return f - log_prob


def gail_logit(f: jax.Array, _log_prob: jax.Array) -> jax.Array:
    """`logit = g(s,a)`, of any shape: GAIL's discriminator is a plain classifier (Ho and Ermon 2016)."""
    return f


def log_d_ratio(logit: jax.Array) -> jax.Array:
    """`log D - log(1 - D)`: the policy's reward in AIRL and EAIRL, equal to f - log pi (Appendix B.1)."""
    return logit


def neg_log_one_minus_d(logit: jax.Array) -> jax.Array:
    """`-log(1 - D)`: the policy's reward in GAIL, always positive (Ho and Ermon 2016)."""
    import jax  # here, because the table of methods is also read by programs without jax

    return jax.nn.softplus(logit)


def cross_entropy(expert_logit: jax.Array, policy_logit: jax.Array) -> jax.Array:
    """Binary cross-entropy `[]` of logits `[batch]` with the label 1 for the expert (Eq. 10, whose signs are wrong).

    `-log D = softplus(-logit)` for the expert, `-log(1 - D) = softplus(logit)` for the policy.
    """
    import jax

    return 0.5 * (jax.nn.softplus(-expert_logit).mean() + jax.nn.softplus(policy_logit).mean())


def wasserstein(expert_logit: jax.Array, policy_logit: jax.Array) -> jax.Array:
    """`E_policy logit - E_expert logit`, `[]`: a critic's loss (Arjovsky et al. 2017). It needs `gradient_penalty`."""
    return policy_logit.mean() - expert_logit.mean()


@dataclass(frozen=True)
class Method:
    """One adversarial method.

    The fields after `empowerment`, and `reward_form` and `shaping`, are the values that "default" stands for in the
    `Config` fields of the same names, where they are documented.
    """

    summary: str
    """One line for the help text."""
    logit_expert_high: Callable[[jax.Array, jax.Array], jax.Array]
    """`(f, log pi(a|s)) -> logit` of transitions, all of one shape."""
    policy_reward: Callable[[jax.Array], jax.Array]
    """`logit -> reward` that the policy is trained on. With `reward_loss` its argument is the reward r."""
    reward_form: str
    shaping: str
    loss: Callable[[jax.Array, jax.Array], jax.Array] = cross_entropy
    """`(logits [batch] of the expert, logits [batch] of the policy) -> loss []` of the discriminator."""
    reward_loss: Callable[[jax.Array, jax.Array], jax.Array] | None = None
    """`(rewards [2 batch, length], logits [2 batch, length]) -> loss []` of a reward r that is no part of the logit.

    The first half is of the expert, the second of the policy. The logits are constants: only r learns from this loss.
    The logit's f is then a network of its own, with the inputs of r. `loss` trains it on single transitions, also if
    the method discriminates trajectories.
    """
    empowerment: bool = False
    """Whether l_I regularises the policy. q and Phi are then trained even if Phi does not shape the reward."""
    discriminates: str = "transitions"
    shaping_discount: str = "gamma"
    policy_phi: str = "target"
    history: str = "iterations"
    update_order: str = "empowerment_first"
    l_i_actions: str = "stored"
    inverse_loss: str = "likelihood"
    policy_activation: str = "relu"


METHODS: dict[str, Method] = {
    "eairl": Method(
        summary="reward r(s,a) shaped by empowerment (Qureshi et al. 2019)",
        logit_expert_high=airl_logit,
        policy_reward=log_d_ratio,
        reward_form="sa",
        shaping="empowerment",
        empowerment=True,
    ),
    "eairl_release": Method(
        summary="EAIRL as its authors released it, where that differs from their paper",
        logit_expert_high=airl_logit,
        policy_reward=log_d_ratio,
        reward_form="sa",
        shaping="empowerment",
        empowerment=True,
        shaping_discount="one",
        policy_phi="online",
        history="paths",
        update_order="discriminator_first",
        l_i_actions="resampled",
        inverse_loss="mse",
        policy_activation="tanh",
    ),
    "airl_sa": Method(
        summary="reward r(s,a) with learned shaping",
        logit_expert_high=airl_logit,
        policy_reward=log_d_ratio,
        reward_form="sa",
        shaping="learned",
    ),
    "airl_s": Method(
        summary="reward r(s) with learned shaping (Fu et al. 2018)",
        logit_expert_high=airl_logit,
        policy_reward=log_d_ratio,
        reward_form="s",
        shaping="learned",
    ),
    "gail": Method(
        summary="a classifier of (s,a) (Ho and Ermon 2016)",
        logit_expert_high=gail_logit,
        policy_reward=neg_log_one_minus_d,
        reward_form="sa",
        shaping="none",
    ),
    "gaifo": Method(
        summary="a classifier of (s,s') that needs no actions of the expert: g(s), shaped (after Torabi et al. 2018)",
        logit_expert_high=gail_logit,
        policy_reward=neg_log_one_minus_d,
        reward_form="s",
        shaping="learned",
    ),
    # D = exp f(tau) / (exp f(tau) + pi(tau)); the bias of f learns 1/Z. The policy's reward of a trajectory,
    # log D - log(1 - D) = f(tau) - log pi(tau), is a sum over the transitions: each transition has its part as reward.
    "gan_gcl": Method(
        summary="a discriminator of whole trajectories (Finn et al. 2016)",
        logit_expert_high=airl_logit,
        policy_reward=log_d_ratio,
        reward_form="sa",
        shaping="none",
        discriminates="trajectories",
    ),
}


LEARNED_PHI = ("empowerment", "both")
LEARNED_H = ("learned", "both")
"""Values of `Config.shaping` with each learned potential."""
EXACT_PHI = "exact_empowerment"
"""The value of `Config.shaping` for which the simulator says what Phi is."""

BUILT_IN = frozenset(METHODS)
"""The methods that every program with this library has. Others come from a user's code."""

STATE_ONLY_ADVICE = "choose --method gaifo, or --method gail --reward-form s"


def needs_expert_actions(config: Config) -> bool:
    """Whether a method, without "default" values, can only learn from demonstrations that hold actions."""
    if config.method not in METHODS:  # behaviour cloning
        return True
    return METHODS[config.method].logit_expert_high is not gail_logit or config.reward_form != "s"


def method_names() -> tuple[str, ...]:
    """Every name that `Config.method` accepts: the keys of `METHODS`, and "bc", which is built by `bc.make_bc`."""
    return (*METHODS, "bc")


def with_method_defaults(config: Config) -> Config:
    """The configuration with the method's value in place of every "default".

    A configuration without a "default" stays as it is, even if its method is known in another program only.

    Raises:
      InputError: if no adversarial method has the name `config.method`.
    """
    if not any(getattr(config, name) == "default" for name in METHOD_DEFAULTS):
        return config
    choose("method", config.method, METHODS)
    method = METHODS[config.method]
    defaults = {name: getattr(method, name) for name in METHOD_DEFAULTS if getattr(config, name) == "default"}
    reward_form = defaults.get("reward_form", config.reward_form)
    if defaults.get("shaping") == "empowerment" and reward_form == "separable":
        # Without h, g(s) alone would have to explain every action, and Phi is too flat to help. h carries the value
        # function, as in AIRL.
        defaults["shaping"] = "both"
    return dataclasses.replace(config, **defaults)


def of_known_method(config: Config) -> Config:
    """`with_method_defaults`, for a configuration that is going to be trained.

    Raises:
      InputError: if no adversarial method has the name `config.method`, or if the method cannot be shaped.
    """
    choose("method", config.method, METHODS)
    config = with_method_defaults(config)
    if METHODS[config.method].reward_loss and config.shaping != "none":
        raise InputError(
            f"{config.method} pays the policy its reward as it is, so shaping = {config.shaping} has no place: use "
            "shaping = none"
        )
    return config


def uses_empowerment(config: Config) -> bool:
    """Whether a configuration without "default" values trains q and Phi."""
    return METHODS[config.method].empowerment or config.shaping in LEARNED_PHI
