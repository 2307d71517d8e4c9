"""Small trees of arrays on disk: an `.npz` without pickled objects beside a JSON that describes it."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import jax
import numpy as np

from eairl_jax.errors import InputError
from eairl_jax.types import PyTree


def named_leaves(tree: PyTree) -> dict[str, np.ndarray]:
    """The leaves of a pytree, each under its path ("params/g/...")."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): np.asarray(leaf) for path, leaf in paths}


def fingerprint(tree: PyTree) -> str:
    """Twelve characters that tell these arrays from others, by their names, shapes and values."""
    named = named_leaves(tree).items()
    return hashlib.sha256(b"".join(f"{name}{x.shape}".encode() + x.tobytes() for name, x in named)).hexdigest()[:12]


def nested(leaves: dict[str, np.ndarray]) -> dict:
    """Nested dicts from `named_leaves`."""
    tree: dict = {}
    for name, leaf in leaves.items():
        *parents, last = name.split("/")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[last] = leaf
    return tree


def write_json(path: Path, content: dict) -> None:
    """Writes JSON so that a reader finds the old file or the new one, never half of one."""
    unfinished = path.with_name(path.name + ".part")
    unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    os.replace(unfinished, path)


def read_json(path: Path) -> dict:
    """Reads a JSON object.

    Raises:
      InputError: if the file is not there or is no JSON object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} is not there") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as e:
        raise InputError(f"{path} is not JSON ({e}); it was cut short or edited: write it anew") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} holds no JSON object")
    return content


def write_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Writes arrays as a compressed `.npz`, whole or not at all."""
    unfinished = path.with_name(path.name + ".part")
    with open(unfinished, "wb") as f:
        np.savez_compressed(f, **arrays)  # pyright: ignore
    os.replace(unfinished, path)


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Reads every array of an `.npz`; pickled objects are refused.

    Raises:
      InputError: if the file is not there, was cut short, or holds anything but plain arrays.
    """
    try:
        with np.lib.npyio.NpzFile(open(path, "rb"), own_fid=True, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise InputError(f"{path} is not there") from None
    except Exception as e:  # NumPy, zipfile and zlib between them raise a dozen kinds for damaged bytes
        raise InputError(f"{path} is not a whole .npz of plain arrays ({e}); copy or collect it again") from None
