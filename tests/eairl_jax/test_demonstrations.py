"""Demonstrations are refused for each thing that training would trip over, in words that help."""

import json

import numpy as np
import pytest

from eairl_jax import Demonstrations, InputError, demonstrations


@pytest.fixture
def good(demos):
    return Demonstrations(*(np.array(x) for x in demos))


@pytest.fixture
def path(tmp_path, good):
    path = tmp_path / "deep" / "demos.npz"
    demonstrations.save(path, good, {"task": "toy", "return": -3.5})
    return path


def test_a_round_trip_keeps_every_array_as_float32_and_the_provenance(path, good, equal_trees):
    loaded = demonstrations.load(path, task="toy", obs_size=4, action_size=2)
    equal_trees(loaded, good)
    assert {x.dtype for x in loaded} == {np.dtype(np.float32)}
    assert demonstrations.provenance(path) == {"task": "toy", "return": -3.5}
    assert json.loads(path.with_suffix(".json").read_text()) == {"task": "toy", "return": -3.5}


def test_arrays_from_elsewhere_need_no_task_and_no_float32(tmp_path, good, equal_trees):
    doubles = {name: np.float64(x) for name, x in good._asdict().items()} | {"terminated": good.terminated > 0}
    np.savez(tmp_path / "x.npz", **doubles)
    equal_trees(demonstrations.load(tmp_path / "x.npz", task="toy"), good)


def poisoned(name, index, value):
    """Puts one bad number into an array."""

    def change(arrays):
        arrays[name] = arrays[name].astype(np.float64)
        arrays[name][index] = value

    return change


def reshaped(name, *shape):
    return lambda arrays: arrays.update({name: np.zeros(shape, np.float32)})


BAD_ARRAYS = {
    "array missing": (lambda a: a.pop("action"), r"lacks action: expected the arrays obs, action, next_obs"),
    "two missing": (lambda a: (a.pop("obs"), a.pop("reward")), r"lacks obs, reward"),
    "NaN": (poisoned("obs", (1, 2, 3), np.nan), r"obs is NaN or infinite at episode 1, step 2"),
    "infinite": (poisoned("reward", (2, 4), -np.inf), r"reward is NaN or infinite at episode 2, step 4"),
    "infinite as float32": (poisoned("action", (0, 3, 1), 1e300), r"action .* episode 0, step 3"),
    "s' of another length": (reshaped("next_obs", 3, 4, 4), r"next_obs has shape \(3, 4, 4\), expected \(3, 5, 4\)"),
    "s' of another size": (reshaped("next_obs", 3, 5, 3), r"next_obs has shape \(3, 5, 3\), expected \(3, 5, 4\)"),
    "reward with an axis too many": (reshaped("reward", 3, 5, 1), r"reward has shape \(3, 5, 1\), expected \(3, 5\)"),
    "steps without episodes": (reshaped("obs", 15, 4), r"obs has shape \(15, 4\).*expected \[episodes, steps, size\]"),
    "no episodes": (reshaped("obs", 0, 5, 4), r"obs has shape \(0, 5, 4\)"),
    "words": (lambda a: a.update(reward=np.full((3, 5), "good")), r"reward has dtype <U4; expected numbers"),
    "objects": (lambda a: a.update(obs=np.full((3, 5, 4), None)), r"not a complete \.npz of plain arrays"),
}


@pytest.mark.parametrize(("change", "message"), BAD_ARRAYS.values(), ids=BAD_ARRAYS.keys())
def test_bad_arrays_are_refused(tmp_path, good, change, message):
    arrays = {name: np.array(x) for name, x in good._asdict().items()}
    change(arrays)
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=message) as e:
        demonstrations.load(path)
    assert str(path) in str(e.value)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"task": "pendulum"}, r"demonstrates 'toy', not 'pendulum': use demonstrations of 'pendulum'"),
        ({"obs_size": 3}, r"obs has shape \(3, 5, 4\), expected \(3, 5, 3\)"),
        ({"action_size": 6}, r"action has shape \(3, 5, 2\), expected \(3, 5, 6\)"),
    ],
)
def test_demonstrations_of_something_else_are_refused(path, wanted, message):
    with pytest.raises(InputError, match=message):
        demonstrations.load(path, **wanted)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda path: path.unlink(), "does not exist"),
        (lambda path: path.write_bytes(path.read_bytes()[:300]), "is not a complete .npz"),
        (lambda path: path.write_bytes(b""), "is not a complete .npz"),
    ],
    ids=["missing", "cut short", "empty"],
)
def test_a_broken_file_is_refused(path, change, message):
    change(path)
    with pytest.raises(InputError, match=message):
        demonstrations.load(path)


@pytest.mark.parametrize("content", [None, '{"task":'])
def test_a_broken_provenance_is_refused(path, content):
    path.with_suffix(".json").unlink()
    if content:
        path.with_suffix(".json").write_text(content)
    with pytest.raises(InputError, match=r"demos\.json (is not JSON|does not exist)"):
        demonstrations.provenance(path)


def test_the_fingerprint_is_of_the_episodes(tmp_path, demos):
    own = demonstrations.fingerprint(demos)
    for name in ("here.npz", "there.npz"):
        demonstrations.save(tmp_path / name, demos, {"task": "toy"})
        assert demonstrations.fingerprint(demonstrations.load(tmp_path / name)) == own
    action = np.array(demos.action)
    action[2, 4, 1] += 1e-6
    assert demonstrations.fingerprint(demos._replace(action=action)) != own
    assert demonstrations.fingerprint(demos._replace(obs=demos.next_obs, next_obs=demos.obs)) != own
