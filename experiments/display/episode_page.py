"""A web page that plays an episode in brax's viewer. The page holds everything that it needs and loads nothing."""

from __future__ import annotations

import base64
import html
import json
import re
import string
from importlib.resources import files

import mujoco
import numpy as np

from eairl_jax.envs.mjx_task import Task

SHAPES = {
    mujoco.mjtGeom.mjGEOM_PLANE: "Plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "Sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "Capsule",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "Cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "Box",
}
UNKNOWN_DT = 0.05  # seconds between two observations of a task that does not say
BRAX_MODULES = ("viewer", "animator", "selector", "system")
# three.js r154 is the last release whose lights are as bright as those of r150, which brax's viewer was written for.
OUR_MODULES = {
    "three": "three.module.min.js",
    "three/addons/controls/OrbitControls.js": "OrbitControls.js",
    "lilgui": "gui.js",
}


def page(title: str, env: Task, qpos: np.ndarray) -> str:
    """The page, as text.

    Args:
      qpos: positions `[T, nq]`, one environment step apart.
    """
    # Without "<", no name in the scene can end the script that the scene stands in, or begin a comment in it.
    system = json.dumps(scene(env, qpos)).replace("<", "\\u003c")
    template = string.Template((_viewer() / "page.html").read_text(encoding="utf-8"))
    return template.substitute(title=html.escape(title), importmap=json.dumps(_import_map()), system=system)


def scene(env: Task, qpos: np.ndarray) -> dict:
    """What brax's viewer reads: the shapes of every body, where each body is after every step, and the camera."""
    model = env.model
    assert model is not None  # `episodes.check_drawable` refuses a task without a model
    states = _body_poses(model, qpos)
    target = np.array(states[0]["pos"][0] if env.camera.follows else model.stat.center)
    return {
        "opt": {"timestep": env.dt or UNKNOWN_DT},
        "geoms": _shapes(model),
        "states": {"x": states},
        "camera": {
            "position": (target + env.camera.offset()).tolist(),
            "target": target.tolist(),
            "follow": env.camera.follows,
        },
    }


def _shapes(model: mujoco.MjModel) -> dict[str, list[dict]]:
    """The visible shapes of every body, by the body's name."""
    bodies = [model.body(b).name or f"body {b}" for b in range(model.nbody)]
    shapes: dict[str, list[dict]] = {}
    for g in range(model.ngeom):
        body, kind = int(model.geom_bodyid[g]), mujoco.mjtGeom(model.geom_type[g])
        if kind not in SHAPES or model.geom_rgba[g, 3] == 0:
            continue
        # The viewer draws a plane of size 0 as an endless chequered floor.
        size = [0.0, 0.0, 0.0] if kind == mujoco.mjtGeom.mjGEOM_PLANE else model.geom_size[g].tolist()
        shape = {
            "name": SHAPES[kind],
            "link_idx": body - 1,
            "size": size,
            "pos": model.geom_pos[g].tolist(),
            "rot": model.geom_quat[g].tolist(),
            "rgba": model.geom_rgba[g].tolist(),
        }
        shapes.setdefault(bodies[body], []).append(shape)
    return shapes


def _body_poses(model: mujoco.MjModel, qpos: np.ndarray) -> list[dict]:
    """Position (metres) and orientation (quaternion) of every body but the world, for each `qpos`."""
    data, poses = mujoco.MjData(model), []
    for positions in qpos:
        data.qpos[:] = positions
        mujoco.mj_kinematics(model, data)
        poses.append({"pos": data.xpos[1:].round(4).tolist(), "rot": data.xquat[1:].round(4).tolist()})
    return poses


def _viewer():
    return files("eairl_jax.experiments.display") / "viewer"


def _import_map() -> dict:
    """The import map: every module as a data URL, under the name that the modules import it by."""
    import brax

    folder = files(brax) / "visualizer" / "js"
    code = {f"brax/{name}": (folder / f"{name}.js").read_text(encoding="utf-8") for name in BRAX_MODULES}
    # A relative import means nothing inside a data URL.
    code = {name: re.sub(r"from '\./(\w+)\.js'", r"from 'brax/\1'", text) for name, text in code.items()}
    code |= {name: (_viewer() / file).read_text(encoding="utf-8") for name, file in OUR_MODULES.items()}
    urls = {name: base64.b64encode(text.encode()).decode() for name, text in code.items()}
    return {"imports": {name: f"data:text/javascript;base64,{url}" for name, url in urls.items()}}
