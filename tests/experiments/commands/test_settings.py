"""`eairl settings`: every setting, and the recipes of a task."""

from eairl_jax.experiments.commands.settings import sections, text_of
from eairl_jax.experiments.settings import SETTINGS


def test_every_setting_is_explained(run, capsys):
    assert run("settings", "point_maze_left") == 0
    printed = capsys.readouterr().out
    for word in (*SETTINGS, "reward separable", "normalize_obs=none"):
        assert word in printed
    assert run("settings", "point_maze") == 2
    assert "did you mean" in capsys.readouterr().err


def test_a_purpose_holds_its_defaults_and_the_tasks_values():
    retrain = sections("point_maze_left")["retrain"]
    assert (retrain["restarts"], retrain["value_hidden"]) == (4, (48, 48))
    without = sections("brax:fast?episode_length=20")
    assert without.keys() == {"expert", "imitate", "reward", "retrain", "imitate gan_gcl", "reward gan_gcl"}
    assert {without[purpose]["normalize_obs"] for purpose in ("expert", "imitate", "reward", "retrain")} == {"running"}


def test_values_are_shown_as_they_are_typed():
    assert [text_of(value) for value in ((32, 32), (), True, 1e-3, "sa", 7)] == [
        "32,32",
        "-",
        "true",
        "0.001",
        "sa",
        "7",
    ]
