"""Impossible settings are refused with words that help."""

import re

import pytest

from eairl_jax import METHODS, Config, InputError
from eairl_jax.methods import resolve

REFUSED = [
    *({name: 0} for name in (
        "num_envs", "rollout_length", "episode_length", "iterations", "ppo_epochs", "ppo_minibatches",
        "discriminator_updates", "discriminator_batch", "empowerment_updates", "empowerment_batch",
        "phi_sync_interval",
    )),
    {"history_length": -1},
    {"hidden": ()},
    {"policy_hidden": (32, 0)},
    {"value_hidden": (-4,)},
    {"activation": "gelu"},
    {"normalize_obs": "mean"},
    {"reward_obs": "normal"},
    {"action_part": "square"},
    {"reward_form": "separate"},
    {"shaping": "off"},
    {"inverse_loss": "mle"},
    {"l_i_power": 3},
    {"method": "bc"},
]  # fmt: skip


@pytest.mark.parametrize("setting", REFUSED, ids=str)
def test_the_message_names_the_setting_and_the_value(setting):
    ((name, value),) = setting.items()
    with pytest.raises(InputError, match=name) as e:
        resolve(Config(**setting))
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
    ],
)
def test_a_typo_is_answered_with_the_nearest_name(setting, meant):
    with pytest.raises(InputError, match=f"did you mean .*{meant}") as e:
        resolve(Config(**setting))
    assert "Choose one of" in str(e.value)


def test_minibatches_that_do_not_divide_are_refused_with_the_numbers():
    with pytest.raises(InputError, match=r"ppo_minibatches = 7 .* 4 x 5 = 20 .* divisor of 20"):
        Config(num_envs=4, rollout_length=5, ppo_minibatches=7)


@pytest.mark.parametrize("init", [-5.0, 0.5, 3.0])
def test_the_first_std_lies_between_its_bounds(init):
    with pytest.raises(InputError, match=f"log_std_init = {init} must lie between .* -5.0 and .* 0.5"):
        Config(log_std_init=init)


def test_a_good_configuration_is_accepted_hashable_and_counts_its_steps():
    config = Config(num_envs=8, rollout_length=30, ppo_minibatches=6)
    assert config.steps_per_iteration == 240
    assert hash(config) == hash(Config(num_envs=8, rollout_length=30, ppo_minibatches=6))


@pytest.mark.parametrize("method", METHODS)
def test_default_is_the_methods_own_choice_and_a_given_one_wins(method):
    row = METHODS[method]
    assert resolve(Config(method=method)) == row
    chosen = resolve(Config(method=method, reward_form="separable", shaping="both"))
    assert (chosen.reward_form, chosen.shaping, chosen.empowerment) == ("separable", "both", True)
    assert resolve(Config(method=method, shaping="none")).empowerment == row.empowerment


@pytest.mark.parametrize(
    ("changes", "shaping"),
    [
        ({"method": "eairl"}, "both"),
        ({"method": "eairl", "shaping": "empowerment"}, "empowerment"),
        ({"method": "eairl", "shaping": "none"}, "none"),
        ({"method": "airl_sa"}, "learned"),
        ({"method": "gail"}, "none"),
    ],
)
def test_a_separable_reward_gets_a_learned_potential_beside_phi_unless_told_otherwise(changes, shaping):
    assert resolve(Config(reward_form="separable", **changes)).shaping == shaping
