"""Plans lead to different places, a reward chooses one plan in each place, and clones act as their plans acted."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from eairl_jax import HParams, Lanes, agent, make_rl, plans
from eairl_jax.policy_optimizers import make_optimizer

SEARCH = plans.Search(plans=256, repeats=4, updates=200, batch=64, lr=1e-2)


@struct.dataclass
class PointState:
    """The fields that every environment's state has."""

    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class Point:
    """A point in [-1, 1] that moves by a tenth of its action. The true reward is NaN, so that no code can use it."""

    observation_size, action_size = 1, 1

    def reset(self, rng):
        del rng
        return PointState(jnp.zeros(1), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return PointState(jnp.clip(state.obs + 0.1 * action, -1.0, 1.0), jnp.nan * state.reward, jnp.zeros(()))


def near(place):
    """A reward for being near a place: 0 there, and the distance is a cost."""
    return lambda batch: -jnp.abs(batch.obs[..., 0] - place)


def test_every_action_of_a_plan_is_held_and_within_the_bounds():
    drawn = np.asarray(plans.draw(jax.random.PRNGKey(0), 200, 30, 2, 0.5))
    assert drawn.shape == (200, 30, 2)
    assert np.abs(drawn).max() <= 0.5
    changes = (np.diff(drawn, axis=1) != 0).any(axis=2).sum(axis=1)
    assert changes.max() <= plans.MAX_ACTIONS - 1
    assert len(np.unique(changes)) > 3
    np.testing.assert_array_equal(drawn, plans.draw(jax.random.PRNGKey(0), 200, 30, 2, 0.5))


def test_a_plan_is_executed_as_it_is_and_counts_until_the_end(toy):
    plan = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, size=(3, 5, 2)), jnp.float32)
    raw = plans.simulate(jax.random.PRNGKey(0), toy(ends_at=4), plan)
    np.testing.assert_array_equal(raw.action, np.swapaxes(plan, 0, 1))
    np.testing.assert_allclose(raw.next_obs[..., 1:3], np.swapaxes(plan, 0, 1), atol=1e-6)
    np.testing.assert_array_equal(raw.terminated[:, 0], [0, 0, 0, 1, 0])
    np.testing.assert_array_equal(raw.truncated[:, 0], [0, 0, 0, 0, 1])
    paid = plans.scores(lambda batch: batch.reward, raw)
    np.testing.assert_allclose(paid, -((np.asarray(plan)[:, :4] - 0.5) ** 2).sum(axis=(1, 2)) / 5, rtol=1e-5)
    noisy = plans.simulate(jax.random.PRNGKey(0), toy(), plan, noise=0.3)
    np.testing.assert_array_equal(noisy.action, raw.action)
    assert np.abs(noisy.next_obs[..., 1:3] - raw.action).mean() > 0.05


def test_separate_groups_of_points_are_separate_clusters():
    rng = np.random.default_rng(0)
    group = rng.integers(0, 3, size=60)
    points = np.array([[0, 0], [5, 0], [0, 5]])[group] + 0.1 * rng.normal(size=(60, 2))
    cluster = np.asarray(plans.clusters(jnp.asarray(points, jnp.float32), 3))
    pairs = {*zip(group.tolist(), cluster.tolist(), strict=True)}
    assert len(pairs) == len(set(cluster.tolist())) == 3


@pytest.fixture(scope="module")
def chosen():
    """`place -> (plans, scores)` that a reward for this place chooses; compiled once."""
    choose = functools.partial(plans.choose, env=Point(), count=4, length=40, search=SEARCH)
    return jax.jit(lambda place: choose(jax.random.PRNGKey(1), reward=near(place)))


@pytest.mark.parametrize("place", [-0.8, 0.6])
def test_the_best_plan_leads_to_what_the_reward_pays_for_and_the_others_lead_elsewhere(place, chosen):
    best_plans, paid = chosen(place)
    raw = plans.simulate(jax.random.PRNGKey(0), Point(), best_plans)
    np.testing.assert_allclose(paid, plans.scores(near(place), raw), atol=1e-6)
    second_half = np.asarray(raw.obs[20:, :, 0].mean(axis=0))
    assert abs(second_half[int(paid.argmax())] - place) < 0.25
    assert np.ptp(second_half) > 1.0  # the four plans cover most of [-1, 1]


