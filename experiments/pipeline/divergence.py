"""NaN and infinity in a training: found in the chunk in which they arise, named, and never a score.

With `on_nan="stop"` a training stops before anything of the chunk is written, so its last checkpoint is a good one.
With "skip" the lane is dropped: its last good state is kept, its metrics are NaN from then on, and the others go on.
`dropped.json` in the folder of the run says what was dropped, and is written before the checkpoint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from eairl_jax import Diverged
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.lanes import NotFinite, not_finite
from eairl_jax.storage import named_leaves
from eairl_jax.types import PyTree

EVALUATION = "the evaluation"
"""In `dropped.json`, the training of a policy that is dropped because it has no finite return or reward."""
ADVICE = (
    "Try a lower learning rate (--set policy_lr=..., discriminator_lr=...) in a new --out; or give the same command "
    "(imitate, expert, sweep, transfer, reproduce) with --on-nan skip, to go on without that seed"
)


class Guard:
    """Looks at every chunk of a training for values that are not finite.

    Args:
      folder: of the training.
      title: of the training, for messages and for the record of a dropped lane.
      labels: what tells the lanes apart.
      on_nan: "stop" or "skip", see the module.
      state: with which the training begins or goes on, NumPy arrays `[lanes, ...]`.
    """

    def __init__(self, folder: RunFolder, title: str, labels: list[dict], on_nan: str, state: PyTree):
        self._folder, self._title, self._labels, self._on_nan = folder, title, labels, on_nan
        # A state may have a NaN from the beginning, in an environment of a user.
        self._usual = {name for name, leaf in named_leaves(state).items() if _bad(name, leaf).any()}
        self._good = state if on_nan == "skip" or folder.dropped() else None

    def checked(
        self, done: int, state: PyTree, metrics: dict[str, np.ndarray], kept: int | None
    ) -> tuple[PyTree, dict[str, np.ndarray]]:
        """The state and the metrics of a chunk, those of dropped lanes replaced.

        Args:
          done: iterations before the chunk.
          state, metrics: after the chunk, NumPy arrays `[lanes, ...]` and `[lanes, length]`.
          kept: iteration of the last checkpoint, if there is one.

        Raises:
          Diverged: if a value is not finite and the training is to stop, or if no lane is left.
        """
        length = next(iter(metrics.values())).shape[1]
        before = {lane for lane in range(len(self._labels)) if self._is_dropped(lane, done)}
        new = [each for each in self._found(state, metrics, length) if each.lane not in before]
        if not (before or new):
            if self._good is not None:
                self._good = state
            return state, metrics
        if new and self._on_nan == "stop":
            raise self._diverged(min(new, key=lambda each: each.iteration), done, kept)
        self._folder.drop([self._entry(each, done) for each in new])
        for each in new:
            say(f"{self._title}: dropped {explain([self._entry(each, done)])}")
        if len(before) + len(new) == len(self._labels):
            raise _none_left(self._folder.dropped())
        lanes = sorted(before | {each.lane for each in new})
        metrics = {name: values.copy() for name, values in metrics.items()}
        begin = dict.fromkeys(before, 0) | {each.lane: each.iteration - 1 for each in new}
        for values in metrics.values():
            for lane in lanes:
                values[lane, begin[lane] :] = np.nan
        self._good = jax.tree.map(lambda now, good: _with_rows(now, good, lanes), state, self._good)
        return self._good, metrics

    def _is_dropped(self, lane: int, done: int) -> bool:
        """Whether a lane was dropped before iteration `done`: in this training, or in one before it."""
        return any(
            matches(entry, self._labels[lane]) and (entry["training"] != self._title or entry["iteration"] <= done)
            for entry in self._folder.dropped()
        )

    def _found(self, state: PyTree, metrics: dict[str, np.ndarray], length: int) -> list[NotFinite]:
        """The first value of each lane that is not finite: of its metrics, else of its state after the chunk."""
        found = {each.lane: each for each in not_finite(metrics)}
        for name, leaf in named_leaves(state).items():
            if name in self._usual:
                continue
            bad = _bad(name, leaf)
            for lane in np.flatnonzero(bad.any(axis=tuple(range(1, bad.ndim)))).tolist() if bad.any() else ():
                found.setdefault(lane, NotFinite(lane, length, name, float(leaf[lane][bad[lane]].flat[0])))
        return list(found.values())

    def _entry(self, each: NotFinite, done: int) -> dict[str, Any]:
        return entry(self._labels[each.lane], self._title, each.metric, done + each.iteration, each.value)

    def _diverged(self, each: NotFinite, done: int, kept: int | None) -> Diverged:
        where = ", ".join(f"{label} {value}" for label, value in self._labels[each.lane].items())
        checkpoint = f"the checkpoint of iteration {kept} is kept" if kept else "no checkpoint was written yet"
        return Diverged(
            f"{each.metric} became {each.value} at iteration {done + each.iteration} ({where}); {checkpoint}. {ADVICE}",
            each.metric,
            each.lane,
            each.iteration,
            each.value,
        )


def _bad(name: str, leaf: np.ndarray) -> np.ndarray:
    """Which values of a leaf are not finite. Environments may hold infinity, and returns while no episode has ended."""
    if leaf.dtype.kind != "f":
        return np.zeros(leaf.shape, bool)
    return np.isnan(leaf) if "rollout/" in name else ~np.isfinite(leaf)


def _with_rows(now: np.ndarray, good: np.ndarray, lanes: list[int]) -> np.ndarray:
    mixed = np.array(now)
    mixed[lanes] = np.asarray(good)[lanes]
    return mixed


def entry(label: dict, training: str, quantity: str, iteration: int, value: float) -> dict[str, Any]:
    """What `dropped.json` says of a lane: its label, the training, and the first value that was not finite."""
    # JSON has no NaN, so the value is a text.
    return label | {"training": training, "quantity": quantity, "iteration": iteration, "value": str(value)}


def matches(entry: dict, label: dict) -> bool:
    """Whether a lane was dropped, by an entry of its own or by one of its seed."""
    return all(entry[name] == value for name, value in label.items() if name in entry)


def kept(folder: RunFolder, labels: Sequence[dict]) -> np.ndarray:
    """The lanes that were not dropped, as indices into `labels`.

    Raises:
      Diverged: if all were dropped.
    """
    dropped = folder.dropped()
    lanes = [lane for lane, label in enumerate(labels) if not any(matches(each, label) for each in dropped)]
    if not lanes:
        raise _none_left(dropped)
    return np.array(lanes)


def _none_left(dropped: Sequence[dict]) -> Diverged:
    first = dropped[0]
    return Diverged(
        f"every seed has diverged, so there is no score: {explain(dropped)}. Try a lower learning rate (--set "
        "policy_lr=..., discriminator_lr=...) in a new --out",
        first["quantity"],
        0,
        first["iteration"],
        float(first["value"]),
    )


def kept_seeds(folder: RunFolder) -> np.ndarray:
    """The seeds of a run that were not dropped, as indices into the seeds of its settings."""
    seeds = folder.settings["seeds"]
    return kept(folder, [{"seed": seed} for seed in (range(seeds) if isinstance(seeds, int) else seeds)])


def explain(dropped: Sequence[dict]) -> str:
    """For example "seed 1 (value_loss became nan at iteration 4 of eairl-sa in pendulum)"."""
    texts = []
    for each in dropped:
        facts = ("training", "quantity", "iteration", "value")
        lane = ", ".join(
            f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in each.items()
            if name not in facts
        )
        texts.append(
            f"{lane} ({each['quantity']} became {each['value']} at iteration {each['iteration']} of {each['training']})"
        )
    return "; ".join(texts)


def note(dropped: Sequence[dict], total: int) -> str:
    """The remark below a table: of how many seeds a mean is, and which were dropped; empty if none was."""
    if not dropped:
        return ""
    lost = len({tuple((k, v) for k, v in each.items() if k == "seed") for each in dropped})
    return f"mean of {total - lost} of {total} seeds; dropped: {explain(dropped)}"


def all_finite(values: Sequence[float] | np.ndarray) -> list[float | None]:
    """Numbers for a JSON file, with None for those of a dropped lane."""
    return [float(value) if math.isfinite(value) else None for value in values]
