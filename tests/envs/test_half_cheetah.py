"""The half-cheetah's masses and its motors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import envs


def test_the_density_makes_the_total_mass_of_gymnasiums_model():
    np.testing.assert_allclose(envs.make("half_cheetah").model.body_mass.sum(), 14.0, rtol=1e-6)


def test_the_motors_are_in_the_order_of_the_actions():
    model = envs.make("half_cheetah").model
    names = [model.actuator(i).name for i in range(model.nu)]
    assert names == ["bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot"]
    np.testing.assert_array_equal(model.actuator_gear[:, 0], [120, 90, 60, 120, 60, 30])


def test_the_cost_of_actions_is_an_argument():
    action, rewards = jnp.full(6, 0.5), {}
    for cost in (0.1, 2.0):
        env = envs.make(f"half_cheetah?control_cost={cost}")
        assert env.gymnasium.settings == {"ctrl_cost_weight": cost}
        rewards[cost] = jax.jit(env.step)(jax.jit(env.reset)(jax.random.PRNGKey(0)), action).reward
    np.testing.assert_allclose(rewards[0.1] - rewards[2.0], 1.9 * 6 * 0.25, rtol=1e-5)
    assert envs.make("half_cheetah").control_cost == 0.1


@pytest.mark.parametrize("cost", ["-1", "x", "nan", "1e9", "null", "true"])
def test_another_cost_is_refused(cost):
    with pytest.raises(envs.TaskError, match=r"control_cost = .*: expected a weight"):
        envs.make(f"half_cheetah?control_cost={cost}")
