"""The shapes that an artefact must have are those of the networks. Damaged files: `test_saved_*` and `test_damage`."""

import itertools

import jax
import numpy as np
import pytest

from eairl_jax import artefacts, discriminator
from eairl_jax.actor_critic import ActorCritic
from eairl_jax.methods import with_method_defaults
from eairl_jax.storage import named_leaves

OBS, ACTION = 3, 2


def shapes_of(tree):
    return {name: np.shape(x) for name, x in named_leaves(tree).items()}


def without_stats(shapes):
    return {name: shape for name, shape in shapes.items() if not name.startswith(artefacts.STATS)}


FORMS = list(itertools.product(("sa", "s", "separable"), ("net", "quadratic"), ((5,), (6, 5)), (False, True)))


@pytest.mark.parametrize(("form", "part", "hidden", "layer_norm"), FORMS)
def test_a_rewards_arrays_are_those_of_its_networks(tiny, form, part, hidden, layer_norm):
    config = tiny(reward_form=form, action_part=part, hidden=hidden, layer_norm=layer_norm)
    params = discriminator.init(jax.random.PRNGKey(0), OBS, ACTION, with_method_defaults(config))
    kept = {"params": {name: params[name] for name in ("g", "k") if name in params}}
    assert without_stats(artefacts.reward_shapes(config, OBS, ACTION)) == shapes_of(kept)


@pytest.mark.parametrize("state_dependent_std", [False, True])
@pytest.mark.parametrize("policy_layer_norm", [False, True])
def test_a_policys_arrays_are_those_of_its_network(tiny, state_dependent_std, policy_layer_norm):
    config = tiny(policy_hidden=(6, 5), state_dependent_std=state_dependent_std, policy_layer_norm=policy_layer_norm)
    actor = ActorCritic.build(ACTION, config).init(jax.random.PRNGKey(0), OBS).nets.params["actor"]
    expected = shapes_of({"actor": actor}) | {"log_std_offset": ()}
    assert without_stats(artefacts.policy_shapes(config, OBS, ACTION)) == expected
