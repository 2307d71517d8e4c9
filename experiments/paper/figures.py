"""The paper's figures, drawn from the results and the run folders that `eairl reproduce` left."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from eairl_jax import load_reward
from eairl_jax.experiments.display import render
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.display.planar import draw_reward, draw_walls
from eairl_jax.experiments.display.plots import Curve, figure_of, plot, save
from eairl_jax.experiments.paper import results
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.episodes import play
from eairl_jax.experiments.pipeline.experiment import transfer_folder_name
from eairl_jax.experiments.pipeline.run import Result, learning_path

SHOWN = "eairl-separable"
"""The method whose gaits are shown, if it was trained. It is not chosen by its score."""


def figure2(loaded: list[Result], out: Path, folder: Path, tasks: tuple[str, ...]) -> None:
    """The paper's figure 2: true return in the target while policies are trained on the learned rewards.

    Args:
      loaded: the results of Table 1.
      out: the folder of the runs, which this figure does not need.
      folder: where the figure is written.
      tasks: only transfers from these; all if empty.
    """
    del out
    curves = learning_curves([result for result in _last(loaded) if not tasks or result.task in tasks])
    if curves:
        plot(folder / "figure2.png", "policies trained on the last iteration's reward", curves)
        say(f"{folder}/figure2.png")


def _last(loaded: list[Result]) -> list[Result]:
    return [result for result in results.transfers(loaded) if result.rule == "last"]


def learning_curves(chosen: list[Result]) -> list[Curve]:
    """A panel for each task or pair of tasks, and a line for each result in it; lines of variants are dashed."""
    return [
        Curve(
            panel=results.pair(result),
            label=results.title(result.name),
            values=np.array(result.curve["true_return"], float),  # None becomes NaN
            steps_per_iteration=result.curve["env_steps"][0],
            level=("expert", result.expert),
            color=results.color(result.name),
            style="--" if "+" in result.name else "-",
        )
        for result in results.in_order(chosen)
        if result.curve
    ]


def appendix_c(loaded: list[Result], out: Path, folder: Path, tasks: tuple[str, ...]) -> None:
    """The paper's Appendix C: paths in the mazes on the learned reward, and paths and gaits of both ants.

    Args:
      loaded: the results of Table 1.
      out: the folder of the runs.
      folder: where the figures are written.
      tasks: only transfers from these; all if empty.
    """
    chosen = [result for result in results.in_order(_last(loaded)) if not tasks or result.task in tasks]
    for transfer in results.by_task(chosen).values():
        if transfer[0].task.startswith("point_maze"):
            maze_paths(folder, transfer, out)
        else:
            gaits(folder, transfer, out)


DRAWN: dict[str, Callable[[list[Result], Path, Path, tuple[str, ...]], None]] = {
    "figure2": figure2,
    "appendix-c": appendix_c,
}


def _run_folders(result: Result, out: Path) -> tuple[Path, Path]:
    """The folder in which a result's reward was learned, and the folder in which it was used."""
    learning_name = result.name.partition(results.RETRAIN)[0]
    learned = learning_path(out, result.task, learning_name, result.settings)
    return learned, out / transfer_folder_name(result.task, str(result.target), result.name, str(result.rule))


def maze_paths(folder: Path, transfer: list[Result], out: Path) -> None:
    """A column for each result: the first seed's reward of action 0 as a heat map, and the paths of every seed."""
    task, target = transfer[0].task, transfer[0].target
    title = f"learned reward and the policies' paths: {task} (above), {target} (below)"
    figure, axes = figure_of(2, len(transfer), (2.6, 2.7), title)
    for column, result in enumerate(transfer):
        folders = _run_folders(result, out)
        reward = load_reward(folders[1] / "reward")
        for axis, run in zip(axes[:, column], folders, strict=True):
            agents = policies.load(run)
            draw_reward(axis, agents.env, reward)
            draw_walls(axis, agents.env)
            for path in play(agents).qpos:
                axis.plot(*path.T, color="white", lw=1.2, alpha=0.9)
        axes[0, column].set_title(f"{results.title(result.name)}\n{result.mean:.1f} in the target", fontsize=9)
    path = folder / f"appendix-c-{task}.png"
    save(figure, path, dpi=110)
    say(f"{path}")


def gaits(folder: Path, transfer: list[Result], out: Path) -> None:
    """A column for each result: every seed's path in the source and in the target. One result's frames are drawn."""
    task, target = transfer[0].task, str(transfer[0].target)
    shown = next((result for result in transfer if result.name == SHOWN), transfer[-1])
    title = f"paths of the torso seen from above, in metres: {task} (above), {target} (below)"
    figure, axes = figure_of(2, len(transfer), (2.8, 1.7), title)
    for column, result in enumerate(transfer):
        for axis, place, run in zip(axes[:, column], (task, target), _run_folders(result, out), strict=True):
            agents = policies.load(run)
            paths = play(agents).qpos
            for seed, path in zip(agents.seeds, paths, strict=True):
                axis.plot(path[:, 0], path[:, 1], label=f"seed {seed}")
            if result is shown:
                problem = render.draw(agents.env, paths[0], folder / f"appendix-c-{place}.png", run / "episode.gif")
                if problem:
                    say(f"no frames of {place}: this machine cannot draw with OpenGL ({problem})")
        axes[0, column].set_title(f"{results.title(result.name)}\n{result.mean:.0f} in the target", fontsize=9)
    for row in axes:
        _share_scale(row)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    save(figure, folder / f"appendix-c-{task}-ways.png", dpi=110)
    say(f"{folder}/appendix-c-{task}-ways.png, appendix-c-{task}.png and appendix-c-{target}.png")


def _share_scale(axes: np.ndarray) -> None:
    """Gives the axes the same limits: on a scale of its own, standing still would look like walking."""
    limits = np.array([(*axis.get_xlim(), *axis.get_ylim()) for axis in axes])
    left, _, low, _ = limits.min(axis=0)
    _, right, _, high = limits.max(axis=0)
    for axis in axes:
        axis.set(xlim=(left, right), ylim=(low, high), aspect="equal")
