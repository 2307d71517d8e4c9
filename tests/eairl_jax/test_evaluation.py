"""Scores, in an environment that writes down what happened to it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import Config, InputError, demonstrations, evaluate, evaluation, horizon, random_policy


@pytest.mark.parametrize(("ends_at", "counted"), [(None, 5), (3, 3)])
def test_returns_stop_at_the_end_of_the_episode(toy, ends_at, counted):
    def act(obs, _key):
        return jnp.stack([obs[:, 0], 3.0 - obs[:, 0]], axis=-1)

    returns, steps = evaluate(jax.random.PRNGKey(0), toy(ends_at), act, episodes=4, episode_length=5)
    t = np.arange(counted)
    executed = np.clip(np.stack([t, 3.0 - t], axis=-1), -1, 1)
    np.testing.assert_allclose(returns, np.full(4, -((executed - 0.5) ** 2).sum()), rtol=1e-6)
    assert {name: x.shape for name, x in steps.items()} == {
        "obs": (4, 5, 4), "action": (4, 5, 2), "next_obs": (4, 5, 4), "reward": (4, 5), "terminated": (4, 5),
        "valid": (4, 5),
    }  # fmt: skip
    np.testing.assert_array_equal(steps["obs"][0, :, 0], np.arange(5))
    np.testing.assert_array_equal(steps["next_obs"][0, :, 0], np.arange(5) + 1)
    np.testing.assert_array_equal(steps["action"][0, :, 1], 3.0 - np.arange(5))
    np.testing.assert_array_equal(steps["terminated"][0], np.arange(5) == (ends_at or 0) - 1)
    np.testing.assert_array_equal(steps["valid"][0], np.arange(5) < counted)
    assert len(set(np.asarray(steps["obs"][:, 0, 3]))) == 4


def test_keys_differ_between_steps_and_episodes(toy):
    def act(obs, key):
        return jax.random.normal(key, (obs.shape[0], 2))

    _, steps = evaluate(jax.random.PRNGKey(0), toy(), act, episodes=3, episode_length=4)
    assert len(np.unique(steps["action"])) == 3 * 4 * 2


@pytest.mark.parametrize("limit", [None, 2.5])
def test_random_policy_fills_the_executed_range(toy, limit):
    act = random_policy(toy(action_limit=limit))
    actions = np.asarray(act(jnp.zeros((4000, 4)), jax.random.PRNGKey(0)))
    assert actions.shape == (4000, 2)
    np.testing.assert_allclose([actions.min(), actions.max()], [-(limit or 1.0), limit or 1.0], rtol=0.01)
    np.testing.assert_allclose(actions.std(), (limit or 1.0) / np.sqrt(3), rtol=0.03)


def test_the_reward_a_step_stops_at_the_end_of_an_episode(toy):
    _, steps = evaluate(jax.random.PRNGKey(0), toy(ends_at=3), random_policy(toy()), 2, 5)
    steps = {name: np.asarray(x) for name, x in steps.items()}
    paid = evaluation.reward_per_step(lambda batch: batch.obs[..., 0] + 1.0, steps)  # 1, 2, 3, ... in each episode
    np.testing.assert_allclose(paid, (1 + 2 + 3) / 5)


def broken_after(toy, ends_at):
    """A toy whose simulation is NaN after the end of the episode, as brax's physics can be."""

    class Broken(type(toy())):
        def step(self, state, action):
            after = super().step(state, action)
            gone = after.obs[0] > self.ends_at
            return jax.tree.map(lambda x: jnp.where(gone, jnp.nan, x), after)

    return Broken(ends_at)


def test_nothing_of_a_simulation_after_the_end_reaches_a_return(toy):
    env = broken_after(toy, 3)
    returns, steps = evaluate(jax.random.PRNGKey(0), env, random_policy(env), 2, 6)
    assert np.isfinite(returns).all()
    assert np.isfinite(steps["reward"]).all()
    assert np.isfinite(evaluation.reward_per_step(lambda batch: batch.obs[..., 0], steps))
    assert np.isnan(steps["obs"]).any()  # the test tests something
    demos = demonstrations.checked(demonstrations.from_steps(steps), "steps")
    assert demos.lengths.tolist() == [3, 3]


def test_an_absorbing_state_hides_a_simulation_after_the_end(toy):
    env = horizon.learning_env(broken_after(toy, 3), Config(horizon="absorbing"))
    state = env.reset(jax.random.PRNGKey(0))
    for _ in range(6):
        state = env.step(state, jnp.zeros(2))
        assert np.isfinite(state.obs).all()
        assert np.isfinite(state.reward)
    assert state.ended == 1


def test_a_policy_of_nan_has_no_score(toy):
    def act(obs, _key):
        return jnp.where(obs[:, :1] >= 2, jnp.nan, jnp.zeros((obs.shape[0], 2)))

    class Pays(type(toy())):
        def step(self, state, action):
            return super().step(state, action).replace(reward=jnp.ones(()))

    returns, _ = evaluate(jax.random.PRNGKey(0), Pays(), act, 2, 5)
    assert np.isnan(returns).all()
    returns, _ = evaluate(jax.random.PRNGKey(0), Pays(ends_at=2), act, 2, 5)
    np.testing.assert_array_equal(returns, [2, 2])  # it ended before


def still(obs, key):
    """An `act` that does nothing."""
    return jnp.zeros((obs.shape[0], 2))


REFUSED = {
    "several keys": ((jax.random.split(jax.random.PRNGKey(0), 4), still, 2, 5), "expected one random key"),
    "no key": ((0, still, 2, 5), "key is 0: expected one random key"),
    "no function": ((jax.random.key(0), "still", 2, 5), "act is 'still': expected a function"),
    "no episode": ((jax.random.key(0), still, 0, 5), "episodes = 0"),
    "half an episode": ((jax.random.key(0), still, 2.5, 5), "episodes = 2.5"),
    "no step": ((jax.random.key(0), still, 2, True), "episode_length = True"),
    "one action for all": ((jax.random.key(0), lambda o, k: jnp.zeros(2), 2, 5), r"shape \(2,\): expected \(2, 2\)"),
    "another size": ((jax.random.key(0), lambda o, k: jnp.zeros((2, 3)), 2, 5), r"shape \(2, 3\): expected \(2, 2\)"),
}


@pytest.mark.parametrize(("arguments", "message"), REFUSED.values(), ids=REFUSED)
def test_arguments_that_do_not_fit_are_named(toy, arguments, message):
    key, act, episodes, length = arguments
    with pytest.raises(InputError, match=message):
        evaluate(key, toy(), act, episodes, length)


@pytest.mark.parametrize("key", [jax.random.key(1), np.asarray(jax.random.PRNGKey(1))], ids=["new-style", "NumPy"])
def test_keys_and_numbers_of_any_kind_are_the_same(toy, key):
    expected = evaluate(jax.random.PRNGKey(1), toy(), still, 2, 5)[1]["obs"]
    np.testing.assert_array_equal(evaluate(key, toy(), still, np.int64(2), jnp.int32(5))[1]["obs"], expected)


def test_an_environment_that_resets_itself_is_refused(toy):
    wrapper = type("AutoResetWrapper", (), {"__module__": "brax.envs", "reset": None, "step": None})()
    wrapper.env = toy()
    with pytest.raises(InputError, match="AutoResetWrapper around Toy"):
        evaluate(jax.random.key(0), wrapper, still, 2, 5)
