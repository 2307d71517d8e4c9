"""Exact empowerment: capacities that are known, a potential of the maze, and the shaping that it makes."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import HParams, InputError, envs, exact_empowerment, horizon, make_irl
from eairl_jax.discriminator_data import for_loss, for_policy_reward
from eairl_jax.gaussian import Gaussian
from eairl_jax.normalize import ObsStats

GAMMA = 0.9


def channel_of_noise(share):
    """Three inputs of which an output shows the right one with probability `1 - share`, else one of the others."""
    return jnp.array((1 - 1.5 * share) * np.eye(3) + share / 2, jnp.float32)


def known_capacity(share):
    return np.log(3) + (1 - share) * np.log(1 - share) + share * np.log(share / 2)


def test_the_capacity_of_a_symmetric_channel_is_the_closed_form():
    for share in (0.1, 0.4):
        bounds = exact_empowerment.capacity(channel_of_noise(share), jnp.ones((3, 1)))
        np.testing.assert_allclose(bounds, known_capacity(share), atol=1e-5)


def test_the_capacities_of_two_independent_outputs_add_up():
    i, j = np.divmod(np.arange(9), 3)
    bounds = exact_empowerment.capacity(channel_of_noise(0.1)[i], channel_of_noise(0.4)[j])
    np.testing.assert_allclose(bounds, known_capacity(0.1) + known_capacity(0.4), atol=1e-5)


def test_the_bounds_close_around_the_capacity_of_the_z_channel():
    """Its best inputs are not uniform: the noisy one has a share of 2/5."""
    p = jnp.array([[1.0, 0.0], [0.5, 0.5]], jnp.float32)
    lower, upper = exact_empowerment.capacity(p, jnp.ones((2, 1)), iterations=2)
    assert lower < np.log(1.25) - 1e-4 < np.log(1.25) + 1e-4 < upper
    np.testing.assert_allclose(exact_empowerment.capacity(p, jnp.ones((2, 1))), np.log(1.25), atol=1e-5)


def test_a_channel_of_gaussian_noise_has_one_bit_for_two_distant_outcomes():
    p, r = exact_empowerment.channel(jnp.array([[10.3, 20.0], [40.7, 20.0]]))
    np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(exact_empowerment.capacity(p, r), np.log(2), rtol=1e-5)
    p, r = exact_empowerment.channel(jnp.array([[10.3], [10.3]]))  # one observed quantity, and no choice at all
    np.testing.assert_allclose(exact_empowerment.capacity(p, r), 0.0, atol=1e-5)


def test_plans_hold_their_actions_within_the_limit():
    plans = exact_empowerment.plans(2, 20, 0.4)
    assert plans.shape == (exact_empowerment.PLANS, 20, 2)
    assert np.abs(plans).max() == np.float32(0.4)
    changes = (np.diff(plans, axis=1) != 0).any(axis=2).sum(axis=1)
    assert changes.max() == exact_empowerment.MOST_CHANGES
    assert changes.min() <= 1
    assert exact_empowerment.plans(1, 1, 1.0).shape == (exact_empowerment.PLANS, 1, 1)


def test_phi_is_linear_between_the_nodes_and_constant_beyond_them():
    x, y = np.meshgrid(*[np.linspace(-0.1, 0.6, exact_empowerment.NODES)] * 2, indexing="ij")
    table = exact_empowerment.Potential(jnp.full(2, -0.1), jnp.full(2, 0.6), jnp.asarray(2 * x + y))
    obs = jnp.array([[0.0, 0.0], [0.123, 0.456], [0.6, -0.1], [0.9, -0.1]])
    np.testing.assert_allclose(exact_empowerment.phi(table, obs), [0.0, 0.702, 1.1, 1.1], atol=1e-5)


@pytest.fixture(scope="module")
def maze_config(tiny):
    return tiny(method="airl_sa", reward_form="sa", shaping="exact_empowerment", episode_length=0, iterations=2)


@pytest.fixture(scope="module")
def state(maze_config):
    """Of a run in the left maze before its first iteration, with a coarse potential."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact_empowerment, "NODES", 8)
        patch.setattr(exact_empowerment, "PLANS", 64)
        patch.setattr(exact_empowerment.plans, "__defaults__", (64,))
        return make_irl(envs.make("point_maze_left"), maze_config).init(jax.random.key(0), HParams())


