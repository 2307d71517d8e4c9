"""Files from strangers: regular files of bounded size, JSON, and archives of plain arrays.

Nothing in a file is ever executed or unpickled. Every size is checked before the memory is taken. Whatever is wrong
raises `Damaged`; `storage` turns it into an `InputError` that names the file.
"""

from __future__ import annotations

import json
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from eairl_jax import schema
from eairl_jax.errors import InputError

MAX_JSON_BYTES = 32 * 2**20
MAX_JSON_VALUES = 1_000_000
MAX_JSON_DEPTH = 40
MAX_ARCHIVE_BYTES = 2**30
MAX_MEMBERS = 10_000
MAX_RATIO = 3
"""Arrays are at most this many times as large as their file."""
SMALL = 32 * 2**20
"""Arrays of so few bytes may be any number of times as large as their file."""
MAX_HEADER = 10_000
LONGEST = 300
"""Characters of a message."""
END_RECORD = b"PK\x05\x06"

NPY = re.compile(
    rb"\{'descr': '([<>|=]?[biufUSOV]\d{0,6})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,15}, ?)*(?:\d{1,15})?)\), ?\} *\n?"
)


class Damaged(Exception):
    """What is wrong with the content of a file, on one line: the libraries' own messages may quote a whole file."""

    def __init__(self, problem: str):
        start = "".join(character if character.isprintable() else "?" for character in problem[:LONGEST])
        super().__init__(start + ("..." if len(problem) > LONGEST else ""))


# Files ---------------------------------------------------------------------------------------------------------------


@contextmanager
def regular_file(path: Path, largest: int) -> Iterator[IO[bytes]]:
    """Opens a regular file of at most `largest` bytes for reading; never waits for a pipe.

    Raises:
      InputError: if there is no such file, or it is no regular file, too large or unreadable.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path} does not exist: check the path") from None
    except (OSError, ValueError) as e:
        raise InputError(f"{path} cannot be read ({getattr(e, 'strerror', None) or e}): check the path") from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise InputError(f"{path} is no regular file: expected a file, not a folder, pipe or device")
    with open(descriptor, "rb") as file:
        if status.st_size > largest:
            raise InputError(
                f"{path} has {status.st_size / 2**20:.0f} MiB: expected at most {largest / 2**20:.0f} MiB; give a "
                "smaller file, for example with fewer episodes"
            )
        yield file


# JSON ----------------------------------------------------------------------------------------------------------------


def parsed(content: bytes) -> Any:
    """The value of a JSON text in UTF-8: finite numbers of at most 64 bits, no name twice, no deep nesting.

    Raises:
      Damaged: for anything else.
    """
    values = sum(map(content.count, (b",", b"[", b"{")))
    if values > MAX_JSON_VALUES:
        raise Damaged(f"it holds about {values} values: expected at most {MAX_JSON_VALUES}")
    try:
        value = json.loads(content.decode("utf-8-sig"), object_pairs_hook=_unique)
    except RecursionError:
        raise Damaged("it is nested too deeply") from None
    except ValueError as e:  # also of numbers with thousands of digits
        raise Damaged(str(e)) from None
    _check_values(value)
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        raise Damaged(f"it holds {next(name for name in names if names.count(name) > 1)!r:.80} twice")
    return result


def _check_values(value: Any) -> None:
    """Walks over all values without recursion; a place is a chain of (place around it, name or position)."""
    stack: list[tuple[Any, tuple, int]] = [(value, (), 0)]
    while stack:
        value, place, depth = stack.pop()
        if depth > MAX_JSON_DEPTH:
            raise Damaged(f"it is nested more than {MAX_JSON_DEPTH} levels deep")
        if isinstance(value, dict):
            stack += [(each, (place, name), depth + 1) for name, each in value.items()]
            stack += [(name, (place, "a name"), depth + 1) for name in value]
        elif isinstance(value, list):
            stack += [(each, (place, i), depth + 1) for i, each in enumerate(value)]
        elif isinstance(value, str):
            if not value.isascii() and any("\ud800" <= character <= "\udfff" for character in value):
                raise Damaged(f"{_name(place)}: expected text of whole Unicode characters")
        elif isinstance(value, int) and abs(value) > schema.LARGEST_WHOLE:
            raise Damaged(f"{_name(place)} is {schema.shown(value)}: expected at most 64 bits")
        elif isinstance(value, float) and not abs(value) <= 1e308:
            raise Damaged(f"{_name(place)} is {value}: expected a finite number")


def _name(place: tuple) -> str:
    parts = []
    while place:
        place, part = place
        parts.append(f"[{part}]" if isinstance(part, int) else f".{ascii(part)[1:-1][: schema.SHOWN]}")
    return "".join(reversed(parts)).removeprefix(".") or "the value"


# Archives ------------------------------------------------------------------------------------------------------------


class Archive:
    """An open `.npz`: `names`, and `array(name)`. An array is read each time that it is asked for.

    Args:
      file: a regular file.

    Raises:
      Damaged: if the file is no archive, if a name comes twice, or if the arrays would be much larger than the file.
    """

    def __init__(self, file: IO[bytes]):
        size = os.fstat(file.fileno()).st_size
        _check_end(file, size)
        try:
            self._zip = zipfile.ZipFile(file)
        except Exception as e:  # zipfile raises several types for damaged files
            raise Damaged(f"{e or type(e).__name__}") from None
        members = self._zip.infolist()
        self._members = {member.filename.removesuffix(".npy"): member for member in members}
        if len(self._members) < len(members):
            names = [member.filename for member in members]
            raise Damaged(f"it holds a member twice, of {schema.listed(names)}")
        total = sum(member.file_size for member in members)
        if total > max(MAX_RATIO * size, SMALL):
            raise Damaged(
                f"its arrays have {total / 2**20:.0f} MiB, and the file {size / 2**20:.1f} MiB: expected at most "
                f"{MAX_RATIO} times the file; write it without compression, with numpy.savez"
            )
        self.names = list(self._members)

    def array(self, name: str) -> np.ndarray:
        """One array of numbers or texts.

        Raises:
          Damaged: if the member is damaged or no plain array.
        """
        member = self._members[name]
        if member.flag_bits & 0x1 or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise Damaged(f"{name!r:.80} is encrypted, or compressed in a way that numpy.savez does not know")
        try:
            with self._zip.open(member) as stream:
                return _npy(stream, member.file_size, name)
        except (zipfile.BadZipFile, zlib.error, OSError, ValueError, EOFError, NotImplementedError, RuntimeError) as e:
            raise Damaged(f"{name!r:.80}: {e or type(e).__name__}") from None

    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by their names."""
        return {name: self.array(name) for name in self.names}


