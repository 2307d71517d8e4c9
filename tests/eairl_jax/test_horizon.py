"""Episodes that end early: what learning sees of them, and what it must not learn from them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax import (
    Config,
    Demonstrations,
    HParams,
    InputError,
    Lanes,
    demonstrations,
    evaluate,
    horizon,
    make_bc,
    make_irl,
    make_rl,
    normalize,
)
from eairl_jax.irl import learned_reward, reward_function


def config(kind, **changes):
    return Config(**{"episode_length": 6, "horizon": kind} | changes)


def episodes(*lengths, terminated=True):
    """Episodes whose observation counts the steps from 1, whose action is the negative of it."""
    t = np.concatenate([1.0 + np.arange(n) for n in lengths]).astype(np.float32)
    ends = np.concatenate([np.arange(n) == n - 1 for n in lengths]) & terminated
    obs = np.stack([t, 10 * t], axis=1)
    ones = np.array([1, 10], np.float32)
    return Demonstrations(obs, -t[:, None], obs + ones, t, ends.astype(np.float32), np.array(lengths, np.int32))


@pytest.mark.parametrize(("kind", "rewards", "ended"), [("fixed", 3, 0), ("absorbing", 3, 3)])
def test_an_episode_lasts_until_the_time_limit_and_pays_until_its_end(toy, kind, rewards, ended):
    """The toy ends after three steps. With "fixed" the simulation goes on, with "absorbing" it does not."""
    env = horizon.learning_env(toy(ends_at=3), config(kind), whole=True)
    size = 5 if kind == "absorbing" else 4
    assert env.observation_size == size
    state, seen, paid = env.reset(jax.random.PRNGKey(0)), [], []
    for _ in range(6):
        seen.append(np.asarray(state.obs))
        state = env.step(state, jnp.zeros(2))
        assert state.done == 0
        paid.append(float(state.reward))
    assert np.count_nonzero(paid) == rewards
    assert [o[0] for o in seen] == ([0, 1, 2, 0, 0, 0] if kind == "absorbing" else [0, 1, 2, 3, 4, 5])
    if kind == "absorbing":
        assert [o[-1] for o in seen] == [0, 0, 0, 1, 1, 1]
        assert not np.stack(seen[3:])[:, :-1].any()


def test_one_absorbing_step_stands_for_all_and_is_paid_for_all(toy):
    """The toy ends after three steps. The fourth is the absorbing one, and the next episode may begin."""
    cfg = config("absorbing")
    env, seen = horizon.learning_env(toy(ends_at=3), cfg), []
    state = env.reset(jax.random.PRNGKey(0))
    for _ in range(4):
        before, state = state, env.step(state, jnp.zeros(2))
        seen.append((float(before.obs[-1]), float(state.obs[-1]), float(state.done)))
    assert seen == [(0, 0, 0), (0, 0, 0), (0, 1, 0), (1, 1, 1)]
    obs = jnp.stack([before.obs, jnp.zeros(5)])
    for gamma, stay in ((0.9, 10.0), (0.0, 1.0), (1.0, 6.0)):
        paid = horizon.rest_paid(jnp.array([2.0, 3.0]), obs, HParams(gamma=gamma), cfg)
        np.testing.assert_allclose(paid, [2.0 * stay, 3.0], rtol=1e-5)
    for gamma, stay in ((0.5, 2), (0.8, 5), (0.99, 6), (1.0, 6)):  # at most the time limit
        assert horizon.stay(HParams(gamma=gamma), cfg) == stay
    for other in (config("variable"), config("absorbing", discriminates="trajectories")):
        assert horizon.stay(HParams(), other) == 1
        assert (horizon.rest_paid(jnp.array([2.0, 3.0]), obs, HParams(), other) == jnp.array([2.0, 3.0])).all()


def test_where_episodes_never_end_or_may_vary_the_environment_is_the_tasks_own(toy):
    never, ends = toy(), toy(ends_at=3)
    assert horizon.learning_env(never, config("fixed")) is never
    assert horizon.learning_env(ends, config("variable")) is ends


@settings(max_examples=20)
@given(
    st.lists(st.integers(1, 6), min_size=1, max_size=4),
    st.booleans(),
    st.sampled_from(["transitions", "trajectories"]),
    st.sampled_from([1, 4]),
)
def test_absorbing_steps_of_the_expert_are_those_of_the_policy(lengths, terminated, discriminates, stay):
    """Every step of every episode is drawn from one row, the last entry says which rows are after an end.

    Where trajectories are discriminated they fill the time limit. Else there are `stay`, if time is left for one.
    """
    demos, cfg = episodes(*lengths, terminated=terminated), config("absorbing", discriminates=discriminates)
    count = int(horizon.step_count(demos, cfg, stay))
    after = [(6 - n if discriminates == "trajectories" else (n < 6) * stay) * terminated for n in lengths]
    learned = [n + more for n, more in zip(lengths, after, strict=True)]
    assert count == sum(learned)
    taken = horizon.take_steps(demos, jnp.arange(count), cfg, stay)
    rows = []  # (obs, action, next_obs), by a loop
    for n, steps in zip(lengths, learned, strict=True):
        for t in range(steps):
            gone, next_gone = t >= n, terminated and t >= n - 1
            obs = [0, 0, 1] if gone else [t + 1, 10 * (t + 1), 0]
            next_obs = [0, 0, 1] if next_gone else [t + 2, 10 * (t + 2), 0]
            rows.append((*obs, 0 if gone else -(t + 1), *next_obs))
    np.testing.assert_array_equal(np.concatenate([taken.obs, taken.action, taken.next_obs], axis=1), rows)
    assert not taken.terminated.any()


@pytest.mark.parametrize("kind", ["fixed", "variable"])
def test_other_horizons_take_the_steps_as_they_are(kind):
    demos = episodes(2, 5)
    taken = horizon.take_steps(demos, jnp.array([[0, 6], [3, 3]]), config(kind))
    np.testing.assert_array_equal(taken.obs[..., 0], [[1, 5], [2, 2]])
    assert horizon.step_count(demos, config(kind)) == 7


def test_judged_episodes_are_seen_as_in_learning():
    """The reward of whole episodes counts the absorbing steps, as the demonstrations of learning do."""
    demos, cfg = episodes(2, 6), config("absorbing", discriminates="trajectories")
    seen = horizon.extended(demonstrations.to_steps(demos, 6), cfg)
    taken = horizon.take_steps(demos, jnp.arange(12), cfg)
    np.testing.assert_array_equal(np.asarray(seen["obs"]).reshape(12, 3), taken.obs)
    np.testing.assert_array_equal(np.asarray(seen["action"]).reshape(12, 1), taken.action)
    np.testing.assert_array_equal(seen["valid"], np.ones((2, 6)))


@pytest.mark.parametrize(
    ("kind", "demos", "message"),
    [
        ("fixed", episodes(6, 4), r"1 of 2 episodes end before the time limit \(4 to 6 steps\), but horizon fixed"),
        ("fixed", episodes(6, 6), r"0 of 2 episodes end before"),
        ("absorbing", episodes(7, 4), r"an episode of 7 steps, and the time limit is 6 steps"),
    ],
)
def test_demonstrations_that_contradict_the_horizon_are_refused(toy, kind, demos, message):
    with pytest.raises(InputError, match=message):
        horizon.check_demonstrations(toy(ends_at=3), demos, config(kind), "here")


def test_where_no_episode_ends_a_demonstration_may_stop_but_not_end(toy):
    horizon.check_demonstrations(toy(), episodes(6, 4, terminated=False), config("fixed"), "here")
    with pytest.raises(InputError, match="the task ended 2 of 2 episodes, but this task never ends an episode"):
        horizon.check_demonstrations(toy(), episodes(6, 4), config("fixed"), "here")


def test_demonstrations_that_fit_are_not_refused(toy):
    for kind, demos in (
        ("fixed", episodes(6, 6, terminated=False)),
        ("absorbing", episodes(1, 6)),
        ("variable", episodes(3)),
    ):
        horizon.check_demonstrations(toy(ends_at=3), demos, config(kind), "here")


def test_the_time_limit_is_the_tasks_own_or_is_asked_for(toy):
    assert horizon.resolved(toy(), Config(), "fixed").episode_length == 5
    assert horizon.resolved(toy(), Config(episode_length=3), "fixed").episode_length == 3
    env = toy()
    env.episode_length = 0
    for make in (make_irl, make_rl, make_bc):
        with pytest.raises(InputError, match=r"no episode_length: give the time limit in steps"):
            make(env, Config(method="eairl"))


class Alive:
    """Ends when the action is negative; every step pays 1. An expert lives for 10 steps."""

    observation_size, action_size, episode_length = 1, 1, 10

    def reset(self, rng):
        return State(jnp.ones(1), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return State(jnp.ones(1), jnp.ones(()), (action[0] < 0).astype(jnp.float32))


@dataclasses.dataclass
class State:
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


jax.tree_util.register_dataclass(State, ["obs", "reward", "done"], [])


@pytest.fixture(scope="module")
def trained():
    """Final true returns of AIRL(s,a) in `Alive`, by horizon: the return's mean over the last iterations."""
    demos = Demonstrations(
        np.ones((40, 1), np.float32), np.full((40, 1), 0.7, np.float32), np.ones((40, 1), np.float32),
        np.ones(40, np.float32), np.zeros(40, np.float32), np.full(4, 10, np.int32),
    )  # fmt: skip

    def run(kind):
        cfg = Config(method="airl_s", num_envs=16, rollout_length=10, iterations=60, hidden=(16,), policy_hidden=(16,),
                     value_hidden=(16,), history_length=2, discriminator_batch=64, horizon=kind,
                     normalize_obs="none")  # fmt: skip
        lanes = Lanes(
            make_irl(Alive(), cfg), jax.random.split(jax.random.PRNGKey(0), 2), HParams(policy_lr=3e-3), demos
        )
        state, metrics = lanes.run(lanes.init(), 60)
        return cfg, state, metrics["true_return"][:, -5:].mean()

    return run


