"""A low true return is the reward's fault only where the training found what the reward pays for."""

import numpy as np
import pytest

from eairl_jax.experiments.pipeline.diagnosis import FROM_EXPERT, RANDOM, TRAINED, Behaviour, Diagnosis
from eairl_jax.experiments.pipeline.places import Reference
from eairl_jax.experiments.pipeline.retraining import share_of_best


def diagnosis(trained, from_expert):
    """Of one seed; each argument is (learned reward a step, true return)."""
    behaviours = {TRAINED: trained, FROM_EXPERT: from_expert, RANDOM: (0.0, -50.0)}
    reference = Reference(expert=-5.0, random=-50.0)
    return Diagnosis({name: Behaviour(*np.array(each)[:, None]) for name, each in behaviours.items()}, reference)


@pytest.mark.parametrize(
    ("trained", "from_expert", "verdict"),
    [
        ((1.0, -5.1), (1.0, -4.9), "agrees"),
        ((1.0, -5.1), (0.2, -28.0), "agrees"),  # the training found something better by both rewards
        ((1.0, -28.0), (0.9, -4.9), "mistaken"),
        ((0.9, -28.0), (1.0, -4.9), "not optimised"),
        ((0.9, -5.0), (1.0, -4.9), "not optimised"),
        ((-0.5, -60.0), (-0.1, -5.0), "not optimised"),  # random actions are worth most
    ],
)
def test_the_verdict_tells_a_mistaken_reward_from_a_training_that_was_not_good_enough(trained, from_expert, verdict):
    assert diagnosis(trained, from_expert).verdicts == [verdict]


def test_a_diagnosis_can_be_written_and_read():
    before = diagnosis((0.5, -20.0), (1.0, -5.0))
    after = Diagnosis.from_json(before.to_json())
    assert after.to_json() == before.to_json()
    np.testing.assert_array_equal(after.share, [0.5])


def test_shares_are_numbers_also_where_nothing_is_better_than_random_actions():
    reached, random = np.array([1.0, 0.0, -1.0, 3.0]), np.array([1.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(share_of_best(reached, random, [reached, random]), [1.0, 1.0, 0.0, 1.0])
