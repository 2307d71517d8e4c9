"""What a chunk of `metrics.csv` costs when the file is long, and what a resume costs that repairs its last line.

    python tests/speed/metrics_file.py [ITERATIONS] [SEEDS]

The figures are of the writing alone, with as many columns as EAIRL has.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from eairl_jax.experiments.pipeline.run_folder import RunFolder

CHUNK, COLUMNS = 20, 22


def main(iterations: int, seeds: int) -> None:
    """Prints milliseconds of a chunk in the first and in the last tenth of the file, and seconds of a repair."""
    labels = [{"seed": seed} for seed in range(seeds)]
    rng = np.random.default_rng(0)
    metrics = {f"metric_{i}": rng.normal(size=(seeds, CHUNK)).astype(np.float32) for i in range(COLUMNS)}
    with tempfile.TemporaryDirectory() as temporary:
        folder, seconds = RunFolder(Path(temporary) / "run", {"task": "speed"}), []
        for first in range(0, iterations, CHUNK):
            start = time.perf_counter()
            folder.append_metrics(first, 1000, labels, metrics)
            seconds.append(time.perf_counter() - start)
        path = folder.path / "metrics.csv"
        size, whole = path.stat().st_size, path.read_bytes()
        tenth = max(1, len(seconds) // 10)
        early, late = (1000 * float(np.median(part)) for part in (seconds[:tenth], seconds[-tenth:]))
        with open(path, "ab") as file:
            file.write(whole[-150:-40])  # a line that a kill has torn
        start = time.perf_counter()
        folder.keep_metrics(iterations * seeds, labels)
        repair = time.perf_counter() - start
        is_whole = path.read_bytes() == whole
        start = time.perf_counter()
        curve = folder.curve("metric_0", seeds)
        read = time.perf_counter() - start
    print(f"metrics.csv of {iterations} iterations, {seeds} seeds, {COLUMNS} metrics: {size / 1e6:.0f} MB")
    print(f"a chunk of {CHUNK} iterations: {early:.2f} ms in the first tenth, {late:.2f} ms in the last")
    print(f"repair of a torn last line: {repair:.2f} s, the file as before: {is_whole}")
    print(f"one curve {curve.shape}: read in {read:.2f} s")


if __name__ == "__main__":
    main(*(int(value) for value in (*sys.argv[1:], *("100000", "5")[len(sys.argv) - 1 :])))
