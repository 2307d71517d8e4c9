"""From which sources does a reward transfer? The theorem's prediction and exact transfers, in tasks of six states.

    python examples/which_sources_are_enough.py

Every source has an expert. A reward that explains all experts is drawn at random, the best policy on it is computed in
the target, and its regret by the true reward is measured.
"""

import numpy as np

from eairl_jax import identifiability

STATES, ACTIONS, GAMMA = 6, 3, 0.9
rng = np.random.default_rng(0)
ROOM = np.arange(STATES) // (STATES // 2)  # states 0 to 2 are one room, 3 to 5 another


def task(open_between_rooms=True):
    """Random transitions `[S, A, S]`; with closed rooms no action leads from one into the other."""
    p = rng.dirichlet(np.ones(STATES), (STATES, ACTIONS))
    p = p if open_between_rooms else p * (ROOM[:, None] == ROOM)[:, None]
    return p / p.sum(axis=-1, keepdims=True)


def changed(p, states):
    """The task `p` with other transitions from some states."""
    p = p.copy()
    p[states] = task()[states]
    return p


def measured_regret(sources, target):
    """Of the worst of 20 rewards that explain the experts of all sources."""
    truth = rng.normal(size=(STATES, ACTIONS))
    experts = [identifiability.best_policy(truth, source, GAMMA) for source in sources]
    reward = identifiability.explaining_reward(experts, sources, GAMMA)
    left_open = identifiability.unidentified(sources, GAMMA)
    drawn = [reward + (left_open @ rng.normal(size=left_open.shape[1])).reshape(reward.shape) for _ in range(20)]
    policies = [identifiability.best_policy(each, target, GAMMA) for each in drawn]
    return max(identifiability.regret(policy, truth, target, GAMMA) for policy in policies)


a, b, closed, also_closed = task(), task(), task(open_between_rooms=False), task(open_between_rooms=False)
CASES = {
    "one source, the target is the source": ([a], a),
    "one source, another target": ([a], b),
    "one source, the target differs in one state": ([a], changed(a, [0])),
    "two equal sources, another target": ([a, a], b),
    "two sources, another target": ([a, b], task()),
    "sources that differ in one state, another target": ([a, changed(a, [0])], task()),
    "sources that differ in one state, the target too": ([a, changed(a, [0])], changed(a, [0])),
    "sources of closed rooms, closed rooms": ([closed, also_closed], task(open_between_rooms=False)),
    "sources of closed rooms, open rooms": ([closed, also_closed], task()),
}
results = {}
for name, (sources, target) in CASES.items():
    predicted, lost = identifiability.transfers(sources, target, GAMMA), measured_regret(sources, target)
    angle = identifiability.principal_angles(sources[0], sources[-1], GAMMA)[1]
    results[name] = predicted, lost
    print(f"{name:50} second angle {angle:.2f}  transfers: {'yes' if predicted else 'no ':3}  regret {lost:.1e}")
