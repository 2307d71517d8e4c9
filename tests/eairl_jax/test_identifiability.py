"""What experts leave open about a reward: angles that are known, and predictions that exact transfers confirm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax import InputError, identifiability

GAMMA = 0.8


def random_task(rng, states=4, actions=2):
    return rng.dirichlet(np.ones(states), (states, actions))


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9])
def test_the_angle_between_a_task_and_itself_with_swapped_actions(gamma):
    """Two states; one action stays, the other changes the state. By hand the second angle is 2 arctan gamma."""
    stay, change = np.eye(2), np.eye(2)[::-1]
    task = np.stack([stay, change], axis=1)
    angles = identifiability.principal_angles(task, task[:, ::-1], gamma)
    np.testing.assert_allclose(angles, [0.0, 2 * np.arctan(gamma)], atol=1e-7)


def test_a_shaping_changes_no_best_policy_and_another_change_does():
    rng = np.random.default_rng(0)
    task, reward, v = random_task(rng), rng.normal(size=(4, 2)), rng.normal(size=4)
    best = identifiability.best_policy(reward, task, GAMMA)
    np.testing.assert_allclose(best.sum(axis=1), 1.0, rtol=1e-12)
    shaped = reward + (identifiability.shaping_operator(task, GAMMA) @ v).reshape(4, 2)
    np.testing.assert_allclose(identifiability.best_policy(shaped, task, GAMMA), best, rtol=1e-10)
    assert identifiability.regret(best, reward, task, GAMMA) == pytest.approx(0.0, abs=1e-12)
    other = identifiability.best_policy(reward + rng.normal(size=(4, 2)), task, GAMMA)
    assert identifiability.regret(other, reward, task, GAMMA) > 0.01


def test_the_regret_is_the_discounted_loss_of_reward_and_entropy():
    """One state: the best policy is a softmax, and a fixed policy gains its reward and entropy at every step."""
    reward, task, policy = np.array([[1.0, 0.0]]), np.ones((1, 2, 1)), np.array([[0.5, 0.5]])
    expected = (np.log(np.e + 1.0) - (0.5 + np.log(2.0))) / (1 - GAMMA)
    assert identifiability.regret(policy, reward, task, GAMMA) == pytest.approx(expected)


def test_an_explaining_reward_has_the_experts_of_all_sources():
    rng = np.random.default_rng(1)
    truth, sources = rng.normal(size=(4, 2)), [random_task(rng), random_task(rng)]
    experts = [identifiability.best_policy(truth, source, GAMMA) for source in sources]
    reward = identifiability.explaining_reward(experts, sources, GAMMA)
    for expert, source in zip(experts, sources, strict=True):
        np.testing.assert_allclose(identifiability.best_policy(reward, source, GAMMA), expert, rtol=1e-7)
    # Two such sources leave a constant open and nothing else.
    assert identifiability.unidentified(sources, GAMMA).shape == (8, 1)
    np.testing.assert_allclose(reward - truth, (reward - truth).mean(), atol=1e-7)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    states=st.integers(2, 5),
    changed=st.lists(st.integers(0, 4), max_size=5, unique=True),
    target_changed=st.lists(st.integers(0, 4), max_size=5, unique=True),
    rooms=st.booleans(),
)
def test_the_predicted_and_the_measured_transfer_agree(seed, states, changed, target_changed, rooms):
    """Two sources and a target: one task with new transitions from some states, perhaps of two closed rooms."""
    rng = np.random.default_rng(seed)

    def draw():
        task = random_task(rng, states)
        room = np.arange(states) % 2
        task = task * (room[:, None] == room)[:, None] if rooms else task
        return task / task.sum(axis=-1, keepdims=True)

    def with_changes(task, places):
        task, new, places = task.copy(), draw(), [place % states for place in places]
        task[places] = new[places]
        return task

    first = draw()
    sources, target = [first, with_changes(first, changed)], with_changes(first, target_changed)
    truth = rng.normal(size=(states, 2))
    experts = [identifiability.best_policy(truth, source, GAMMA) for source in sources]
    left_open = identifiability.unidentified(sources, GAMMA)
    reward = identifiability.explaining_reward(experts, sources, GAMMA)
    reward = reward + (left_open @ rng.normal(size=left_open.shape[1])).reshape(reward.shape)
    lost = identifiability.regret(identifiability.best_policy(reward, target, GAMMA), truth, target, GAMMA)
    assert (lost < 1e-10) == identifiability.transfers(sources, target, GAMMA), lost


@pytest.mark.parametrize(
    "transitions, gamma, message",
    [
        (np.ones((2, 2, 3)) / 3, 0.9, r"the shape \(2, 2, 3\): expected \[S, A, S\]"),
        (np.ones((2, 2)), 0.9, r"the shape \(2, 2\)"),
        (np.ones((2, 2, 2)), 0.9, "a distribution"),
        (np.full((2, 1, 2), np.nan), 0.9, "a distribution"),
        (np.ones((1, 1, 1)), 1.0, "gamma = 1.0: expected at least 0 and below 1"),
    ],
)
def test_what_is_no_task_is_refused(transitions, gamma, message):
    for function in (
        lambda: identifiability.unidentified([transitions], gamma),
        lambda: identifiability.best_policy(np.zeros((2, 2)), transitions, gamma),
    ):
        with pytest.raises(InputError, match=message):
            function()
