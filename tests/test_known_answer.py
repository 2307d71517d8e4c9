"""AIRL(s) against the answer: a small board whose reward, expert and best policies are exact, by dynamic programming.

The library's discriminator plays the adversarial game against the policy's best answer: every round the soft-optimal
policy of f, which maximises `sum gamma^t (f - log pi)`, in place of a policy gradient. Observations and actions are
one-hot. The truth comes twice: the reward that made the expert, and exact maximum-entropy IRL of a table.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from eairl_jax import Config, HParams, discriminator, methods, train_state

GAMMA, SIDE = 0.9, 4
STATES = SIDE**2
ROW, COLUMN = np.divmod(np.arange(STATES), SIDE)
COLOUR = (ROW + COLUMN) % 2
TRUE = np.random.default_rng(0).normal(0, 0.7, STATES) + 0.7 * COLOUR
ROUNDS, UPDATES, BATCH, LR = 200, 10, 256, 0.02


def board(stays):
    """The state that each action leads to, `[states, actions]`: four moves on a torus, and perhaps staying."""
    moves = ((0, 1), (0, -1), (1, 0), (-1, 0), (0, 0))[: 5 if stays else 4]
    return np.stack([(ROW + i) % SIDE * SIDE + (COLUMN + j) % SIDE for i, j in moves], axis=1)


def linked(leads_to):
    """Which states are linked, `[states, states]`: one state leads to both in a step, and so on (Fu et al. 2018)."""
    reach = np.eye(STATES)[leads_to].sum(axis=1)
    return np.linalg.matrix_power(reach.T @ reach, STATES) > 0


def centred(reward, leads_to):
    """A reward `[states]` less its mean over the states that are linked."""
    links = linked(leads_to)
    return reward - links @ reward / links.sum(axis=1)


def soft_optimal(f, leads_to):
    """`log pi`, `[states, actions]`, of the policy that maximises `sum gamma^t (f(s, a) - log pi)`."""
    value = np.zeros(STATES)
    for _ in range(200):
        value = np.logaddexp.reduce(f + GAMMA * value[leads_to], axis=1)
    q = f + GAMMA * value[leads_to]
    return q - np.logaddexp.reduce(q, axis=1, keepdims=True)


def occupancy(log_pi, leads_to):
    """Share of its discounted time that a policy is in a state and takes an action there, `[states, actions]`."""
    chain = np.einsum("sa,sat->ts", np.exp(log_pi), np.eye(STATES)[leads_to])
    start = np.full(STATES, 1 / STATES)
    return (1 - GAMMA) * np.linalg.solve(np.eye(STATES) - GAMMA * chain, start)[:, None] * np.exp(log_pi)


def expert(leads_to):
    """The occupancy of the true reward's soft-optimal policy."""
    return occupancy(soft_optimal(TRUE[:, None], leads_to), leads_to)


def max_ent_irl(leads_to):
    """The reward `[states]` under which the expert's actions are likeliest; the gradient: what it visits too often."""

    def loss(reward):
        log_pi = soft_optimal(reward[:, None], leads_to)
        return -np.sum(expert_share * log_pi), (occupancy(log_pi, leads_to) - expert_share).sum(axis=1)

    expert_share = expert(leads_to)
    return minimize(loss, np.zeros(STATES), jac=True, options={"gtol": 1e-7}).x