def test_a_planner_makes_policies_that_act_as_their_plans_acted(tiny, equal_trees):
    config = tiny(policy_hidden=(32, 32), policy_activation="tanh", episode_length=20)
    planner = plans.make_planner(Point(), config, 3, SEARCH, lambda place, batch: near(place)(batch))
    lanes = Lanes(planner, jax.random.split(jax.random.PRNGKey(0), 2), HParams(), jnp.array([-0.8, 0.8]), True)
    fresh = lanes.take(lanes.init())
    state, metrics = lanes.run(lanes.init(), 1)
    state = lanes.take(state)
    assert metrics["score"].shape == (2, 1)
    assert np.isfinite(metrics["score"]).all()
    # `make_rl` can go on with each policy, and only the actor's mean has changed.
    policies, policy = make_rl(Point(), config), jax.tree.map(lambda x: x[0, 0], state)
    like = jax.eval_shape(policies.init, jax.random.PRNGKey(0), HParams())
    assert jax.tree.map(lambda x: x.shape, policy) == jax.tree.map(lambda x: x.shape, like)
    before, after = (x.agent.policy.nets.params for x in (fresh, state))
    equal_trees(before["critic"], after["critic"])
    np.testing.assert_array_equal(before["actor"]["params"]["raw_log_std"], after["actor"]["params"]["raw_log_std"])
    # At the start, one of the three policies of each reward acts towards the place that its reward pays for.
    distribution = jax.vmap(jax.vmap(make_optimizer(Point(), config).distribution, (0, None)), (0, None))
    first = np.asarray(distribution(state.agent.policy, jnp.zeros(1)).mean[..., 0])
    assert first[0].min() < -0.2
    assert first[1].max() > 0.2


def test_a_clone_acts_at_raw_observations_learns_from_weighted_samples_and_begins_adam_anew(toy, tiny):
    """Half of the samples want the opposite action and weigh nothing. The normaliser is far from doing nothing."""
    config = tiny(policy_hidden=(32, 32), policy_activation="tanh", normalize_obs="task")
    env, rng = toy(scale=((5.0,) * 4, (3.0,) * 4)), np.random.default_rng(0)
    optimizer = make_optimizer(env, config)
    before = agent.init(jax.random.PRNGKey(0), env, optimizer, HParams(), config)
    obs = jnp.asarray(rng.normal(5, 3, size=(40, 2, 4)), jnp.float32)
    wanted = 0.1 * (obs[..., :2] - 5.0)
    action, weight = wanted.at[:, 1].multiply(-1.0), jnp.ones((40, 2)).at[:, 1].set(0.0)
    search = plans.Search(updates=600, batch=64, lr=1e-2)
    after = plans.fit(jax.random.PRNGKey(1), optimizer, before, (obs, action, weight), search)
    np.testing.assert_allclose(agent.distribution(after, obs, optimizer).mean[:, 0], wanted[:, 0], atol=0.15)
    assert all((np.asarray(leaf) == 0).all() for leaf in jax.tree.leaves(after.policy.nets.adam))


def test_a_clone_does_not_learn_what_its_plan_did_after_the_end(toy, tiny):
    """The plan turns around at step 3. The first observation of `Toy` counts the steps."""
    config = tiny(policy_hidden=(32,), policy_activation="tanh", normalize_obs="none")
    plan = jnp.where(jnp.arange(6)[:, None] < 3, 0.8, -0.8) * jnp.ones((6, 2))
    search, late = plans.Search(updates=400, batch=64, lr=1e-2), jnp.array([5.0, -0.8, -0.8, 1.5])
    acts = {}
    for ends_at in (3, None):
        env = toy(ends_at=ends_at)
        optimizer = make_optimizer(env, config)
        before = agent.init(jax.random.PRNGKey(0), env, optimizer, HParams(), config)
        clone = plans.clone(jax.random.PRNGKey(1), env, optimizer, before, plan, search)
        acts[ends_at] = agent.distribution(clone, late, optimizer).mean
    assert (acts[None] < -0.6).all()
    assert (acts[3] > -0.6).any()
