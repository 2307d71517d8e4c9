"""The whole state of a run on disk, by orbax: what was computed before a kill is there after it."""

from __future__ import annotations

import logging
from pathlib import Path

import jax
import numpy as np

from eairl_jax.errors import InputError
from eairl_jax.storage import named_leaves
from eairl_jax.types import PyTree

KEPT = 2  # the newest, and the one before it


class Checkpoints:
    """The newest states of a run, a folder an iteration.

    A checkpoint appears under its name only when it is whole; one whose writing was cut off is cleared away.
    """

    def __init__(self, directory: Path | str):
        import orbax.checkpoint as ocp  # a third of a second that commands without training need not pay

        logging.getLogger("absl").setLevel(logging.ERROR)
        self._ocp = ocp
        self._manager = ocp.CheckpointManager(
            Path(directory).resolve(),
            item_handlers=ocp.StandardCheckpointHandler(),  # so that what is on disk can be asked before it is read
            options=ocp.CheckpointManagerOptions(
                max_to_keep=KEPT, enable_async_checkpointing=False, cleanup_tmp_directories=True
            ),
        )

    def latest(self) -> int | None:
        """The newest iteration on disk, or None."""
        return self._manager.latest_step()

    def save(self, iteration: int, state: PyTree) -> None:
        """Writes a state of arrays; returns when it is on disk."""
        self._manager.save(iteration, args=self._ocp.args.StandardSave(named_leaves(state)))
        self._manager.wait_until_finished()

    def restore(self, iteration: int, like: PyTree) -> PyTree:
        """Reads a state with the structure of `like`, bit for bit as it was saved, as NumPy arrays.

        Raises:
          InputError: if what was saved has another structure.
        """
        template = named_leaves(like)
        expected = {name: leaf.shape for name, leaf in template.items()}
        on_disk = {name: tuple(leaf.shape) for name, leaf in self._manager.item_metadata(iteration).items()}
        for name in expected | on_disk:
            if expected.get(name) != on_disk.get(name):
                raise InputError(
                    f"checkpoint {iteration} does not fit these settings: {name} has shape "
                    f"{on_disk.get(name)} on disk, expected {expected.get(name)}"
                )
        saved = self._manager.restore(iteration, args=self._ocp.args.StandardRestore(template))
        return jax.tree.unflatten(jax.tree.structure(like), [np.asarray(saved[name]) for name in template])
