"""The page that plays an episode shows the model's shapes and poses, and holds everything that it loads."""

import base64
import json
import re

import jax
import mujoco
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import Camera
from eairl_jax.experiments.display import episode_page
from eairl_jax.experiments.display.episode_page import page, scene


def drifting(env, steps=6):
    """Positions `[steps, nq]` of a body that drifts along its first coordinate."""
    start = np.asarray(env.reset(jax.random.PRNGKey(0)).pipeline_state.qpos)
    return start + np.linspace(0, 1, steps)[:, None] * np.eye(len(start))[0]


@pytest.mark.parametrize("task", tuple(envs.TASKS))
def test_the_scene_has_the_poses_and_the_shapes_of_the_model(task):
    env = envs.make(task)
    qpos = drifting(env)
    shown = scene(env, qpos)
    data = mujoco.MjData(env.model)
    data.qpos[:] = qpos[-1]
    mujoco.mj_forward(env.model, data)
    assert len(shown["states"]["x"]) == len(qpos)
    np.testing.assert_allclose(shown["states"]["x"][-1]["pos"], data.xpos[1:], atol=1e-4)
    np.testing.assert_allclose(shown["states"]["x"][-1]["rot"], data.xquat[1:], atol=1e-4)
    bodies = [env.model.body(b).name for b in range(1, env.model.nbody)]
    moving = {name: shapes for name, shapes in shown["geoms"].items() if name != "world"}
    assert set(moving) == {bodies[shapes[0]["link_idx"]] for shapes in moving.values()}
    (body, shape), *_ = ((name, shapes[0]) for name, shapes in moving.items())
    geom = env.model.body(body).geomadr[0]
    for name in ("size", "pos"):
        np.testing.assert_array_equal(shape[name], getattr(env.model, f"geom_{name}")[geom])


@pytest.mark.parametrize("task", ["ant", "point_maze_left"])
def test_the_camera_looks_at_the_body_or_at_the_middle_of_the_arena(task):
    env = envs.make(task)
    qpos = drifting(env)
    camera = scene(env, qpos)["camera"]
    data = mujoco.MjData(env.model)
    data.qpos[:] = qpos[0]
    mujoco.mj_kinematics(env.model, data)
    middle = data.xpos[1] if env.camera.follows else env.model.stat.center
    np.testing.assert_allclose(camera["target"], middle, atol=1e-4)
    assert camera["follow"] == env.camera.follows == (task == "ant")


def test_the_line_of_sight_follows_mujocos_convention():
    # Azimuth 90 looks along y; elevation -90 looks down.
    np.testing.assert_allclose(Camera(90, 0, 2, True).offset(), [0, -2, 0], atol=1e-9)
    np.testing.assert_allclose(Camera(0, -90, 3, True).offset(), [0, 0, 3], atol=1e-9)


@pytest.fixture(scope="module")
def html():
    env = envs.make("swimmer")
    return page("a <b>title</b> of 5 $", env, drifting(env))


@pytest.fixture(scope="module")
def modules(html):
    """The code of every module of the page, by the name in its import map."""
    imports = json.loads(re.search(r'<script type="importmap">(.*?)</script>', html)[1])["imports"]
    assert all(url.startswith("data:text/javascript;base64,") for url in imports.values())
    return {name: base64.b64decode(url.partition(",")[2]).decode() for name, url in imports.items()}


def test_the_page_loads_nothing_and_every_imported_module_is_in_it(html, modules):
    assert not re.search(r"""<[^>]+\b(src|href)=""", html)
    imported = set(re.findall(r"""from\s*['"]([^'"]+)['"]""", "\n".join([html, *modules.values()])))
    assert imported == set(modules)
    # The one address in three.js is the name of an XML namespace.
    assert set(re.findall(r"https?://[\w./]+", modules["three"])) == {"http://www.w3.org/1999/xhtml"}


def test_three_js_exports_every_name_that_the_viewer_uses(modules):
    exports = set(re.findall(r"\bas (\w+)", modules["three"]))
    used = {name for module, text in modules.items() if module != "three" for name in re.findall(r"THREE\.(\w+)", text)}
    assert len(used) > 20
    assert used <= exports


def test_the_title_is_escaped_and_the_episode_is_whole(html):
    assert "a &lt;b&gt;title&lt;/b&gt; of 5 $" in html
    system = json.loads(re.search(r'id="system">(.*?)</script>', html)[1])
    assert len(system["states"]["x"]) == 6


def test_no_name_is_run(monkeypatch):
    """A run folder, a task or a body may have any name."""
    evil, env = "</script><!--<script>alert(1)</script>\"'$title", envs.make("pendulum")
    shown = scene(env, drifting(env))
    monkeypatch.setattr(episode_page, "scene", lambda env, qpos: shown | {"geoms": {evil: []}})
    text = page(evil, env, drifting(env))
    assert "<script>alert" not in text
    assert "<!--" not in text
    assert "&lt;/script&gt;&lt;!--&lt;script&gt;alert(1)" in text
    data = re.search(r'id="system">(.*?)</script>', text, re.DOTALL)[1]
    assert evil in json.loads(data)["geoms"]
