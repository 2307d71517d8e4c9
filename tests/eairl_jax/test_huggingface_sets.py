"""Trajectories that `imitation` saved with HuggingFace's `datasets` become demonstrations."""

import json
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax import InputError
from eairl_jax.demonstration_files import read

pytestmark = pytest.mark.extras
datasets = pytest.importorskip("datasets")

LENGTHS = st.lists(st.integers(1, 6), min_size=1, max_size=5).filter(lambda lengths: max(lengths) > 1)


@pytest.fixture(scope="session", autouse=True)
def quiet():
    """No progress bars."""
    datasets.disable_progress_bars()


def columns_of(episodes, terminal=None, infos=None):
    """The columns as `imitation.data.huggingface_utils.trajectories_to_dict` makes them."""
    columns = {
        "obs": [e["obs"] for e in episodes],
        "acts": [e["action"] for e in episodes],
        "infos": infos or [[json.dumps({})] * len(e["action"]) for e in episodes],
        "terminal": terminal or [True for _ in episodes],
    }
    return columns | ({"rews": [e["reward"] for e in episodes]} if "reward" in episodes[0] else {})


def save(path, columns, features=None):
    datasets.Dataset.from_dict(columns, features=features).save_to_disk(str(path))
    return path


def cut_off(episodes):
    """Infos of Stable-Baselines3, which say of each episode whether its time limit ended it."""
    last = [json.dumps({"TimeLimit.truncated": not e["terminated"], "terminal_observation": [0]}) for e in episodes]
    return [[json.dumps({})] * (len(e["action"]) - 1) + [x] for e, x in zip(episodes, last, strict=True)]


@settings(max_examples=30)
@given(
    lengths=LENGTHS,
    ends=st.lists(st.booleans(), max_size=5),
    dtype=st.sampled_from(["<f4", "<f8"]),
    names=st.permutations(["obs", "acts", "infos", "terminal", "rews"]),
)
def test_any_lengths_ends_and_orders(tmp_path_factory, make_episodes, expected, same, lengths, ends, dtype, names):
    episodes = make_episodes(lengths, ends, dtype)
    columns = columns_of(episodes, infos=cut_off(episodes))
    path = save(tmp_path_factory.mktemp("hf") / "set", {name: columns[name] for name in names})
    demos, facts = read(path)
    same(demos, expected(episodes))
    assert (facts.format, facts.ends_assumed, facts.remarks, facts.unused) == ("hf", "", {}, ())


def test_terminal_alone_does_not_say_what_ended_an_episode(tmp_path, make_episodes):
    path = save(tmp_path / "set", columns_of(make_episodes([3, 3])))
    facts = read(path).facts
    assert facts.terminated == 0
    assert "All have 3 steps, so a time limit is assumed." in facts.ends_assumed
    assert read(path, time_limit=5).facts.terminated == 2


def test_a_fragment_is_no_end(tmp_path, make_episodes):
    assert read(save(tmp_path / "set", columns_of(make_episodes([3, 4]), [False, False]))).facts.terminated == 0


def test_infos_that_are_no_json_are_ignored(tmp_path, make_episodes):
    infos = [["{}"] * 2 + ["[" * 100_000], ["{}"] * 3 + ["{"]]
    assert read(save(tmp_path / "set", columns_of(make_episodes([3, 4]), infos=infos))).facts.terminated == 2


def test_rewards_and_actions_may_be_missing(tmp_path, make_episodes, expected, same):
    episodes = [{name: e[name] for name in ("obs", "terminated")} for e in make_episodes([3, 4])]
    path = save(tmp_path / "set", {"obs": [e["obs"] for e in episodes]})
    same(read(path).demos, expected(episodes))


