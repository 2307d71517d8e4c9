"""Demonstrations are refused for each thing that training would trip over, in words that help."""

import json
import tempfile
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eairl_jax import Demonstrations, InputError, demonstrations, evaluate, random_policy


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
    assert {x.dtype for x in loaded[:-1]} == {np.dtype(np.float32)}
    assert demonstrations.provenance(path) == {"task": "toy", "return": -3.5}
    assert json.loads(path.with_suffix(".json").read_text()).items() > {"task": "toy", "return": -3.5}.items()


def ragged(seed=0, lengths=(3, 1, 5), obs=4, action=2, terminated=True):
    """Made-up episodes of these lengths, which the task ended or the time limit did."""
    rng = np.random.default_rng(seed)
    path = [rng.normal(size=(n + 1, obs)).astype(np.float32) for n in lengths]
    ends = [np.arange(n) == n - 1 if terminated else np.zeros(n, bool) for n in lengths]
    rows = sum(lengths)
    return Demonstrations(
        np.concatenate([x[:-1] for x in path]),
        rng.normal(size=(rows, action)).astype(np.float32),
        np.concatenate([x[1:] for x in path]),
        rng.normal(size=rows).astype(np.float32),
        np.concatenate(ends).astype(np.float32),
        np.array(lengths, np.int32),
    )


@given(st.lists(st.integers(1, 6), min_size=1, max_size=4).filter(lambda x: max(x) > 1), st.booleans(), st.booleans())
def test_episodes_of_any_lengths_survive_a_file_padding_and_missing_columns(lengths, has_action, has_reward):
    demos = ragged(lengths=tuple(lengths))
    demos = demos._replace(action=demos.action if has_action else None, reward=demos.reward if has_reward else None)
    with tempfile.TemporaryDirectory() as folder:
        path = demonstrations.save(Path(folder) / "x", demos, {"task": "toy"})
        loaded = demonstrations.load(path)
    padded = demonstrations.to_steps(demos, max(lengths) + 1)
    again = demonstrations.from_steps(padded)
    for name, x in demos._asdict().items():
        if x is None:
            assert getattr(loaded, name) is None
        else:
            np.testing.assert_array_equal(getattr(loaded, name), x)
            np.testing.assert_array_equal(getattr(again, name), x)
    assert demonstrations.fingerprint(loaded) == demonstrations.fingerprint(demos)
    returns = demonstrations.returns(demos)
    assert (returns is None) is not has_reward
    if has_reward:
        np.testing.assert_allclose(returns, padded["reward"].sum(axis=1), atol=1e-5)


def test_what_evaluate_records_after_the_end_is_no_demonstration(toy):
    """An episode that ends at its third step has three demonstrated steps, whatever is simulated after them."""
    env = toy(ends_at=3)
    _, steps = evaluate(jax.random.PRNGKey(0), env, random_policy(env), 2, 5)
    demos = demonstrations.checked(demonstrations.from_steps(steps), "steps")
    np.testing.assert_array_equal(demos.lengths, [3, 3])
    np.testing.assert_array_equal(demos.obs[:, 0], [0, 1, 2, 0, 1, 2])
    np.testing.assert_array_equal(demos.terminated, [0, 0, 1, 0, 0, 1])


def test_a_file_of_format_1_is_read(tmp_path, good, equal_trees):
    arrays = {
        name: np.float64(x).reshape(3, 5, *x.shape[1:]) for name, x in good._asdict().items() if name != "lengths"
    }
    np.savez(tmp_path / "x.npz", **arrays | {"terminated": arrays["terminated"] > 0})
    equal_trees(demonstrations.load(tmp_path / "x.npz", task="toy"), good)


def test_no_name_loses_the_episodes_or_shares_its_provenance(tmp_path, good):
    for name in ("run.v1", "run.v2", "run.v2.npz", "other.zip"):
        path = demonstrations.save(tmp_path / name, good, {"task": "toy", "name": name})
        assert demonstrations.provenance(path)["name"] == name
        demonstrations.load(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "other.zip.json", "other.zip.npz", "run.v1.json", "run.v1.npz", "run.v2.json", "run.v2.npz"
    ]  # fmt: skip


