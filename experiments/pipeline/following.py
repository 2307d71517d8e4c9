"""The metrics of a run, read while another process writes them. Nothing is computed, and jax is not imported."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from eairl_jax import InputError


class Followed:
    """The curves of `metrics.csv`, means over the lanes. Each `update` reads what was written since the last one.

    Attributes:
      iterations: `[iterations]` numbers of the iterations.
      curves: by name of the metric, `[iterations]`; NaN where no lane has a finite value.

    Args:
      path: a run's folder, or one in which a part of it is trained.
    """

    def __init__(self, path: Path):
        self._path = path / "metrics.csv"
        self._begin()

    def _begin(self) -> None:
        self._offset, self._header = 0, []
        self._sums: dict[int, np.ndarray] = {}  # sums and counts `[2, metrics]` of each iteration
        self.iterations, self.curves = np.zeros(0, int), {}

    def update(self) -> bool:
        """Whether there was news. A torn last line is left for the next time.

        Raises:
          InputError: if the file is no table of metrics.
        """
        try:
            with open(self._path, "rb") as file:
                if file.seek(0, 2) < self._offset:  # an interrupted run went on, and dropped what had no checkpoint
                    self._begin()
                file.seek(self._offset)
                text = file.read()
        except FileNotFoundError:
            return False
        text = text[: text.rfind(b"\n") + 1]
        rows = list(csv.reader(text.decode("utf-8", errors="replace").removeprefix("\ufeff").splitlines()))
        self._offset += len(text)
        if rows and not self._header:
            self._header = rows.pop(0)
            if "iteration" not in self._header or "env_steps" not in self._header:
                raise InputError(f"{self._path} is no table of metrics: give the folder of a run")
        for row in rows:
            self._add(row)
        if rows:
            self._average()
        return bool(rows)

    def _add(self, row: list[str]) -> None:
        names = self._header[self._header.index("env_steps") + 1 :]
        try:
            iteration = int(row[self._header.index("iteration")])
            values = np.array([float(value) for value in row[-len(names) :]])
        except (ValueError, IndexError):
            raise InputError(f"{self._path} has a line that is no metrics: {','.join(row)[:60]}") from None
        finite = np.isfinite(values)
        sums = self._sums.setdefault(iteration, np.zeros((2, len(names))))
        if values.shape == sums[0].shape:
            sums += np.where(finite, values, 0.0), finite

    def _average(self) -> None:
        names = self._header[self._header.index("env_steps") + 1 :]
        self.iterations = np.array(sorted(self._sums))
        total, count = np.stack([self._sums[iteration] for iteration in self.iterations.tolist()], axis=1)
        means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        self.curves = dict(zip(names, means.T, strict=True))
