"""The table of tasks."""

import contextlib
import re
import sys

import jax
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eairl_jax import envs
from eairl_jax.envs import registry

SIZES = {
    "pendulum": (3, 1),
    "point_maze_left": (2, 2),
    "point_maze_right": (2, 2),
    "point_maze_middle": (2, 2),
    "point_maze_double": (2, 2),
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


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("ant+crippled_ant", ["ant", "crippled_ant"]),
        ("ant?gear=10+brax:ant", ["ant?gear=10", "brax:ant"]),
        ("pendulum+mine.py:make", ["pendulum", "mine.py:make"]),
        ("brax:ant?speed=1e+5", ["brax:ant?speed=1e+5"]),
        ("a+b/tasks.py:make", ["a+b/tasks.py:make"]),
        ("c++/tasks.py:make", ["c++/tasks.py:make"]),
        ("pendulum+", ["pendulum+"]),
    ],
)
def test_a_plus_between_names_of_tasks_means_several(name, parts):
    assert registry.each_of(name) == parts


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


def test_a_name_may_hold_settings():
    assert envs.make("point_maze_left?solver_iterations=7").model.opt.iterations == 7
    assert envs.make("point_maze_left?solver_iterations=7", solver_iterations=8).model.opt.iterations == 8


def test_an_environment_of_brax_is_a_task():
    env = envs.make("brax:inverted_pendulum?episode_length=20&backend=generalized")
    assert (env.observation_size, env.action_size, env.episode_length, env.ends) == (4, 1, 20, True)
    assert env.qpos(jax.eval_shape(env.reset, jax.random.PRNGKey(0))).shape == (env.model.nq,)


def test_the_names_of_other_tasks_are_listed():
    assert {"ant", "hopper", "inverted_pendulum"} <= set(registry.brax_names())
    if registry.playground_names():
        assert "CheetahRun" in registry.playground_names()


SOURCE = """
import dataclasses, jax.numpy as jnp
from typing import NamedTuple

@dataclasses.dataclass  # which looks for its module
class Start:
    x: "float"

class State(NamedTuple):
    obs: object
    reward: object
    done: object

class Point:
    observation_size, action_size = 1, 1
    def __init__(self, start): self.start = start
    def reset(self, rng): return State(jnp.full(1, float(self.start)), jnp.zeros(()), jnp.zeros(()))
    def step(self, state, action): return State(state.obs + action, -state.obs[0], jnp.zeros(()))

def make_env(start=1.0): return Point(Start(start).x)
def other(**settings): return Point(settings["start"])
def fails(): return 1 / 0
def wrong(): return 3
def leaves(): raise SystemExit
def needy(start): return Point(start)
constant = 3
"""


@pytest.fixture
def tasks_file(tmp_path, monkeypatch):
    """`my_tasks.py` in the current folder."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "my_tasks.py"
    path.write_text(SOURCE)
    return path


@pytest.mark.parametrize("name", ["my_tasks.py:make_env?start=2", "my_tasks.py:other?start=2.0", "{}:needy?start=2"])
def test_a_function_of_a_file_makes_a_task(name, tasks_file):
    env = envs.make(name.format(tasks_file) + "&episode_length=7")
    assert env.reset(jax.random.PRNGKey(0)).obs == 2.0
    assert env.episode_length == 7


def test_a_file_is_read_again_when_it_has_changed(tasks_file):
    tasks_file.write_text(SOURCE.replace("start=1.0", "start=5.0"))
    assert envs.make("my_tasks.py:make_env").reset(jax.random.PRNGKey(0)).obs == 5.0


def test_loading_a_file_leaves_pythons_path_alone(tasks_file):
    before = list(sys.path)
    envs.make("my_tasks.py:make_env")
    assert sys.path == before
    with pytest.raises(envs.UnknownTask, match="no module my_tasks_of_nobody is installed"):
        envs.make("my_tasks_of_nobody:make_env")


def test_a_function_of_a_module_makes_a_task(tasks_file, monkeypatch):
    monkeypatch.syspath_prepend(tasks_file.parent)
    assert envs.make("my_tasks:make_env").reset(jax.random.PRNGKey(0)).obs == 1.0
    del sys.modules["my_tasks"]


REFUSED = {
    "brax:hoper": "did you mean brax:hopper",
    "brax:ant?backen=mjx": "unknown setting of task brax:ant: backen; did you mean backend?",
    "brax:ant?backend=none": "brax:ant cannot be made with backend='none': ValueError: backend should be in",
    "hopper": "did you mean brax:hopper",
    "ant?length=long": "ant cannot be made with length='long'",
    "nowhere.py:make_env": "no file nowhere.py in",
    "my_tasks.py:make_en": "my_tasks.py has no function make_en; did you mean make_env?",
    "my_tasks.py:constant": "has no function constant",
    "my_tasks.py:make_env?stat=1": "did you mean start?",
    "my_tasks.py:fails": r"my_tasks.py:fails cannot be made: ZeroDivisionError at .*my_tasks.py:\d+",
    "my_tasks.py:wrong": "my_tasks.py:wrong: builtins.int has no reset, step, observation_size, action_size",
    "my_tasks.py:needy": "missing 1 required positional argument: 'start'",
    "my_tasks.py:make_env?episode_length=0": "episode_length is 0",
    "my_tasks.py:make_env?obs=state": "obs=state chooses from observations that are dictionaries",
    "broken.py:make_env": r"broken.py cannot be loaded: ZeroDivisionError at .*broken.py:2",
    "my_tasks.py:leaves": "my_tasks.py:leaves cannot be made: SystemExit at",
    "syntax.py:make_env": r"syntax.py cannot be loaded: SyntaxError",
    "brax.nothing:make_env": "no module brax.nothing is installed",
    "json:dumps": "json:dumps cannot be made: TypeError",
}


@pytest.mark.parametrize(("name", "hint"), REFUSED.items(), ids=REFUSED)
def test_a_task_that_cannot_be_made_is_one_clear_message(name, hint, tasks_file):
    tasks_file.with_name("broken.py").write_text("\n1 / 0\n")
    tasks_file.with_name("syntax.py").write_text("def (\n")
    with pytest.raises(envs.TaskError, match=hint):
        envs.make(name)


@given(st.text(max_size=20).filter(lambda text: ":" not in text) | st.text(alphabet="zq:.?=&/\\ 1\0é", max_size=20))
def test_any_text_is_a_task_or_a_clear_error(text):
    with contextlib.suppress(envs.TaskError):
        assert envs.make(text).observation_size > 0


def test_playground_refuses_what_it_cannot_do():
    pytest.importorskip("mujoco_playground")
    for name, hint in {
        "CheetahRu": "did you mean playground:CheetahRun",
        "CheetahRun?simdt=1": "did you mean sim_dt",
        "CheetahRun?impl=warp": "impl=warp has states that cannot be reset one by one",
        "CheetahRun?sim_dt=x": "cannot be made with sim_dt='x'",
        "CheetahRun?vision=true": "Vision not implemented",
        "PandaRobotiqPushCube": "its action_repeat is 4",
    }.items():
        with pytest.raises(envs.TaskError, match=hint):
            envs.make(f"playground:{name}")


def test_without_playground_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_playground", None)
    with pytest.raises(envs.TaskError, match=re.escape('pip install "eairl-jax[playground]"')):
        envs.make("playground:CheetahRun")