def poisoned(name, row, value):
    """Puts one bad number into a row of an array."""

    def change(arrays):
        arrays[name] = arrays[name].astype(np.float64)
        arrays[name][row] = value

    return change


def reshaped(name, *shape):
    return lambda arrays: arrays.update({name: np.zeros(shape, np.float32)})


def shifted(arrays):
    arrays["next_obs"] = np.roll(arrays["next_obs"], -1, axis=0)


BAD_ARRAYS = {
    "array missing": (lambda a: a.pop("next_obs"), r"lacks next_obs: expected the arrays obs, action, next_obs"),
    "two missing": (lambda a: (a.pop("obs"), a.pop("terminated")), r"lacks obs, terminated"),
    "NaN": (poisoned("obs", 7, np.nan), r"obs is NaN or infinite at episode 1, step 2"),
    "infinite": (poisoned("reward", 14, -np.inf), r"reward is NaN or infinite at episode 2, step 4"),
    "infinite as float32": (poisoned("action", 3, 1e300), r"action .* episode 0, step 3"),
    "s' of another length": (reshaped("next_obs", 14, 4), r"next_obs has shape \(14, 4\), expected \(15, 4\)"),
    "s' of another size": (reshaped("next_obs", 15, 3), r"next_obs has shape \(15, 3\), expected \(15, 4\)"),
    "s' equal to s": (lambda a: a.update(next_obs=a["obs"]), r"next_obs equals obs everywhere"),
    "s' shifted": (shifted, r"next_obs differs from the obs of the next step in 12 of 12 steps, first at episode 0"),
    "reward with an axis too many": (reshaped("reward", 15, 1), r"reward has shape \(15, 1\), expected \(15,\)"),
    "no lengths": (lambda a: a.pop("lengths"), r"there is no array lengths; expected \[steps, size\] and lengths"),
    "lengths of other episodes": (lambda a: a.update(lengths=[5, 5, 4]), r"add up to 14 steps, but obs holds 15"),
    "an empty episode": (lambda a: a.update(lengths=[5, 0, 10]), r"whole numbers of at least 1; .* lowest 0"),
    "fractions of steps": (lambda a: a.update(lengths=[7.5, 7.5]), r"whole numbers of at least 1; found float64"),
    "episodes of one step": (lambda a: a.update(lengths=[1] * 15), r"all 15 episodes have one step"),
    "no episodes": (lambda a: a.update(lengths=np.zeros(0, int)), r"whole numbers of at least 1"),
    "an end that is no flag": (
        poisoned("terminated", 4, 255),
        r"terminated is 255 at episode 0, step 4; expected 0 or 1",
    ),
    "a negative end": (poisoned("terminated", 4, -1), r"terminated is -1 at episode 0, step 4; expected 0 or 1"),
    "rows after an end": (poisoned("terminated", 6, 1), r"episode 1, step 1 is terminated, and the episode goes on"),
    "words": (lambda a: a.update(reward=np.full(15, "good")), r"reward has dtype <U4; expected numbers"),
    "objects": (lambda a: a.update(obs=np.full((15, 4), None)), r"not a complete \.npz of plain arrays"),
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
    ("change", "message"),
    [
        ({"action": lambda x: 50 * x}, r"actions are typically .* times their bound"),
        (
            {"action": lambda x: np.where(np.arange(15)[:, None] == 7, 1e25, x)},
            r"the largest 1e\+25 times, at episode 1",
        ),
        ({"obs": lambda x: 1000 * x + 1e4}, r"another scale than the task: entry . is typically"),
    ],
    ids=["x50", "1e25", "observations"],
)
def test_other_units_than_the_tasks_are_refused(toy, good, scale, change, message):
    env = toy(scale=scale)
    demonstrations.check_fits(good, env, "here")
    changed = good._replace(**{name: f(getattr(good, name)) for name, f in change.items()})
    with pytest.raises(InputError, match=message):
        demonstrations.check_fits(changed, env, "here")


