"""What stands in the files of a run is checked where it is read."""

import json

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline import records
from eairl_jax.storage import check

GOOD = {"task": "pendulum", "seeds": [0, 1], "config": {"gamma": 0.9}, "restarts": 2, "rule": {"kind": "last"}}
JUDGED = {"learned": [1.0, 2.0], "true": [3.0, 4.0]}


def write(folder, settings):
    (folder / "config.json").write_text(json.dumps({"settings": settings, "machine": {}}))


def test_settings_are_read_as_they_were_written(tmp_path):
    write(tmp_path, GOOD)
    assert records.settings(tmp_path) == GOOD


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"seeds": "x"}, "seeds"), ({"restarts": 0}, "restarts"), ({"config": None}, "config"), ({"task": 3}, "task"),
     ({"rule": {}}, "kind"), ({"seeds": [2**32]}, "seeds"), ({"random_std": -1.0}, "random_std")],
    ids=str,
)  # fmt: skip
def test_damaged_settings_are_named(tmp_path, changes, named):
    write(tmp_path, GOOD | changes)
    with pytest.raises(InputError, match=named):
        records.settings(tmp_path)


def test_settings_that_another_version_did_not_write_are_named(tmp_path):
    assert records.needed(GOOD, ["task", "restarts"], tmp_path) == ["pendulum", 2]
    with pytest.raises(InputError, match=r"lacks retrain_config, hparams"):
        records.needed(GOOD, ["task", "retrain_config", "hparams"], tmp_path)


def test_a_diagnosis_has_the_named_behaviours_and_as_many_seeds_for_each():
    content = {"behaviours": {"expert": JUDGED, "trained": JUDGED}, "expert": 1.0, "random": 0.0}
    check(content, records.diagnosis("expert"), "here")
    with pytest.raises(InputError, match="plan"):
        check(content, records.diagnosis("expert", "plan"), "here")
    content["behaviours"]["trained"] = {"learned": [1.0], "true": [3.0]}
    with pytest.raises(InputError, match="as many seeds"):
        check(content, records.diagnosis("expert"), "here")
