"""Episodes of trained policies, to be drawn."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from eairl_jax import Algorithm, Config, InputError, envs
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.episodes import check_drawable, play
from eairl_jax.experiments.pipeline.policies import Policies


def test_an_episode_of_each_policy(finished):
    """Each lane plays its seed's episode, whichever lanes are asked for."""
    trained = policies.load(finished)
    assert (trained.task, trained.seeds) == ("pendulum", [0, 1])
    both, second = play(trained), play(trained, [1])
    assert both.qpos.shape == (2, 201, 1)
    assert both.returns.shape == (2,)
    np.testing.assert_allclose(second.qpos[0], both.qpos[1], rtol=1e-3, atol=1e-4)


MODEL = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><joint type='slide'/><geom size='1'/></body></worldbody></mujoco>"
)


class State(NamedTuple):
    obs: Any
    reward: Any
    done: Any


class Counter:
    """Counts its steps and pays 1 for each; ends after `ends_at` steps, and is NaN from then on."""

    observation_size, action_size, episode_length = 1, 1, 6

    def __init__(self, ends_at, **attributes):
        self.ends_at = ends_at
        for name, value in attributes.items():
            setattr(self, name, value)

    def reset(self, rng):
        return State(jnp.zeros(1), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        count = state.obs + 1
        over = count[0] > self.ends_at
        obs = jnp.where(over, jnp.nan, count)
        return State(obs, jnp.where(over, jnp.nan, 1.0), (count[0] >= self.ends_at).astype(jnp.float32))


@pytest.mark.parametrize(("ends_at", "steps"), [(3, 3), (1, 1), (9, 6)])
def test_an_episode_is_over_where_the_task_ends_it(ends_at, steps):
    env = envs.adapt(Counter(ends_at, model=MODEL, qpos=lambda state: state.obs))
    still = Algorithm(lambda *_: None, lambda *_: None, lambda state, obs, key: jnp.zeros((1, 1)))
    episodes = play(Policies("counter", env, still, {"p": np.zeros(1)}, [0], {}, Config(), 100))
    assert (episodes.lengths, episodes.returns) == (steps, steps)
    np.testing.assert_array_equal(episodes.qpos[0, :, 0], np.minimum(np.arange(7), steps))


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(InputError, match="counter has no MuJoCo model to draw: give the environment"):
        check_drawable("counter", envs.adapt(Counter(3)))
    for attributes in ({}, {"qpos": lambda state: jnp.zeros(2)}):
        with pytest.raises(InputError, match="the states of counter do not hold the 1 positions of its model"):
            check_drawable("counter", envs.adapt(Counter(3, model=MODEL, **attributes)))


def test_environments_of_brax_and_playground_can_be_drawn():
    check_drawable("brax", envs.make("brax:inverted_pendulum"))
    if envs.registry.playground_names():
        check_drawable("playground", envs.make("playground:PendulumSwingup"))
