"""Programs of a command as jobs: who trains what, what submitit is asked, and the whole way through processes."""

import importlib.util
import subprocess
import sys
import time
import types

import pytest

from eairl_jax import InputError
from eairl_jax.experiments.pipeline.cluster import Job, groups, mine
from eairl_jax.experiments.pipeline.run_folder import WAITS

JOBS = [["a"], ["b", "c"]]


def options(kind=None, parameters=(), program=None):
    return types.SimpleNamespace(cluster=kind, cluster_set=parameters, program=program)


@pytest.fixture(autouse=True)
def _no_process_waits_after_the_test():
    token = WAITS.set(False)
    yield
    WAITS.reset(token)


def test_what_shares_a_folder_is_one_job():
    assert groups(["ax", "b", "ay"], lambda each: each[0]) == [["ax", "ay"], ["b"]]


def test_a_process_trains_all_or_its_own_job(tmp_path):
    assert mine(options(), JOBS, tmp_path, "eairl") == ["a", "b", "c"]
    assert not WAITS.get()
    assert mine(options(program=1), JOBS, tmp_path, "eairl") == ["b", "c"]
    assert WAITS.get()  # for folders that it shares with other jobs
    with pytest.raises(InputError, match="--program 2: the command has programs 0 to 1"):
        mine(options(program=2), JOBS, tmp_path, "eairl")
    with pytest.raises(InputError, match="give --cluster slurm too"):
        mine(options(parameters=("nodes=2",)), JOBS, tmp_path, "eairl")


@pytest.fixture
def submitit(monkeypatch):
    """A module that records what it is asked, in place of the library."""
    asked = types.SimpleNamespace(parameters={}, jobs=[], folder=None)

    class Executor:
        def __init__(self, folder, cluster, slurm_max_num_timeout):
            if cluster == "slurm" and asked.folder == "none":
                raise RuntimeError("no srun here")
            asked.folder = folder

        def update_parameters(self, **parameters):
            asked.parameters = parameters

        def batch(self):
            return asked_batch()

        def submit(self, job):
            asked.jobs.append(job)
            return types.SimpleNamespace(job_id=len(asked.jobs))

    class asked_batch:  # noqa: N801
        def __enter__(self):
            asked.in_batch = True

        def __exit__(self, *_):
            pass

    helpers = types.SimpleNamespace(DelayedSubmission=lambda job: ("again", job))
    monkeypatch.setitem(sys.modules, "submitit", types.SimpleNamespace(AutoExecutor=Executor, helpers=helpers))
    return asked


def test_a_cluster_gets_a_job_for_each_group(tmp_path, submitit, capsys):
    given = options("slurm", ("timeout_min=600", "slurm_partition=gpu"))
    assert mine(given, JOBS, tmp_path, "eairl sweep 'my task' --cluster slurm") == []
    assert submitit.jobs == [Job(("sweep", "my task", "--cluster", "slurm"), number) for number in (0, 1)]
    assert submitit.parameters == {"name": "eairl-sweep", "timeout_min": 600, "slurm_partition": "gpu"}
    assert submitit.in_batch
    assert submitit.jobs[1].checkpoint() == ("again", submitit.jobs[1])
    assert "jobs of slurm: 1 2" in capsys.readouterr().out


def test_a_cluster_that_cannot_is_one_message(tmp_path, submitit):
    with pytest.raises(InputError, match="--cluster-set gpu: expected NAME=VALUE"):
        mine(options("slurm", ("gpu",)), JOBS, tmp_path, "eairl sweep")
    submitit.folder = "none"
    with pytest.raises(InputError, match="--cluster slurm: RuntimeError: no srun here"):
        mine(options("slurm"), JOBS, tmp_path, "eairl sweep")


def test_without_submitit_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(InputError, match=r'pip install "eairl-jax\[cluster\]"'):
        mine(options("slurm"), JOBS, tmp_path, "eairl sweep")


@pytest.mark.parametrize(("code", "error"), [(0, None), (1, RuntimeError), (2, RuntimeError), (143, SystemExit)])
def test_a_job_is_the_command_with_the_number_of_its_program(monkeypatch, code, error):
    commands = []

    def started(command, check):
        commands.append(command)
        return types.SimpleNamespace(returncode=code)

    monkeypatch.setattr(subprocess, "run", started)
    if error:
        with pytest.raises(error):
            Job(("sweep", "pendulum"), 3)()
    else:
        Job(("sweep", "pendulum"), 3)()
    assert commands[0][1:] == ["-m", "eairl_jax.experiments.cli", "sweep", "pendulum", "--program", "3"]


@pytest.mark.extras
@pytest.mark.skipif(importlib.util.find_spec("submitit") is None, reason="needs submitit")
def test_a_job_of_this_machine_trains_what_the_command_then_finds(tmp_path, tiny, run, capsys, monkeypatch):
    out = tmp_path / "sweep"
    command = ["sweep", "pendulum", "--seeds", "2", "--out", str(out), "--set", *tiny, "lambda_i=0,1"]
    # In a process of its own: importing submitit closes the handlers of logging, and with them pytest's streams.
    program = [sys.executable, "-m", "eairl_jax.experiments.cli"]
    printed = subprocess.run([*program, *command, "--cluster", "local"], capture_output=True, text=True, check=True)
    assert "jobs of local" in printed.stdout
    for _ in range(240):
        if (out / "summary.json").is_file():  # the folder of one program holds nothing but the run
            break
        time.sleep(1)
    monkeypatch.setattr("eairl_jax.Lanes.run", lambda *_: pytest.fail("trained again"))
    assert run(*command) == 0
    assert "lambda_i 1" in capsys.readouterr().out
