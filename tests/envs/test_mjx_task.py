"""What holds for every task: brax's interface, the tables of the docstring, and the state between steps."""

import re
import subprocess
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import envs
from eairl_jax.envs.mjx_task import Env
from eairl_jax.envs.swimmer import Swimmer

DT = {Swimmer: 0.04}  # s, of the tasks whose step is not 0.05 s


@pytest.fixture(params=envs.TASKS)
def env(request):
    return envs.make(request.param)


def test_the_docstrings_tables_are_the_sizes_and_the_limits(env):
    text = type(env).__doc__
    assert int(re.search(r"Observation \((\d+)\)", text)[1]) == env.observation_size
    rows = re.findall(r"^ *\| (\d+) +\|(.*)\|$", text, re.MULTILINE)
    tables = [int(index) for index, _ in rows]
    observation, action = list(range(env.observation_size)), list(range(env.action_size))
    assert tables in (observation, observation + action)  # a single motor needs no table
    assert all(len(row.split("|")) == 3 for _, row in rows)
    size, limit = re.search(r"Action \((\d+)\).*clipped to \[-(\d+), \2\]", text).groups()
    assert (int(size), float(limit)) == (env.action_size, env.action_limit)
    np.testing.assert_array_equal(env.model.actuator_ctrlrange, [[-env.action_limit, env.action_limit]] * int(size))
    assert len(env.obs_std) == env.observation_size


@pytest.fixture(scope="module", params=envs.TASKS)
def traced(request):
    """A task, its first state, and its step: the traced equations and the shapes of the next state."""
    env = envs.make(request.param)
    state = env.reset(jax.random.PRNGKey(0))
    equations, after = jax.make_jaxpr(env.step, return_shape=True)(state, jnp.zeros(env.action_size))
    return SimpleNamespace(env=env, state=state, equations=equations.jaxpr, after=after)


def test_only_positions_speeds_and_the_warm_start_are_carried(traced):
    state, after = traced.state, traced.after
    assert jax.tree.structure(after) == jax.tree.structure(state)
    carried = {jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(after)}
    physics = {".pipeline_state.qpos", ".pipeline_state.qvel", ".pipeline_state.qacc_warmstart"}
    assert carried == physics | {".obs", ".reward", ".done"}
    assert [x.shape for x in jax.tree.leaves(after)] == [x.shape for x in jax.tree.leaves(state)]


def test_a_task_is_a_brax_environment_that_never_ends(traced):
    env, state, after = traced.env, traced.state, traced.after
    assert isinstance(env, Env)
    assert state.obs.shape == after.obs.shape == (env.observation_size,)
    assert (state.reward, state.done) == (0.0, 0.0)
    # The `done` that comes out is the `done` that went in: no equation changes it.
    place = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(after)].index(".done")
    (step,) = traced.equations.eqns
    inner = step.params["jaxpr"].jaxpr
    assert inner.outvars[place] is inner.invars[place]
    np.testing.assert_allclose(env.dt, DT.get(type(env), 0.05))


@pytest.mark.parametrize("shape", [(), (2,), (4, 1)])
def test_an_action_of_another_shape_is_refused(shape):
    env = envs.make("pendulum")
    with pytest.raises(envs.TaskError, match=r"expected \(1,\), one number for each motor; step a batch .* jax.vmap"):
        env.step(env.reset(jax.random.PRNGKey(0)), jnp.zeros(shape))


@pytest.mark.parametrize("task", envs.TASKS)
def test_extreme_actions_are_clipped_and_nan_is_reported(task, compiled_step):
    """1e30, infinity and the bound are one action. A NaN in one entry makes everything NaN."""
    step = compiled_step(task)
    env = step.env
    bound = np.full(env.action_size, env.action_limit)
    with_nan = np.where(np.arange(env.action_size) == 0, np.nan, 0.0)
    actions = np.array([bound, bound * 1e30, bound * np.inf, -bound, bound * -1e30, bound * -np.inf, with_nan])
    start = env.reset(jax.random.PRNGKey(0)).pipeline_state
    after = step(*(np.tile(x, (7, 1)) for x in jax.tree.leaves(start)), actions)
    for leaf in jax.tree.leaves((after.pipeline_state, after.obs, after.reward)):
        np.testing.assert_array_equal(leaf[1:3], leaf[:1].repeat(2, axis=0))
        np.testing.assert_array_equal(leaf[4:6], leaf[3:4].repeat(2, axis=0))
        assert np.isfinite(leaf[:6]).all()
    assert np.isnan(after.obs[6]).any()
    assert np.isnan(after.reward[6])


@pytest.mark.parametrize("task", envs.TASKS)
def test_random_actions_keep_a_simulation_stable(task, compiled_step):
    """`tests/physics/random_steps.py` takes ten million steps."""
    step, rng = compiled_step(task), np.random.default_rng(0)
    env, count = step.env, 50
    physics = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), count)).pipeline_state
    for _ in range(40):
        actions = rng.uniform(-1, 1, (count, env.action_size)) * env.action_limit
        actions[: count // 2] = np.sign(actions[: count // 2]) * env.action_limit
        state = step(*jax.tree.leaves(physics), actions)
        physics = state.pipeline_state
        assert np.isfinite(state.obs).all()
        assert np.isfinite(state.reward).all()


def test_importing_the_tasks_prints_nothing():
    command = [sys.executable, "-c", "import eairl_jax.envs"]
    assert subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout == ""
