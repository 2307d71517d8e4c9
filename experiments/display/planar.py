"""The reward of a task whose state is a position in the plane, as a heat map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from eairl_jax import LearnedReward
from eairl_jax.experiments.display.plots import figure_of, save

GRID = 70  # points on a side of a heat map
MOST_SEEDS = 10


def is_planar(env: Any) -> bool:
    """Whether observations are positions in the plane, whose scale the task declares."""
    return env.observation_size == 2 and hasattr(env, "obs_mean") and hasattr(env, "obs_std")


def plot_rewards(path: Path, title: str, env: Any, reward: LearnedReward) -> None:
    """Saves a panel for each seed: the reward of action 0, bright where it is high."""
    seeds = list(enumerate(reward.description["seeds"]))[:MOST_SEEDS]
    columns = min(5, len(seeds))
    figure, axes = figure_of(-(-len(seeds) // columns), columns, (2.6, 2.8), title)
    for spare in axes.flat[len(seeds) :]:
        spare.set_visible(False)
    for axis, (row, seed) in zip(axes.flat, seeds, strict=False):
        draw_reward(axis, env, reward, row)
        draw_walls(axis, env)
        axis.set_title(f"seed {seed}", fontsize=9)
    save(figure, path, dpi=110)


def draw_reward(axis, env: Any, reward: LearnedReward, seed: int = 0) -> None:
    """Draws the reward `reward(s, 0)`; `seed` is a position among the reward's seeds."""
    centre, reach = np.array(env.obs_mean), np.array(env.obs_std)
    low, high = centre - reach, centre + reach
    x, y = np.meshgrid(*np.linspace(low, high, GRID).T)
    positions = jnp.stack([jnp.asarray(x), jnp.asarray(y)], axis=-1)
    values = reward(positions, jnp.zeros((*positions.shape[:-1], env.action_size)), seed=seed)
    axis.imshow(values, origin="lower", extent=(low[0], high[0], low[1], high[1]), cmap="viridis")
    axis.set(xticks=[], yticks=[], xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def draw_walls(axis, env: Any) -> None:
    """Draws the wall and the goal of a maze; a task without them is left as it is."""
    model = getattr(env, "model", None)
    if model is None:
        return
    names = {model.geom(i).name for i in range(model.ngeom)}
    if "barrier" in names:
        barrier = model.geom("barrier")
        half = float(barrier.size[1])
        axis.plot([barrier.pos[0] - half, barrier.pos[0] + half], [barrier.pos[1]] * 2, color="black", lw=4)
    if "goal" in names:
        axis.plot(*model.geom("goal").pos[:2], "o", color="tab:green", ms=7)
