"""The warning about a discriminator that is right about nearly everything."""

import dataclasses
import json

import pytest

from eairl_jax.experiments.commands.saturation import warn_if_saturated
from eairl_jax.experiments.pipeline.run import Result


@pytest.mark.parametrize("lanes", [[], ["seed 1"]])
def test_saturated_lanes_are_named(finished, lanes, capsys):
    result = Result.from_json(json.loads((finished / "summary.json").read_text()), "summary.json")
    warn_if_saturated(dataclasses.replace(result, saturated_lanes=lanes))
    printed = capsys.readouterr().out
    assert ("iterations (seed 1)" in printed) == ("discriminator_lr" in printed) == bool(lanes)
