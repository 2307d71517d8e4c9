"""Logits and policy rewards against their definitions by D, in double precision."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import METHODS, InputError
from eairl_jax.methods import (
    airl_logit,
    cross_entropy,
    gail_logit,
    log_d_ratio,
    neg_log_one_minus_d,
    of_known_method,
    wasserstein,
    with_method_defaults,
)

RNG = np.random.default_rng(0)
F, LOG_PI = RNG.normal(0, 2, 200), RNG.normal(-1, 2, 200)
AIRL_D = np.exp(F) / (np.exp(F) + np.exp(LOG_PI))
GAIL_D = 1 / (1 + np.exp(-F))

# (what the paper says, what the authors' code does)
RELEASE = {
    "shaping_discount": ("gamma", "one"),
    "policy_phi": ("target", "online"),
    "history": ("iterations", "paths"),
    "update_order": ("empowerment_first", "discriminator_first"),
    "l_i_actions": ("stored", "resampled"),
    "inverse_loss": ("likelihood", "mse"),
    "policy_activation": ("relu", "tanh"),
}


# Each logit and each reward, by its definition in D; a new one gets a line here.
D_OF = {airl_logit: AIRL_D, gail_logit: GAIL_D}
REWARD_OF = {log_d_ratio: lambda d: np.log(d) - np.log(1 - d), neg_log_one_minus_d: lambda d: -np.log(1 - d)}


@pytest.mark.parametrize("method", METHODS)
def test_logit_and_reward_follow_from_d(method):
    row = METHODS[method]
    logit, d = row.logit_expert_high(jnp.asarray(F), jnp.asarray(LOG_PI)), D_OF[row.logit_expert_high]
    np.testing.assert_allclose(1 / (1 + np.exp(-np.asarray(logit, np.float64))), d, atol=1e-5)
    np.testing.assert_allclose(row.policy_reward(logit), REWARD_OF[row.policy_reward](d), atol=1e-5)


@pytest.mark.parametrize("method", [name for name, row in METHODS.items() if row.policy_reward is log_d_ratio])
def test_airls_reward_is_f_minus_log_pi(method):
    row = METHODS[method]
    reward = row.policy_reward(row.logit_expert_high(jnp.asarray(F), jnp.asarray(LOG_PI)))
    np.testing.assert_allclose(reward, F - LOG_PI, atol=1e-5)


def test_gails_reward_is_positive_and_does_not_see_pi():
    row = METHODS["gail"]
    logits = [row.logit_expert_high(jnp.asarray(F), jnp.asarray(LOG_PI * scale)) for scale in (0.0, 3.0)]
    np.testing.assert_array_equal(*logits)
    assert (row.policy_reward(logits[0]) > 0).all()


def test_rows_differ_in_what_the_paper_says():
    assert {
        name: (row.reward_form, row.shaping, row.empowerment, row.discriminates) for name, row in METHODS.items()
    } == {
        "eairl": ("sa", "empowerment", True, "transitions"),
        "eairl_release": ("sa", "empowerment", True, "transitions"),
        "airl_sa": ("sa", "learned", False, "transitions"),
        "airl_s": ("s", "learned", False, "transitions"),
        "gail": ("sa", "none", False, "transitions"),
        "gaifo": ("s", "learned", False, "transitions"),
        "gan_gcl": ("sa", "none", False, "trajectories"),
    }


def test_only_the_release_leaves_the_paper_and_where_it_does():
    own = {name: {field: getattr(row, field) for field in RELEASE} for name, row in METHODS.items()}
    paper = {field: choices[0] for field, choices in RELEASE.items()}
    release = {field: choices[1] for field, choices in RELEASE.items()}
    assert own == dict.fromkeys(METHODS, paper) | {"eairl_release": release}


def test_losses_follow_from_their_definitions():
    expert, policy = F[:100], F[100:150]
    d_expert, d_policy = 1 / (1 + np.exp(-expert)), 1 / (1 + np.exp(-policy))
    expected = -0.5 * (np.log(d_expert).mean() + np.log(1 - d_policy).mean())
    np.testing.assert_allclose(cross_entropy(jnp.asarray(expert), jnp.asarray(policy)), expected, rtol=1e-5)
    critic = wasserstein(jnp.asarray(expert), jnp.asarray(policy))
    np.testing.assert_allclose(critic, policy.mean() - expert.mean(), rtol=1e-5)


def test_a_reward_beside_the_classifier_cannot_be_shaped(tiny, monkeypatch):
    row = dataclasses.replace(METHODS["gail"], reward_loss=lambda r, logit: -(r * logit).mean())
    monkeypatch.setitem(METHODS, "beside", row)
    assert of_known_method(tiny(method="beside")).shaping == "none"
    with pytest.raises(InputError, match="shaping = learned has no place: use shaping = none"):
        of_known_method(tiny(method="beside", shaping="learned"))


def test_settings_without_a_default_need_no_method(tiny):
    resolved = with_method_defaults(tiny(method="airl_s"))
    elsewhere = dataclasses.replace(resolved, method="known in another program")
    assert with_method_defaults(elsewhere) == elsewhere
    with pytest.raises(InputError, match="unknown method"):
        with_method_defaults(tiny(method="known in another program"))
