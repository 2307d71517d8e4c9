"""What a model looks like: floor, sky and colours. None of it touches the physics."""

from __future__ import annotations

import mujoco

BODY, WORLD = (0.80, 0.45, 0.20, 1.0), (0.55, 0.60, 0.65, 1.0)
GREY = [0.5, 0.5, 0.5, 1.0]  # MuJoCo's colour of what was given none


def dress(spec: mujoco.MjSpec) -> None:
    """Gives a model an endless chequered floor, a sky, a light, and a colour to whatever has none."""
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
                     rgb1=[0.95, 0.97, 1.0], rgb2=[0.65, 0.75, 0.85], width=64, height=64)  # fmt: skip
    spec.add_texture(name="chequers", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
                     rgb1=[0.80, 0.82, 0.84], rgb2=[0.70, 0.72, 0.75], width=64, height=64)  # fmt: skip
    material = spec.add_material(name="floor", texrepeat=[0.5, 0.5], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "chequers"
    spec.worldbody.add_light(pos=[0, 0, 5], dir=[0, 0.3, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
                             castshadow=False, diffuse=[0.4, 0.4, 0.4])  # fmt: skip
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.5] * 3, [0.2] * 3
    for geom in spec.geoms:
        # A plane that was not turned is a floor, another is a wall.
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE and geom.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
            geom.material = "floor"
            geom.size[:2] = 0  # drawn without end; to the physics every plane is
        elif list(geom.rgba) == GREY:
            geom.rgba = WORLD if geom.parent == spec.worldbody else BODY
