"""One lane on two devices against the same lane on one, and what cannot be split."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.sharding import Mesh, PartitionSpec

from eairl_jax import Algorithm, Config, HParams, InputError, Lanes, make_irl, make_rl, processes, shards
from eairl_jax.lanes import shards_for
from eairl_jax.shards import AXIS, Shards


def of_size(num_envs, steps=200):
    """A configuration of `num_envs` environments and rollouts of `steps` steps."""
    return Config(num_envs=num_envs, rollout_length=steps, episode_length=steps, ppo_minibatches=1)


def on_two_devices(function, *arguments):
    """Calls a function on two devices; the results of both, one after another."""
    mesh, spec = Mesh(np.array(jax.devices()[:2]), (AXIS,)), PartitionSpec()
    both = jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=PartitionSpec(AXIS), check_vma=False)
    return jax.jit(both)(*arguments)


def test_parts_are_in_order_and_joined_to_the_whole():
    tree = {"x": np.arange(12.0).reshape(6, 2), "n": np.arange(4)}
    parts = on_two_devices(Shards(2).part, tree)
    jax.tree.map(np.testing.assert_array_equal, parts, tree)
    columns = on_two_devices(lambda x: Shards(2).part(x, axis=1), tree["x"])
    np.testing.assert_array_equal(columns, np.concatenate([tree["x"][:, :1], tree["x"][:, 1:]]))
    for axis in (0, 1):
        joined = on_two_devices(lambda x, axis=axis: Shards(2).join(Shards(2).part(x, axis), axis), tree["x"])
        np.testing.assert_array_equal(joined, np.concatenate([tree["x"]] * 2))


def test_what_has_no_equal_parts_stays_whole():
    np.testing.assert_array_equal(on_two_devices(Shards(2).part, np.arange(3)), [0, 1, 2, 0, 1, 2])


def test_a_mean_is_taken_over_devices():
    def means(x):
        own = Shards(2).part(x)
        return jax.tree.map(lambda y: y[None], Shards(2).mean({"mean": own.mean(), "sums": own.sum(axis=0)}))

    found = on_two_devices(means, np.arange(8.0).reshape(4, 2))
    np.testing.assert_allclose(found["mean"], [3.5, 3.5])
    np.testing.assert_allclose(found["sums"], [[6.0, 8.0]] * 2)


def test_one_shard_changes_nothing():
    x = object()
    assert shards.ONE.part(x) is shards.ONE.join(x) is shards.ONE.mean(x) is x


@given(num_envs=st.integers(1, 300), devices=st.integers(0, 70))
def test_the_most_devices_that_split_the_environments_evenly(num_envs, devices):
    count = shards.fitting(num_envs, devices)
    assert 1 <= count <= max(1, devices)
    assert num_envs % count == 0
    assert not any(num_envs % more == 0 for more in range(count + 1, devices + 1))
    assert shards.of_count(count, num_envs) == Shards(count)


def trained(algorithm, data, lanes):
    """The state and the metrics of two iterations."""
    run = Lanes(algorithm, jax.random.split(jax.random.PRNGKey(5), lanes), HParams(), data)
    state, metrics = run.run(run.init(), 2)
    return run.take(state), metrics


def same_on_two_devices(make, data, lanes, tolerance):
    """Trains by an algorithm built for one device a lane, and by the same one built for two; the states agree."""
    both = [trained(make(count), data, lanes) for count in (1, 2)]
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance), *both)
    assert np.ptp(both[0][0].agent.rollout.env.obs) > 0
    return both[1]


@pytest.mark.filterwarnings("ignore:horizon")
def test_lanes_on_two_devices_differ_in_the_last_bits_alone(toy, tiny, demos):
    """Episodes end within the rollout, so environments of one device start from states of the other."""
    config = tiny(method="eairl", num_envs=4, rollout_length=6, ppo_epochs=2, ppo_minibatches=3)
    config = dataclasses.replace(config, normalize_obs="running")
    same_on_two_devices(lambda count: make_irl(toy(ends_at=4), config, count), demos, 2, 2e-4)


def test_trpo_too_with_minibatches_that_have_no_equal_parts(toy, tiny):
    config = tiny(optimizer="trpo", num_envs=2, rollout_length=3, ppo_epochs=2, ppo_minibatches=2)  # minibatches of 3
    alone = same_on_two_devices(lambda count: make_rl(toy(), config, shards=count), (), 1, 2e-4)
    with processes.leading(processes.Team([], [2])):  # a team of this process alone, with its two devices
        jax.tree.map(np.testing.assert_array_equal, trained(make_rl(toy(), config, shards=2), (), 1), alone)


def test_what_cannot_be_split_is_refused(toy, tiny):
    with pytest.raises(InputError, match=r"num_envs = 6 .* over 4 devices; try shards=3"):
        make_rl(toy(), tiny(num_envs=6), shards=4)
    with pytest.raises(InputError, match="shards"):
        make_irl(toy(), tiny(num_envs=6), 0)


def test_lanes_refuse_an_algorithm_that_needs_more_devices():
    algorithm = Algorithm(lambda key, _: {"x": jnp.zeros(())}, lambda s, h, d: (s, {}), lambda *_: None, shards=4)
    with pytest.raises(InputError, match=r"shards = 4, and there are 2 devices: build it with shards=2"):
        Lanes(algorithm, jax.random.split(jax.random.PRNGKey(0), 1), HParams())


@pytest.mark.parametrize(
    ("lanes", "devices", "expected"), [(2, [4, 4], 4), (3, [4, 4], 2), (2, [4, 3], 2), (2, [1, 4], 1), (5, [4, 4], 1)]
)
def test_the_devices_of_a_lane_are_of_one_process(monkeypatch, lanes, devices, expected):
    monkeypatch.setattr(processes, "current", lambda: processes.Team([], devices))
    assert shards_for(lanes, of_size(64)) == expected


def test_a_process_with_too_few_devices_is_refused(monkeypatch):
    algorithm = Algorithm(lambda key, _: {"x": jnp.zeros(())}, lambda s, h, d: (s, {}), lambda *_: None, shards=2)
    monkeypatch.setattr(processes, "current", lambda: processes.Team([], [4, 1]))
    with pytest.raises(InputError, match="shards = 2, and there are 1 devices"):
        Lanes(algorithm, jax.random.split(jax.random.PRNGKey(0), 2), HParams())


@pytest.mark.parametrize(
    ("lanes", "num_envs", "steps", "expected"),
    [(1, 32, 200, 2), (1, 32, 199, 1), (1, 33, 200, 1), (2, 32, 200, 1), (5, 32, 200, 1), (1, 30, 400, 1)],
)
def test_a_lane_gets_several_devices_only_if_they_would_be_idle_and_have_enough_to_do(lanes, num_envs, steps, expected):
    assert shards_for(lanes, of_size(num_envs, steps)) == expected
