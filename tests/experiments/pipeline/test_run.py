"""A result on disk is the result in memory."""

import json

import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline.places import Reference
from eairl_jax.experiments.pipeline.run import Result

FIELDS = dict(
    name="eairl-sa",
    method="eairl",
    task="ant",
    seeds=[0, 1],
    returns=[10.0, 30.0],
    expert=50.0,
    random=-50.0,
    env_steps=7,
    compile_seconds=1.0,
    run_seconds=2.0,
    peak_memory_gb=0.5,
    command_line="eairl imitate ant",
    is_published=True,
    settings={"config": {"gamma": 0.9}},
)


def test_scores_are_0_for_random_actions_and_1_for_the_expert():
    result = Result(**FIELDS)
    assert (result.mean, result.std, result.normalized) == (20.0, 10.0, 0.7)
    np.testing.assert_allclose(result.scores, [0.6, 0.8])
    assert Reference(50.0, -50.0).normalized(-50.0) == 0.0


def test_what_is_written_is_read_again():
    for more in ({}, {"target": "crippled_ant", "rule": "last", "ceiling": [1.0, 2.0], "chosen_iterations": [4, 4]}):
        result = Result(**FIELDS | more)
        content = json.loads(json.dumps(result.to_json()))
        assert Result.from_json(content, "here") == result
        assert content["normalized"] == 0.7
        assert "snapshots" not in content
    assert result.identity == ("eairl-sa", "ant", "crippled_ant", "last")


def test_without_an_expert_there_are_no_scores():
    result = Result(**FIELDS | {"expert": None})
    assert (result.mean, result.normalized, result.scores) == (20.0, None, None)
    content = json.loads(json.dumps(result.to_json()), parse_constant=pytest.fail)
    assert (content["expert"], content["normalized"]) == (None, None)
    assert Result.from_json(content, "here") == result


def test_a_missing_field_is_named():
    content = {name: value for name, value in FIELDS.items() if name not in ("expert", "seeds")}
    with pytest.raises(InputError, match="result 3 lacks seeds, expert: repeat"):
        Result.from_json(content, "result 3")
