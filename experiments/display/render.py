"""Draws an episode with MuJoCo's renderer, in a process of its own, so that a failing OpenGL driver ends nothing else.

The process starts this file by its path with `python -P`: it imports no module of the folder that the user stands in,
and nothing of jax.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from eairl_jax.envs.mjx_task import Task

WIDTH, HEIGHT = 320, 240  # of a frame, in pixels
STRIP_FRAMES = 8  # in two rows of four
MOVIE_FRAMES = 125  # at most
UNKNOWN_DT = 0.05  # seconds between two observations of a task that does not say
CANNOT_DRAW = 3  # exit code: the machine has no working OpenGL


def draw(env: Task, qpos: np.ndarray, strip: Path, movie: Path) -> str | None:
    """Writes a strip of frames (PNG) and a movie (GIF) of an episode.

    Args:
      qpos: positions `[T, nq]`, one environment step apart.

    Returns:
      None, or why the machine cannot draw.

    Raises:
      RuntimeError: if drawing failed for another reason.
    """
    needs_egl = sys.platform == "linux" and not {"MUJOCO_GL", "DISPLAY"} & set(os.environ)
    backend = {"MUJOCO_GL": "egl"} if needs_egl else {}
    with tempfile.TemporaryDirectory() as folder:
        model, episode = Path(folder) / "model.mjb", Path(folder) / "episode.npz"
        mujoco.mj_saveModel(env.model, str(model), None)
        camera = env.camera
        view = [camera.azimuth, camera.elevation, camera.distance, camera.follows]
        np.savez(episode, qpos=qpos, seconds=env.dt or UNKNOWN_DT, view=view)
        command = [sys.executable, "-P", __file__, model, episode, strip, movie]
        done = subprocess.run([*map(str, command)], env=os.environ | backend, capture_output=True, text=True)
    # A negative code says that a signal ended the process: the driver crashed.
    if done.returncode == CANNOT_DRAW or done.returncode < 0:
        return done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"signal {-done.returncode}"
    if done.returncode:
        raise RuntimeError(f"drawing failed:\n{done.stderr}")
    return None


def main(model_path: str, episode_path: str, strip: str, movie: str) -> None:
    """Reads what `draw` wrote and draws it; ends the process with `CANNOT_DRAW` where OpenGL is missing."""
    model = mujoco.MjModel.from_binary_path(model_path)
    with np.load(episode_path) as episode:
        qpos, seconds, view = episode["qpos"], float(episode["seconds"]), episode["view"]
    try:
        renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    except Exception as e:  # every OpenGL backend raises another type
        print(e, file=sys.stderr)
        os._exit(CANNOT_DRAW)  # skips the destructor of the half-made renderer, which would complain
    with renderer:
        _write_pictures(renderer, model, qpos, seconds, _camera(model, view), Path(strip), Path(movie))


def _camera(model: mujoco.MjModel, view: np.ndarray) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance, follows = view
    camera.lookat = model.stat.center
    if follows:
        camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, 1
    return camera


def _write_pictures(
    renderer: mujoco.Renderer,
    model: mujoco.MjModel,
    qpos: np.ndarray,
    seconds: float,
    camera: mujoco.MjvCamera,
    strip: Path,
    movie: Path,
) -> None:
    from PIL import Image

    data = mujoco.MjData(model)

    def frame(positions: np.ndarray) -> np.ndarray:
        data.qpos[:] = positions
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, camera)
        return renderer.render()

    times = np.linspace(0, len(qpos) - 1, STRIP_FRAMES).round().astype(int)
    frames = np.stack([frame(qpos[t]) for t in times]).reshape(2, STRIP_FRAMES // 2, HEIGHT, WIDTH, 3)
    Image.fromarray(np.concatenate([np.concatenate(list(row), axis=1) for row in frames])).save(strip)
    stride = -(-len(qpos) // MOVIE_FRAMES)
    images = [Image.fromarray(frame(positions)) for positions in qpos[::stride]]
    images[0].save(movie, save_all=True, append_images=images[1:], duration=1000 * seconds * stride, loop=0)


if __name__ == "__main__":
    main(*sys.argv[1:])
