"""Small trees of arrays on disk: an `.npz` without pickled objects, and a JSON that describes the arrays."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from eairl_jax import schema, untrusted
from eairl_jax.errors import InputError
from eairl_jax.schema import Schema

if TYPE_CHECKING:
    from eairl_jax.types import PyTree

REWRITE = "write the file again, with the command that made it"


def named_leaves(tree: PyTree) -> dict[str, np.ndarray]:
    """The leaves of a pytree by their paths, for example "params/g/kernel"."""
    import jax  # here, because files are also read by programs without jax

    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): np.asarray(leaf) for path, leaf in paths}


def fingerprint(tree: PyTree) -> str:
    """Twelve hexadecimal digits that depend on the paths, shapes and values of a pytree of arrays."""
    return digest(named_leaves(tree).items())


def digest(named: Iterable[tuple[str, np.ndarray]]) -> str:
    """Twelve hexadecimal digits of SHA-256 over the names, shapes and values of arrays."""
    return hashlib.sha256(b"".join(f"{name}{x.shape}".encode() + x.tobytes() for name, x in named)).hexdigest()[:12]


CHECKSUM, SEALED = "checksum", "sealed"
"""The member of a file that says what the rest of the file was when it was written; the first of a JSON that has it."""


def checksum(arrays: Mapping[str, np.ndarray], content: Any = None) -> str:
    """Sixteen hexadecimal digits of SHA-256 over arrays and a JSON value, without those named `CHECKSUM`."""
    total = hashlib.sha256()
    for name in sorted(set(arrays) - {CHECKSUM}):
        x = arrays[name]
        total.update(f"{name} {x.dtype.str} {x.shape}".encode())
        if x.size:
            total.update(np.ascontiguousarray(x).reshape(-1).view(np.uint8).data)
    if isinstance(content, dict):
        content = {name: value for name, value in content.items() if name != CHECKSUM}
    total.update(json.dumps(content, sort_keys=True).encode())
    return total.hexdigest()[:16]


def refuse_changed(where: Path | str, found: Any, expected: str) -> None:
    """Raises `InputError` if the checksum of a file differs from `expected`, or is no text.

    Args:
      found: the checksum in the file; None if its version writes none, or if a user has removed it.
    """
    if found is not None and str(found) != expected:
        raise InputError(
            f"{where} is not as it was written (its {CHECKSUM} differs): copy it again; if you have changed it on "
            f"purpose, remove {CHECKSUM} from it (from a JSON also {SEALED})"
        )


def sealed(content: dict, arrays: Mapping[str, np.ndarray] | None = None) -> dict:
    """The content of a JSON with a first and a last member that say whether it is whole; see `unsealed`."""
    content = {SEALED: True} | content
    return content | {CHECKSUM: checksum(arrays or {}, content)}


def unsealed(content: dict, where: Path | str, arrays: Mapping[str, np.ndarray] | None = None) -> dict:
    """The content of a JSON that `sealed` made, without its additions. Earlier versions made none.

    Args:
      where: what to call the file in an error message.
      arrays: that stand in another file, and belong to the content.

    Raises:
      InputError: if the content or the arrays have changed since.
    """
    if content.get(SEALED, True) is not True or (SEALED in content) != (CHECKSUM in content):
        raise InputError(f"{where} has lost a part: copy it again; without {SEALED} and {CHECKSUM} it is not compared")
    refuse_changed(where, content.get(CHECKSUM), checksum(arrays or {}, content))
    return {name: value for name, value in content.items() if name not in (SEALED, CHECKSUM)}


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the path of a file to write. At the end of the context this file takes the place of `path`.

    A reader finds the old file or the new file, never a part of one, even if the process is killed. If the context
    fails, the old file stays.

    Raises:
      OSError: if the file cannot be written, with its path.
    """
    unfinished = path.with_name(path.name + ".part")
    with naming(path):
        try:
            yield unfinished
            os.replace(unfinished, path)
        except OSError:  # a part of a file would only take the place that a full disk lacks
            with suppress(OSError):
                unfinished.unlink()
            raise


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Gives an `OSError` that names no file, for example of a full disk, the path that was written."""
    try:
        yield
    except OSError as e:
        if e.filename is None and e.errno is not None:
            raise OSError(e.errno, e.strerror, str(path)) from e
        raise


def reserve(folder: Path, size: int) -> None:
    """Tries whether a folder can take `size` bytes more. Nothing is left of the trial.

    Raises:
      OSError: if the disk is full, or the user's share of it.
    """
    path = folder / ".space"
    with naming(folder):
        try:
            with open(path, "wb") as f:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(f.fileno(), 0, size)
                elif shutil.disk_usage(folder).free < size:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        finally:
            path.unlink(missing_ok=True)


def write_json(path: Path, content: dict) -> None:
    """Writes JSON, atomically (`replacing`)."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def read_json(path: Path, expected: Schema | None = None, advice: str = REWRITE) -> dict:
    """Reads a JSON object from a file that may come from a stranger (`untrusted`).

    Args:
      expected: what the object must look like; any object if None.
      advice: how to mend the file, for the error message.

    Raises:
      InputError: if there is no such regular file, or if it does not hold such an object.
    """
    with untrusted.regular_file(path, untrusted.MAX_JSON_BYTES) as file:
        text = file.read(os.fstat(file.fileno()).st_size)  # a larger number would be allocated at once
    try:
        content = untrusted.parsed(text)
    except untrusted.Damaged as e:
        raise InputError(f"{path} is not JSON ({e}): {advice}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} holds {schema.shown(content)}: expected a JSON object; {advice}")
    return check(content, expected, path, advice) if expected else content


