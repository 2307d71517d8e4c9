"""The folders of runs for which no `--out` was given."""

import dataclasses
from pathlib import Path

import pytest

from eairl_jax.experiments.options import Imitate, Transfer
from eairl_jax.experiments.pipeline.default_folder import changed_options, default_path
from eairl_jax.experiments.pipeline.run_folder import RunFolder

MAZES = {"source": "point_maze_left", "target": "point_maze_right"}
CASES = {
    "nothing": (Imitate("pendulum"), ""),
    "what the name holds already": (Imitate("ant", ("gail",), ("sa",), tuned=True, out=Path("x")), ""),
    "settings": (Imitate("pendulum", seeds=2, set=("gamma=0.9", "beta=2")), "seeds=2-beta=2-gamma=0.9"),
    "of the retraining": (Transfer(**MAZES, restarts=1, retrain_set=("gamma=1",)), "retrain_set-gamma=1-restarts=1"),
}


@pytest.mark.parametrize(("options", "expected"), CASES.values(), ids=CASES)
def test_what_was_changed(options, expected):
    assert changed_options(options) == expected


def test_names_are_short_fit_for_a_file_and_different():
    demos = [Imitate("pendulum", demos=Path(folder) / "demos.npz") for folder in ("a/b", "a_b", "/a/b c")]
    sets = [Imitate("pendulum", set=("gamma=0.9",) * 40 + (last,)) for last in ("beta=1", "beta=2")]
    names = [changed_options(each) for each in (*demos, *sets)]
    assert len(set(names)) == len(names)
    for name in names:
        assert "/" not in name
        assert " " not in name
        assert len(name) < 100


def test_every_option_of_a_command_is_told_apart():
    for cls, needed in ((Imitate, {"task": "pendulum"}), (Transfer, MAZES)):
        for field in dataclasses.fields(cls):
            if field.name in ("out", "reward", "tuned", "method", "reward_form", "rule", "track", "on_nan", *needed):
                continue
            changed = cls(**needed, **{field.name: ("x=1",) if field.name.endswith("set") else "other"})
            assert changed_options(changed), field.name


def test_a_run_that_an_earlier_version_began_goes_on_where_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options, settings = Imitate("pendulum", seeds=2), {"task": "pendulum", "seeds": [0, 1]}
    assert default_path(options, "imitate-pendulum", settings) == Path("runs/imitate-pendulum-seeds=2")
    RunFolder(Path("runs/imitate-pendulum"), settings)
    assert default_path(options, "imitate-pendulum", settings) == Path("runs/imitate-pendulum")
    assert default_path(options, "imitate-pendulum", {"seeds": [3]}) == Path("runs/imitate-pendulum-seeds=2")
    assert default_path(Imitate("pendulum"), "imitate-pendulum", {"seeds": [3]}) == Path("runs/imitate-pendulum")


def test_what_happens_at_a_nan_makes_no_other_run():
    """So a run that has stopped goes on with --on-nan skip, in its folder."""
    assert not changed_options(Imitate("pendulum", on_nan="skip"))