def test_arrays_of_fixed_sizes_are_read(tmp_path, make_episodes, expected, same):
    episodes = make_episodes([3, 3], dtype="<f4")
    number = datasets.Value("float32")
    features = datasets.Features(
        {
            "obs": datasets.Array2D((4, 3), "float32"),
            "acts": datasets.List(datasets.List(number, length=2)),
            "infos": datasets.List(datasets.Value("string")),
            "terminal": datasets.Value("bool"),
            "rews": datasets.List(number),
        }
    )
    path = save(tmp_path / "set", columns_of(episodes, [False, False]), features)
    same(read(path).demos, expected(episodes))


def test_no_more_rows_than_wanted_are_read(tmp_path, make_episodes, expected, same):
    episodes = make_episodes([3, 4])
    path = save(tmp_path / "set", columns_of(episodes, [False, False]))
    same(read(path, max_episodes=1).demos, expected(episodes[:1]))


# What is refused -----------------------------------------------------------------------------------------------------


def test_a_set_with_splits_needs_one(tmp_path, make_episodes, expected, same):
    episodes = make_episodes([3, 4])
    made = datasets.Dataset.from_dict(columns_of(episodes, [False, False]))
    datasets.DatasetDict({"train": made, "test": made}).save_to_disk(str(tmp_path / "set"))
    with pytest.raises(InputError, match=r"has the splits test, train: give one, e\.g\. .*set/train"):
        read(tmp_path / "set")
    same(read(tmp_path / "set" / "train").demos, expected(episodes))


BAD = {
    "a row for each step": (
        {"obs": [[0.0, 1.0], [1.0, 2.0]], "acts": [[0.5], [0.5]], "rews": [0.0, 0.0]},
        "obs is one observation; expected one row of the data set for each trajectory",
    ),
    "no observations": ({"acts": [[[0.5]]]}, "has the columns acts, and no observations: expected obs or observations"),
    "discrete": ({"obs": [[[0.0], [1.0]]], "acts": [[1]]}, "actions are whole numbers"),
    "null": ({"obs": [[[0.0], [None]]], "acts": [[[0.5]]]}, "missing values"),
    "null episode": ({"obs": [[[0.0], [1.0]], None], "acts": [[[0.5]], None]}, "missing values"),
    "ragged": ({"obs": [[[0.0], [1.0, 2.0]]], "acts": [[[0.5]]]}, r"rows of different lengths, \[1, 2\]"),
    "text": ({"obs": [[["a"], ["b"]]], "acts": [[[0.5]]]}, "expected numbers"),
    "no steps": ({"obs": [[[0.0]]], "acts": [[]]}, "has no steps"),
    "empty": ({"obs": [], "acts": []}, "holds no episodes|cannot be read"),  # datasets 5.2 does not load it
    "other lengths": ({"obs": [[[0.0], [1.0]]], "acts": [[[0.5], [0.5]]]}, "has 1 steps by obs, but action 2"),
}


@pytest.mark.parametrize(("columns", "message"), BAD.values(), ids=BAD.keys())
def test_bad_rows_are_refused(tmp_path, columns, message):
    with pytest.raises(InputError, match=message):
        read(save(tmp_path / "set", columns))


@pytest.mark.parametrize("share", [0, 0.5])
@pytest.mark.parametrize("name", ["data-00000-of-00001.arrow", "state.json", "dataset_info.json"])
def test_a_damaged_set_is_refused(tmp_path, make_episodes, name, share):
    path = save(tmp_path / "set", columns_of(make_episodes([3, 4]))) / name
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "set")


def test_a_missing_library_names_the_extra(tmp_path, make_episodes, monkeypatch):
    path = save(tmp_path / "set", columns_of(make_episodes([3, 4])))
    monkeypatch.setitem(sys.modules, "datasets", None)
    with pytest.raises(InputError, match=r'datasets is missing .* pip install "eairl-jax\[hf\]"'):
        read(path)


def test_a_large_set_is_read_with_few_python_objects(tmp_path):
    """Rows become arrays as a whole: 40,000 numbers take milliseconds."""
    obs = np.arange(20_002, dtype=np.float32).reshape(2, -1, 1)
    path = save(tmp_path / "set", {"obs": obs, "acts": obs[:, 1:]})
    assert read(path).facts.steps == 20_000