def test_an_expert_that_lives_is_imitated_with_absorbing_states(trained):
    """The defect in small: the reward of a living step is negative, so a policy that can end its episode does."""
    cfg, state, living = trained("absorbing")
    assert living > 9.0
    with pytest.warns(UserWarning, match="sign of the learned reward"):
        assert trained("variable")[2] < living - 1.0
    # The learned reward takes the task's observations, and has a value for the steps after the end.
    reward = reward_function(cfg)
    params = jax.tree.map(lambda leaf: leaf[0], learned_reward(state))
    alive, gone = (reward(params, jnp.asarray(obs), jnp.zeros(1)) for obs in ([1.0], [0.0, 1.0]))
    assert np.isfinite([alive, gone]).all()
    assert alive != gone


def test_a_policy_trained_with_absorbing_states_acts_in_the_task_itself(trained):
    _, state, _ = trained("absorbing")
    algorithm = make_irl(Alive(), Config(method="airl_s", hidden=(16,), policy_hidden=(16,), value_hidden=(16,),
                                         horizon="absorbing", normalize_obs="none"))  # fmt: skip
    alone = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], state)
    returns, _ = evaluate(jax.random.PRNGKey(1), Alive(), lambda obs, key: algorithm.act(alone, obs, key), 50, 10)
    assert returns.mean() > 9.0