@functools.cache
def adversarial(stays, **changes):
    """`(reward [states, actions], total variation from the policy's occupancy to the expert's)`, before and after."""
    leads_to, rng, config = (
        board(stays),
        np.random.default_rng(0),
        methods.with_method_defaults(Config(hidden=(32,), **changes)),
    )
    state, action = (index.ravel() for index in np.indices(leads_to.shape))
    one_hot, none = np.eye(STATES), np.zeros(state.size)
    pairs = discriminator.Samples(
        one_hot[state], np.eye(leads_to.shape[1])[action], one_hot[leads_to.ravel()], none, none, none
    )  # fmt: skip

    @jax.jit
    def f(params):  # the logit, if log pi is 0
        return discriminator.logit_expert_high(params, pairs, GAMMA, config).reshape(leads_to.shape)

    @jax.jit
    def fit(fitted, expert_rows, policy_rows, log_prob, lr):
        scored = pairs._replace(log_prob=log_prob)
        samples = (train_state.take_samples(scored, 1, rows) for rows in (expert_rows, policy_rows))
        return discriminator.fit(fitted, *samples, HParams(gamma=GAMMA, discriminator_lr=lr), config)[0]

    def draw(share):  # evenly spaced quantiles, shifted at random
        at = (np.arange(BATCH) + rng.random((UPDATES, 1))) / BATCH
        return np.searchsorted(np.cumsum(share)[:-1], at)[..., None]

    def found(fitted, log_pi):
        reward = discriminator.reward(fitted.params, pairs.obs, pairs.action, config)
        distance = 0.5 * np.abs(occupancy(log_pi, leads_to) - expert(leads_to)).sum()
        return np.asarray(reward, np.float64).reshape(leads_to.shape), distance

    fitted = train_state.init(discriminator.init(jax.random.PRNGKey(0), STATES, leads_to.shape[1], config))
    log_pi = soft_optimal(np.asarray(f(fitted.params), np.float64), leads_to)
    before = found(fitted, log_pi)
    for i in range(ROUNDS):
        drawn = draw(expert(leads_to)), draw(occupancy(log_pi, leads_to))
        fitted = fit(fitted, *drawn, jnp.asarray(log_pi.ravel()), LR * (1 - i / ROUNDS))
        log_pi = soft_optimal(np.asarray(f(fitted.params), np.float64), leads_to)
    return before, found(fitted, log_pi)


@pytest.mark.parametrize("stays", [True, False])
def test_an_expert_tells_a_reward_up_to_a_constant_on_linked_states(stays):
    """Without staying every step changes the colour: no expert shows what a colour is worth."""
    leads_to = board(stays)
    np.testing.assert_array_equal(linked(leads_to), stays | (COLOUR[:, None] == COLOUR))
    shifted, policy = (soft_optimal((TRUE + COLOUR * bonus)[:, None], leads_to) for bonus in (1.0, 0.0))
    assert (np.abs(shifted - policy).max() > 0.1) == stays
    reference = max_ent_irl(leads_to)
    np.testing.assert_allclose(centred(reference, leads_to), centred(TRUE, leads_to), atol=1e-4)
    assert (np.corrcoef(reference, TRUE)[0, 1] > 0.99) == stays


@pytest.mark.parametrize("stays", [True, False])
def test_airl_s_recovers_the_reward_and_the_expert(stays):
    leads_to = board(stays)
    (first, far), (reward, near) = adversarial(stays, method="airl_s")
    first, g = (centred(x[:, 0], leads_to) for x in (first, reward))
    for truth in (TRUE, max_ent_irl(leads_to)):
        truth = centred(truth, leads_to)
        assert np.corrcoef(g, truth)[0, 1] >= 0.99
        np.testing.assert_allclose(g, truth, atol=0.15)
        assert np.corrcoef(first, truth)[0, 1] < 0.5
    assert near < 0.01 < 0.3 < far


def test_a_reward_of_state_and_action_imitates_as_well_and_recovers_nothing():
    """Unshaped, it is the advantage: the expert's log pi, whatever the reward."""
    reward, near = adversarial(True, method="airl_sa", shaping="none")[1]
    assert near < 0.01
    log_pi = soft_optimal(TRUE[:, None], board(True))
    assert np.corrcoef(reward.ravel(), log_pi.ravel())[0, 1] >= 0.99
    assert np.corrcoef(reward.mean(axis=1), TRUE)[0, 1] < 0.5
    assert np.corrcoef(reward.ravel(), np.repeat(TRUE, 5))[0, 1] < 0.5
