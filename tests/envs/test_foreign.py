"""Environments from elsewhere as tasks."""

import re
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eairl_jax.envs.foreign import ForeignTask, UnfitEnvironment, adapt, where
from eairl_jax.envs.mjx_task import TaskError
from eairl_jax.envs.pendulum import Pendulum

KEY = jax.random.PRNGKey(0)


class State(NamedTuple):
    obs: Any
    reward: Any
    done: Any
    inner: Any = ()


class Line:
    """A point on a line (x, steps): moved by the action; pays -|x|; ends beyond 1. Its rewards are not float32."""

    observation_size, action_size = 2, 1

    def __init__(self, **attributes):
        for name, value in attributes.items():
            setattr(self, name, value)

    def observed(self, x):
        return x

    def reset(self, rng):
        x = jnp.stack([jax.random.uniform(rng), 0.0])
        return State(self.observed(x), 0, False, {"x": x})

    def step(self, state, action):
        x = state.inner["x"] + jnp.stack([action[0], 1.0])
        return State(self.observed(x), -jnp.abs(x[0]), jnp.abs(x[0]) > 1.0, {"x": x})


class Many(Line):
    """The same with a dictionary of observations."""

    observation_size = MappingProxyType({"where": 2, "flag": (1, 1)})

    def observed(self, x):
        return {"where": x, "flag": jnp.full((1, 1), 7.0)}