def test_a_wall_takes_empowerment_and_a_corner_takes_more(state):
    """One step moves the point by 1 cm. Beside a wall half of the moves are lost."""
    phi = np.asarray(state.exact_phi.values)
    corner, wall, open_space = phi[0, 0], phi[3, 0], phi[2, 1:3]
    assert 0.2 < corner < wall - 0.1 < open_space.min() - 0.2
    np.testing.assert_allclose(open_space, phi[5, 6], atol=0.01)  # the dynamics are the same in all open space


@pytest.mark.slow
@pytest.mark.parametrize("steps, most", [(5, 0.05), (20, 0.1)])
def test_more_plans_raise_the_capacity_alike_everywhere(steps, most):
    """So a shaping, which is a difference of two capacities, hardly changes."""
    env = envs.make("point_maze_left")
    places = jnp.array([[0.25, 0.0], [0.0, 0.0], [0.25, 0.15], [0.1, 0.25], [0.5, 0.5], [0.25, 0.5]])

    def capacities(count):
        plans = jnp.asarray(exact_empowerment.plans(2, steps, 1.0, count))

        def one(place):
            cells = (exact_empowerment.outcomes(env, place, plans) + 0.1) / (0.35 * exact_empowerment.RESOLUTION)
            return exact_empowerment.capacity(*exact_empowerment.channel(cells))

        return np.asarray(jax.jit(lambda places: jax.lax.map(one, places))(places))

    fewer, more = capacities(exact_empowerment.PLANS), capacities(4 * exact_empowerment.PLANS)
    raised = more[0] - fewer[0]
    print(f"K = {steps}: raised by {raised.min():.2f} to {raised.max():.2f}, known to {(more[1] - more[0]).max():.3f}")
    assert np.ptp(raised) < most
    assert (more[1] - more[0]).max() < 0.05


@pytest.mark.parametrize("scoring", [False, True])
def test_the_shaping_is_that_of_the_exact_phi(state, maze_config, transitions, scoring, monkeypatch):
    monkeypatch.setattr(exact_empowerment, "NODES", 8)
    raw = transitions()
    raw = raw._replace(obs=0.2 * raw.obs[..., :2], next_obs=0.2 * raw.next_obs[..., :2])
    # A normaliser that must not matter: Phi is a function of metres.
    acting = SimpleNamespace(obs_stats=ObsStats(jnp.full(2, 3.0), jnp.full(2, 9.0), jnp.zeros(())))
    hparams = HParams(gamma=GAMMA)
    if scoring:
        samples = for_policy_reward(raw, None, state.exact_phi, acting, hparams, maze_config)
    else:
        pi = Gaussian(jnp.zeros((6, 4, 2)), jnp.zeros((6, 4, 2)))
        samples = for_loss(raw, lambda _obs: pi, None, state.exact_phi, acting, hparams, maze_config)
    phi, next_phi = (exact_empowerment.phi(state.exact_phi, x) for x in (raw.obs, raw.next_obs))
    np.testing.assert_allclose(samples.phi_shaping, GAMMA * (1 - raw.terminated) * next_phi - phi, rtol=1e-5)
    assert np.ptp(samples.phi_shaping) > 0.1


@pytest.mark.parametrize(
    "task, message",
    [
        ("pendulum", r"Pendulum has no function at_rest\(obs\)"),
        (SimpleNamespace(at_rest=print), "declares no obs_mean and obs_std"),
        (
            SimpleNamespace(at_rest=print, obs_mean=(0.0,) * 3, obs_std=(1.0,) * 3, observation_size=3),
            "observes 3 quantities",
        ),
    ],
)
def test_a_task_without_an_exact_phi_is_refused(maze_config, task, message):
    with pytest.raises(InputError, match=message):
        exact_empowerment.check(envs.make(task) if isinstance(task, str) else task, maze_config)


def test_other_shapings_ask_nothing_of_the_task(tiny):
    exact_empowerment.check(envs.make("pendulum"), tiny())
    assert exact_empowerment.potential(envs.make("pendulum"), tiny()) == ()


def test_a_task_whose_episodes_go_on_after_their_end_starts_at_rest_as_before(toy, tiny):
    class Rests(toy):
        def at_rest(self, obs):
            return dataclasses.replace(self.reset(jax.random.PRNGKey(0)), obs=obs)

    env, obs = horizon.learning_env(Rests(ends_at=1), tiny(horizon="fixed")), jnp.array([0.0, 0.1, 0.2, 1.5])
    state = env.at_rest(obs)
    np.testing.assert_array_equal(state.obs, obs)
    assert not env.step(env.step(state, jnp.zeros(2)), jnp.zeros(2)).done  # beyond the end at step 1
    assert not hasattr(horizon.learning_env(toy(ends_at=1), tiny(horizon="fixed")), "at_rest")
