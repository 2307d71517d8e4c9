"""`eairl view`: an episode of a run's policy, to look at."""

from __future__ import annotations

from eairl_jax import InputError
from eairl_jax.experiments.display.console import console, say
from eairl_jax.experiments.display.episode_page import page
from eairl_jax.experiments.display.render import draw
from eairl_jax.experiments.options import View
from eairl_jax.experiments.pipeline import policies, run_page
from eairl_jax.experiments.pipeline.episodes import check_drawable, play
from eairl_jax.experiments.pipeline.run_folder import check_writable


def run(options: View, command_line: str) -> None:
    """Writes a page that plays an episode and, where the machine can draw, a strip of frames and a movie."""
    del command_line
    trained = policies.load(options.run_folder, may_be_unfinished=True)
    seed = trained.seeds[0] if options.seed is None else options.seed
    if seed not in trained.seeds:
        raise InputError(f"--seed {seed}: the run has seeds {', '.join(map(str, trained.seeds))}")
    check_drawable(trained.task, trained.env)
    folder = options.out or options.run_folder / "view"
    check_writable(folder / "episode.html")
    episodes = play(trained, [trained.seeds.index(seed)])
    qpos = episodes.qpos[0, : episodes.lengths[0] + 1]
    title = f"{options.run_folder.name}, seed {seed}: return {episodes.returns[0]:.2f}"
    title += f", ended after {len(qpos) - 1} steps" if len(qpos) <= trained.env.episode_length else ""
    (folder / "episode.html").write_text(page(title, trained.env, qpos), encoding="utf-8")
    console.print(
        f"{title}\n{folder}/episode.html plays the episode in any browser, without a network",
        soft_wrap=True,
        markup=False,
    )
    with console.status("drawing"):
        problem = draw(trained.env, qpos, folder / "frames.png", folder / "episode.gif")
    if problem:
        console.print(
            f"no pictures: this machine cannot draw with OpenGL ({problem}). On a machine without a display install "
            "EGL (Debian: libegl1 and libgl1-mesa-dri) and repeat the command. The page needs no OpenGL",
            style="yellow",
            markup=False,
            soft_wrap=True,
        )
    else:
        say(f"{folder}/frames.png: from left to right, then down; {folder}/episode.gif: the whole episode")
    if folder == options.run_folder / "view" and (options.run_folder / run_page.PAGE).is_file():
        run_page.write(options.run_folder)  # which now shows the episode
