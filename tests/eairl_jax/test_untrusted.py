"""Files from strangers are regular and bounded, and nothing in them is believed before it is checked."""

import os
import threading
import tracemalloc
import zipfile

import numpy as np
import pytest

from eairl_jax import InputError, storage, untrusted

BOTH = pytest.mark.parametrize("read", [storage.read_arrays, storage.read_json])


@BOTH
@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "no name", "too long", "below a file"])
def test_what_is_no_regular_file_is_refused_and_never_waited_for(tmp_path, read, kind):
    (tmp_path / "file").write_text("{}")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    paths = {"folder": tmp_path, "pipe": tmp_path / "pipe", "device": tmp_path / "zero", "no name": tmp_path / "a\0b"}
    paths |= {"too long": tmp_path / ("x" * 5000), "below a file": tmp_path / "file" / "x"}
    outcome = []

    def attempt():
        try:
            read(paths[kind])
        except InputError as e:
            outcome.append(str(e))

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(5)
    assert outcome, "it waits, or another exception was raised"
    assert any(words in outcome[0] for words in ("is no regular file", "cannot be read", "does not exist"))


@BOTH
def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path, read):
    with open(tmp_path / "x", "wb") as f:
        f.truncate(untrusted.MAX_ARCHIVE_BYTES + 1)
    with pytest.raises(InputError, match=r"has 1024 MiB: expected at most"):
        read(tmp_path / "x")


JSON = {
    "NaN": ('{"a": [NaN]}', r"a\[0\] is nan: expected a finite number"),
    "infinite": ('{"a": [0, 1e999]}', r"a\[1\] is inf: expected a finite number"),
    "huge": ('{"a": ' + "9" * 30 + "}", "a is .*: expected at most 64 bits"),
    "thousands of digits": ('{"a": ' + "9" * 5000 + "}", "digits"),
    "deep": ("[" * 60 + "]" * 60, "nested more than 40"),
    "very deep": ('{"a":' * 100_000, "nested too deeply|not JSON"),
    "twice": ('{"a": 1, "a": 2}', "holds 'a' twice"),
    "half a character": ('{"a": "\\ud800"}', "whole Unicode"),
    "half a character in a name": ('{"\\udfff": 1}', "whole Unicode"),
    "many": ("[" + "0," * 1_000_001 + "0]", "expected at most 1000000"),
}


@pytest.mark.parametrize(("text", "message"), JSON.values(), ids=JSON)
def test_json_that_no_reader_expects_is_refused(text, message):
    with pytest.raises(untrusted.Damaged, match=message):
        untrusted.parsed(text.encode())


def test_a_mark_of_byte_order_is_no_content():
    assert untrusted.parsed(b'\xef\xbb\xbf{"a": 1.5}') == {"a": 1.5}


def npy(dtype="<f4", shape="(2,)", data=bytes(8)):
    """The bytes of an `.npy` with any header."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


def archive(path, members, **options):
    """Writes an archive of `(name, bytes)`."""
    with zipfile.ZipFile(path, "w", **options) as f:
        for name, data in members:
            f.writestr(name, data)
    return path


MEMBERS = {
    "twice": ([("a.npy", npy()), ("a.npy", npy())], "holds a member twice"),
    "twice with and without suffix": ([("a.npy", npy()), ("a", npy())], "holds a member twice"),
    "objects": ([("a.npy", npy("|O"))], "holds object: expected numbers or texts"),
    "records": ([("a.npy", npy("|V8"))], "expected numbers or texts"),
    "unknown type": ([("a.npy", npy("<f3"))], "unknown type"),
    "code in the header": ([("a.npy", npy(shape="(__import__('os'),)"))], "expected a plain array"),
    "larger than it is": ([("a.npy", npy(shape="(1000000000000,)"))], "holds 8 bytes"),
    "smaller than it is": ([("a.npy", npy(shape="(1,)"))], "holds 8 bytes"),
    "negative": ([("a.npy", npy(shape="(-2,)"))], "expected a plain array"),
    "many empty rows": ([("a.npy", npy(shape="(0, 1000000000000)", data=b""))], "says"),
    "a text": ([("a.npy", b"hello")], "no array of NumPy"),
    "nothing": ([("a.npy", b"")], "no array of NumPy"),
}


@pytest.mark.parametrize(("members", "message"), MEMBERS.values(), ids=MEMBERS)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_members_that_are_no_plain_arrays_are_refused(tmp_path, members, message):
    with pytest.raises(InputError, match=rf"not a complete \.npz of plain arrays .*{message}"):
        storage.read_arrays(archive(tmp_path / "x.npz", members))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_are_refused(tmp_path, method):
    with pytest.raises(InputError, match="compressed in a way"):
        storage.read_arrays(archive(tmp_path / "x.npz", [("a.npy", npy())], compression=method))


def test_arrays_that_are_read_are_those_of_numpy(tmp_path):
    arrays = {
        "f": np.arange(6.0).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6, dtype=">i2").reshape(2, 3)),
        "scalar": np.array(3, np.uint8),
        "text": np.array("pendulum"),
        "bytes": np.array(b"pendulum"),
        "bool": np.array([True, False]),
        "empty": np.zeros((0, 4), np.float32),
    }
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "x.npz", **arrays)
        for name, x in storage.read_arrays(tmp_path / "x.npz").items():
            assert (x.dtype, x.shape) == (arrays[name].dtype, arrays[name].shape)
            np.testing.assert_array_equal(x, arrays[name])


def test_a_bomb_is_refused_without_the_memory(tmp_path):
    size = 2 * untrusted.SMALL
    archive(tmp_path / "x.npz", [("a.npy", npy("|u1", f"({size},)", bytes(size)))], compression=zipfile.ZIP_DEFLATED)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"its arrays have 64 MiB, and the file 0\.1 MiB: .*numpy\.savez"):
        storage.read_arrays(tmp_path / "x.npz")
    assert tracemalloc.get_traced_memory()[1] < 4e6
    tracemalloc.stop()


def test_a_list_of_many_members_is_refused_before_it_is_read(tmp_path):
    with open(tmp_path / "x.npz", "wb") as f:
        f.write(untrusted.END_RECORD + bytes(6) + (60_000).to_bytes(2, "little") + bytes(10))
    with pytest.raises(InputError, match="lists more than 10000 members"):
        storage.read_arrays(tmp_path / "x.npz")


def test_what_we_write_is_never_too_small_to_be_read(tmp_path):
    arrays = {"a": np.zeros(untrusted.SMALL // 4 + 1, np.float32)}
    storage.write_arrays(tmp_path / "x.npz", arrays)
    assert storage.read_arrays(tmp_path / "x.npz")["a"].shape == arrays["a"].shape


def test_memory_is_a_few_times_the_file(tmp_path):
    np.savez(tmp_path / "x.npz", a=np.ones(2_000_000))
    tracemalloc.start()
    storage.read_arrays(tmp_path / "x.npz")
    assert tracemalloc.get_traced_memory()[1] < 1.5 * (tmp_path / "x.npz").stat().st_size
    tracemalloc.stop()


def test_an_array_that_nobody_asks_for_may_be_anything(tmp_path):
    np.savez(tmp_path / "x.npz", good=np.ones(2), objects=np.array([{}], dtype=object))
    with storage.archive(tmp_path / "x.npz") as opened:
        assert opened.names == ["good", "objects"]
        np.testing.assert_array_equal(opened.array("good"), [1, 1])
