"""An option that is given several times has all of its values, or is refused."""

import dataclasses

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.command_line import normalised
from eairl_jax.experiments.options import COMMANDS

BOTH = {
    "nothing to do": ("imitate a --set a=1 b=2 --seeds 3", "imitate a --set a=1 b=2 --seeds 3"),
    "two options": ("imitate a --set a=1 --seeds 3 --set b=2 c=3", "imitate a --set a=1 b=2 c=3 --seeds 3"),
    "equals signs": ("imitate a --set=a=1 --set=b=2 --seeds=3", "imitate a --set a=1 b=2 --seeds 3"),
    "underscores": ("transfer a b --retrain_set x=1 --retrain-set y=1", "transfer a b --retrain-set x=1 y=1"),
    "methods": ("imitate a --method gail --method bc --tuned", "imitate a --method gail bc --tuned"),
    "rules": ("transfer a b --rule iteration=2 --rule iteration=4", "transfer a b --rule iteration=2 iteration=4"),
    "an unknown option": ("imitate a --bogus 1 --bogus 2", "imitate a --bogus 1 --bogus 2"),
    "an unknown command": ("imitat --set --set", "imitat --set --set"),
    "help": ("imitate --set --help", "imitate --set --help"),
    "nothing": ("", ""),
}


@pytest.mark.parametrize(("given", "expected"), BOTH.values(), ids=BOTH)
def test_both_forms_mean_the_same(given, expected):
    assert normalised(given.split()) == expected.split()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_many_values_accumulates(command):
    for field in dataclasses.fields(COMMANDS[command]):
        hint = str(field.type)
        if "tuple" in hint or hint in ("Set", "Methods", "Forms"):
            option = f"--{field.name.replace('_', '-')}"
            assert normalised([command, option, "x", option, "y"]) == [command, option, "x", "y"]


REFUSED = {
    "imitate a --seeds 2 --seeds 3": "--seeds is given twice: give it once",
    "imitate a --tuned --no-tuned": "--tuned is given twice",
    "imitate a --out x --out=y": "--out is given twice",
    "imitate a --set": "--set has no value: give one or more, or leave --set out",
    "imitate a --set=": "--set has no value",
    "imitate a --set a=1 --set a=2": r"--set has a 2 times \(a=1, a=2\): give it once",
    "diagnose a --policies x --policies x": "--policies has x 2 times",
}


@pytest.mark.parametrize("given", REFUSED)
def test_what_would_be_lost_is_refused(given):
    with pytest.raises(InputError, match=REFUSED[given]):
        normalised(given.split())


def test_values_may_be_any_text():
    odd = ["demos/run.v1 [a] $x.npz", "näme <b>", "a=b=c"]
    assert normalised(["diagnose", odd[0], "--policies", odd[1], "--policies", odd[2]])[1:] == [
        odd[0],
        "--policies",
        *odd[1:],
    ]
