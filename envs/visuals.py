"""How a model looks: floor, sky, light and colours. Nothing in this file changes the physics."""

from __future__ import annotations

import mujoco

BODY_COLOUR, WORLD_COLOUR = (0.80, 0.45, 0.20, 1.0), (0.55, 0.60, 0.65, 1.0)
DEFAULT_COLOUR = [0.5, 0.5, 0.5, 1.0]  # MuJoCo's colour of a geom whose model names no colour


def dress(spec: mujoco.MjSpec) -> None:
    """Adds an endless chequered floor, a sky and a light to `spec`, and colours every geom that has no colour."""
    _add_sky_and_chequers(spec)
    _add_light(spec)
    for geom in spec.geoms:
        # A plane without a rotation is the floor; a rotated plane is a wall.
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE and geom.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
            geom.material = "floor"
            geom.size[:2] = 0  # MuJoCo draws a plane of size 0 without end; in the physics every plane is infinite
        elif list(geom.rgba) == DEFAULT_COLOUR:
            geom.rgba = WORLD_COLOUR if geom.parent == spec.worldbody else BODY_COLOUR


def _add_sky_and_chequers(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.95, 0.97, 1.0],
        rgb2=[0.65, 0.75, 0.85],
        width=64,
        height=64,
    )
    spec.add_texture(
        name="chequers",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.80, 0.82, 0.84],
        rgb2=[0.70, 0.72, 0.75],
        width=64,
        height=64,
    )
    material = spec.add_material(name="floor", texrepeat=[0.5, 0.5], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "chequers"


def _add_light(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_light(
        pos=[0, 0, 5],
        dir=[0, 0.3, -1],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=False,
        diffuse=[0.4, 0.4, 0.4],
    )
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.5] * 3, [0.2] * 3
