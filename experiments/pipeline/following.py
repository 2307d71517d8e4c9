"""The metrics of a run, read while another process writes them. Nothing is computed, and jax is not imported."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from eairl_jax import InputError

Content = TypeVar("Content")


class Reader:
    """The lines of `metrics.csv`, read as they are written. A torn last line is left for the next time.

    Attributes:
      labels: names of what tells the lanes apart.
      names: of the metrics.

    Args:
      folder: a run's folder, or one in which a part of it is trained.
    """

    def __init__(self, folder: Path):
        self.path, self.labels, self.names = folder / "metrics.csv", [], []
        self._offset = 0

    def is_shorter(self) -> bool:
        """Whether lines that were read are gone: an interrupted run went on, and dropped what had no checkpoint."""
        return self.path.stat().st_size < self._offset

    def news(self) -> list[list[str]]:
        """The lines since the last time: the lane's label, iteration, environment steps, metrics.

        Raises:
          FileNotFoundError: if there are no metrics yet.
          InputError: if the file is no table of metrics.
        """
        with open(self.path, "rb") as file:
            file.seek(self._offset)
            text = file.read()
        text = text[: text.rfind(b"\n") + 1]
        rows = list(csv.reader(text.decode("utf-8", errors="replace").removeprefix("\ufeff").splitlines()))
        if rows and not self._offset:
            header = rows.pop(0)
            if not {"iteration", "env_steps"} <= set(header):
                raise self.no_table()
            first = header.index("iteration")
            self.labels, self.names = header[:first], header[first + 2 :]
        self._offset += len(text)
        return rows

    def no_table(self) -> InputError:
        """The error of a file that does not begin as a table of metrics does."""
        return InputError(f"{self.path} is no table of metrics: give the folder of a run")

    def parsed(self, row: list[str], parse: Callable[[list[str]], Content]) -> Content:
        """What `parse` makes of a line.

        Raises:
          InputError: if it is no line of metrics.
        """
        try:
            return parse(row)
        except (ValueError, IndexError, ZeroDivisionError):
            raise InputError(f"{self.path} has a line that is no metrics: {','.join(row)[:60]}") from None


class Followed:
    """The curves of `metrics.csv`, means over the lanes. Each `update` reads what was written since the last one.

    Attributes:
      iterations: `[iterations]` numbers of the iterations.
      curves: by name of the metric, `[iterations]`; NaN where no lane has a finite value.

    Args:
      path: a run's folder, or one in which a part of it is trained.
    """

    def __init__(self, path: Path):
        self._folder = path
        self._begin()

    def _begin(self) -> None:
        self._reader = Reader(self._folder)
        self._sums: dict[int, np.ndarray] = {}  # sums and counts `[2, metrics]` of each iteration
        self.iterations, self.curves = np.zeros(0, int), {}

    def update(self) -> bool:
        """Whether there was news.

        Raises:
          InputError: if the file is no table of metrics.
        """
        try:
            if self._reader.is_shorter():
                self._begin()
            rows = self._reader.news()
        except FileNotFoundError:
            return False
        for row in rows:
            self._reader.parsed(row, self._add)
        if rows:
            self._average()
        return bool(rows)

    def _add(self, row: list[str]) -> None:
        labels, names = self._reader.labels, self._reader.names
        iteration = int(row[len(labels)])
        values = np.array([float(value) for value in row[-len(names) :]])
        finite = np.isfinite(values)
        sums = self._sums.setdefault(iteration, np.zeros((2, len(names))))
        if values.shape == sums[0].shape:
            sums += np.where(finite, values, 0.0), finite

    def _average(self) -> None:
        self.iterations = np.array(sorted(self._sums))
        total, count = np.stack([self._sums[iteration] for iteration in self.iterations.tolist()], axis=1)
        means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        self.curves = dict(zip(self._reader.names, means.T, strict=True))
