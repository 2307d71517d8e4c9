"""Pictures of an episode, drawn by a process that runs nothing of the folder that the user stands in."""

import subprocess
import sys

import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.experiments.display import render
from eairl_jax.experiments.display.render import HEIGHT, STRIP_FRAMES, WIDTH, draw


@pytest.fixture
def pictures(tmp_path):
    """Where the strip and the movie are written."""
    (tmp_path / "pictures").mkdir()
    return tmp_path / "pictures" / "frames.png", tmp_path / "pictures" / "episode.gif"


def standing(env, steps=9):
    """Positions `[steps, nq]` of a body that does not move."""
    return np.repeat(env.model.qpos0[None], steps, axis=0)


def test_a_strip_and_a_movie_are_drawn(pictures):
    image = pytest.importorskip("PIL.Image")
    env = envs.make("half_cheetah")
    problem = draw(env, standing(env), *pictures)
    if problem:
        assert not pictures[1].exists()
        pytest.skip(f"this machine cannot draw: {problem}")
    pixels = np.asarray(image.open(pictures[0]), np.int64)
    assert pixels.shape == (2 * HEIGHT, STRIP_FRAMES // 2 * WIDTH, 3)
    orange = (pixels[..., 0] - pixels[..., 2]) > 40
    assert orange[:HEIGHT, :WIDTH].any()  # the body is in the first frame
    assert image.open(pictures[1]).n_frames >= 1


def test_an_episode_of_another_model_is_an_error(pictures):
    env = envs.make("pendulum")
    if draw(env, standing(env), *pictures):
        pytest.skip("this machine cannot draw")
    with pytest.raises(RuntimeError, match="drawing failed"):
        draw(env, np.zeros((4, 7)), *pictures)


def test_a_machine_that_cannot_draw_gives_a_reason(pictures, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    env = envs.make("pendulum")
    assert draw(env, standing(env), *pictures)
    assert not any(path.exists() for path in pictures)


def test_nothing_of_the_current_folder_is_run(pictures, tmp_path, monkeypatch):
    bait = tmp_path / "bait"
    for name in ("mujoco", "numpy", "PIL", "experiments", "eairl_jax"):
        (bait / name).mkdir(parents=True)
        (bait / name / "__init__.py").write_text(f"open({str(bait / 'was_run')!r}, 'w').close()")
    monkeypatch.chdir(bait)
    monkeypatch.setenv("MUJOCO_GL", "disable")
    env = envs.make("pendulum")
    assert draw(env, standing(env), *pictures)
    assert not (bait / "was_run").exists()


def test_the_process_that_draws_imports_no_jax():
    program = (
        "import runpy, sys; runpy.run_path(sys.argv[1], run_name='render'); "
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", program, render.__file__], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules = set(done.stdout.split())
    assert "mujoco" in modules
    assert not modules & {"jax", "brax", "eairl_jax"}
