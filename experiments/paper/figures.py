"""The paper's figures, drawn from what `eairl reproduce` left."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from eairl_jax.experiments.pipeline.transfer import learning_path, use_path

from eairl_jax import load_reward
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.experiments.commands.view import episodes
from eairl_jax.experiments.display import render
from eairl_jax.experiments.display.plots import Curve, figure_of, plot
from eairl_jax.experiments.paper import results
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.train import say

GRID = 70  # points a side of a heat map
SHOWN = "eairl-separable"


def figure2(rows: list[dict], out: Path, folder: Path, tasks: tuple[str, ...]) -> None:
    """Policies on the learned rewards (the paper's second figure): true return in the target while they train."""
    del out
    curves = learning_curves([row for row in results.moved(rows) if row["rule"] == "last"], tasks)
    if curves:
        plot(folder / "figure2.png", "policies trained on the last iteration's reward", curves)
        say(f"{folder}/figure2.png")


def learning_curves(rows: list[dict], tasks: tuple[str, ...] = ()) -> list[Curve]:
    """A panel for each task or pair of tasks, a line for each row of the results; a variant's is dashed."""
    curves = []
    for row in results.listed(rows):
        if "curve" not in row or (tasks and row["task"] not in tasks):
            continue
        panel = f"{row['task']} to {row['target']}" if row["target"] else row["task"]
        values = np.array(row["curve"]["true_return"], float)  # None becomes NaN
        level = ("expert", row["expert"])
        curves.append(Curve(panel, results.name(row["row"]), values, row["curve"]["env_steps"][0], level,
                            results.color(row["row"]), "--" if "+" in row["row"] else "-"))  # fmt: skip
    return curves


def appendix_c(rows: list[dict], out: Path, folder: Path, tasks: tuple[str, ...]) -> None:
    """Appendix C: paths in the mazes, over the learned reward; gaits and paths of the ant and the crippled ant."""
    last = [row for row in results.moved(rows) if row["rule"] == "last" and (not tasks or row["task"] in tasks)]
    for (task, target), moved in results.by_task(results.listed(last)).items():
        if task.startswith("point_maze"):
            maze_paths(folder / f"appendix-c-{task}.png", task, target, moved, out)
        else:
            gaits(folder, task, target, moved, out)


def _runs(row: dict, out: Path) -> tuple[Path, Path]:
    """The folders of a row: where its reward was learned, and where it was put to use."""
    learned = learning_path(out, row["task"], row["row"], row["settings"])
    return learned, use_path(out, row["task"], row["target"], row["row"], row["rule"])


def maze_paths(path: Path, task: str, target: str, rows: list[dict], out: Path) -> None:
    """A column for each row: its reward (of its first seed, action 0) as a heat map and the paths of every seed."""
    title = f"learned reward and the paths taken: {task} (above), {target} (below)"
    figure, axes = figure_of(2, len(rows), (2.6, 2.7), title)
    for column, row in enumerate(rows):
        learned, used = _runs(row, out)
        reward = load_reward(used / "reward")
        for axis, folder in zip(axes[:, column], (learned, used), strict=True):
            found = policies.load(folder)
            centre, reach = np.array(found.env.obs_mean), np.array(found.env.obs_std)
            low, high = centre - reach, centre + reach
            x, y = np.meshgrid(*np.linspace(low, high, GRID).T)
            grid = jnp.stack([jnp.asarray(x), jnp.asarray(y)], axis=-1)
            value = reward(grid, jnp.zeros((*grid.shape[:-1], 2)))
            axis.imshow(value, origin="lower", extent=(low[0], high[0], low[1], high[1]), cmap="viridis")
            _walls(axis, found.env)
            for way in episodes(found)[0]:
                axis.plot(*way.T, color="white", lw=1.2, alpha=0.9)
            axis.set(xticks=[], yticks=[], xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes[0, column].set_title(f"{results.name(row['row'])}\n{row['mean']:.1f} in the target", fontsize=9)
    figure.savefig(path, dpi=110)
    say(f"{path}")


def _walls(axis, env: MjxTask) -> None:
    barrier, goal = env.model.geom("barrier"), env.model.geom("goal")
    half = float(barrier.size[1])
    axis.plot([barrier.pos[0] - half, barrier.pos[0] + half], [barrier.pos[1]] * 2, color="black", lw=4)
    axis.plot(*goal.pos[:2], "o", color="tab:green", ms=7)


def gaits(folder: Path, task: str, target: str, rows: list[dict], out: Path) -> None:
    """A column for each row, the ways of every seed in the source and on its reward in the target; frames of one row.

    Of `SHOWN` if it is there, not of the row that came out best.
    """
    shown = next((row for row in rows if row["row"] == SHOWN), rows[-1])
    title = f"ways of the torso from above, m: {task} (above), {target} (below)"
    figure, axes = figure_of(2, len(rows), (2.8, 1.7), title)
    for column, row in enumerate(rows):
        for axis, name, run in zip(axes[:, column], (task, target), _runs(row, out), strict=True):
            found = policies.load(run)
            ways, _ = episodes(found)
            for seed, way in zip(found.seeds, ways, strict=True):
                axis.plot(way[:, 0], way[:, 1], label=f"seed {seed}")
            if row is shown:
                problem = render.draw(found.env, ways[0], folder / f"appendix-c-{name}.png", run / "episode.gif")
                if problem:
                    say(f"no frames of {name}: this machine cannot draw with OpenGL ({problem})")
        axes[0, column].set_title(f"{results.name(row['row'])}\n{row['mean']:.0f} in the target", fontsize=9)
    for beside in axes:  # one scale, or standing still looks like walking
        limits = np.array([(*axis.get_xlim(), *axis.get_ylim()) for axis in beside])
        left, _, low, _ = limits.min(axis=0)
        _, right, _, high = limits.max(axis=0)
        for axis in beside:
            axis.set(xlim=(left, right), ylim=(low, high), aspect="equal")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(folder / f"appendix-c-{task}-ways.png", dpi=110)
    say(f"{folder}/appendix-c-{task}-ways.png, appendix-c-{task}.png and appendix-c-{target}.png")


DRAWN = {"figure2": figure2, "appendix-c": appendix_c}
