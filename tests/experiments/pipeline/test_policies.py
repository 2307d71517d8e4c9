"""The policies of a finished run, read again."""

import shutil

import jax
import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import policies
from eairl_jax.experiments.pipeline.run_folder import RunFolder


@pytest.mark.parametrize("better", [0, 1])
def test_the_best_seed_of_an_expert_is_chosen_by_its_training(expert, tmp_path, better):
    folder = shutil.copytree(expert, tmp_path / "expert")
    both = policies.load(folder)
    # So short a training ends no episode: its returns are made up.
    run, labels = RunFolder(folder, both.settings), [{"seed": 0}, {"seed": 1}]
    run.keep_metrics(0, labels)
    run.append_metrics(0, 40, labels, {"true_return": np.full((2, 4), -10.0) + 5.0 * (np.arange(2) == better)[:, None]})
    best = policies.best_expert(folder, "pendulum")
    assert best.settings["chosen_seed"] == best.seeds[0] == better
    for leaf, chosen in zip(*map(leaves, (both, best)), strict=True):
        np.testing.assert_array_equal(leaf[best.seeds[0]], chosen[0])
    with pytest.raises(InputError, match="no expert of swimmer"):
        policies.best_expert(expert, "swimmer")


def leaves(trained):
    """The arrays of policies."""
    return jax.tree.leaves(trained.state)