def test_what_may_be_wrong_is_said(good):
    assert demonstrations.doubts(good) == []
    zeros = good._replace(reward=0 * good.reward, action=0 * good.action, obs=0 * good.obs)
    assert len(demonstrations.doubts(zeros)) == 3
    assert "no rewards" in demonstrations.doubts(good._replace(reward=None))[0]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"task": "pendulum"}, r"demonstrates 'toy', not 'pendulum': use demonstrations of 'pendulum'"),
        ({"obs_size": 3}, r"obs has shape \(15, 4\), expected \(15, 3\)"),
        ({"action_size": 6}, r"action has shape \(15, 2\), expected \(15, 6\)"),
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
    action[14, 1] += 1e-6
    assert demonstrations.fingerprint(demos._replace(action=action)) != own
    assert demonstrations.fingerprint(demos._replace(obs=demos.next_obs, next_obs=demos.obs)) != own


STEPS = {
    "obs": np.zeros((2, 3, 4)), "action": np.zeros((2, 3, 1)), "next_obs": np.ones((2, 3, 4)),
    "reward": np.zeros((2, 3)), "terminated": np.zeros((2, 3)), "valid": np.ones((2, 3)),
}  # fmt: skip
NO_STEPS = {
    "no dict": (None, "steps are None: expected a dict"),
    "missing": ({"obs": STEPS["obs"]}, "steps lack next_obs, terminated"),
    "no episodes": (
        STEPS | {"action": np.zeros((2, 3))},
        r"action has shape \(2, 3\) and dtype float64: expected numbers",
    ),
    "other steps": (STEPS | {"reward": np.zeros((2, 4))}, r"reward has shape \(2, 4\)"),
    "texts": (STEPS | {"obs": np.full((2, 3, 4), "x")}, "obs has shape .* and dtype <U1"),
    "ragged": (STEPS | {"obs": [[[0.0]], [[0.0], [1.0]]]}, "obs"),
    "a gap": (STEPS | {"valid": np.array([[1, 0, 1], [1, 1, 1]])}, "valid has a gap"),
}


@pytest.mark.parametrize(("steps", "message"), NO_STEPS.values(), ids=NO_STEPS)
def test_steps_that_are_no_episodes_are_refused(steps, message):
    with pytest.raises(InputError, match=message):
        demonstrations.from_steps(steps)


def test_what_could_not_be_loaded_is_not_saved(tmp_path, good):
    for demos, provenance, message in (
        (good._replace(obs=good.obs * np.nan), {"task": "toy"}, "NaN or infinite"),
        (good, {}, "the provenance lacks task"),
        (good, {"task": "toy", "expert_return": "high"}, "expert_return is 'high'"),
        (good, {"task": "toy", "expert_return": float("nan")}, "cannot be written as JSON"),
        (good, {"task": "toy", "note": {1}}, "cannot be written as JSON"),
    ):
        with pytest.raises(InputError, match=message):
            demonstrations.save(tmp_path / "x.npz", demos, provenance)
    assert not list(tmp_path.iterdir())


def test_a_change_after_the_writing_is_found(path):
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **arrays | {"reward": arrays["reward"] + 1})
    with pytest.raises(InputError, match=r"is not as it was written .* remove checksum"):
        demonstrations.load(path)
    np.savez(path, **{name: x for name, x in arrays.items() if name != "checksum"})
    assert demonstrations.load(path).reward.sum() == arrays["reward"].sum()


def test_demonstrations_of_several_tasks_say_which_task_each_step_is_of(good):
    short = good._replace(action=None, lengths=good.lengths)
    both = demonstrations.of_several([good, good])
    steps, size = good.obs.shape
    assert both.obs.shape == both.next_obs.shape == (2 * steps, size + 2)
    np.testing.assert_array_equal(both.obs[steps:, :size], good.obs)
    np.testing.assert_array_equal(both.obs[:, size:], np.repeat(np.eye(2), steps, axis=0))
    np.testing.assert_array_equal(both.next_obs[:, size:], both.obs[:, size:])
    np.testing.assert_array_equal(both.lengths, [*good.lengths, *good.lengths])
    assert both.action.shape == (2 * steps, good.action.shape[1])
    assert both.obs.dtype == np.float32
    assert demonstrations.of_several([good, short]).action is None
