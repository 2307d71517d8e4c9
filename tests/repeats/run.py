"""How equal are two runs that should be equal? `make test-repeats`.

    python tests/repeats/run.py                        # EAIRL in pendulum
    python tests/repeats/run.py --task point_maze_left --method airl_s

`eairl imitate` trains two seeds on two CPU devices, in chunks of five iterations. It does so again: the same command,
one seed alone, four seeds, one device, shorter and longer chunks. The table shows how far the metrics and the reward of
seed 0 are from those of the first run. The same command must give the same bits: if it does not, the exit code is 1.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ITERATIONS, CHUNK = 20, 5


@dataclasses.dataclass(frozen=True)
class Arrangement:
    """How a run is laid out. Nothing in it may change what seed 0 learns.

    Attributes:
      title: for the table.
      seeds: trained side by side; seed 0 is one of them.
      devices: that share the seeds.
      chunk: iterations of one compiled program.
      must_be_equal: whether another bit is a fault. Programs of another shape may round differently.
    """

    title: str
    seeds: int = 2
    devices: int = 2
    chunk: int = CHUNK
    must_be_equal: bool = False


FIRST = Arrangement("two seeds, two devices")
OTHERS = (
    Arrangement("the same command again", must_be_equal=True),
    Arrangement("chunks of 1 iteration", chunk=1),
    Arrangement(f"chunks of {ITERATIONS} iterations", chunk=ITERATIONS),
    Arrangement("seed 0 alone", seeds=1),
    Arrangement("four seeds", seeds=4),
    Arrangement("one device", devices=1),
)


def train(task: str, method: str, arrangement: Arrangement, out: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Seed 0's metrics `[iterations, names]` and the arrays of its last reward."""
    settings = [f"iterations={ITERATIONS}", f"snapshot_every={arrangement.chunk}"]
    arguments = ["imitate", task, "--method", method, "--seeds", str(arrangement.seeds), "--out", str(out)]
    subprocess.run(
        [sys.executable, "-m", "eairl_jax.experiments.cli", *arguments, "--set", *settings],
        env=os.environ | {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": str(arrangement.devices)},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    with open(out / "metrics.csv", newline="", encoding="utf-8") as f:
        lines = [line for line in csv.DictReader(f) if line["seed"] == "0"]
    metrics = np.array([[float(value) for value in line.values()] for line in lines])
    with np.load(out / "snapshots" / f"{ITERATIONS:06d}" / "reward.npz") as arrays:
        return metrics, {name: arrays[name][0] for name in arrays.files}


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """The largest difference of two arrays, as a share of the largest number in them."""
    both_known = np.isfinite(a) & np.isfinite(b)
    size = max(np.abs(a[both_known]).max(), 1e-30)
    return float(np.abs(a - b)[both_known].max() / size)


def main() -> int:
    """The exit code: 0 if all that must be equal is equal."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="pendulum")
    parser.add_argument("--method", default="eairl")
    options = parser.parse_args()
    print(f"{options.method} in {options.task}, {ITERATIONS} iterations; beside {FIRST.title}, chunks of {CHUNK}:")
    print(f"{'':<28}{'bits':<8}{'metrics, 1st iteration':>24}{'metrics, last':>16}{'reward, last':>16}")
    faults = 0
    with tempfile.TemporaryDirectory() as folder:
        metrics, reward = train(options.task, options.method, FIRST, Path(folder) / "first")
        for number, arrangement in enumerate(OTHERS):
            others, other_reward = train(options.task, options.method, arrangement, Path(folder) / str(number))
            is_equal = np.array_equal(metrics, others, equal_nan=True) and all(
                np.array_equal(reward[name], other_reward[name]) for name in reward
            )
            far = max(difference(reward[name], other_reward[name]) for name in reward)
            first, last = (
                max(difference(a, b) for a, b in zip(metrics[row], others[row], strict=True) if np.isfinite(a))
                for row in (0, -1)
            )
            faults += arrangement.must_be_equal and not is_equal
            bits = "equal" if is_equal else "other"
            print(f"{arrangement.title:<28}{bits:<8}{first:>24.1e}{last:>16.1e}{far:>16.1e}", flush=True)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
