"""Impossible settings are refused with words that help."""

import re

import pytest

from eairl_jax import METHODS, Config, InputError
from eairl_jax.config import METHOD_DEFAULTS
from eairl_jax.methods import uses_empowerment, with_method_defaults

REFUSED = [
    *({name: 0} for name in (
        "num_envs", "rollout_length", "iterations", "ppo_epochs", "ppo_minibatches",
        "discriminator_updates", "discriminator_batch", "empowerment_updates", "empowerment_batch",
        "phi_sync_interval", "cg_iterations", "line_search_steps",
    )),
    {"history_length": -1},
    {"episode_length": -1},
    {"horizon": "endless"},
    {"hidden": ()},
    {"policy_hidden": (32, 0)},
    {"value_hidden": (-4,)},
    {"activation": "glu"},
    {"normalize_obs": "mean"},
    {"reward_obs": "normal"},
    {"action_part": "square"},
    {"reward_form": "separate"},
    {"shaping": "off"},
    {"inverse_loss": "mle"},
    {"l_i_power": 3},
    {"l_i_actions": "fresh"},
    {"l_i_in": "cost"},
    {"optimizer": "sac"},
    {"discriminates": "pairs"},
    {"shaping_discount": "two"},
    {"policy_phi": "slow"},
    {"history": "everything"},
    {"update_order": "policy_first"},
    {"policy_activation": "glu"},
    {"method": "bc"},
]  # fmt: skip


@pytest.mark.parametrize("setting", REFUSED, ids=str)
def test_the_message_names_the_setting_and_the_value(setting):
    ((name, value),) = setting.items()
    with pytest.raises(InputError, match=name) as e:
        with_method_defaults(Config(**setting))
    assert re.search(re.escape(str(value)), str(e.value))


@pytest.mark.parametrize(
    ("setting", "meant"),
    [
        ({"method": "eairll"}, "eairl"),
        ({"method": "airl"}, "airl_s"),
        ({"reward_form": "seperable"}, "separable"),
        ({"shaping": "empowermnt"}, "empowerment"),
        ({"activation": "Relu"}, "relu"),
        ({"inverse_loss": "liklihood"}, "likelihood"),
        ({"method": "gangcl"}, "gan_gcl"),
        ({"update_order": "discriminator"}, "discriminator_first"),
        ({"penalties": ("gradients",)}, "gradient"),
    ],
)
def test_a_typo_is_answered_with_the_nearest_name(setting, meant):
    with pytest.raises(InputError, match=f"did you mean .*{meant}") as e:
        with_method_defaults(Config(**setting))
    assert "Choose one of" in str(e.value)


def test_minibatches_that_do_not_divide_are_refused_with_the_numbers():
    with pytest.raises(InputError, match=r"ppo_minibatches = 7 .* 4 x 5 = 20 .* divisor of 20"):
        Config(num_envs=4, rollout_length=5, ppo_minibatches=7)


@pytest.mark.parametrize("init", [-5.0, 0.5, 3.0])
def test_the_first_std_lies_between_its_bounds(init):
    with pytest.raises(InputError, match=f"log_std_init = {init} must lie between .* -5.0 and .* 0.5"):
        Config(log_std_init=init)


@pytest.mark.parametrize(("norm", "widths"), [
    ("layer_norm", "hidden"), ("layer_norm", "value_hidden"), ("policy_layer_norm", "policy_hidden"),
])  # fmt: skip
def test_a_normalised_layer_has_more_than_one_unit(norm, widths):
    assert getattr(Config(**{widths: (4, 1)}), widths) == (4, 1)
    with pytest.raises(InputError, match=rf"{widths} = \(4, 1\): layer normalisation makes a layer of width 1"):
        Config(**{widths: (4, 1), norm: True})


def test_a_good_configuration_is_accepted_hashable_and_counts_its_steps():
    config = Config(num_envs=8, rollout_length=30, ppo_minibatches=6)
    assert config.steps_per_iteration == 240
    assert hash(config) == hash(Config(num_envs=8, rollout_length=30, ppo_minibatches=6))


@pytest.mark.parametrize("method", METHODS)
def test_default_is_the_methods_own_choice_and_a_given_one_wins(method):
    row, own = METHODS[method], with_method_defaults(Config(method=method))
    assert {name: getattr(own, name) for name in METHOD_DEFAULTS} == {
        name: getattr(row, name) for name in METHOD_DEFAULTS
    }
    assert with_method_defaults(own) == own
    assert uses_empowerment(own) == row.empowerment
    given = {name: choices[-1] for name, choices in METHOD_DEFAULTS.items()}
    assert with_method_defaults(Config(method=method, **given)) == Config(method=method, **given)
    assert uses_empowerment(with_method_defaults(Config(method=method, shaping="both")))
    assert uses_empowerment(with_method_defaults(Config(method=method, shaping="none"))) == row.empowerment


@pytest.mark.parametrize(
    ("changes", "shaping"),
    [
        ({"method": "eairl"}, "both"),
        ({"method": "eairl", "shaping": "empowerment"}, "empowerment"),
        ({"method": "eairl", "shaping": "none"}, "none"),
        ({"method": "airl_sa"}, "learned"),
        ({"method": "gail"}, "none"),
        ({"method": "eairl_release"}, "both"),
    ],
)
def test_a_separable_reward_gets_a_learned_potential_beside_phi_unless_told_otherwise(changes, shaping):
    assert with_method_defaults(Config(reward_form="separable", **changes)).shaping == shaping


def test_the_last_policy_is_not_cut_short():
    assert Config(iterations=12, policy_reset_every=4).policy_reset_every == 4
    with pytest.raises(InputError, match="iterations = 10 is not a multiple of policy_reset_every = 4"):
        Config(iterations=10, policy_reset_every=4)
