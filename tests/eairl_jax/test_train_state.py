"""Adam against its definition, and how minibatches are drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import train_state


def test_descend_is_adam():
    rng = np.random.default_rng(0)
    gradients = rng.normal(size=(6, 3))
    x, m, v = np.array([1.0, -2.0, 0.5]), np.zeros(3), np.zeros(3)
    fitted = train_state.init({"x": jnp.asarray(x)})
    for t, gradient in enumerate(gradients, 1):
        fitted = train_state.adam_step(fitted, {"x": jnp.asarray(gradient)}, 0.1)
        m, v = 0.9 * m + 0.1 * gradient, 0.999 * v + 0.001 * gradient**2
        x = x - 0.1 * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
        np.testing.assert_allclose(fitted.params["x"], x, rtol=1e-5)


@pytest.mark.parametrize(("bound", "norm"), [(1.0, 1.0), (20.0, 13.0)])
def test_clip_norm_bounds_the_global_norm_and_keeps_the_direction(bound, norm):
    clipped = train_state.clip_norm({"a": jnp.array([3.0, 4.0]), "b": jnp.array(12.0)}, bound)
    np.testing.assert_allclose(clipped["a"], np.array([3.0, 4.0]) * norm / 13, rtol=1e-5)
    np.testing.assert_allclose(clipped["b"], 12.0 * norm / 13, rtol=1e-5)


def test_fit_descends_once_on_each_minibatch_and_averages_the_metrics():
    minibatches = jnp.array([[1.0, 3.0], [10.0, 10.0], [-5.0, 5.0]])

    def loss(x, minibatch):
        return jnp.mean((x - minibatch) ** 2) / 2, {"mean": minibatch.mean(), "x": x}

    fitted, metrics = train_state.fit(train_state.init(jnp.array(0.0)), loss, minibatches, 0.5)
    by_hand, visited = train_state.init(jnp.array(0.0)), []
    for mean in (2.0, 10.0, 0.0):
        visited.append(by_hand.params)
        by_hand = train_state.adam_step(by_hand, by_hand.params - mean, 0.5)
    np.testing.assert_allclose(fitted.params, by_hand.params, rtol=1e-5)
    np.testing.assert_allclose(metrics["mean"], 4.0)
    np.testing.assert_allclose(metrics["x"], np.mean(visited), rtol=1e-5)


def test_draw_takes_whole_samples_and_all_of_them():
    # NumPy arrays, as they come from a file: drawn from inside a compiled function all the same.
    data = {"x": np.arange(12.0).reshape(3, 4), "y": np.arange(24.0).reshape(3, 4, 2)}
    drawn = jax.jit(lambda key: train_state.draw_minibatches(key, data, 2, 5, 200))(jax.random.PRNGKey(0))
    assert (drawn["x"].shape, drawn["y"].shape) == ((5, 200), (5, 200, 2))
    np.testing.assert_array_equal(drawn["y"][..., 0], 2 * drawn["x"])
    np.testing.assert_array_equal(drawn["y"][..., 1], 2 * drawn["x"] + 1)
    _, counts = np.unique(drawn["x"], return_counts=True)
    assert len(counts) == 12
    assert counts.min() > 40


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("length", [1, 2, 6])
def test_segments_are_the_consecutive_steps_of_one_environment(length, num_envs):
    """Two iterations of six steps: every segment once, none across iterations or environments."""
    layout = np.arange(2 * 6 * num_envs).reshape(2, 6, num_envs)
    count = layout.size // length
    rows = np.asarray(train_state.segment_indices(jnp.arange(count), length, num_envs))
    by_hand = [layout[i, t : t + length, n] for i in range(2) for t in range(0, 6, length) for n in range(num_envs)]
    np.testing.assert_array_equal(rows, by_hand)
    if length == 1:
        np.testing.assert_array_equal(rows[:, 0], np.arange(count))
    batch = train_state.segment_indices(jnp.array([[0, 1], [count - 1, 0]]), length, num_envs)
    np.testing.assert_array_equal(batch, rows[[[0, 1], [count - 1, 0]]])


def test_rows_are_whole_samples_of_the_flattened_axes():
    data = {"x": np.arange(12.0).reshape(2, 3, 2), "y": np.arange(24.0).reshape(2, 3, 2, 2)}
    index = np.array([[0, 11, 5], [7, 7, 2]])
    taken = train_state.take_samples(data, 3, index)
    where = np.unravel_index(index, (2, 3, 2))
    for name in data:
        np.testing.assert_array_equal(taken[name], data[name][where])