def test_statistics_of_observations_leave_out_the_absorbing_state():
    stats = normalize.ObsStats(jnp.zeros(3), jnp.ones(3), jnp.zeros(()))
    obs = horizon.absorb(jnp.array([[1.0, 5.0], [3.0, 7.0], [9.0, 9.0]]), jnp.array([0.0, 0.0, 1.0]))
    updated = horizon.update_stats(stats, obs, config("absorbing"))
    np.testing.assert_allclose(updated.mean, [2, 6, 0])
    np.testing.assert_allclose(updated.var, [1, 1, 1])
    assert updated.count == 2


def test_the_history_holds_ends_of_all_iterations_where_an_absorbing_state_follows_them(toy, tiny, demos):
    ending, kept = toy(ends_at=3), dataclasses.replace(config("absorbing"), history="all")
    assert horizon.learning_config(ending, config("absorbing")) == kept
    for env, other in (
        (ending, config("variable")),
        (ending, dataclasses.replace(config("absorbing"), history="paths")),
        (toy(), config("absorbing")),
    ):
        assert horizon.learning_config(env, other) == other

    def loss(**changes):
        algorithm = make_irl(ending, tiny(method="gail", horizon="absorbing", **changes))
        state = algorithm.init(jax.random.PRNGKey(0), HParams())
        return float(jax.jit(algorithm.step)(state, HParams(), demos)[1]["discriminator_loss"])

    assert loss() == loss(history="all")
    assert loss() != loss(history="iterations")


def test_whole_trajectories_need_whole_episodes(toy, tiny):
    with pytest.raises(InputError, match="horizon variable an episode may end early"):
        make_irl(toy(ends_at=3), tiny(method="gan_gcl", rollout_length=5, horizon="variable"))
    make_irl(toy(ends_at=3), tiny(method="gan_gcl", rollout_length=5, horizon="absorbing"))


def test_demonstrations_without_actions_are_for_methods_that_need_none(toy, tiny, demos):
    states = demos._replace(action=None)
    for method, form in (("gaifo", "default"), ("gail", "s")):
        algorithm = make_irl(toy(), tiny(method=method, reward_form=form))
        state, metrics = jax.jit(algorithm.step)(algorithm.init(jax.random.PRNGKey(0), HParams()), HParams(), states)
        assert np.isfinite(metrics["discriminator_loss"])
        given, _ = jax.jit(algorithm.step)(algorithm.init(jax.random.PRNGKey(0), HParams()), HParams(), demos)
        jax.tree.map(np.testing.assert_array_equal, state.discriminator.params, given.discriminator.params)
    for algorithm in (make_irl(toy(), tiny(method="airl_s")), make_bc(toy(), tiny())):
        with pytest.raises(InputError, match=r"needs the expert's actions"):
            algorithm.step(algorithm.init(jax.random.PRNGKey(0), HParams()), HParams(), states)
