"""The ring of past samples."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax import replay
from eairl_jax.methods import with_method_defaults


@pytest.fixture
def filled(tiny, transitions):
    """`(ring, transitions, config)` after `added` iterations; obs and next_obs tell (iteration, step, environment)."""

    def make(added, seed=0, **changes):
        config = with_method_defaults(tiny(history_length=2, **changes))
        ring = replay.empty(4, 2, config)
        for i in range(1, added + 1):
            x = transitions(seed=i, num_envs=config.num_envs)
            step, env = np.indices(x.reward.shape)
            told = np.stack([np.full_like(step, i), step, env, 0 * env], axis=-1).astype(np.float32)
            x = x._replace(obs=told, next_obs=told + np.eye(4, dtype=np.float32)[1], reward=np.full_like(x.reward, i))
            ring = replay.add(jax.random.fold_in(jax.random.PRNGKey(seed), i), ring, x, config)
        return ring, x, config

    return make


@pytest.fixture
def drawn():
    """`draw` of `[updates, batch, length]` as NumPy arrays."""

    def draw(filled, updates, batch, length=1):
        return jax.tree.map(
            np.asarray, replay.draw_segments(jax.random.PRNGKey(0), *filled[:2], (updates, batch, length), filled[2])
        )

    return draw


@pytest.mark.parametrize("length", [1, 3])
@pytest.mark.parametrize(("added", "kept"), [(1, {1}), (2, {1, 2}), (3, {1, 2, 3}), (5, {3, 4, 5}), (6, {4, 5, 6})])
def test_keeps_the_newest_and_draws_evenly_from_what_is_filled(filled, drawn, added, kept, length):
    x = drawn(filled(added), 5, 600, length)
    assert x.obs.shape == (5, 600, length, 4)
    values, counts = np.unique(x.reward[..., 0], return_counts=True)
    assert set(values) == kept
    np.testing.assert_allclose(counts / 3000, 1 / len(kept), atol=0.05)


def test_draws_whole_transitions_and_every_one_of_them(filled, drawn):
    _, x, _ = ring = filled(1)

    def rows(x):
        columns = (x.obs, x.action, x.next_obs, x.log_prob[..., None], x.terminated[..., None], x.truncated[..., None])
        return {tuple(row) for row in np.concatenate(columns, axis=-1).reshape(-1, 13)}

    assert rows(drawn(ring, 1, 1000)) == rows(x)


@pytest.mark.parametrize("mode", ["iterations", "paths"])
def test_a_segment_is_consecutive_steps_of_one_iteration_and_environment(filled, drawn, mode):
    told = drawn(filled(3, history=mode), 1, 2000, 3).obs[0]
    iteration, step, env = (told[..., i] for i in range(3))
    for same in (iteration, env):
        np.testing.assert_array_equal(same, np.broadcast_to(same[:, :1], same.shape))
    assert set(step[:, 0]) == {0, 3}
    np.testing.assert_array_equal(step, step[:, :1] + np.arange(3))


@pytest.mark.parametrize("added", [1, 4])
def test_paths_are_half_old_ones_of_half_the_environments_and_half_new_ones_of_all(filled, drawn, added):
    told = drawn(filled(added, history="paths"), 4, 800).obs[:, :, 0]
    old, new = told[:, :400].reshape(-1, 4), told[:, 400:].reshape(-1, 4)
    assert (set(new[:, 0]), set(new[:, 2])) == ({added}, {0, 1, 2, 3})
    iterations, counts = np.unique(old[:, 0], return_counts=True)
    assert (set(iterations), set(old[:, 2])) == (set(range(1, added + 1)), {0, 1})
    np.testing.assert_allclose(counts / 1600, 1 / added, atol=0.05)


@pytest.mark.parametrize("batch", [1, 5])
def test_an_odd_batch_of_paths_is_whole_and_its_odd_one_is_new(filled, drawn, batch):
    told = drawn(filled(60, history="paths"), 300, batch).obs[:, :, 0]
    assert told.shape == (300, batch, 4)
    share = (told[..., 0] == 60).mean(axis=0)
    assert (share[batch // 2 :] == 1).all()
    assert (share[: batch // 2] < 0.1).all()


@pytest.mark.parametrize("num_envs", [1, 2, 7, 32, 250])
def test_the_pool_holds_a_hundred_paths_or_the_one_batch_that_is_more(tiny, num_envs):
    ring = replay.empty(4, 2, tiny(num_envs=num_envs, history="paths")).transitions.obs
    slots, _, kept = ring.shape[:3]
    assert kept == max(1, num_envs // 2)
    assert 100 <= slots * kept < 100 + kept


def test_of_all_iterations_each_is_as_likely_to_be_kept_and_the_newest_is_half(filled, drawn):
    iterations, kept = 12, []
    for seed in range(60):
        ring, x, config = filled(iterations, seed, num_envs=1, history="all")
        kept.append(np.asarray(ring.transitions.reward[:, 0, 0]))
    assert all(len(set(slots)) == 3 for slots in kept)
    _, counts = np.unique(np.stack(kept), return_counts=True)
    assert len(counts) == iterations  # the first ones, too, long after
    assert stats.chisquare(counts).pvalue > 0.01
    told = drawn((ring, x, config), 4, 100).obs[:, :, 0, 0]
    assert set(told[:, 50:].ravel()) == {iterations}
    assert set(told[:, :50].ravel()) == set(kept[-1])


@pytest.mark.parametrize("history", ["iterations", "all"])
def test_an_absorbing_step_is_drawn_as_often_as_it_stands_for_steps(filled, history):
    """One of four environments is in the absorbing state, in every iteration."""
    ring, x, config = filled(2, history=history)

    def absorbed(steps):
        flag = jnp.zeros(steps.reward.shape).at[..., 1].set(1.0)
        return steps._replace(obs=jnp.concatenate([steps.obs, flag[..., None]], axis=-1))

    ring, x = ring.replace(transitions=absorbed(ring.transitions)), absorbed(x)
    config = dataclasses.replace(config, horizon="absorbing")
    drawn = replay.draw_segments(jax.random.PRNGKey(0), ring, x, (10, 400, 1), config, jnp.int32(7)).obs
    assert drawn.shape[:3] == (10, 400, 1)
    np.testing.assert_allclose(drawn[..., -1].mean(), 7 / (7 + 3), atol=0.03)
    told = np.asarray(drawn[..., :3].reshape(-1, 3))
    assert set(told[:, 0]) == {1, 2}  # a slot that is not filled yet is never drawn
    alive = told[np.asarray(drawn[..., -1]).ravel() == 0]
    _, counts = np.unique(alive[alive[:, 0] == 1], axis=0, return_counts=True)
    assert stats.chisquare(counts).pvalue > 0.001
