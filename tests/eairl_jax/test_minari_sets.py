"""Minari data sets: ours survive the way out and in bit by bit, and those of others are read or refused."""

import importlib.util
import json
import sys
import time
import tracemalloc
import warnings
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eairl_jax import Demonstrations, InputError, demonstrations, minari_sets
from eairl_jax.demonstration_files import read
from eairl_jax.envs import names, registry

pytestmark = pytest.mark.extras
minari = pytest.importorskip("minari")
pytest.importorskip("h5py")
gymnasium = pytest.importorskip("gymnasium")

SHIPPED = sorted(Path(str(files("eairl_jax.experiments") / "data")).glob("*.npz"))
LENGTHS = st.lists(st.integers(1, 6), min_size=1, max_size=5).filter(lambda lengths: max(lengths) > 1)
FORMS = ["hdf5", *(["arrow", "parquet"] if importlib.util.find_spec("pyarrow") else [])]
BOX = gymnasium.spaces.Box(-np.inf, np.inf, (3,))
ACTIONS = gymnasium.spaces.Box(-2.0, 2.0, (2,))


@pytest.fixture(autouse=True)
def root(monkeypatch, tmp_path):
    """An empty local folder of Minari."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "root"))
    return tmp_path / "root"


def create(episodes, name="other/set-v0", obs_space=BOX, action_space=ACTIONS, form="hdf5"):
    """A data set by Minari's own function."""
    buffers = [
        minari.data_collector.EpisodeBuffer(
            observations=e["obs"],
            actions=e["action"],
            rewards=list(e["reward"]),
            terminations=[False] * (len(e["reward"]) - 1) + [bool(e["terminated"])],
            truncations=[False] * len(e["reward"]),
            infos={},
        )
        for e in episodes
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        spaces = {"observation_space": obs_space, "action_space": action_space}
        return minari.create_dataset_from_buffers(name, buffers, data_format=form, **spaces)


def task_of(path):
    """The task of a shipped set, without its arguments."""
    return names.parse(demonstrations.provenance(path)["task"]).name


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_demonstrations_return_bit_by_bit_in_little_time_and_memory(path, same):
    demos = demonstrations.load(path)
    size = sum(x.nbytes for x in demos)
    start = time.perf_counter()
    task = task_of(path)
    minari_sets.write(f"{task}/expert-v0", demos, task=task)
    same(read(f"minari:{task}/expert-v0").demos, demos)
    assert time.perf_counter() - start < 5
    tracemalloc.start()
    try:
        read(f"minari:{task}/expert-v0")
        assert tracemalloc.get_traced_memory()[1] <= 2 * size + 100_000  # the libraries' objects are no data
    finally:
        tracemalloc.stop()


def test_every_task_of_ours_ships_a_set():
    assert {task_of(path) for path in SHIPPED} == set(registry.TASKS)


@settings(max_examples=30)
@given(lengths=LENGTHS, ends=st.lists(st.booleans(), max_size=5), form=st.sampled_from(FORMS), number=st.integers(0))
def test_any_lengths_and_ends_return(tmp_path_factory, make_episodes, expected, same, lengths, ends, form, number):
    demos = expected(make_episodes(lengths, ends))
    folder = tmp_path_factory.mktemp("minari") / "set-v0"
    minari_sets.write(str(folder), demos, task="toy", data_format=form)
    found, facts = read(folder)
    same(found, demos)
    assert facts.format == "minari"
    assert facts.terminated == sum(ends[: len(lengths)])


@pytest.mark.parametrize("form", FORMS)
def test_a_set_of_gymnasium_is_read(form, same, expected):
    env = minari.DataCollector(gymnasium.make("Pendulum-v1", max_episode_steps=5), data_format=form)
    rng, episodes = np.random.default_rng(0), []
    for seed in range(3):
        rows = {"obs": [env.reset(seed=seed)[0]], "action": [], "reward": [], "terminated": False}
        for _ in range(5):
            action = rng.uniform(-2, 2, 1).astype(np.float32)
            obs, reward, *_ = env.step(action)
            rows["obs"].append(obs)
            rows["action"].append(action)
            rows["reward"].append(reward)
        episodes.append({name: np.array(x) for name, x in rows.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env.create_dataset("gym/pendulum-v0")
    demos, facts = read("minari:gym/pendulum-v0", max_episodes=2)
    same(demos, expected(episodes[:2]))
    assert facts.bounds == "[-2, 2]"
    assert facts.outside == facts.terminated == 0
    assert read("minari:gym/pendulum-v0").facts.episodes == 3


def test_minari_reads_ours(make_episodes, expected):
    demos = expected(make_episodes([3, 4], [True]))
    scores = {"reference": (-10.0, 5.0), "metadata": {"algorithm_name": "PPO"}}
    minari_sets.write("ours/nested/expert-v1", demos, task="toy", action_limit=20.0, **scores)
    dataset = minari.load_dataset("ours/nested/expert-v1")
    assert [len(episode) for episode in dataset] == [3, 4]
    assert dataset[0].terminations.tolist() == [False, False, True]
    assert dataset[1].truncations.tolist() == [False, False, False, True]
    assert dataset.action_space.high.tolist() == [20.0, 20.0]
    assert dataset.action_space.contains(dataset[0].actions[0])
    assert dataset.observation_space.contains(dataset[0].observations[-1])
    metadata = dataset.storage.metadata
    assert (metadata["ref_min_score"], metadata["ref_max_score"]) == (-10.0, 5.0)
    assert (metadata["task"], metadata["algorithm_name"]) == ("toy", "PPO")
    assert list(minari.list_local_datasets()) == ["ours/nested/expert-v1"]
    assert minari.namespace.list_local_namespaces() == ["ours", "ours/nested"]


def test_a_limit_that_actions_exceed_is_no_bound_of_the_space(make_episodes, expected):
    minari_sets.write("ours/set-v0", expected(make_episodes([3, 4])), task="toy", action_limit=0.1)
    assert np.isinf(minari.load_dataset("ours/set-v0").action_space.high).all()
    assert read("minari:ours/set-v0").facts.bounds == ""


@pytest.mark.parametrize("form", FORMS)
def test_dictionary_observations_need_a_key(make_episodes, expected, same, form):
    episodes = make_episodes([3, 4], dtype="<f4")
    space = gymnasium.spaces.Dict({"state": BOX, "a": gymnasium.spaces.Box(-1, 1, (1,))})
    made = [e | {"obs": {"state": e["obs"], "a": np.ones((len(e["obs"]), 1), "f4")}} for e in episodes]
    create(made, obs_space=space, form=form)
    same(read("minari:other/set-v0", obs_key="state").demos, expected(episodes))
    assert read("minari:other/set-v0", obs_key="flatten").demos.obs[:, 0].tolist() == [1.0] * 7
    with pytest.raises(InputError, match="obs is a dictionary of a, state: choose an entry"):
        read("minari:other/set-v0")


def test_whole_numbers_in_a_box_are_continuous_and_discrete_actions_are_refused(make_episodes):
    episodes = [e | {"action": e["action"].astype(int)} for e in make_episodes([3, 4])]
    create(episodes, action_space=gymnasium.spaces.Box(-20, 20, (2,), int))
    assert read("minari:other/set-v0").demos.action.shape == (7, 2)
    episodes = [e | {"action": np.zeros(len(e["reward"]), int)} for e in episodes]
    create(episodes, "other/discrete-v0", action_space=gymnasium.spaces.Discrete(3))
    with pytest.raises(InputError, match=r"actions of Discrete\(3\): this library needs continuous actions"):
        read("minari:other/discrete-v0")


# What is refused -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["none-v0", "../none-v0", ""])
def test_an_unknown_set_is_refused(name):
    with pytest.raises(InputError, match="no Minari data set"):
        read(f"minari:{name}")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("share", [0, 0.5])
def test_a_damaged_set_is_refused(make_episodes, root, form, share):
    create(make_episodes([30, 40], dtype="<f4"), form=form)
    for path in root.rglob("*"):
        if path.suffix in (".hdf5", ".arrow", ".parquet"):
            path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError, match="other/set-v0"):
        read("minari:other/set-v0")


def test_metadata_without_spaces_or_of_another_kind_is_refused(make_episodes, root):
    create(make_episodes([3, 4]))
    path = root / "other" / "set-v0" / "data" / "metadata.json"
    metadata = json.loads(path.read_text())
    for change in ({"observation_space": None}, {"data_format": "csv"}, {"action_space": '{"type": "Moon"}'}):
        path.write_text(json.dumps({name: x for name, x in (metadata | change).items() if x is not None}))
        with pytest.raises(InputError):
            read("minari:other/set-v0")


def test_an_episode_that_goes_on_after_its_end_is_refused(make_episodes, root):
    h5py = pytest.importorskip("h5py")
    create(make_episodes([3, 4]))
    with h5py.File(root / "other" / "set-v0" / "data" / "main_data.hdf5", "a") as file:
        file["episode_1"]["terminations"][1] = True
    with pytest.raises(InputError, match="episode 1 ends at step 1, and has 4 steps"):
        read("minari:other/set-v0")


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("set", {}, "set is no name of a Minari data set: .* for example set-v0"),
        ("a b/set-v0", {}, "is no name of a Minari data set"),
        ("taken/set-v0", {}, "exists: choose another name or version"),
        ("ours/set-v0", {"action": None}, "have no action, which Minari demands"),
        ("ours/set-v0", {"action": None, "reward": None}, "have no action and no reward"),
        (
            "ours/set-v0",
            {"next_obs": np.zeros((7, 3), np.float32)},
            "episode 0: next_obs at step 0 is not obs",
        ),
    ],
)
def test_what_minari_cannot_hold_is_refused_and_leaves_nothing(make_episodes, expected, root, name, change, message):
    demos = expected(make_episodes([3, 4]))
    minari_sets.write("taken/set-v0", demos, task="toy")
    with pytest.raises(InputError, match=message):
        minari_sets.write(name, Demonstrations(**demos._asdict() | change), task="toy")
    assert list(minari.list_local_datasets()) == ["taken/set-v0"]
    assert not list(root.rglob("*.part"))


def test_an_unknown_form_is_refused(make_episodes, expected):
    with pytest.raises(InputError, match="unknown form 'csv'"):
        minari_sets.write("ours/set-v0", expected(make_episodes([3, 4])), task="toy", data_format="csv")


@pytest.mark.parametrize(
    ("module", "form", "extra"), [("minari", "hdf5", "minari"), ("h5py", "hdf5", "minari"), ("pyarrow", "arrow", "hf")]
)
def test_a_missing_library_names_the_extra(make_episodes, expected, monkeypatch, module, form, extra):
    demos = expected(make_episodes([3, 4]))
    if form in FORMS:
        minari_sets.write("ours/set-v0", demos, task="toy", data_format=form)
    monkeypatch.setitem(sys.modules, module, None)
    message = rf'{module} is missing .* pip install "eairl-jax\[{extra}\]"'
    with pytest.raises(InputError, match=message):
        minari_sets.write("ours/set-v1", demos, task="toy", data_format=form)
    if form in FORMS:
        with pytest.raises(InputError, match=message):
            read("minari:ours/set-v0")
