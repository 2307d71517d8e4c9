"""Environments that do not fit are refused with the call that makes them fit."""

import types

import gymnasium
import jax
import jax.numpy as jnp
import pytest
from brax.envs.base import Env, State
from brax.envs.wrappers import training

from eairl_jax import InputError, evaluate, make_bc, make_irl, make_rl
from eairl_jax.environment import check_env, check_steps


class Still(Env):
    """The smallest environment of brax."""

    observation_size, action_size, backend = 2, 1, "none"

    def reset(self, rng):
        return State(None, jnp.zeros(2), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return state


def made_in(package, name="Task", **attributes):
    """An object of a class that another package defines."""
    functions = {"reset": lambda self: None, "step": lambda self, action: None}
    return type(name, (), functions | attributes | {"__module__": f"{package}.somewhere"})()


DISCRETE = types.SimpleNamespace(
    reset=None, step=None, observation_size=2, action_size=2, action_space=gymnasium.spaces.Discrete(2)
)
REFUSED = {
    "a time limit": (training.EpisodeWrapper(Still(), 10, 1), "EpisodeWrapper around Still turns the time limit"),
    "resets": (training.AutoResetWrapper(Still()), "use brax.envs.get_environment(...), or env.unwrapped"),
    "a batch": (training.VmapWrapper(Still()), "VmapWrapper around Still"),
    "an inner time limit": (types.SimpleNamespace(env=training.EpisodeWrapper(Still(), 10, 1)), "EpisodeWrapper"),
    "Gymnasium": (gymnasium.make("Pendulum-v1"), "is a Gymnasium environment, which computes outside of JAX"),
    "discrete actions": (gymnasium.make("CartPole-v1"), "has discrete actions: eairl_jax learns with continuous"),
    "a discrete space": (DISCRETE, "has discrete actions"),
    "gymnax": (made_in("gymnax", num_actions=3), "has discrete actions"),
    "Stable-Baselines3": (made_in("stable_baselines3", "DummyVecEnv"), "a vector of environments of Stable-Baselines3"),
    "Playground": (made_in("mujoco_playground", "Run"), "eairl_jax.envs.adapt(env)"),
    "no functions": (object(), "has no function reset, step"),
}
NO_SIZES = {
    "no sizes": (dict(), "has no observation_size, action_size"),
    "a dictionary": (dict(observation_size={"state": 3}, action_size=1), 'eairl_jax.envs.adapt(env, obs="state")'),
    "a shape": (dict(observation_size=(3, 2), action_size=1), "expected a whole number"),
    "no actions": (dict(observation_size=3, action_size=0), "action_size is 0"),
}


@pytest.mark.parametrize(("env", "hint"), REFUSED.values(), ids=REFUSED)
def test_steps_that_are_not_what_a_rollout_needs_are_refused(env, hint, tiny):
    for refuse in (check_steps, check_env, lambda env: make_irl(env, tiny()), lambda env: make_rl(env, tiny())):
        with pytest.raises(InputError) as e:
            refuse(env)
        assert hint in str(e.value)
    with pytest.raises(InputError):
        make_bc(env, tiny(method="bc"))
    with pytest.raises(InputError):
        evaluate(jax.random.PRNGKey(0), env, lambda obs, key: obs[:, :1], 2, 3)


@pytest.mark.parametrize(("attributes", "hint"), NO_SIZES.values(), ids=NO_SIZES)
def test_sizes_that_no_network_has_are_refused(attributes, hint):
    env = made_in("mine", **attributes)
    check_steps(env)
    with pytest.raises(InputError) as e:
        check_env(env)
    assert hint in str(e.value)


def test_what_fits_is_accepted(toy):
    for env in (toy(), Still(), training.EpisodeWrapper(Still(), 10, 1).unwrapped):
        check_env(env)


def test_wrappers_that_hold_each_other_end_the_search():
    env = made_in("mine", observation_size=1, action_size=1)
    env.env = env
    check_env(env)
