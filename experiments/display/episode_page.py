"""A web page that plays an episode: brax's viewer with all that it needs inside, so that it opens without a network."""

from __future__ import annotations

import base64
import html
import json
import re
import string
from importlib.resources import files

import mujoco
import numpy as np

from eairl_jax.envs.mjx_task import MjxTask

SHAPES = {
    mujoco.mjtGeom.mjGEOM_PLANE: "Plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "Sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "Capsule",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "Cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "Box",
}


def page(title: str, env: MjxTask, qpos: np.ndarray) -> str:
    """The page, as text.

    Args:
      qpos: `[T, nq]` positions, a step apart.
    """
    system = json.dumps(scene(env, qpos)).replace("</", "<\\/")
    template = string.Template((_ours() / "page.html").read_text(encoding="utf-8"))
    # The text of scripts holds dollars of its own: it is put in, not read as a template.
    return template.substitute(
        title=html.escape(title), three=_three(), importmap=json.dumps(_modules()), system=system
    )


def scene(env: MjxTask, qpos: np.ndarray) -> dict:
    """What brax's viewer reads: every body's shapes, and where the bodies are after every step."""
    model, data = env.model, mujoco.MjData(env.model)
    bodies = [model.body(b).name or f"body {b}" for b in range(model.nbody)]
    geoms: dict[str, list[dict]] = {}
    for g in range(model.ngeom):
        body, kind = int(model.geom_bodyid[g]), mujoco.mjtGeom(model.geom_type[g])
        if kind not in SHAPES or model.geom_rgba[g, 3] == 0:
            continue
        # A plane of no size is drawn as an endless chequered floor.
        size = [0.0, 0.0, 0.0] if kind == mujoco.mjtGeom.mjGEOM_PLANE else model.geom_size[g].tolist()
        geoms.setdefault(bodies[body], []).append({
            "name": SHAPES[kind], "link_idx": body - 1, "size": size, "pos": model.geom_pos[g].tolist(),
            "rot": model.geom_quat[g].tolist(), "rgba": model.geom_rgba[g].tolist(),
        })  # fmt: skip
    states = []
    for now in qpos:
        data.qpos[:] = now
        mujoco.mj_kinematics(model, data)
        states.append({"pos": data.xpos[1:].round(4).tolist(), "rot": data.xquat[1:].round(4).tolist()})
    target = np.array(states[0]["pos"][0] if env.camera.follows else model.stat.center)
    return {
        "opt": {"timestep": env.dt},
        "geoms": geoms,
        "states": {"x": states},
        "camera": {
            "position": (target + env.camera.offset()).tolist(),
            "target": target.tolist(),
            "follow": env.camera.follows,
        },
    }


def _ours():
    return files("eairl_jax.experiments.display") / "viewer"


def _three() -> str:
    """three.js as a plain script, which makes `THREE`: trimesh brings it, in the page of its own viewer."""
    from trimesh.resources import get_bytes
    from trimesh.util import decompress

    archive = decompress(get_bytes("templates/viewer.zip"), file_type="zip")
    text = archive["viewer.html.template"].read().decode("utf-8")  # pyright: ignore
    script = re.search(r"<script>(.*)</script>", text, re.DOTALL)
    code, start, _ = script[1].rpartition("init();") if script else ("", "", "")
    if not start:
        raise RuntimeError("the viewer template of this version of trimesh holds no three.js where it is looked for")
    return code


def _modules() -> dict:
    """The import map: brax's modules and ours as data URLs, and `three` as a module made of `THREE`."""
    import brax

    folder = files(brax) / "visualizer" / "js"
    theirs = ("viewer", "animator", "selector", "system")
    code = {f"brax/{name}": (folder / f"{name}.js").read_text(encoding="utf-8") for name in theirs}
    code = {name: re.sub(r"from '\./(\w+)\.js'", r"from 'brax/\1'", text) for name, text in code.items()}
    ours = {"three/addons/controls/OrbitControls.js": "controls.js", "lilgui": "gui.js"}
    code |= {name: (_ours() / file).read_text(encoding="utf-8") for name, file in ours.items()}
    names = sorted({name for text in code.values() for name in re.findall(r"\bTHREE\.(\w+)", text)})
    code["three"] = f"export const {{{', '.join(names)}}} = window.THREE;"
    urls = {name: base64.b64encode(text.encode()).decode() for name, text in code.items()}
    return {"imports": {name: f"data:text/javascript;base64,{url}" for name, url in urls.items()}}
