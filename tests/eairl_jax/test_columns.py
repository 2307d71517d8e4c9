"""Flat and stacked columns, in .npz and in HDF5: where episodes end, what is assumed, and what is refused."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eairl_jax import InputError, demonstrations
from eairl_jax.columns import read_npz
from eairl_jax.demonstration_files import read
from eairl_jax.episodes import Options

LENGTHS = st.lists(st.integers(1, 6), min_size=1, max_size=5).filter(lambda lengths: max(lengths) > 1)
REALS = ("<f4", "<f8", ">f8", ">f4", "<f2")


def write_npz(path, columns):
    np.savez(path.with_suffix(".npz"), **columns)
    return path.with_suffix(".npz")


def write_hdf5(path, columns):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path.with_suffix(".hdf5"), "w") as file:
        for name, x in columns.items():
            file[name] = x
    return path.with_suffix(".hdf5")


WRITERS = [write_npz, pytest.param(write_hdf5, marks=pytest.mark.extras)]


@pytest.mark.parametrize("write", WRITERS)
@given(lengths=LENGTHS, ends=st.lists(st.booleans(), max_size=5), dtype=st.sampled_from(REALS), data=st.data())
def test_any_lengths_types_and_orders(
    tmp_path_factory, make_episodes, expected, flat_columns, same, write, lengths, ends, dtype, data
):
    episodes = make_episodes(lengths, ends, dtype)
    columns = flat_columns(episodes)
    columns = {name: columns[name] for name in data.draw(st.permutations(list(columns)))}
    demos, facts = read(write(tmp_path_factory.mktemp("d4rl") / "x", columns))
    same(demos, expected(episodes))
    assert facts.remarks == {}
    assert facts.converted.get("obs") == (None if dtype == "<f4" else facts.converted["action"])


@pytest.mark.parametrize("write", WRITERS)
@given(lengths=LENGTHS, ends=st.lists(st.booleans(), max_size=5))
def test_without_next_obs_the_last_step_has_no_successor(
    tmp_path_factory, make_episodes, expected, flat_columns, same, write, lengths, ends
):
    episodes = make_episodes(lengths, ends)
    kept = []
    for e in episodes:
        if e["terminated"]:
            kept.append(e | {"obs": np.concatenate([e["obs"][:-1], e["obs"][-2:-1]])})
        elif len(e["reward"]) > 1:
            kept.append({"obs": e["obs"][:-1], "action": e["action"][:-1], "reward": e["reward"][:-1], "terminated": 0})
    path = write(tmp_path_factory.mktemp("d4rl") / "x", flat_columns(episodes, with_next_obs=False))
    if max((len(e["reward"]) for e in kept), default=0) < 2:
        with pytest.raises(InputError, match=r"holds no episodes|have one step"):
            read(path)
        return
    demos, facts = read(path)
    same(demos, expected(kept))
    assert sum(facts.remarks.values()) == len(episodes)
    assert "the last" in " ".join(facts.lines())


def test_without_time_limits_an_episode_ends_at_a_jump(tmp_path, make_episodes, expected, flat_columns, same):
    episodes = make_episodes([3, 4, 2], [True])
    columns = flat_columns(episodes)
    del columns["timeouts"]
    demos, facts = read(write_npz(tmp_path / "x", columns))
    same(demos, expected(episodes))
    lines = " ".join(facts.lines())
    assert "1 episode ended where next_obs is not the obs of the next row" in lines
    assert "1 episode stopped without a flag" in lines


def test_without_time_limits_and_next_obs_a_given_limit_cuts(tmp_path, make_episodes, flat_columns):
    columns = flat_columns(make_episodes([7, 3], [True, True]), with_next_obs=False)
    del columns["timeouts"]
    path = write_npz(tmp_path / "x", columns)
    demos, facts = read(path, time_limit=4)
    assert demos.lengths.tolist() == [3, 3, 3]  # four steps without the last; three that the task ended; three
    assert facts.terminated == 2
    assert "1 episode ended after the time limit" in " ".join(facts.lines())
    assert read(path).demos.lengths.tolist() == [7, 3]


@given(lengths=LENGTHS, ends=st.lists(st.booleans(), max_size=5), limit=st.integers(2, 7))
def test_episodes_are_cut_at_the_time_limit_and_no_end_is_left(
    tmp_path_factory, make_episodes, flat_columns, expected, same, lengths, ends, limit
):
    episodes = make_episodes(lengths, ends)
    is_long = [n > limit for n in lengths]
    kept = [
        e
        | {"obs": e["obs"][: limit + 1], "action": e["action"][:limit], "reward": e["reward"][:limit]}
        | ({"terminated": False} if long else {})
        for e, long in zip(episodes, is_long, strict=True)
    ]
    folder = tmp_path_factory.mktemp("cut")
    ours = demonstrations.save(folder / "ours.npz", expected(episodes), {"task": "toy"})
    for path in (write_npz(folder / "x", flat_columns(episodes)), ours):
        demos, facts = read(path, time_limit=limit)
        same(demos, expected(kept))
        assert sum(facts.remarks.values()) == sum(is_long)


@pytest.mark.parametrize("name", ["lengths", "episode_starts"])
def test_boundaries_may_stand_in_a_column(tmp_path, make_episodes, flat_columns, expected, same, name):
    episodes = make_episodes([3, 1, 4], [False, True])
    columns = flat_columns(episodes)
    del columns["timeouts"]
    lengths = np.array([3, 1, 4])
    columns[name] = lengths if name == "lengths" else np.isin(np.arange(8), np.cumsum(lengths) - lengths)
    same(read(write_npz(tmp_path / "x", columns)).demos, expected(episodes))


def test_boundaries_without_flags_are_said(tmp_path, make_episodes, flat_columns):
    columns = flat_columns(make_episodes([3, 4]))
    columns = {n: x for n, x in columns.items() if n not in ("terminals", "timeouts")} | {"lengths": np.array([3, 4])}
    assert "2 episodes stopped without a flag" in " ".join(read(write_npz(tmp_path / "x", columns)).facts.lines())


def test_dones_alone_leave_the_end_unexplained(tmp_path, make_episodes, flat_columns):
    columns = flat_columns(make_episodes([3, 4]))
    columns["dones"] = columns.pop("terminals") | columns.pop("timeouts")
    facts = read(write_npz(tmp_path / "x", columns)).facts
    assert facts.terminated == 2
    assert "do not say what ended 2 episodes" in facts.ends_assumed


# Stacked columns -----------------------------------------------------------------------------------------------------


def stack(episodes, length):
    """`[E, length, ...]` padded with 99, which no step holds."""

    def padded(x, rows):
        return np.concatenate([x, np.full((rows - len(x), *x.shape[1:]), 99.0)])

    names = ("obs", "action", "reward")
    return {name: np.stack([padded(e[name], length + (name == "obs")) for e in episodes]) for name in names}


def test_stacked_arrays_with_one_observation_more(tmp_path, make_episodes, expected, same):
    episodes = make_episodes([4, 4, 4], [True])
    columns = stack(episodes, 4) | {"terminated": np.eye(4)[[3] * 3] * [[1], [0], [0]]}
    same(read(write_npz(tmp_path / "x", columns)).demos, expected(episodes))


def test_stacked_arrays_with_padding(tmp_path, make_episodes, expected, same):
    episodes = make_episodes([4, 2, 3])
    columns = stack(episodes, 4) | {"lengths": np.array([4, 2, 3])}
    same(read(write_npz(tmp_path / "x", columns)).demos, expected(episodes))


def test_stacked_observations_alone(tmp_path, make_episodes, expected, same):
    episodes = [{name: e[name] for name in ("obs", "terminated")} for e in make_episodes([4, 4])]
    same(read(write_npz(tmp_path / "x", {"obs": np.stack([e["obs"] for e in episodes])})).demos, expected(episodes))


def test_stacked_arrays_without_next_obs_lose_their_last_step(tmp_path, make_episodes):
    columns = stack(make_episodes([4, 4]), 4)
    columns["obs"] = columns["obs"][:, :-1]
    demos, facts = read(write_npz(tmp_path / "x", columns))
    assert demos.lengths.tolist() == [3, 3]
    assert "2 episodes lost the last step" in " ".join(facts.lines())


# Files of this library -----------------------------------------------------------------------------------------------


def test_files_of_this_library_are_read_as_load_reads_them(tmp_path, make_episodes, expected, same):
    demos = expected(make_episodes([3, 5], [True]))
    path = demonstrations.save(tmp_path / "x.npz", demos, {"task": "toy"})
    found, facts = read(path, task="toy", action_limit=2.0)
    same(found, demos)
    assert (facts.episodes, facts.longest, facts.terminated) == (2, 5, 1)
    assert facts.outside == (np.abs(demos.action) > 2).any(axis=1).sum()
    same(read(path, max_episodes=1).demos, expected(make_episodes([3, 5], [True])[:1]))
    with pytest.raises(InputError, match="demonstrates 'toy', not 'ant'"):
        read(path, task="ant")


def test_files_of_earlier_versions_are_read(tmp_path, make_episodes, expected, same):
    episodes = make_episodes([4, 4], dtype="<f4")
    wanted = expected(episodes)
    arrays = {n: x.reshape(2, 4, *x.shape[1:]) for n, x in wanted._asdict().items() if n != "lengths"}
    for extra in ({"task": np.asarray("toy")}, {}):
        same(read(write_npz(tmp_path / "x", arrays | extra)).demos, wanted)


# What is refused -----------------------------------------------------------------------------------------------------


def without(*names):
    return lambda columns: [columns.pop(name) for name in names]


def changed(**fields):
    return lambda columns: columns.update(fields)


BAD = {
    "no observations": (without("observations"), r"has the columns actions, .*, and no observations: expected obs or"),
    "no ends": (without("terminals", "timeouts"), r"nothing says where an episode ends; found action, next_obs, obs"),
    "rows missing": (changed(rewards=np.zeros(6)), "reward has 6 rows, and obs 7"),
    "wrong lengths": (changed(lengths=np.array([3, 3])), "whose sum is the 7 steps; found int64"),
    "lengths of 0": (changed(lengths=np.array([7, 0])), "whole numbers of at least 1"),
    "lengths in pieces": (changed(lengths=np.array([3.5, 3.5])), "whole numbers of at least 1"),
    "late start": (changed(episode_starts=np.eye(7)[1]), "episode_starts is 0 at the first step"),
    "end inside": (changed(lengths=np.array([4, 3])), "ended an episode at row 2, but the episode goes on"),
    "no flags": (changed(terminals=np.full(7, 255)), "terminated holds 255: expected 0 or 1"),
    "two names": (changed(obs=np.zeros((7, 3))), "obs and observations, which mean the same"),
    "NaN": (changed(observations=np.full((7, 3), np.nan)), "NaN or infinite"),
    "text": (changed(observations=np.full((7, 3), "x")), "expected numbers"),
    "discrete": (changed(actions=np.zeros(7, np.int64)), "actions are whole numbers"),
    "images": (changed(observations=np.zeros((7, 3, 3)), next_observations=np.zeros((7, 3, 3))), "flatten"),
    "nothing": (lambda columns: columns.update({name: x[:0] for name, x in columns.items()}), "holds no episodes"),
}


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD.keys())
def test_bad_columns_are_refused(tmp_path, make_episodes, flat_columns, write, change, message):
    columns = flat_columns(make_episodes([3, 4], [True]))
    change(columns)
    if write is write_hdf5:
        columns = {n: x.astype("S1") if x.dtype.kind == "U" else x for n, x in columns.items()}
    with pytest.raises(InputError, match=message):
        read(write(tmp_path / "x", columns))


def test_stacked_arrays_that_do_not_agree_are_refused(tmp_path, make_episodes):
    columns = stack(make_episodes([4, 4]), 4)
    with pytest.raises(InputError, match="has 2 episodes by obs, but reward 1"):
        read(write_npz(tmp_path / "x", columns | {"reward": columns["reward"][:1]}))
    with pytest.raises(InputError, match="lengths must be whole numbers of at most 4"):
        read(write_npz(tmp_path / "x", columns | {"lengths": np.array([4, 5])}))


@pytest.mark.parametrize("write", WRITERS)
def test_columns_that_are_not_read_are_named_and_may_hold_anything(
    tmp_path, make_episodes, flat_columns, expected, same, write
):
    episodes = make_episodes([3, 4])
    columns = flat_columns(episodes) | {"infos": np.array([{}] * 7) if write is write_npz else np.zeros(7)}
    demos, facts = read(write(tmp_path / "x", columns))
    same(demos, expected(episodes))
    assert "Columns that were not read: infos." in facts.lines()


@pytest.mark.parametrize("write", WRITERS)
@given(share=st.floats(0.0, 0.99))
def test_a_file_that_is_cut_short_is_refused(tmp_path_factory, make_episodes, flat_columns, write, share):
    path = write(tmp_path_factory.mktemp("cut") / "x", flat_columns(make_episodes([3, 4])))
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError):
        read(path)


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(InputError, match="no regular file"):
        read(tmp_path / "pipe.npz")
    np.save(tmp_path / "x.npy", np.zeros(3))
    with pytest.raises(InputError, match="it is one array"):
        read(tmp_path / "x.npy", "npz")
    with pytest.raises(InputError, match="does not exist"):
        read_npz(str(tmp_path / "none.npz"), Options())


# HDF5 ----------------------------------------------------------------------------------------------------------------


@pytest.mark.extras
def test_a_group_of_observations_needs_a_key(tmp_path, make_episodes, flat_columns, expected, same):
    episodes = make_episodes([3, 4])
    columns = flat_columns(episodes)
    for name in ("observations", "next_observations"):
        columns[f"{name}/state"] = columns.pop(name)
        columns[f"{name}/image"] = np.zeros((7, 2, 2))
    path = write_hdf5(tmp_path / "x", columns)
    same(read(path, obs_key="state").demos, expected(episodes))
    assert read(path, obs_key="flatten").demos.obs.shape == (7, 7)
    with pytest.raises(InputError, match="obs is a dictionary of image, state: choose an entry"):
        read(path)
