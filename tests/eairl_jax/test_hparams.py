"""Rates over the length of a run, and values that no run can have."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, InputError
from eairl_jax.arguments import SMALLEST, Range
from eairl_jax.hparams import RANGES, check_hparams


@pytest.mark.parametrize(("progress", "lr"), [(0.0, 0.4), (0.5, 0.22), (1.0, 0.04), (3.0, 0.04)])
def test_annealed_rates_fall_in_a_line_to_their_end_and_stay_there(progress, lr):
    hparams = HParams(policy_lr=0.4, policy_lr_final_fraction=0.1, entropy_weight=0.1, phi_lr=0.7).at(
        jnp.asarray(progress)
    )
    np.testing.assert_allclose([hparams.policy_lr, hparams.entropy_weight], [lr, 0.1], rtol=1e-6)
    assert hparams.phi_lr == 0.7


def test_entropy_and_temperature_are_annealed_on_their_own():
    start = HParams(
        policy_lr=0.4, entropy_weight=0.1, entropy_final_fraction=0.0, temperature=2.0, temperature_final_fraction=0.5
    )
    hparams = start.at(jnp.asarray(0.75))
    annealed = [hparams.policy_lr, hparams.entropy_weight, hparams.temperature]
    np.testing.assert_allclose(annealed, [0.4, 0.025, 1.25], rtol=1e-6)


@pytest.mark.parametrize(("progress", "fraction"), [(0.0, 1.0), (0.5, 0.1), (0.75, 0.1**1.5), (1.0, 0.01), (3.0, 0.01)])
def test_the_std_falls_by_the_same_factor_everywhere_to_its_end_and_stays_there(progress, fraction):
    for first in (1.0, 5.0):
        hparams = HParams(std_initial_fraction=first, std_final_fraction=0.01 * first).at(jnp.asarray(progress))
        np.testing.assert_allclose(hparams.std_final_fraction, first * fraction, rtol=1e-5)
    assert HParams().at(jnp.asarray(progress)).std_final_fraction == 1.0


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("gamma", 1.5, "gamma = 1.5: expected a number at least 0 and at most 1, for example 0.99"),
        ("gae_lambda", np.float32(2.0), "gae_lambda = 2: .* at most 1"),
        ("policy_lr", -1.0, "policy_lr = -1: expected a number at least 0 and at most 100, for example 0.001"),
        ("beta", np.nan, "beta = nan"),
        ("lambda_i", np.inf, "lambda_i = inf"),
        ("kl_limit", 0.0, "kl_limit = 0: expected a number above 0"),
        ("std_final_fraction", 0.0, "std_final_fraction = 0: expected a number above 0"),
        ("lambda_i", np.array([0.1, -0.2, 0.3]), "lambda_i = -0.2"),
        ("phi_lr", jnp.array([1e-3, jnp.nan]), "phi_lr = nan"),
        ("policy_lr", "fast", "policy_lr = 'fast': expected a number"),
        ("policy_lr", None, "policy_lr = None|policy_lr = nan"),
    ],
)
def test_a_value_that_no_run_can_have_is_refused_by_name(name, value, expected):
    with pytest.raises(InputError, match=expected):
        check_hparams(HParams(**{name: value}))


def test_possible_values_are_accepted_and_tracers_are_not_checked():
    check_hparams(HParams())
    check_hparams(HParams(gamma=1.0, gae_lambda=0.0, policy_lr=0, lambda_i=np.array([0.0, 1e3])))

    @jax.jit
    def traced(gamma):
        check_hparams(HParams(gamma=gamma))
        return gamma

    assert traced(1.5) == 1.5


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(HParams)])
@pytest.mark.parametrize("value", [1e38, 1e-45, -1e30, -1e-45, 1e300, 2e6, np.float32(1e38), jnp.array([0.5, 1e38])])
def test_an_absurd_value_of_any_setting_is_refused(name, value):
    with pytest.raises(InputError, match=f"{name} = .*: expected a number .* and at most"):
        check_hparams(HParams(**{name: value}))


def test_the_ends_of_the_ranges_are_possible_in_single_precision_too():
    for field in dataclasses.fields(HParams):
        high = RANGES.get(field.name, Range()).high
        for value in (high, SMALLEST):
            check_hparams(HParams(**{field.name: value}))
            check_hparams(HParams(**{field.name: np.float32(value)}))
    with pytest.raises(InputError, match=r"phi_lr = 1e-20: .* a number below 1e-12 acts as 0"):
        check_hparams(HParams(phi_lr=1e-20))


def test_zero_is_possible_for_every_setting_but_three():
    """TRPO never moves with a KL limit of 0, and a std of 0 has no density."""
    for field in dataclasses.fields(HParams):
        hparams = HParams(**{field.name: 0.0})
        if field.name in ("kl_limit", "std_initial_fraction", "std_final_fraction"):
            with pytest.raises(InputError, match=field.name):
                check_hparams(hparams)
        else:
            check_hparams(hparams)
