"""The whole state of a run on disk, by orbax: a killed run goes on from its last checkpoint."""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from eairl_jax.errors import InputError
from eairl_jax.storage import named_leaves, replacing, reserve
from eairl_jax.types import PyTree

KEPT = 2  # the newest checkpoint, and the one before it
SPARE_BYTES = 2**20  # beside the arrays of a checkpoint: the descriptions, and what blocks of the disk waste
DIGEST = "sha256.txt"  # in the folder of a checkpoint: the digest of all other files in it


class Restored(NamedTuple):
    """The newest checkpoint that can be read.

    Attributes:
      iteration: of the checkpoint; None if there is none.
      state: NumPy arrays, as they were saved; None if there is none.
      damaged: iterations of newer checkpoints that are damaged. Their folders are removed.
    """

    iteration: int | None
    state: PyTree | None
    damaged: list[int]


class Checkpoints:
    """The newest states of a run, one folder for each.

    A checkpoint gets its name only when it is complete. Incomplete checkpoints of killed processes are deleted. Each
    checkpoint has a digest of its files, so that damage is found before anything is believed.

    Args:
      directory: the folder of the checkpoints; it is created.
      read_only: whether nothing is to be written or removed, so that the folder may lie where nobody may write.
    """

    def __init__(self, directory: Path | str, read_only: bool = False):
        import orbax.checkpoint as ocp  # takes a third of a second, which only training has to spend

        logging.getLogger("absl").setLevel(logging.CRITICAL)  # an error is raised too, and said once
        self._ocp, self._directory, self._read_only = ocp, Path(directory).resolve(), read_only
        self._open()

    def _open(self) -> None:
        ocp = self._ocp
        self._manager = ocp.CheckpointManager(
            self._directory,
            item_handlers=ocp.StandardCheckpointHandler(),  # needed to read the shapes on disk before the arrays
            options=ocp.CheckpointManagerOptions(
                max_to_keep=None if self._read_only else KEPT,
                enable_async_checkpointing=False,
                cleanup_tmp_directories=not self._read_only,
                create=not self._read_only,
                read_only=self._read_only,
            ),
        )

    def latest(self) -> int | None:
        """The iteration of the newest checkpoint, or None if there is none."""
        return self._manager.latest_step()

    def save(self, iteration: int, state: PyTree) -> None:
        """Writes a state of arrays; returns when the state is on disk.

        Raises:
          OSError: if it cannot be written, for example because the disk is full. Earlier checkpoints stay as they are.
        """
        leaves, folder = _filled(named_leaves(state)), self._directory / str(iteration)
        self._directory.mkdir(parents=True, exist_ok=True)
        # orbax would meet a full disk in many threads, which print hundreds of lines.
        reserve(self._directory, sum(leaf.nbytes for leaf in leaves.values()) * 5 // 4 + SPARE_BYTES)
        try:
            self._manager.save(iteration, args=self._ocp.args.StandardSave(leaves))
            self._manager.wait_until_finished()
        except Exception as e:  # orbax and tensorstore raise many exceptions, the number of the system's in their text
            code = re.search(r"os_error_code='(\d+)'", str(e))
            number = int(code[1]) if code else getattr(e, "errno", None) or errno.EIO
            raise OSError(number, os.strerror(number), str(folder)) from e
        with replacing(folder / DIGEST) as unfinished:
            unfinished.write_text(_digest(folder), encoding="ascii")

    def is_intact(self, iteration: int) -> bool:
        """Whether the files of a checkpoint are those that were written (earlier versions wrote no digest)."""
        folder = self._directory / str(iteration)
        try:
            written = (folder / DIGEST).read_text(encoding="ascii")
        except FileNotFoundError:
            return folder.is_dir()
        except (OSError, UnicodeDecodeError):
            return False
        return written == _digest(folder)

    def restore_newest(self, like: Callable[[], PyTree]) -> Restored:
        """Reads the newest checkpoint that is not damaged. Damaged ones are removed, so that they can be made again.

        Checkpoints before the newest `KEPT` are removed too: a process was killed while it removed them.

        Args:
          like: makes a state of the same structure and shapes.

        Raises:
          InputError: if the newest intact checkpoint has another structure or other shapes.
        """
        damaged: list[int] = []
        for iteration in sorted(self._manager.all_steps(), reverse=True):
            if self.is_intact(iteration):
                try:
                    restored = Restored(iteration, self.restore(iteration, like()), damaged)
                    self._remove_older()
                    return restored
                except InputError:
                    raise
                except Exception as e:  # orbax and tensorstore raise a dozen different exceptions for damaged files
                    if (self._directory / str(iteration) / DIGEST).exists():
                        raise InputError(f"checkpoint {iteration} in {self._directory} cannot be read ({e})") from e
            damaged.append(iteration)
            shutil.rmtree(self._directory / str(iteration), ignore_errors=True)
            self._manager.close()
            self._open()
        return Restored(None, None, damaged)

    def _remove_older(self) -> None:
        older = sorted(self._manager.all_steps())[:-KEPT]
        for iteration in older:
            shutil.rmtree(self._directory / str(iteration), ignore_errors=True)
        if older:
            self._manager.close()
            self._open()

    def restore(self, iteration: int, like: PyTree) -> PyTree:
        """Reads a state as NumPy arrays, bit for bit as it was saved.

        Args:
          iteration: the iteration of the checkpoint.
          like: a state of the same structure and shapes.

        Raises:
          InputError: if the checkpoint has another structure or other shapes.
        """
        leaves = named_leaves(like)
        template = _filled(leaves)
        expected = {name: leaf.shape for name, leaf in template.items()}
        on_disk = {name: tuple(leaf.shape) for name, leaf in self._manager.item_metadata(iteration).items()}
        for name in expected | on_disk:
            if expected.get(name) != on_disk.get(name):
                raise InputError(
                    f"checkpoint {iteration} does not fit these settings: {name} has shape "
                    f"{on_disk.get(name)} on disk, expected {expected.get(name)}; use the settings of the "
                    "run, or another folder"
                )
        saved = self._manager.restore(iteration, args=self._ocp.args.StandardRestore(template))
        return jax.tree.unflatten(jax.tree.structure(like), [np.asarray(leaf) for leaf in {**leaves, **saved}.values()])


def _digest(folder: Path) -> str:
    """SHA-256 over the names and contents of all files in a folder, without its `DIGEST`."""
    total = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(DIGEST)):
        content = path.read_bytes()
        total.update(f"{path.relative_to(folder).as_posix()} {len(content)} ".encode() + content)
    return total.hexdigest()


def _filled(leaves: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays that hold a number. Orbax saves no empty array, and states of MJX without contacts have some."""
    return {name: leaf for name, leaf in leaves.items() if np.size(leaf)}
