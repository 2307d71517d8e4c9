"""A command's programs as jobs of a cluster, by submitit: SLURM's queue, or processes of this machine.

A job runs the same command, but trains one group of its experiments. So a job that was pre-empted goes on from its
checkpoint as every command does. When all jobs are done, the command without `--cluster` finds every result and prints
the table.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from eairl_jax import InputError
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.pipeline.run_folder import WAITS, check_writable
from eairl_jax.extras import required

T = TypeVar("T")
MINUTES = 24 * 60
"""The time limit of a job, unless `--cluster-set timeout_min=N` says another."""
STOPPED = {130, 143}
"""Exit codes of a command that SIGINT or SIGTERM has stopped."""
MOST_TIMEOUTS = 100
"""How often a job that ran out of time begins again."""


class Options(Protocol):
    """What the record of a command with programs for a cluster holds.

    Attributes:
      cluster: "slurm", "local", or None to train here.
      cluster_set: parameters of submitit, NAME=VALUE.
      program: in a job, the number of the group that it trains.
    """

    @property
    def cluster(self) -> str | None: ...
    @property
    def cluster_set(self) -> tuple[str, ...]: ...
    @property
    def program(self) -> int | None: ...


@dataclass(frozen=True)
class Job:
    """Trains one group of a command's experiments.

    Attributes:
      arguments: of `eairl`.
      number: of the group.
    """

    arguments: tuple[str, ...]
    number: int

    def __call__(self) -> None:
        """Runs the command in a process of its own.

        Raises:
          RuntimeError: if the command fails, so that the job counts as failed. Its message is in the job's log.
          SystemExit: if the command was asked to stop. It has saved what it had.
        """
        command = [sys.executable, "-m", "eairl_jax.experiments.cli", *self.arguments, "--program", str(self.number)]
        code = subprocess.run(command, check=False).returncode
        if code in STOPPED:
            sys.exit(code)
        if code:
            raise RuntimeError(f"the command ended with the exit code {code}: its message is in this log")

    def checkpoint(self) -> Any:
        """What submitit puts into the queue again when the job is pre-empted: the job goes on from its checkpoint."""
        return required("submitit", "cluster").helpers.DelayedSubmission(self)


def groups(experiments: Iterable[T], shared: Callable[[T], Any]) -> list[list[T]]:
    """The experiments in groups that share something, e.g. the folder in which their reward is learned."""
    found: dict[Any, list[T]] = {}
    for each in experiments:
        found.setdefault(shared(each), []).append(each)
    return list(found.values())


def beside(out: Path) -> Path:
    """The folder of the jobs' logs beside a run's folder, in which nothing else may be."""
    return out.with_name(f"{out.name}-jobs")


def mine(options: Options, jobs: Sequence[Sequence[T]], logs: Path, command_line: str) -> list[T]:
    """The experiments that this process trains: all, or those of its job; none if they were given to a cluster.

    Args:
      jobs: the experiments of each job.
      logs: the folder of the jobs' logs.

    Raises:
      InputError: if the cluster cannot take the jobs, or if there is no job of the number.
    """
    if options.program is not None:
        if not 0 <= options.program < len(jobs):
            raise InputError(f"--program {options.program}: the command has programs 0 to {len(jobs) - 1}")
        WAITS.set(True)
        return list(jobs[options.program])
    if options.cluster is None:
        if options.cluster_set:
            raise InputError(f"--cluster-set {options.cluster_set[0]}: give --cluster slurm too")
        return [each for job in jobs for each in job]
    submit(options.cluster, options.cluster_set, len(jobs), logs, command_line)
    return []


def submit(cluster: str, parameters: Sequence[str], count: int, logs: Path, command_line: str) -> list[Any]:
    """Puts a job for each group into the queue, as one array. Returns submitit's jobs.

    Raises:
      InputError: if the cluster is not here, or if it does not know a parameter.
    """
    submitit, named = required("submitit", "cluster"), dict(map(_parameter, parameters))
    check_writable(logs / "log")
    arguments = tuple(shlex.split(command_line)[1:])
    try:
        executor = submitit.AutoExecutor(folder=logs / "%j", cluster=cluster, slurm_max_num_timeout=MOST_TIMEOUTS)
        executor.update_parameters(**{"name": f"eairl-{arguments[0]}", "timeout_min": MINUTES} | named)
        with executor.batch():
            jobs = [executor.submit(Job(arguments, number)) for number in range(count)]
    except Exception as e:  # submitit has no type of error of its own for any of these
        raise InputError(f"--cluster {cluster}: {type(e).__name__}: {e}") from None
    say(f"jobs of {cluster}: {' '.join(str(job.job_id) for job in jobs)}; their logs are in {logs}/")
    say("`eairl runs` shows what they have done; when all are done, this command without --cluster prints the table")
    return jobs


def _parameter(text: str) -> tuple[str, int | str]:
    name, is_there, value = text.partition("=")
    if not (is_there and name and value):
        raise InputError(f"--cluster-set {text}: expected NAME=VALUE, e.g. timeout_min=600 slurm_partition=gpu")
    return name, int(value) if value.isdecimal() else value
