"""Several tasks as one: each episode is exactly one of its task, and says which."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from eairl_jax import envs
from eairl_jax.envs.several import SeveralTasks


@struct.dataclass
class WalkState:
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class Walk:
    """A point that moves by `speed` times its action, from a random start; the reward is the place before the step."""

    observation_size, action_size, action_limit, episode_length, ends, dt = 1, 1, 1.0, 10, False, 0.1
    backend, obs_mean, obs_std = "none", (0.0,), (2.0,)

    def __init__(self, speed):
        self.speed = speed

    def reset(self, rng):
        return WalkState(jax.random.normal(rng, (1,)), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return WalkState(state.obs + self.speed * action, state.obs[0], jnp.float32(self.speed > 1))


KEY = jax.random.PRNGKey(0)
WALKS = (Walk(1.0), Walk(-0.5), Walk(2.0))


def play(env, key):
    """The first observation, and what each of five steps shows."""
    first = env.reset(key)
    shown = []
    state = first
    for _ in range(5):
        state = env.step(state, jnp.array([0.3]))
        shown.append((state.obs, state.reward, state.done))
    return first.obs, *(jnp.stack(column) for column in zip(*shown, strict=True))


def test_an_episode_is_one_of_the_task_that_its_observations_name():
    keys = jax.random.split(jax.random.PRNGKey(0), 30)
    first, obs, reward, done = jax.vmap(lambda key: play(SeveralTasks(WALKS), key))(keys)
    which = np.argmax(np.asarray(first[:, 1:]), axis=1)
    assert set(which) == {0, 1, 2}  # every task comes up
    np.testing.assert_array_equal(first[:, 1:], np.eye(3)[which])
    np.testing.assert_array_equal(obs[:, :, 1:], np.repeat(np.eye(3)[which][:, None], 5, axis=1))
    for episode, task in enumerate(which):
        alone = play(WALKS[task], keys[episode])
        np.testing.assert_array_equal(first[episode, :1], alone[0])
        for x, y in zip((obs[episode, :, :1], reward[episode], done[episode]), alone[1:], strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-6)


def test_what_the_tasks_declare_is_declared_for_all():
    both = SeveralTasks(WALKS)
    assert (both.observation_size, both.context_size, both.action_size, both.action_limit) == (4, 3, 1, 1.0)
    assert (both.episode_length, both.ends, both.dt, both.backend) == (10, False, 0.1, "none")
    assert (both.obs_mean, both.obs_std) == ((0.0, 0.0, 0.0, 0.0), (2.0, 1.0, 1.0, 1.0))
    assert both.model is None
    assert both.qpos(None) is None


def test_the_names_of_two_mazes_make_one_task():
    both = envs.make("point_maze_left+point_maze_right")
    assert [task.spec.geom("barrier").fromto[0] for task in both.tasks] == pytest.approx([0.2, -0.1])


class PaidWalk(Walk):
    """A walk with a pay of its own for each step. All of them move alike, so one simulation serves all."""

    dynamics = "walk"

    def __init__(self, pay):
        super().__init__(1.0)
        self.pay = pay

    def step(self, state, action):
        assert self.pay == 1.0, "the first of them is simulated, no other"
        return self.rewarded(state, action, super().step(state, action))

    def rewarded(self, before, action, after):
        return after.replace(reward=self.pay * (before.obs[0] + action[0]))


def test_tasks_that_differ_in_their_rewards_alone_are_simulated_once():
    several, keys, action = SeveralTasks([PaidWalk(pay) for pay in (1.0, 10.0, 100.0)]), jax.random.split(KEY, 30), 0.3
    first = jax.vmap(several.reset)(keys)
    states = jax.vmap(lambda state: several.step(state, jnp.array([action])))(first)
    assert len(states.inner) == 1
    assert set(states.which.tolist()) == {0, 1, 2}
    np.testing.assert_allclose(states.obs[:, 0], first.obs[:, 0] + action, rtol=1e-6)
    pay = np.array([1.0, 10.0, 100.0])[states.which]
    np.testing.assert_allclose(states.reward, pay * (first.obs[:, 0] + action), rtol=1e-5)


def test_gaits_of_one_body_move_alike_and_are_paid_apart():
    names = ("half_cheetah?control_cost=0", "half_cheetah?control_cost=0.5", "half_cheetah?fidelity=exact", "ant")
    free, dear, *others = (envs.make(name) for name in names)
    assert free.dynamics == dear.dynamics
    assert len({env.dynamics for env in (free, *others)}) == 3
    assert len(jax.eval_shape(SeveralTasks([free, dear]).reset, KEY).inner) == 1
    before, after = free.reset(KEY), free.reset(jax.random.PRNGKey(1))
    paid = [env.rewarded(before, jnp.full(6, 2.0), after).reward for env in (free, dear)]  # beyond the bounds, so 1
    np.testing.assert_allclose(paid[0] - paid[1], 0.5 * 6, rtol=1e-4)


def task_like(**changes):
    declared = dict(observation_size=2, action_size=1, action_limit=1.0, episode_length=10, ends=False, dt=0.1)
    return SimpleNamespace(**declared | changes)


@pytest.mark.parametrize("name, value", [("observation_size", 3), ("action_size", 2), ("episode_length", 20)])
def test_tasks_that_do_not_fit_together_are_refused(name, value):
    own = getattr(task_like(), name)
    with pytest.raises(envs.TaskError, match=f"need the same {name}, and these have {own}, {value}"):
        SeveralTasks([task_like(), task_like(**{name: value})])


def test_what_only_some_tasks_declare_is_not_declared():
    both = SeveralTasks([task_like(ends=True, obs_mean=(0.0, 0.0), obs_std=(1.0, 1.0)), task_like(dt=0.2)])
    assert both.ends
    assert both.dt is None
    assert not hasattr(both, "obs_mean")