class Spring:
    """A state of brax: positions in `pipeline_state.q`."""

    observation_size, action_size = 1, 1

    class sys:  # noqa: N801
        mj_model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><joint type='slide'/><geom size='1'/></body></worldbody></mujoco>"
        )

    def reset(self, rng):
        class Pipeline(NamedTuple):
            q: Any

        class Brax(NamedTuple):
            pipeline_state: Any
            obs: Any
            reward: Any
            done: Any

        q = jax.random.uniform(rng, (1,))
        return Brax(Pipeline(q), q, jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return state


def test_steps_are_those_of_the_environment_in_float32():
    env = Line()
    task = adapt(env)
    state, own = task.reset(KEY), env.reset(KEY)
    for _ in range(3):
        for name in ("obs", "reward", "done"):
            value = getattr(state, name)
            assert value.dtype == jnp.float32
            np.testing.assert_array_equal(value, np.float32(getattr(own, name)))
        state, own = task.step(state, jnp.full(1, 0.6)), env.step(own, jnp.full(1, 0.6))
    assert float(task.reset(KEY).done) == 0.0
    assert float(state.done) == 1.0


def test_defaults_are_braxs():
    task = adapt(Line())
    assert (task.observation_size, task.action_size, task.episode_length, task.action_limit) == (2, 1, 1000, 1.0)
    assert (task.ends, task.model, task.dt, task.gymnasium) == (True, None, None, None)
    assert not hasattr(task, "obs_mean")
    assert task.qpos(task.reset(KEY)) is None


def test_the_attributes_of_an_environment_are_used():
    declared = dict(episode_length=7, action_limit=2, ends=False, dt=0.5, obs_mean=(0, 1), obs_std=(1, 2))
    task = adapt(Line(**declared))
    assert {name: getattr(task, name) for name in declared} == declared
    assert adapt(Line(**declared), episode_length=9).episode_length == 9


def test_a_task_of_ours_is_returned_as_it_is():
    pendulum = Pendulum()
    assert adapt(pendulum) is pendulum
    assert adapt(pendulum, episode_length=3).episode_length == 3
    with pytest.raises(TaskError, match="leave it out"):
        adapt(pendulum, obs="state")


def test_a_dictionary_is_observed_by_an_entry_or_flattened_in_sorted_order():
    x = adapt(Line()).reset(KEY).obs
    np.testing.assert_array_equal(adapt(Many(), obs="where").reset(KEY).obs, x)
    flat = adapt(Many(), obs="flatten")
    np.testing.assert_array_equal(flat.reset(KEY).obs, [7.0, *x])
    assert flat.observation_size == 3
    np.testing.assert_array_equal(jax.vmap(flat.reset)(KEY[None]).obs, [[7.0, *x]])


def test_positions_of_brax_are_found_where_its_states_hold_them():
    task = adapt(Spring())
    np.testing.assert_array_equal(task.qpos(task.reset(KEY)), task.reset(KEY).obs)
    assert task.model is Spring.sys.mj_model
    assert task.camera.follows
    assert task.camera.distance > 1.0


def test_the_environments_own_function_of_positions_is_used():
    task = adapt(Line(model=Spring.sys.mj_model, qpos=lambda state: state.obs[:1]))
    np.testing.assert_array_equal(task.qpos(task.reset(KEY)), task.reset(KEY).obs[:1])


def changed(**functions):
    """A `Line` with other functions."""
    return type("Line", (Line,), functions)()


REFUSED = {
    "nothing": (lambda: object(), "has no reset, step, observation_size, action_size"),
    "a size": (lambda: Line(action_size=1.5), "action_size is 1.5, expected a whole number"),
    "another size": (lambda: Line(observation_size=3), "observation_size is 3, but reset observes 2 numbers"),
    "a picture": (lambda: changed(observed=lambda self, x: jnp.ones((4, 4))), "expected a flat vector"),
    "a failing reset": (lambda: changed(reset=lambda self, rng: 1 / 0), "reset(rng) failed (ZeroDivisionError at"),
    "no state": (lambda: changed(reset=lambda self, rng: rng), "without obs, reward, done"),
    "a dictionary": (Many, "dictionaries of flag, where, and none is chosen: choose one, ?obs=flag, or all of them"),
    "episode_length": (lambda: Line(episode_length=0), "episode_length is 0"),
    "action_limit": (lambda: Line(action_limit=(1, 2)), "action_limit is (1, 2), expected one positive number"),
    "obs_mean": (lambda: Line(obs_mean=(1, 2, 3), obs_std=(1, 1)), "obs_mean is not 2 finite numbers"),
    "obs_std": (lambda: Line(obs_mean=(0, 0), obs_std=(1, 0)), "obs_std is not 2 finite positive numbers"),
}


@pytest.mark.parametrize(("make", "hint"), REFUSED.values(), ids=REFUSED)
def test_what_does_not_fit_is_refused(make, hint):
    with pytest.raises(TaskError, match=re.escape(hint)):
        adapt(make())


def test_an_unknown_entry_is_answered_with_the_entries():
    with pytest.raises(UnfitEnvironment, match="flag, where, and obs=wher is none of them"):
        adapt(Many(), obs="wher")
    with pytest.raises(TaskError, match="obs=state chooses from observations that are dictionaries"):
        adapt(Line(), obs="state")


BAD_STEPS = {
    "other entries": (dict(step=lambda self, s, a: s._replace(inner=())), "other entries"),
    "another dtype": (
        dict(step=lambda self, s, a: s._replace(inner={"x": s.inner["x"].astype(jnp.int32)})),
        "is float32[2] after reset and int32[2] after step",
    ),
    "a typed key": (
        dict(reset=lambda self, rng: State(jnp.zeros(2), 0, 0, jax.random.key(0)), step=lambda self, s, a: s),
        "a key of jax.random.key",
    ),
    "rewards": (
        dict(reset=lambda self, rng: State(jnp.zeros(2), jnp.zeros(1), jnp.zeros(())), step=lambda self, s, a: s),
        "reward has shape (1,), expected ()",
    ),
    "a failure": (dict(step=lambda self, s, a: float(a[0])), "step(state, action) failed (ConcretizationTypeError at"),
}


@pytest.mark.parametrize(("functions", "hint"), BAD_STEPS.values(), ids=BAD_STEPS)
def test_steps_that_no_loop_can_take_are_refused(functions, hint):
    task = adapt(changed(**functions))
    assert isinstance(task, ForeignTask)
    with pytest.raises(UnfitEnvironment, match=re.escape(hint)):
        task.check_steps()


def test_an_error_is_told_with_the_users_line():
    with pytest.raises(KeyError) as e:
        raise KeyError("x")
    assert re.fullmatch(rf"KeyError at {re.escape(__file__)}:\d+: 'x'", where(e.value))


def test_playgrounds_steps_are_its_own():
    registry = pytest.importorskip("mujoco_playground").registry
    own, task = (
        registry.load("PendulumSwingup", config_overrides={"impl": "jax"}),
        adapt(registry.load("PendulumSwingup", config_overrides={"impl": "jax"})),
    )
    state, other = task.reset(KEY), jax.jit(own.reset)(KEY)
    step, own_step = jax.jit(task.step), jax.jit(own.step)
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 1)).astype(np.float32):
        state, other = step(state, action), own_step(other, action)
        np.testing.assert_array_equal(state.obs, other.obs)
        np.testing.assert_array_equal(state.reward, other.reward)
        np.testing.assert_array_equal(task.qpos(state), other.data.qpos)
    assert (task.episode_length, task.dt) == (1000, own.dt)


@pytest.mark.slow
def test_playgrounds_cheetah_steps_as_its_own():
    registry = pytest.importorskip("mujoco_playground").registry
    own = registry.load("CheetahRun", config_overrides={"impl": "jax"})
    task = adapt(registry.load("CheetahRun", config_overrides={"impl": "jax"}))
    keys = jax.random.split(KEY, 3)
    state, other = jax.jit(jax.vmap(task.reset))(keys), jax.jit(jax.vmap(own.reset))(keys)
    step, own_step = jax.jit(jax.vmap(task.step)), jax.jit(jax.vmap(own.step))
    for action in np.random.default_rng(0).uniform(-1, 1, (50, 3, 6)).astype(np.float32):
        np.testing.assert_array_equal(state.obs, other.obs)
        np.testing.assert_array_equal(state.reward, other.reward)
        state, other = step(state, action), own_step(other, action)


def test_playgrounds_warp_is_refused():
    class Warp:
        _config = {"impl": "warp"}  # noqa: RUF012
        observation_size, action_size = 1, 1
        reset = step = None

    Warp.__module__ = "mujoco_playground._src.nothing"
    with pytest.raises(UnfitEnvironment, match="impl is warp"):
        adapt(Warp())
