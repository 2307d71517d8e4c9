"""What `eairl view` shows: a page with all that it needs inside, and pictures where the machine can draw."""

import base64
import json
import re

import jax
import mujoco
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import Camera
from eairl_jax.experiments.display.episode_page import page, scene
from eairl_jax.experiments.display.render import HEIGHT, SHOTS, WIDTH, draw

TASKS = tuple(envs.TASKS)


def rolling(env, steps=6):
    """Positions `[steps, nq]` of a body that drifts along its first coordinate."""
    start = np.asarray(env.reset(jax.random.PRNGKey(0)).pipeline_state.qpos)
    return start + np.linspace(0, 1, steps)[:, None] * np.eye(len(start))[0]


@pytest.mark.parametrize("task", TASKS)
def test_the_scene_is_the_models(task):
    env = envs.make(task)
    qpos = rolling(env)
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
    # The camera looks at the body where it starts, or at the middle of the arena.
    camera = shown["camera"]
    data.qpos[:] = qpos[0]
    mujoco.mj_kinematics(env.model, data)
    np.testing.assert_allclose(
        camera["target"], data.xpos[1] if env.camera.follows else env.model.stat.center, atol=1e-4
    )
    assert camera["follow"] == env.camera.follows


def test_the_cameras_line_of_sight():
    # From the side (azimuth 90 looks along y) and, at elevation -90, from above; MuJoCo's convention.
    np.testing.assert_allclose(Camera(90, 0, 2, True).offset(), [0, -2, 0], atol=1e-9)
    np.testing.assert_allclose(Camera(0, -90, 3, True).offset(), [0, 0, 3], atol=1e-9)


def test_the_page_needs_no_network_and_every_name_that_it_imports_is_there():
    html = page("a <b>title</b> of 5 $", envs.make("swimmer"), rolling(envs.make("swimmer")))
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", html, re.DOTALL)
    assert not any("src=" in attributes for attributes, _ in scripts)
    imports = json.loads(next(text for attributes, text in scripts if "importmap" in attributes))["imports"]
    code = {name: base64.b64decode(url.partition(",")[2]).decode() for name, url in imports.items()}
    assert all(url.startswith("data:text/javascript;base64,") for url in imports.values())
    wanted = set(re.findall(r"from '([^']+)'", "\n".join([html, *code.values()])))
    assert wanted == set(code)
    (three,) = (text for attributes, text in scripts if not attributes and "Three.js" in text)
    names = re.search(r"\{(.*)\}", code["three"])[1].split(", ")
    assert len(names) > 20
    assert [name for name in names if f"t.{name}=" not in three and f"THREE.{name}=" not in three] == []
    assert "a &lt;b&gt;title&lt;/b&gt; of 5 $" in html
    system = json.loads(next(text for attributes, text in scripts if 'id="system"' in attributes))
    assert len(system["states"]["x"]) == 6


def test_pictures_where_the_machine_can_draw(tmp_path):
    image = pytest.importorskip("PIL.Image")
    env = envs.make("half_cheetah")
    strip, movie = tmp_path / "frames.png", tmp_path / "episode.gif"
    problem = draw(env, rolling(env, 9), strip, movie)
    if problem:
        assert not movie.exists()
        pytest.skip(f"no OpenGL here: {problem}")
    pixels = np.asarray(image.open(strip), np.int64)
    assert pixels.shape == (2 * HEIGHT, SHOTS // 2 * WIDTH, 3)
    orange = (pixels[..., 0] - pixels[..., 2]) > 40
    assert orange[:HEIGHT, :WIDTH].any()  # a body is in the first frame
    assert image.open(movie).n_frames == 9


def test_what_is_wrong_with_the_episode_is_no_matter_of_the_machine(tmp_path):
    env, pictures = envs.make("pendulum"), (tmp_path / "frames.png", tmp_path / "episode.gif")
    if draw(env, rolling(env), *pictures):
        pytest.skip("no OpenGL here")
    with pytest.raises(RuntimeError, match="drawing failed"):
        draw(env, np.zeros((4, 7)), *pictures)


def test_a_machine_that_cannot_draw_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    env = envs.make("pendulum")
    assert draw(env, rolling(env), tmp_path / "frames.png", tmp_path / "episode.gif")
    assert not list(tmp_path.iterdir())
