"""The ring of past samples."""

import jax
import numpy as np
import pytest

from eairl_jax import history


@pytest.fixture
def filled(tiny, transitions):
    """A ring of three slots after `added` iterations; every reward of iteration i is i."""

    def make(added):
        ring = history.empty(4, 2, tiny(history_length=2))
        for i in range(1, added + 1):
            x = transitions(seed=i)
            ring = history.add(ring, x._replace(reward=np.full_like(x.reward, i)))
        return ring

    return make


@pytest.mark.parametrize(("added", "kept"), [(1, {1}), (2, {1, 2}), (3, {1, 2, 3}), (5, {3, 4, 5}), (6, {4, 5, 6})])
def test_keeps_the_newest_and_draws_evenly_from_what_is_filled(filled, added, kept):
    drawn = history.draw(jax.random.PRNGKey(0), filled(added), 5, 600)
    assert drawn.obs.shape == (5, 600, 4)
    values, counts = np.unique(drawn.reward, return_counts=True)
    assert set(values) == kept
    np.testing.assert_allclose(counts / 3000, 1 / len(kept), atol=0.05)


def test_draws_whole_transitions_and_every_one_of_them(filled, transitions):
    drawn = history.draw(jax.random.PRNGKey(0), filled(1), 1, 1000)
    x = transitions(seed=1)
    rows = {tuple(np.concatenate([o, a, s, [p]])) for o, a, s, p in zip(
        x.obs.reshape(-1, 4), x.action.reshape(-1, 2), x.next_obs.reshape(-1, 4), x.log_prob.reshape(-1), strict=True
    )}  # fmt: skip
    got = np.concatenate([drawn.obs[0], drawn.action[0], drawn.next_obs[0], drawn.log_prob[0][:, None]], axis=-1)
    assert {tuple(row) for row in got} == rows
