"""Small trees of arrays on disk: an `.npz` without pickled objects, and a JSON that describes the arrays."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import jax
import numpy as np

from eairl_jax.errors import InputError
from eairl_jax.types import PyTree


def named_leaves(tree: PyTree) -> dict[str, np.ndarray]:
    """The leaves of a pytree by their paths, for example "params/g/kernel"."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): np.asarray(leaf) for path, leaf in paths}


def fingerprint(tree: PyTree) -> str:
    """Twelve hexadecimal digits that depend on the paths, shapes and values of a pytree of arrays."""
    return digest(named_leaves(tree).items())


def digest(named: Iterable[tuple[str, np.ndarray]]) -> str:
    """Twelve hexadecimal digits of SHA-256 over the names, shapes and values of arrays."""
    return hashlib.sha256(b"".join(f"{name}{x.shape}".encode() + x.tobytes() for name, x in named)).hexdigest()[:12]


def write_json(path: Path, content: dict) -> None:
    """Writes JSON atomically: a reader finds the old file or the new file, never a part of one."""
    unfinished = path.with_name(path.name + ".part")
    unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    os.replace(unfinished, path)


def read_json(path: Path) -> dict:
    """Reads a JSON object.

    Raises:
      InputError: if the file does not exist or is not a JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: check the path") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as e:
        raise InputError(f"{path} is not JSON ({e}): the file is cut short or edited; write it again") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} holds {type(content).__name__}: expected a JSON object; write the file again")
    return content


def write_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Writes arrays as a compressed `.npz`, atomically."""
    unfinished = path.with_name(path.name + ".part")
    with open(unfinished, "wb") as f:
        _savez(f, arrays)
    os.replace(unfinished, path)


def _savez(file: IO[bytes], arrays: dict[str, Any]) -> None:
    np.savez_compressed(file, **arrays)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Reads every array of an `.npz`; pickled objects are refused.

    Raises:
      InputError: if the file does not exist, is cut short, or holds anything except plain arrays.
    """
    try:
        with np.lib.npyio.NpzFile(open(path, "rb"), own_fid=True, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: check the path") from None
    except Exception as e:  # NumPy, zipfile and zlib raise a dozen different exceptions for damaged files
        raise InputError(
            f"{path} is not a complete .npz of plain arrays ({e}): copy the file again, or write it again"
        ) from None
