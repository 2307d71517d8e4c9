"""`eairl view`: an episode of a run's policy, to look at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from eairl_jax import InputError
from eairl_jax.experiments.display.episode_page import page
from eairl_jax.experiments.display.render import draw
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.learn import take_rows
from eairl_jax.experiments.pipeline.policies import Policies
from eairl_jax.experiments.pipeline.run_folder import writable
from eairl_jax.experiments.pipeline.train import EVALUATE, console, lane_keys, say


def command(run: Path, seed: int | None, out: Path | None) -> None:
    """Writes a page that plays an episode and, where the machine can draw, a strip of frames and a movie."""
    found = policies.load(run)
    seed = found.seeds[0] if seed is None else seed
    if seed not in found.seeds:
        raise InputError(f"--seed {seed}: the run has seeds {', '.join(map(str, found.seeds))}")
    folder = out or run / "view"
    writable(folder / "episode.html")
    (qpos,), (total,) = episodes(found, [found.seeds.index(seed)])
    title = f"{run.name}, seed {seed}: return {total:.2f}"
    (folder / "episode.html").write_text(page(title, found.env, qpos), encoding="utf-8")
    console.print(f"{title}\n{folder}/episode.html plays it in any browser, without a network", soft_wrap=True,
                  markup=False)  # fmt: skip
    with console.status("drawing"):
        problem = draw(found.env, qpos, folder / "frames.png", folder / "episode.gif")
    if problem:
        console.print(
            f"no pictures: this machine cannot draw with OpenGL ({problem}). On a machine without a display install "
            "EGL (Debian: libegl1 and libgl1-mesa-dri) and repeat the command; the page needs none of it",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )
    else:
        say(f"{folder}/frames.png: from left to right, then down; {folder}/episode.gif: the whole episode")


def episodes(found: Policies, lanes: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """An episode of each sampled policy: positions `[lanes, T + 1, nq]`, start included, and true returns `[lanes]`.

    Args:
      lanes: whose; default, every one's.
    """
    env, algorithm = found.env, found.algorithm
    lanes = range(len(found.seeds)) if lanes is None else lanes

    @jax.jit
    @jax.vmap
    def play(state, key):
        reset_key, key = jax.random.split(key)
        start = env.reset(reset_key)

        def step(now, key):
            action = algorithm.act(state, now.obs[None], key)[0]
            after = env.step(now, action)  # which clips the action
            return after, (after.pipeline_state.qpos, after.reward)  # pyright: ignore

        _, (qpos, reward) = jax.lax.scan(step, start, jax.random.split(key, env.episode_length))
        first = start.pipeline_state.qpos  # pyright: ignore
        return jax.numpy.concatenate([first[None], qpos]), reward.sum()

    states = jax.tree.map(jax.numpy.asarray, take_rows(found.state, np.array(lanes)))
    qpos, total = play(states, lane_keys(EVALUATE, [found.seeds[lane] for lane in lanes]))
    return np.asarray(qpos), np.asarray(total)
