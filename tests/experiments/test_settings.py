"""Every setting is documented, parsed by its type, and ends in one recipe."""

from dataclasses import fields, replace

import pytest

from eairl_jax import Config, HParams, InputError, envs
from eairl_jax.experiments.pipeline.places import make_env
from eairl_jax.experiments.recipes import PURPOSE_DEFAULTS, RECIPES
from eairl_jax.experiments.settings import SETTINGS, Recipe, divisor, documentation, parse_overrides, recipe
from eairl_jax.hparams import check_hparams


def test_every_setting_is_documented():
    texts = documentation()
    assert {name for name in SETTINGS if len(texts.get(name, "")) < 10} <= UNDOCUMENTED
    assert "empowerment" in texts["beta"].lower()


UNDOCUMENTED: set[str] = set()


def test_values_are_read_by_the_type_of_the_setting():
    read = parse_overrides(("gamma=0.5", "num_envs=3", "hidden=8,9", "state_dependent_std=true", "method=gail"))
    assert read == {"gamma": 0.5, "num_envs": 3, "hidden": (8, 9), "state_dependent_std": True, "method": "gail"}
    with pytest.raises(InputError, match=r"did you mean lambda_i.*`eairl settings` explains"):
        parse_overrides(("lamda_i=1",))


def test_every_section_of_a_recipe_is_read():
    """A section that no purpose, form or method asks for would be dead."""
    for sections in RECIPES.values():
        for name in sections:
            purpose, _, rest = name.partition(" ")
            assert name == "all" or purpose in PURPOSE_DEFAULTS
            assert rest in ("", "tuned", "separable", "gan_gcl")


def test_later_sections_win():
    env = envs.make("point_maze_left")
    plain = recipe("point_maze_left", env, "reward", {})
    separable = recipe("point_maze_left", env, "reward", {"reward_form": "separable"})
    changed = recipe("point_maze_left", env, "reward", {"reward_form": "separable", "lambda_i": 5.0})
    assert [r.hparams.lambda_i for r in (plain, separable, changed)] == [1.0, 0.01, 5.0]
    assert plain.config.episode_length == env.episode_length


def test_a_penalty_is_computed_only_where_it_has_a_weight():
    env = envs.make("pendulum")
    assert recipe("pendulum", env, "imitate", {}).config.penalties == ()
    assert recipe("pendulum", env, "imitate", {"gradient_penalty": 1.0}).config.penalties == ("gradient",)


@pytest.mark.parametrize("iterations, near, largest", [(200, 40, 40), (50, 40, 25), (7, 40, 7), (7, 3, 1)])
def test_divisor(iterations, near, largest):
    assert divisor(iterations, near) == largest


def test_the_trials_of_a_recipe_are_possible_in_its_iterations():
    env = envs.make("point_maze_left")

    def trials(task="point_maze_left", **overrides):
        made = recipe(task, env, "retrain", {"snapshot_every": 1} | overrides)
        return made.trials, made.trial_iterations, made.random_trials

    given = {"trials": 16, "trial_iterations": 20, "random_trials": 2, "restarts": 4}
    assert trials(**given) == (16, 20, 2)
    assert trials(**given | {"iterations": 4, "snapshot_every": 4}) == (16, 2, 2)
    assert trials(**given | {"iterations": 1, "snapshot_every": 1}) == (0, 0, 0)
    assert trials(**given | {"restarts": 20}) == (20, 20, 2)
    assert trials(**given | {"restarts": 3}) == (16, 20, 1)
    assert trials(**given | {"trials": 0}) == (0, 0, 0)
    assert trials(**given | {"trials": 2, "restarts": 1}) == (2, 20, 2)  # all are random, and the better one goes on


@pytest.mark.parametrize(
    ("iterations", "every"), [(5, 5), (50, 50), (120, 40), (101, 101), (90, 45), (1200, 40), (1, 1)]
)
def test_snapshots_follow_the_iterations_that_are_set(iterations, every):
    made = recipe("pendulum", envs.make("pendulum"), "imitate", {"method": "eairl", "iterations": iterations})
    assert made.snapshot_every == every


def test_a_number_of_snapshots_that_was_set_is_kept():
    changes = {"method": "eairl", "iterations": 8, "snapshot_every": 2}
    assert recipe("pendulum", envs.make("pendulum"), "imitate", changes).snapshot_every == 2
    with pytest.raises(InputError, match="iterations = 1009 is not a multiple of snapshot_every = 40"):
        recipe("pendulum", envs.make("pendulum"), "imitate", {"method": "eairl", "iterations": 1009})


FLOATS = [(cls, field.name) for cls in (Config, HParams, Recipe) for field in fields(cls) if "float" in str(field.type)]


@pytest.mark.parametrize("value", ["1e38", "1e-45", "-1e30"])
def test_an_absurd_float_is_refused_from_the_command_line_and_from_python(value):
    env = make_env("pendulum")
    whole = {Config: Config(), HParams: HParams(), Recipe: Recipe(Config(), HParams())}
    assert {"gamma", "log_std_init", "random_std"} < {name for _, name in FLOATS}
    for cls, name in FLOATS:
        overrides = parse_overrides((f"{name}={value}",))
        with pytest.raises(InputError, match=f"{name} = .*: expected a number"):
            recipe("pendulum", env, "retrain", overrides)
        with pytest.raises(InputError, match=f"{name} = .*: expected a number"):
            check_hparams(replace(whole[cls], **{name: float(value)}))


@pytest.mark.parametrize("tuned", [False, True])
def test_each_of_several_sources_has_as_many_environments_as_alone(tuned):
    env = make_env("ant")
    alone = recipe("ant", env, "reward", {}, tuned)
    both = recipe("ant+crippled_ant", env, "reward", {}, tuned)
    assert both.config.num_envs == 2 * alone.config.num_envs
    assert replace(both.config, num_envs=alone.config.num_envs) == alone.config
    assert recipe("ant+crippled_ant", env, "reward", {"num_envs": 16}, tuned).config.num_envs == 16
