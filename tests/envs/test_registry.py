"""The table of tasks."""

import pytest

from eairl_jax import envs

SIZES = {
    "pendulum": (3, 1),
    "point_maze_left": (2, 2),
    "point_maze_right": (2, 2),
    "ant": (27, 8),
    "crippled_ant": (27, 8),
    "half_cheetah": (17, 6),
    "swimmer": (8, 2),
}


@pytest.mark.parametrize("name", envs.TASKS)
def test_every_task_can_be_made_by_name(name):
    env = envs.make(name)
    assert (env.observation_size, env.action_size) == SIZES[name]


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("pendulm", "pendulum"), ("point_maze_rigth", "point_maze_right"), ("PointMaze-left", "point_maze_left")],
)
def test_an_unknown_name_is_answered_with_the_nearest(name, nearest):
    with pytest.raises(envs.UnknownTask, match=f"unknown task '{name}'; did you mean {nearest}") as e:
        envs.make(name)
    assert all(task in str(e.value) for task in envs.TASKS)


def test_settings_reach_the_task():
    assert envs.make("point_maze_left", solver_iterations=7).model.opt.iterations == 7
    assert envs.make("point_maze_left").model.opt.iterations != 7


@pytest.mark.parametrize(
    ("name", "choices"),
    [("ant", "the settings of ant are crippled, length, gear, fidelity"), ("pendulum", "pendulum has no settings")],
)
def test_an_unknown_setting_is_answered_with_the_settings_of_the_task(name, choices):
    with pytest.raises(envs.TaskError, match=f"unknown setting of task {name}: colour; {choices}"):
        envs.make(name, colour="red")


def test_the_table_cannot_be_changed_by_accident():
    with pytest.raises(TypeError):
        envs.TASKS["new"] = None