def _check_end(file: IO[bytes], size: int) -> None:
    """Raises `Damaged` unless the archive's list of members is small; zipfile reads the whole list at once."""
    file.seek(max(0, size - 2**16 - 22))
    tail = file.read()
    file.seek(0)
    at = tail.rfind(END_RECORD)
    if at < 0 or len(tail) < at + 22:
        file.seek(0)
        is_array = file.read(6) == b"\x93NUMPY"
        raise Damaged("it is one array, as of an .npy" if is_array else "it is no archive, or cut short")
    if int.from_bytes(tail[at + 10 : at + 12], "little") > MAX_MEMBERS:
        raise Damaged(f"it lists more than {MAX_MEMBERS} members")
    if int.from_bytes(tail[at + 12 : at + 16], "little") > 200 * MAX_MEMBERS:
        raise Damaged("its list of members is too long")


def _npy(stream: IO[bytes], size: int, name: str) -> np.ndarray:
    """The array of an `.npy` of `size` bytes."""
    start = stream.read(12)
    versions = {b"\x93NUMPY\x01\x00": 2, b"\x93NUMPY\x02\x00": 4}
    if start[:8] not in versions:
        raise Damaged(f"{name!r:.80} is no array of NumPy")
    begin = 8 + versions[start[:8]]
    length = int.from_bytes(start[8:begin], "little")
    header = start[begin:] + stream.read(max(0, min(length, MAX_HEADER) - (12 - begin)))
    match = NPY.fullmatch(header)
    if match is None or length != len(header):
        raise Damaged(f"{name!r:.80} has the header {header[:80]!r}: expected a plain array")
    dtype, shape = _dtype(name, match[1].decode()), tuple(int(n) for n in match[3].split(b",") if n.strip())
    count = 1
    for n in shape:
        count *= n
    if count * dtype.itemsize != size - begin - length or max(shape, default=0) > max(size, 10**6) or len(shape) > 32:
        raise Damaged(f"{name!r:.80} says {shape} of {dtype}, and holds {size - begin - length} bytes")
    data = np.empty(count, dtype)
    _fill(stream, memoryview(data.view(np.uint8)) if data.nbytes else None)
    return data.reshape(shape, order="F" if match[2] == b"True" else "C")


def _fill(stream: IO[bytes], memory: memoryview | None) -> None:
    """Reads exactly as many bytes as the memory has, and checks the sum of the member."""
    at = 0
    while memory is not None and at < len(memory):
        part = stream.read(min(2**20, len(memory) - at))
        if not part:
            raise EOFError("it is cut short")
        memory[at : at + len(part)] = part
        at += len(part)
    if stream.read(1):
        raise EOFError("it is longer than it says")


def _dtype(name: str, description: str) -> np.dtype:
    try:
        dtype = np.dtype(description)
    except TypeError:
        raise Damaged(f"{name!r:.80} has the unknown type {description!r}") from None
    if dtype.kind not in "biufUS" or dtype.itemsize == 0:
        raise Damaged(f"{name!r:.80} holds {dtype}: expected numbers or texts")
    return dtype
