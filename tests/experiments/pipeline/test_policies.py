"""The policies of a finished run, read again."""

import jax
import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.run_folder import RunFolder


def test_the_best_seed_of_an_expert_is_chosen_by_its_training(expert):
    both, best = policies.load(expert), policies.best_expert(expert, "pendulum")
    ended = RunFolder(expert, both.settings).curve("true_return", 2)[:, -1]
    assert best.settings["chosen_seed"] == np.nanargmax(ended) == best.seeds[0]
    for leaf, chosen in zip(*map(leaves, (both, best)), strict=True):
        np.testing.assert_array_equal(leaf[best.seeds[0]], chosen[0])
    with pytest.raises(InputError, match="no expert of swimmer"):
        policies.best_expert(expert, "swimmer")


def leaves(trained):
    """The arrays of policies."""
    return jax.tree.leaves(trained.state)