def check(content: Any, expected: Schema, where: Path | str, advice: str = REWRITE) -> Any:
    """The content of a file, if it is as expected.

    Args:
      where: what to call the file in an error message.
      advice: how to mend the file, for the error message.

    Raises:
      InputError: if it is not; the message names the place in the file.
    """
    try:
        return expected(content, "")
    except schema.Mismatch as e:
        if isinstance(e.found, schema.Absent):
            raise InputError(f"{where} lacks {e.place}: {advice}") from None
        raise InputError(f"{where}: {e}: {advice}") from None


def as_json(content: Any, expected: Schema, what: str) -> dict:
    """What a reader of the file will find, before it is written.

    Raises:
      InputError: if it cannot be written as JSON, or if it is not as expected.
    """
    try:
        text = json.dumps(content, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as e:
        raise InputError(f"{what} cannot be written as JSON ({e}): give texts and finite numbers of Python") from None
    return check(json.loads(text), expected, what, "give what is expected")


def write_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Writes arrays as an `.npz`, atomically: compressed, unless that makes the file so small that none may read it."""
    with replacing(path) as unfinished:
        with open(unfinished, "wb") as f:
            _savez(f, arrays)
        size = sum(x.nbytes for x in arrays.values())
        if size > untrusted.SMALL // 2 and size > untrusted.MAX_RATIO / 2 * unfinished.stat().st_size:
            with open(unfinished, "wb") as f:
                _save_plain(f, arrays)


def _savez(file: IO[bytes], arrays: dict[str, Any]) -> None:
    np.savez_compressed(file, **arrays)


def _save_plain(file: IO[bytes], arrays: dict[str, Any]) -> None:
    np.savez(file, **arrays)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Reads every array of an `.npz` that may come from a stranger; pickled objects are refused.

    Raises:
      InputError: as `archive`.
    """
    with archive(path) as opened:
        return opened.arrays()


@contextmanager
def archive(path: Path) -> Iterator[untrusted.Archive]:
    """Opens an `.npz` that may come from a stranger, to read its arrays one by one.

    Raises:
      InputError: if there is no such regular file, or if what is read of it is anything except plain arrays.
    """
    with untrusted.regular_file(path, untrusted.MAX_ARCHIVE_BYTES) as file:
        try:
            yield untrusted.Archive(file)
        except untrusted.Damaged as e:
            raise InputError(
                f"{path} is not a complete .npz of plain arrays ({e}): copy the file again, or write it again"
            ) from None
