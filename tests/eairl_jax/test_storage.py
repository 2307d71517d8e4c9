"""Trees of arrays on disk, whole or refused."""

import io

import jax
import numpy as np
import pytest
from flax.traverse_util import unflatten_dict

from eairl_jax import InputError, storage

ARRAYS = {"a": np.arange(600.0, dtype=np.float32).reshape(3, 200), "b/c": np.array(7, np.int32)}


def test_leaves_are_named_by_their_paths_and_nest_again(equal_trees):
    tree = {"params": {"g": {"kernel": np.ones((2, 3)), "bias": np.zeros(3)}}, "count": np.array(4)}
    leaves = storage.named_leaves(tree)
    assert set(leaves) == {"params/g/kernel", "params/g/bias", "count"}
    equal_trees(unflatten_dict(leaves, sep="/"), tree)


def test_arrays_round_trip_and_leave_nothing_behind(tmp_path, equal_trees):
    for scale in (1, 2):  # the second time over the first
        arrays = jax.tree.map(lambda x, scale=scale: x * scale, ARRAYS)
        storage.write_arrays(tmp_path / "x.npz", arrays)
        equal_trees(storage.read_arrays(tmp_path / "x.npz"), arrays)
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_json_round_trips_and_leaves_nothing_behind(tmp_path):
    content = {"task": "pendulum", "sizes": [3, 1], "nested": {"lr": 1e-3, "none": None}}
    storage.write_json(tmp_path / "x.json", content)
    assert storage.read_json(tmp_path / "x.json") == content
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]


def whole():
    """The bytes of a good archive."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **ARRAYS)
    return stream.getvalue()


def saved(save, value):
    """The bytes that one of NumPy's functions writes."""
    stream = io.BytesIO()
    save(stream, value)
    return stream.getvalue()


UNREADABLE = {
    "cut in the middle": lambda: whole()[: len(whole()) // 2],
    "cut near the end": lambda: whole()[:-10],
    "empty": lambda: b"",
    "text": lambda: b"these are no arrays\n",
    "a single .npy": lambda: saved(np.save, np.zeros(3)),
    "pickled objects": lambda: saved(np.savez, np.array([{"a": 1}, None], dtype=object)),
    "a bare pickle": lambda: saved(lambda f, x: np.save(f, x, allow_pickle=True), np.array([{}], dtype=object)),
}


@pytest.mark.parametrize("content", UNREADABLE.values(), ids=UNREADABLE.keys())
def test_what_is_no_whole_archive_of_plain_arrays_is_refused(tmp_path, content):
    path = tmp_path / "x.npz"
    path.write_bytes(content())
    with pytest.raises(InputError, match=r"x\.npz is not a complete \.npz of plain arrays"):
        storage.read_arrays(path)


def test_damage_anywhere_is_refused_in_the_same_words(tmp_path):
    """NumPy, zipfile and zlib have an exception of their own for every byte; the reader meets one."""
    good, path, refused = whole(), tmp_path / "x.npz", 0
    for i in range(0, len(good), 7):
        path.write_bytes(good[:i] + bytes([good[i] ^ 255]) + good[i + 1 :])
        try:
            storage.read_arrays(path)  # some bytes, a time stamp's for one, say nothing
        except InputError as e:
            refused += "is not a complete .npz" in str(e)
    assert refused > 0.7 * len(good) / 7


@pytest.mark.parametrize("content", ['{"a": 1', "", "[1, 2]", b"\xff\xfe\x00"], ids=["cut", "empty", "list", "bytes"])
def test_what_is_no_json_object_is_refused(tmp_path, content):
    path = tmp_path / "x.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=r"x\.json (is not JSON|holds \[1, 2\]: expected a JSON object)"):
        storage.read_json(path)


@pytest.mark.parametrize("read", [storage.read_arrays, storage.read_json])
def test_a_file_that_is_not_there_is_named(tmp_path, read):
    with pytest.raises(InputError, match=r"missing does not exist"):
        read(tmp_path / "missing")


def test_a_file_that_cannot_be_written_is_named_and_leaves_no_part(tmp_path):
    path = tmp_path / "a.json"
    storage.write_json(path, {"a": 1})

    def write_a_part():
        with storage.replacing(path) as unfinished:
            unfinished.write_text("{")
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match=r"No space left on device: .*a\.json"):
        write_a_part()
    assert [each.name for each in tmp_path.iterdir()] == ["a.json"]
    assert storage.read_json(path) == {"a": 1}
