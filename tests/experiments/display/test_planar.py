"""Rewards in the plane as heat maps."""

import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.experiments.display import planar


@pytest.mark.parametrize("task", ["point_maze_left", "point_maze_right"])
def test_the_reward_is_drawn_over_the_whole_arena_and_the_walls_where_the_model_has_them(task):
    from matplotlib.figure import Figure

    env, axis = envs.make(task), Figure().subplots()
    planar.draw_reward(axis, env, lambda obs, action, seed: obs[..., 0])
    planar.draw_walls(axis, env)
    (image,) = axis.images
    values = image.get_array()
    assert values.shape == (planar.GRID, planar.GRID)
    assert np.all(np.diff(values, axis=1) > 0)  # x grows to the right
    barrier, goal = axis.lines
    np.testing.assert_allclose(np.mean(barrier.get_xdata()), env.model.geom("barrier").pos[0])
    np.testing.assert_allclose(goal.get_xydata()[0], env.model.geom("goal").pos[:2])


def test_only_positions_in_the_plane_are_drawn():
    assert planar.is_planar(envs.make("point_maze_left"))
    assert not planar.is_planar(envs.make("pendulum"))


def test_a_panel_for_each_seed(tmp_path, monkeypatch):
    def reward(obs, action, seed):
        return obs[..., 0] * (seed + 1)

    reward.description, figures = {"seeds": [4, 7]}, []
    monkeypatch.setattr(planar, "save", lambda figure, path, dpi: figures.append(figure))
    planar.plot_rewards(tmp_path / "reward.png", "title", envs.make("point_maze_left"), reward)
    first, second = figures[0].axes
    assert (first.get_title(), second.get_title()) == ("seed 4", "seed 7")
    np.testing.assert_allclose(second.images[0].get_array(), 2 * first.images[0].get_array(), rtol=1e-5)
