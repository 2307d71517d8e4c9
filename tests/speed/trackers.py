"""What a tracker costs: chunks of the pendulum's EAIRL with TensorBoard and without, in turns.

python tests/speed/trackers.py [ROUNDS]
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from eairl_jax import xla

xla.configure_jax()

from eairl_jax.experiments.options import Imitate  # noqa: E402
from eairl_jax.experiments.pipeline import stages  # noqa: E402
from eairl_jax.experiments.pipeline.experiment import imitations  # noqa: E402
from eairl_jax.experiments.pipeline.run_folder import RunFolder  # noqa: E402
from eairl_jax.experiments.pipeline.trackers import Training, tracked  # noqa: E402

CHUNK = 20


def main(rounds: int) -> None:
    """Prints the seconds of a chunk, and the tracker's share."""
    (experiment,) = imitations(Imitate("pendulum"))
    labels = stages.lanes_of(experiment)
    _, lanes = stages.learner(experiment)
    state = lanes.init()
    lanes.compile(state, CHUNK)
    seconds: dict[str, list[float]] = {"chunk": [], "metrics.csv": [], "TensorBoard": []}
    with tempfile.TemporaryDirectory() as temporary:
        folder = RunFolder(Path(temporary) / "run", experiment.settings())
        steps = experiment.config.steps_per_iteration
        with tracked(["tensorboard"], Training(folder.path, folder.settings, labels, steps, 0)) as log:
            for i in range(rounds):
                times = [time.perf_counter()]
                state, metrics = lanes.run(state, CHUNK)
                times.append(time.perf_counter())
                folder.append_metrics(i * CHUNK, steps, labels, metrics)
                times.append(time.perf_counter())
                log(i * CHUNK, metrics)
                times.append(time.perf_counter())
                for name, taken in zip(seconds, np.diff(times), strict=True):
                    seconds[name].append(taken)
    median = {name: float(np.median(each)) for name, each in seconds.items()}
    print(f"{len(labels)} seeds, chunks of {CHUNK} iterations, median of {rounds}:")
    for name, each in median.items():
        print(f"  {name:12} {1000 * each:8.1f} ms  {each / median['chunk']:.4f} of a chunk")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 8)
