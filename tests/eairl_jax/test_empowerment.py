"""Empowerment: l_I by hand, and Phi against mutual informations and channel capacities that are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eairl_jax import HParams, Transition, empowerment, train_state
from eairl_jax.gaussian import Gaussian
from eairl_jax.methods import with_method_defaults

# p(s'|s,a): a row an action. The last one is the symmetric channel, the others have no closed form.
CHANNELS = np.array(
    [
        [[0.90, 0.05, 0.05], [0.10, 0.80, 0.10], [0.25, 0.05, 0.70]],
        [[0.98, 0.01, 0.01], [0.20, 0.60, 0.20], [0.02, 0.08, 0.90]],
        [[0.60, 0.20, 0.20], [0.20, 0.60, 0.20], [0.20, 0.20, 0.60]],
    ]
)


def capacity(channel):
    """Blahut and Arimoto's algorithm: `(nats, capacity-achieving p(a))` of one channel `[a, s']`."""
    p = np.full(len(channel), 1 / len(channel))
    for _ in range(10_000):
        divergence = (channel * np.log(channel / (p @ channel))).sum(axis=1)
        z = p @ np.exp(divergence)
        p = p * np.exp(divergence) / z
    return np.log(z), p


def test_the_exact_capacity_of_the_symmetric_channel_is_the_closed_form():
    expected = np.log(3) + 0.6 * np.log(0.6) + 0.4 * np.log(0.2)
    np.testing.assert_allclose(capacity(CHANNELS[2])[0], expected, rtol=1e-9)


def test_phi_becomes_the_channels_capacity_and_pi_achieves_it():
    """Tables of log pi, Phi and log q, by l_q and l_I on exact expectations, beta = 1."""
    channels = jnp.asarray(CHANNELS, jnp.float32)
    index = jnp.broadcast_to(jnp.arange(3)[None, :, None], (3, 3, 3))  # the action of each (s, a, s')

    def update(fitted, _):
        inverse, tables = fitted
        pi = jax.nn.softmax(tables.params["pi"])
        joint = jax.lax.stop_gradient(pi[:, :, None] * channels)

        def l_q(logits):
            return -(joint * jax.nn.log_softmax(logits, axis=1)).sum()

        inverse = train_state.adam_step(inverse, jax.grad(l_q)(inverse.params), 0.02)
        log_q = jax.nn.log_softmax(inverse.params, axis=1)

        def l_i(tables):
            log_pi = jax.nn.log_softmax(tables["pi"])[:, :, None]
            phi = tables["phi"][:, None, None]
            return (joint * empowerment.l_i(log_q, log_pi, phi, 1.0, 2)).sum()

        return (inverse, train_state.adam_step(tables, jax.grad(l_i)(tables.params), 0.02)), None

    start = (
        train_state.init(0.1 * jnp.sin(1.0 + index + jnp.arange(3))),
        train_state.init({"pi": jnp.zeros((3, 3)), "phi": jnp.zeros(3)}),
    )
    (_, tables), _ = jax.jit(lambda s: jax.lax.scan(update, s, length=3000))(start)
    for s, channel in enumerate(CHANNELS):
        nats, p = capacity(channel)
        np.testing.assert_allclose(tables.params["phi"][s], nats, rtol=0.03)
        np.testing.assert_allclose(jax.nn.softmax(tables.params["pi"][s]), p, atol=0.03)


@pytest.fixture
def gaussian_channel():
    """s' = s + a + noise, with deviations 0.6 of a and 0.8 of the noise: `(transitions, pi's std, noise's std)`."""
    rng, shape = np.random.default_rng(0), (200, 40)
    s, a, noise = (jnp.asarray(std * rng.normal(size=(*shape, 1)), jnp.float32) for std in (1.0, 0.6, 0.8))
    log_prob = Gaussian(jnp.zeros(a.shape), jnp.full(a.shape, np.log(0.6))).log_prob(a)
    zero = jnp.zeros(shape)
    return Transition(s, a, log_prob, s + a + noise, zero, zero, zero), 0.6, 0.8


@pytest.mark.parametrize(("loss", "actions"), [("likelihood", "stored"), ("mse", "stored"), ("mse", "resampled")])
def test_q_becomes_the_posterior_and_phi_the_mutual_information(tiny, gaussian_channel, loss, actions):
    """E[log q(a|s,s') - log pi(a|s)] = I(A; S'|S) for the true posterior; less by a known amount if q's std is off.

    With actions drawn from q and from pi it is the difference of their entropies.
    """
    batch, prior, noise = gaussian_channel
    config = tiny(policy_hidden=(16, 16), activation="tanh", policy_activation="tanh", empowerment_updates=600,
                  empowerment_batch=512, inverse_loss=loss, l_i_actions=actions)  # fmt: skip
    state = empowerment.init(jax.random.PRNGKey(0), 1, 1, config)

    def pi(obs):
        return Gaussian(jnp.zeros(obs.shape), jnp.full(obs.shape, np.log(prior)))

    fit = jax.jit(lambda key, s, hparams: empowerment.fit(key, s, batch, pi, hparams, config))
    for i, lr in enumerate((0.01, 0.003, 0.001)):
        state, metrics = fit(jax.random.PRNGKey(i), state, HParams(inverse_lr=lr, phi_lr=lr))
    gain, posterior = prior**2 / (prior**2 + noise**2), prior * noise / np.hypot(prior, noise)
    q = empowerment.q_distribution(state.inverse.params, batch, config)
    inside = (np.abs(batch.obs) < 1.5) & (np.abs(batch.next_obs - batch.obs) < 1.5)
    expected_mean = gain * (batch.next_obs - batch.obs)
    np.testing.assert_allclose(q.mean[inside], expected_mean[inside], atol=0.12)
    std = float(np.exp(q.log_std).mean())
    if loss == "likelihood":
        np.testing.assert_allclose(std, posterior, rtol=0.05)
    else:  # the std stays as it began
        np.testing.assert_array_equal(state.inverse.params["params"]["raw_log_std"], [0.0])
        np.testing.assert_allclose(metrics["l_q"], posterior**2, rtol=0.1)
    # E log N(a; posterior mean, std) - E log pi, with E (a - posterior mean)^2 = posterior^2.
    information = np.log(prior / std) + (0.5 * (1 - (posterior / std) ** 2) if actions == "stored" else 0.0)
    phi = empowerment.phi(state.phi.params, batch.obs, config)
    np.testing.assert_allclose(phi[inside[..., 0]].mean(), information, atol=0.04)
    np.testing.assert_allclose(metrics["empowerment"], information, atol=0.05)


@pytest.fixture
def own_terms(tiny, transitions):
    """`terms` of 3000 transitions as `(terms, q, pi, transitions)`, and their dependence on q's and pi's parameters."""
    x = jax.tree.map(jnp.asarray, transitions(length=3000, num_envs=1))
    key = jax.random.PRNGKey(0)

    def make(actions):
        config = with_method_defaults(tiny(l_i_actions=actions))
        inverse = empowerment.init(key, 4, 2, config).inverse.params
        shift = {"mean": jnp.array([0.4, -0.2]), "log_std": jnp.array([-1.0, 0.3])}

        def terms(inverse, shift):
            pi = Gaussian(*(jnp.broadcast_to(shift[name], x.action.shape) for name in ("mean", "log_std")))
            return empowerment.terms(key, inverse, pi, x, config), pi

        own, pi = terms(inverse, shift)
        slope = jax.grad(lambda *given: sum(leaf.sum() for leaf in terms(*given)[0]), argnums=(0, 1))(inverse, shift)
        return own, empowerment.q_distribution(inverse, x, config), pi, x, slope

    return make


def test_terms_of_the_actions_taken_are_their_own_log_probabilities(own_terms):
    own, q, _, x, _ = own_terms("stored")
    np.testing.assert_array_equal(own.action, x.action)
    np.testing.assert_array_equal(own.log_prob, x.log_prob)
    by_hand = stats.norm.logpdf(x.action, q.mean, np.exp(q.log_std)).sum(axis=-1)
    np.testing.assert_allclose(own.log_q, by_hand, rtol=1e-4, atol=1e-4)


def test_terms_of_actions_drawn_are_one_of_q_and_another_of_pi(own_terms):
    own, q, pi, x, slope = own_terms("resampled")
    standard = (own.action - pi.mean) / np.exp(pi.log_std)
    np.testing.assert_allclose(standard.mean(axis=(0, 1)), [0.0, 0.0], atol=0.06)
    np.testing.assert_allclose(standard.std(axis=(0, 1)), [1.0, 1.0], atol=0.05)
    np.testing.assert_allclose(
        own.log_prob, stats.norm.logpdf(own.action, pi.mean, np.exp(pi.log_std)).sum(axis=-1), rtol=1e-4, atol=1e-4
    )
    # The density at a draw of the distribution itself: -2 (log q + sum log std + log 2 pi) is a chi^2 of 2.
    chi2 = -2 * (own.log_q + q.log_std.sum(axis=-1) + np.log(2 * np.pi)).ravel()
    assert stats.kstest(chi2, stats.chi2(2).cdf).pvalue > 0.01
    # Neither draw knows of the other, nor of the action taken.
    for other in (own.log_prob, q.log_prob(x.action), q.log_prob(own.action)):
        assert abs(np.corrcoef(own.log_q.ravel(), other.ravel())[0, 1]) < 0.06
    assert abs(np.corrcoef(standard[:, 0].T, np.asarray(x.action)[:, 0].T)[:2, 2:]).max() < 0.06
    # Constants of Phi's target: nothing flows into q or pi through it.
    for leaf in jax.tree.leaves(slope):
        np.testing.assert_array_equal(leaf, np.zeros(leaf.shape))


@pytest.mark.parametrize(
    ("log_q", "log_pi", "phi", "beta", "power", "expected"),
    [
        (-1.0, -2.0, 0.5, 1.0, 1, 0.5),
        (-1.0, -2.0, 0.5, 1.0, 2, 0.25),
        (-1.0, -2.0, 3.0, 1.0, 1, 2.0),
        (-1.0, -2.0, 3.0, 1.0, 2, 4.0),
        (-4.0, -1.0, 0.0, 0.5, 1, 1.0),
        (-4.0, -1.0, 2.0, 0.5, 2, 9.0),
    ],
)
def test_l_i_by_hand(log_q, log_pi, phi, beta, power, expected):
    np.testing.assert_allclose(empowerment.l_i(*map(jnp.asarray, (log_q, log_pi, phi)), beta, power), expected)


@pytest.mark.parametrize("power", [1, 2])
def test_l_i_is_zero_where_phi_is_beta_log_q_less_log_pi(power):
    log_q, log_pi = np.random.default_rng(0).normal(size=(2, 50))
    np.testing.assert_allclose(empowerment.l_i(log_q, log_pi, 0.3 * log_q - log_pi, 0.3, power), 0.0, atol=1e-6)
    assert (empowerment.l_i(log_q, log_pi, 0.3 * log_q - log_pi + 0.1, 0.3, power) > 0.005).all()


@pytest.mark.parametrize(("loss", "expected"), [("mse", 0.25 + 4.0), ("likelihood", 0.5 * 4.25 + np.log(2 * np.pi))])
def test_l_q_by_hand(loss, expected):
    q = Gaussian(jnp.array([[1.0, 0.0]]), jnp.zeros((1, 2)))
    np.testing.assert_allclose(empowerment.l_q(q, jnp.array([[0.5, 2.0]]), loss), [expected], rtol=1e-6)


@pytest.mark.parametrize("interval", [1, 3])
def test_the_slow_copy_follows_every_so_many_iterations(tiny, interval):
    config = tiny(phi_sync_interval=interval)
    state = empowerment.init(jax.random.PRNGKey(0), 4, 2, config)
    jax.tree.map(np.testing.assert_array_equal, state.phi_target, state.phi.params)
    copied = []
    for iteration in range(1, 8):
        moved = jax.tree.map(lambda p, i=iteration: p + i, state.phi.params)
        state = state.replace(phi=state.phi.replace(params=moved))
        state = empowerment.sync(state, jnp.asarray(iteration), config)
        slow, new = (p["params"]["MLP_0"]["Dense_0"]["bias"][0] for p in (state.phi_target, moved))
        copied.append(bool(slow == new))
    assert copied == [i % interval == 0 for i in range(1, 8)]
