"""The normaliser against NumPy."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax import InputError, normalize
from eairl_jax.normalize import ObsStats


@settings(max_examples=15)
@given(sizes=st.lists(st.integers(1, 9), min_size=1, max_size=4), seed=st.integers(0, 2**31))
def test_merged_batches_equal_the_concatenation(sizes, seed):
    rng = np.random.default_rng(seed)
    batches = [rng.normal(5.0 * i, 1.0 + i, size=(size, 2, 3)) for i, size in enumerate(sizes)]
    stats = normalize.initial(SimpleNamespace(observation_size=3), "running")
    for batch in batches:
        stats = normalize.update(stats, jnp.asarray(batch, jnp.float32))
    everything = np.concatenate(batches).reshape(-1, 3)
    np.testing.assert_allclose(stats.mean, everything.mean(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(stats.var, everything.var(axis=0), rtol=1e-3, atol=1e-4)
    assert stats.count == len(everything)


@pytest.mark.parametrize(
    ("mode", "declares", "mean", "var"),
    [
        ("task", True, [1.0, -2.0], [9.0, 0.25]),
        ("task", False, [0.0, 0.0], [1.0, 1.0]),
        ("running", True, [0.0, 0.0], [1.0, 1.0]),
        ("none", True, [0.0, 0.0], [1.0, 1.0]),
    ],
)
def test_initial_statistics(mode, declares, mean, var):
    scale = {"obs_mean": (1.0, -2.0), "obs_std": (3.0, 0.5)} if declares else {}
    stats = normalize.initial(SimpleNamespace(observation_size=2, **scale), mode)
    np.testing.assert_allclose(stats.mean, mean)
    np.testing.assert_allclose(stats.var, var)
    assert stats.count == 0


def test_normalize_centres_scales_and_clips():
    stats = ObsStats(jnp.array([1.0, 0.0]), jnp.array([4.0, 0.25]), jnp.zeros(()))
    obs = jnp.array([[3.0, 0.5], [-1.0, 99.0]])
    np.testing.assert_allclose(normalize.normalize(stats, obs), [[1.0, 1.0], [-1.0, 10.0]], rtol=1e-5)


@pytest.mark.parametrize("size", [{"state": 3}, (3, 3)])
def test_observations_that_are_not_flat_are_refused(size):
    with pytest.raises(InputError, match="flat vector"):
        normalize.initial(SimpleNamespace(observation_size=size), "task")
