"""The ant's legs, its reward near the ground, and what is refused."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.ant import LEGS, MOTORS
from eairl_jax.envs.mjx_task import Physics


def of_leg(model, number):
    """`(length of thigh, length of shin, reach from hip to foot, gears)` of a leg."""
    thigh, shin = model.geom(f"thigh_{number}"), model.geom(f"shin_{number}")
    knee = model.body(f"shin_{number}").pos
    gears = [model.actuator(f"{joint}_{number}").gear[0] for joint in ("hip", "ankle")]
    return 2 * thigh.size[1], 2 * shin.size[1], np.linalg.norm(knee + 2 * shin.pos), gears


@pytest.mark.parametrize("fidelity", ["fast", "exact"])
def test_crippled_legs_are_half_as_long_and_weak_and_the_others_sound(fidelity):
    model = envs.make("crippled_ant", fidelity=fidelity).model
    thigh = 0.2 * np.sqrt(2)
    for number, (_, y) in enumerate(LEGS.values(), start=1):
        share, gear = (1.0, 30.0) if y > 0 else (0.5, 1.0)
        *lengths, gears = of_leg(model, number)
        np.testing.assert_allclose(lengths, np.array([thigh, 2 * thigh, 3 * thigh]) * share, rtol=1e-6)
        assert gears == [gear, gear]


def test_actions_keep_their_order():
    for task in ("ant", "crippled_ant"):
        model = envs.make(task).model
        assert [model.actuator(i).name for i in range(model.nu)] == MOTORS
        assert [model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nu)] == MOTORS


def test_any_leg_can_be_crippled_to_any_length():
    model = envs.make("ant", crippled="front_left_leg", length=0.25, gear=3.0).model
    np.testing.assert_allclose(of_leg(model, 1)[0], 0.05 * np.sqrt(2), rtol=1e-6)
    assert of_leg(model, 1)[3] == [3.0, 3.0]
    np.testing.assert_allclose(of_leg(model, 2)[0], 0.2 * np.sqrt(2), rtol=1e-6)


@pytest.mark.parametrize("task", ["ant", "crippled_ant"])
@pytest.mark.parametrize("fidelity", ["fast", "exact"])
def test_every_part_touches_the_floor(task, fidelity):
    env = envs.make(task, fidelity=fidelity)
    data = mujoco.MjData(env.model)
    data.qpos[2] = -1.0
    mujoco.mj_forward(env.model, data)
    touching = {env.model.geom(g).name for contact in data.contact for g in contact.geom}
    assert touching == {env.model.geom(g).name for g in range(env.model.ngeom)}
    assert len(data.contact) == len(env._constraints.geom) == 25  # a torso and twelve capsules of two ends


def test_being_near_the_ground_costs_one():
    env = envs.make("ant")
    before = Physics(jnp.asarray(env.model.qpos0), jnp.zeros(14), jnp.zeros(14))
    high = before.replace(qpos=before.qpos.at[0].add(0.1).at[2].set(0.21))
    low = before.replace(qpos=high.qpos.at[2].set(0.19))
    action = jnp.full(8, 0.5)
    np.testing.assert_allclose(env.reward(before, action, high), 0.1 / 0.05 - 0.01 * 2.0, rtol=1e-5)
    np.testing.assert_allclose(env.reward(before, action, low), 0.1 / 0.05 - 0.01 * 2.0 - 1, rtol=1e-5)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            dict(crippled=("middle_leg",)),
            "crippled = middle_leg: unknown leg; expected names from front_left_leg, front_right",
        ),
        (dict(crippled=("back_leg",), length=-0.5), r"length = -0.5: expected a share .* from 0.01"),
        (dict(crippled=("back_leg",), length=float("nan")), "length = nan"),
        (dict(crippled=("back_leg",), gear=-1.0), "gear = -1.0: expected N m, from 0 to 1000"),
    ],
)
def test_impossible_legs_are_refused(settings, message):
    with pytest.raises(envs.TaskError, match=message):
        envs.make("ant", **settings)
