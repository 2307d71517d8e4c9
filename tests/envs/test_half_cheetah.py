"""The half-cheetah's masses and its motors."""

import numpy as np

from eairl_jax import envs


def test_the_density_makes_the_total_mass_of_gymnasiums_model():
    np.testing.assert_allclose(envs.make("half_cheetah").model.body_mass.sum(), 14.0, rtol=1e-6)


def test_the_motors_are_in_the_order_of_the_actions():
    model = envs.make("half_cheetah").model
    names = [model.actuator(i).name for i in range(model.nu)]
    assert names == ["bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"]
    np.testing.assert_array_equal(model.actuator_gear[:, 0], [120, 90, 60, 120, 60, 30])
