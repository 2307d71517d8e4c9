"""The whole state of a run on disk, by orbax: a killed run goes on from its last checkpoint."""

from __future__ import annotations

import logging
from pathlib import Path

import jax
import numpy as np

from eairl_jax.errors import InputError
from eairl_jax.storage import named_leaves
from eairl_jax.types import PyTree

KEPT = 2  # the newest checkpoint, and the one before it


class Checkpoints:
    """The newest states of a run, one folder for each.

    A checkpoint gets its name only when it is complete. Incomplete checkpoints of killed processes are deleted.

    Args:
      directory: the folder of the checkpoints; it is created.
    """

    def __init__(self, directory: Path | str):
        import orbax.checkpoint as ocp  # takes a third of a second, which only training has to spend

        logging.getLogger("absl").setLevel(logging.ERROR)
        self._ocp = ocp
        self._manager = ocp.CheckpointManager(
            Path(directory).resolve(),
            item_handlers=ocp.StandardCheckpointHandler(),  # needed to read the shapes on disk before the arrays
            options=ocp.CheckpointManagerOptions(
                max_to_keep=KEPT, enable_async_checkpointing=False, cleanup_tmp_directories=True
            ),
        )

    def latest(self) -> int | None:
        """The iteration of the newest checkpoint, or None if there is none."""
        return self._manager.latest_step()

    def save(self, iteration: int, state: PyTree) -> None:
        """Writes a state of arrays; returns when the state is on disk."""
        self._manager.save(iteration, args=self._ocp.args.StandardSave(_filled(named_leaves(state))))
        self._manager.wait_until_finished()

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


def _filled(leaves: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays that hold a number. Orbax saves no empty array, and states of MJX without contacts have some."""
    return {name: leaf for name, leaf in leaves.items() if np.size(leaf)}
