"""ActorCritic: the bounds of the std, and what the layers are."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import nets

BOUNDS = [(-5.0, -0.5, 0.5), (-2.0, -0.5, 0.5), (-1.0, 0.0, 1.0), (-20.0, 0.0, 2.0)]


@pytest.fixture
def log_std(tiny):
    """log_std as a function of its free parameter, for bounds (low, first, high)."""

    def make(low, first, high):
        config = tiny(log_std_min=low, log_std_init=first, log_std_max=high)
        return lambda raw: nets.GaussianMLP(2, config).log_std(jnp.asarray(raw))

    return make


@pytest.mark.parametrize("bounds", BOUNDS, ids=str)
def test_the_std_never_leaves_its_bounds_and_rises_throughout(log_std, bounds):
    values = np.asarray(log_std(*bounds)(np.linspace(-60, 60, 4001)))
    assert values.min() >= bounds[0] - 1e-5
    assert values.max() <= bounds[2] + 1e-5
    np.testing.assert_allclose(values[[0, -1]], bounds[::2], atol=1e-3)
    assert (np.diff(values) >= 0).all()


@pytest.mark.parametrize("bounds", BOUNDS, ids=str)
def test_the_std_begins_where_it_should_and_can_move(log_std, bounds):
    np.testing.assert_allclose(log_std(*bounds)(0.0), bounds[1], atol=1e-5)
    assert 0.2 < jax.grad(log_std(*bounds))(0.0) < 1.5


@pytest.mark.parametrize("state_dependent", [False, True])
def test_the_first_policy_acts_around_0_with_the_first_std(tiny, state_dependent):
    config = tiny(state_dependent_std=state_dependent, log_std_init=-0.5)
    net, obs = nets.GaussianMLP(2, config), jnp.asarray(np.random.default_rng(0).normal(size=(5, 3, 4)))
    params = net.init(jax.random.PRNGKey(0), obs)
    pi = net.apply(params, obs)
    assert pi.mean.shape == pi.log_std.shape == (5, 3, 2)
    assert np.abs(pi.mean).max() < 0.1
    np.testing.assert_allclose(pi.log_std, np.full((5, 3, 2), -0.5), atol=0.1)
    moves = np.ptp(np.asarray(pi.log_std).reshape(-1, 2), axis=0) > 0
    assert (moves == state_dependent).all()


@pytest.mark.parametrize(("make", "setting"), [
    (nets.scalar, "layer_norm"), (nets.value, "layer_norm"),
    (lambda config: nets.GaussianMLP(2, config), "policy_layer_norm"),
])  # fmt: skip
def test_a_normalised_layer_ignores_the_scale_of_its_input(tiny, make, setting):
    """With inputs that add up to 0 and no bias, twice the input is the same normalised layer."""
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(6, 4)))
    for is_on in (False, True):
        net = make(tiny(**{setting: is_on}))
        params = net.init(jax.random.PRNGKey(0), obs)
        assert ("LayerNorm_0" in params["params"]["MLP_0"]) == is_on
        out, doubled = (np.asarray(getattr(x, "mean", x)) if hasattr(x, "log_std") else np.asarray(x)
                        for x in (net.apply(params, obs), net.apply(params, 2 * obs)))  # fmt: skip
        assert np.allclose(out, doubled, rtol=1e-3, atol=1e-6) == is_on


@pytest.mark.parametrize(("make", "widths"), [(nets.scalar, (5, 3)), (nets.value, (7,))])
def test_a_scalar_network_is_the_perceptron_that_its_parameters_say(tiny, mlp, make, widths):
    net, rng = make(tiny(hidden=(5, 3), value_hidden=(7,))), np.random.default_rng(0)
    a, b = rng.normal(size=(6, 4)), rng.normal(size=(6, 2))
    params = net.init(jax.random.PRNGKey(0), a, b)
    kernels = [layer["kernel"].shape for _, layer in sorted(params["params"]["MLP_0"].items())]
    sizes = (6, *widths, 1)
    assert kernels == list(itertools.pairwise(sizes))
    np.testing.assert_allclose(net.apply(params, jnp.asarray(a), jnp.asarray(b)), mlp(params, a, b)[:, 0], rtol=1e-4)
