"""Rates over the length of a run."""

import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams


@pytest.mark.parametrize(("progress", "lr"), [(0.0, 0.4), (0.5, 0.22), (1.0, 0.04), (3.0, 0.04)])
def test_annealed_rates_fall_in_a_line_to_their_end_and_stay_there(progress, lr):
    hparams = HParams(policy_lr=0.4, policy_lr_final_fraction=0.1, entropy_weight=0.1, phi_lr=0.7).at(
        jnp.asarray(progress)
    )
    np.testing.assert_allclose([hparams.policy_lr, hparams.entropy_weight], [lr, 0.1], rtol=1e-6)
    assert hparams.phi_lr == 0.7


def test_entropy_and_temperature_are_annealed_on_their_own():
    given = HParams(
        policy_lr=0.4, entropy_weight=0.1, entropy_final_fraction=0.0, temperature=2.0, temperature_final_fraction=0.5
    )
    hparams = given.at(jnp.asarray(0.75))
    annealed = [hparams.policy_lr, hparams.entropy_weight, hparams.temperature]
    np.testing.assert_allclose(annealed, [0.4, 0.025, 1.25], rtol=1e-6)


@pytest.mark.parametrize(("progress", "fraction"), [(0.0, 1.0), (0.5, 0.1), (0.75, 0.1**1.5), (1.0, 0.01), (3.0, 0.01)])
def test_the_std_falls_by_the_same_factor_everywhere_to_its_end_and_stays_there(progress, fraction):
    np.testing.assert_allclose(
        HParams(std_final_fraction=0.01).at(jnp.asarray(progress)).std_final_fraction, fraction, rtol=1e-5
    )
    assert HParams().at(jnp.asarray(progress)).std_final_fraction == 1.0
