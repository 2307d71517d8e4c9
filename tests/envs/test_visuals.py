"""Colours and floor of a model, and physics that they do not change."""

import mujoco
import numpy as np

from eairl_jax.envs.visuals import BODY_COLOUR, WORLD_COLOUR, dress

MJCF = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 1"/>
    <geom name="wall" type="plane" size="3 3 1" zaxis="1 0 0"/>
    <geom name="red" type="box" size="1 1 1" rgba="1 0 0 1"/>
    <body name="ball"><freejoint/><geom name="ball" size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def test_the_floor_is_endless_and_geoms_without_a_colour_get_one():
    spec = mujoco.MjSpec.from_string(MJCF)
    dress(spec)
    model = spec.compile()
    np.testing.assert_array_equal(model.geom("floor").size[:2], [0, 0])
    assert model.mat(model.geom("floor").matid[0]).name == "floor"
    assert [model.geom(name).matid[0] for name in ("wall", "red", "ball")] == [-1, -1, -1]
    for name, colour in {"wall": WORLD_COLOUR, "red": (1, 0, 0, 1), "ball": BODY_COLOUR}.items():
        np.testing.assert_allclose(model.geom(name).rgba, colour, rtol=1e-6)


def test_the_physics_does_not_change():
    dressed = mujoco.MjSpec.from_string(MJCF)
    dress(dressed)
    ends = []
    for model in (mujoco.MjModel.from_xml_string(MJCF), dressed.compile()):
        data = mujoco.MjData(model)
        data.qpos[:3] = [1.5, 2.0, 0.3]
        mujoco.mj_step(model, data, nstep=300)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(*ends)
