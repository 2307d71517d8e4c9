"""Draws an episode with MuJoCo's renderer, in a process of its own: where OpenGL is missing or dies, nothing is lost.

`python -m eairl_jax.experiments.display.render MODEL.mjb EPISODE.npz STRIP.png MOVIE.gif`
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

if TYPE_CHECKING:  # the process that draws needs no jax
    from eairl_jax.envs.mjx_task import MjxTask

WIDTH, HEIGHT = 320, 240
SHOTS = 8  # of the strip, two rows of four
MOVIE_FRAMES = 125
CANNOT_DRAW = 3  # exit code


def draw(env: MjxTask, qpos: np.ndarray, strip: Path, movie: Path) -> str | None:
    """Writes a strip of frames (PNG) and a movie (GIF) of positions `[T, nq]`; returns why it could not, or None."""
    backend = {} if "MUJOCO_GL" in os.environ or "DISPLAY" in os.environ or sys.platform != "linux" else {
        "MUJOCO_GL": "egl"
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        model, episode = Path(folder) / "model.mjb", Path(folder) / "episode.npz"
        mujoco.mj_saveModel(env.model, str(model), None)
        camera = env.camera
        view = [camera.azimuth, camera.elevation, camera.distance, camera.follows]
        np.savez(episode, qpos=qpos, seconds=env.dt, view=view)
        command = [sys.executable, "-m", "eairl_jax.experiments.display.render", model, episode, strip, movie]
        done = subprocess.run([*map(str, command)], env=os.environ | backend, capture_output=True, text=True)
    if done.returncode == CANNOT_DRAW or done.returncode < 0:  # killed by a signal: a driver that died
        return done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"signal {-done.returncode}"
    if done.returncode:
        raise RuntimeError(f"drawing failed:\n{done.stderr}")
    return None


def main(model_path: str, episode_path: str, strip: str, movie: str) -> None:
    """The process that draws."""
    from PIL import Image

    model = mujoco.MjModel.from_binary_path(model_path)
    with np.load(episode_path) as episode:
        qpos, seconds = episode["qpos"], float(episode["seconds"])
        azimuth, elevation, distance, follows = episode["view"]
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
    camera.lookat = model.stat.center
    if follows:
        camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, 1
    data = mujoco.MjData(model)
    try:
        renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    except Exception as e:  # each backend of OpenGL has errors of its own
        print(e, file=sys.stderr)
        os._exit(CANNOT_DRAW)  # what is half made complains when it is taken down
    with renderer:

        def shot(now: np.ndarray) -> np.ndarray:
            data.qpos[:] = now
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            return renderer.render()

        moments = np.linspace(0, len(qpos) - 1, SHOTS).round().astype(int)
        shots = np.stack([shot(qpos[t]) for t in moments]).reshape(2, SHOTS // 2, HEIGHT, WIDTH, 3)
        Image.fromarray(np.concatenate([np.concatenate(list(row), axis=1) for row in shots])).save(strip)
        stride = -(-len(qpos) // MOVIE_FRAMES)
        images = [Image.fromarray(shot(now)) for now in qpos[::stride]]
    images[0].save(movie, save_all=True, append_images=images[1:], duration=1000 * seconds * stride, loop=0)


if __name__ == "__main__":
    main(*sys.argv[1:])
