"""Which sources are enough? What experts leave open about a reward in finite tasks, exact and by linear algebra.

An expert that maximises reward and entropy (temperature 1) has the policy `log pi = Q - V`. So a source with the
transitions P shows its reward up to a shaping,

    r(s,a) = log pi(a|s) + (B v)(s,a),    (B v)(s,a) = v(s) - gamma E[v(s')],    v unknown.

Rewards that explain the experts of several sources differ by what lies in the image of every B. The best policies on
them in a target are the true reward's, if and only if the target's B has all that in its image too. Two sources leave
only constants open, and so are enough for every target, if `rank [B_0, B_1] = 2 S - 1`, that is, if the second smallest
principal angle between their images is not 0 (Schlaginhaufen and Kamgarpour 2024, arXiv 2406.01793).

Transitions `P(s'|s,a)` are `[S, A, S]`, policies and rewards `[S, A]`; gamma is below 1. All functions raise
`InputError` for transitions of another shape, for rows that are no distributions, and for another gamma.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eairl_jax.errors import InputError

TOLERANCE = 1e-8
"""Two spaces share a direction if the squared cosine between them differs from 1 by less."""


def shaping_operator(transitions: np.ndarray, gamma: float) -> np.ndarray:
    """B, `[S * A, S]`: `(B v)(s,a) = v(s) - gamma E[v(s')]`."""
    states, actions = _check(transitions, gamma)
    return np.repeat(np.eye(states), actions, axis=0) - gamma * transitions.reshape(states * actions, states)


def principal_angles(first: np.ndarray, second: np.ndarray, gamma: float) -> np.ndarray:
    """The principal angles `[S]` (rad, ascending) between the shapings of two sources. The first is 0: constants."""
    cosines = np.linalg.svd(_image(first, gamma).T @ _image(second, gamma), compute_uv=False)
    return np.arccos(np.clip(cosines, -1.0, 1.0))


def unidentified(sources: Sequence[np.ndarray], gamma: float) -> np.ndarray:
    """An orthonormal basis `[S * A, directions]` of what the experts of all sources together leave open."""
    projections = [image @ image.T for image in (_image(source, gamma) for source in sources)]
    shares, directions = np.linalg.eigh(np.mean(projections, axis=0))
    return directions[:, shares > 1.0 - TOLERANCE]


def transfers(sources: Sequence[np.ndarray], target: np.ndarray, gamma: float) -> bool:
    """Whether every reward that explains the experts of all sources has the true reward's policy in the target."""
    image, left_open = _image(target, gamma), unidentified(sources, gamma)
    return bool(np.abs(left_open - image @ (image.T @ left_open)).max() < np.sqrt(TOLERANCE))


def explaining_reward(policies: Sequence[np.ndarray], sources: Sequence[np.ndarray], gamma: float) -> np.ndarray:
    """The smallest reward `[S, A]` for which each policy is the best in its source."""
    rows, wanted = [], []
    for policy, source in zip(policies, sources, strict=True):
        image = _image(source, gamma)
        outside = np.eye(len(image)) - image @ image.T  # removes what a shaping can explain
        rows.append(outside)
        wanted.append(outside @ np.log(policy).ravel())
    reward, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=TOLERANCE)
    return reward.reshape(policies[0].shape)


def best_policy(reward: np.ndarray, transitions: np.ndarray, gamma: float) -> np.ndarray:
    """The policy `[S, A]` that maximises discounted reward and entropy, by soft value iteration to full precision."""
    _check(transitions, gamma)
    q, value = reward, np.zeros(len(reward))
    for _ in range(int(np.ceil(40.0 / (1.0 - gamma)))):  # gamma^n < 1e-17
        q = reward + gamma * transitions @ value
        highest = q.max(axis=1)
        value = highest + np.log(np.exp(q - highest[:, None]).sum(axis=1))
    return np.exp(q - value[:, None])


def regret(policy: np.ndarray, reward: np.ndarray, transitions: np.ndarray, gamma: float) -> float:
    """What a policy loses of discounted reward and entropy against the best one, on average over the first state."""

    def value(pi: np.ndarray) -> np.ndarray:
        gain = (pi * (reward - np.log(np.maximum(pi, 1e-300)))).sum(axis=1)
        return np.linalg.solve(np.eye(len(pi)) - gamma * np.einsum("sa,sat->st", pi, transitions), gain)

    return float(np.mean(value(best_policy(reward, transitions, gamma)) - value(policy)))


def _check(transitions: np.ndarray, gamma: float) -> tuple[int, int]:
    """The numbers of states and actions of valid transitions."""
    shape = np.shape(transitions)
    if len(shape) != 3 or shape[0] != shape[2] or min(shape) < 1:
        raise InputError(f"transitions have the shape {shape}: expected [S, A, S], P(s'|s,a)")
    if not (np.all(transitions >= 0) and np.allclose(np.sum(transitions, axis=2), 1.0)):
        raise InputError("transitions: expected a distribution P(.|s,a) for each state and action, with the sum 1")
    if not 0.0 <= gamma < 1.0:
        raise InputError(f"gamma = {gamma}: expected at least 0 and below 1")
    return shape[0], shape[1]


def _image(transitions: np.ndarray, gamma: float) -> np.ndarray:
    """An orthonormal basis `[S * A, S]` of the image of B, which has full rank because gamma is below 1."""
    basis, _ = np.linalg.qr(shaping_operator(transitions, gamma))
    return basis
