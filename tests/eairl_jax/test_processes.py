"""Processes that find each other, and what happens when one of them is wrong or gone."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from eairl_jax import Algorithm, HParams, InputError, Lanes, ProcessLost, processes
from eairl_jax.processes import Meeting, Peer, meeting
from eairl_jax.shards import Shards

ROOT = Path(__file__).resolve().parents[2]
SLURM = {"SLURM_JOB_ID": "7", "SLURM_STEP_NODELIST": "127.0.0.1", "SLURM_NTASKS": "2", "SLURM_LOCALID": "0"}
MPI = {"OMPI_MCA_orte_hnp_uri": "4096.0;tcp://127.0.0.1:1", "OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "1"}
POD = {"KUBERNETES_SERVICE_HOST": "10.0.0.1"}

MEETINGS = {
    "alone": ((None, None, None), {}, None),
    "alone by hand": (("host:1", 1, 0), {}, None),
    "by hand": (("node-1.local:65535", 3, 2), {}, Meeting("node-1.local:65535", 3, 2)),
    "an address": (("[::1]:80", 2, 0), {}, Meeting("[::1]:80", 2, 0)),
    "by hand under a launcher": (("host:1", 2, 0), MPI, Meeting("host:1", 2, 0)),
    "srun": ((None, None, None), SLURM | {"SLURM_PROCID": "0"}, Meeting(process=0)),
    "srun of one process": ((None, None, None), SLURM | {"SLURM_PROCID": "0", "SLURM_NTASKS": "1"}, None),
    "a script of sbatch": ((None, None, None), {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "2"}, None),
    "alone in srun": ((None, 1, None), SLURM | {"SLURM_PROCID": "0"}, None),
    "mpirun": ((None, None, None), MPI, Meeting(process=1)),
    "mpirun of one process": ((None, None, None), MPI | {"OMPI_COMM_WORLD_SIZE": "1"}, None),
    "a pod": ((None, None, None), POD, None),
    "an indexed job": ((None, None, None), POD | {"JOB_COMPLETION_INDEX": "3"}, Meeting(process=3)),
}


@pytest.mark.parametrize(("given", "environ", "expected"), MEETINGS.values(), ids=MEETINGS)
def test_where_a_process_meets_others(given, environ, expected):
    assert meeting(*given, environ) == expected


MISTAKES = {
    "no coordinator": ((None, 2, 0), "--coordinator missing: processes that are started by hand need"),
    "a number alone": ((None, None, 1), "--coordinator and --processes missing"),
    "no number": (("host:1", 2, None), "--process missing"),
    "no process": ((None, 0, None), "--processes 0: expected at least 1"),
    "too high": (("host:1", 2, 2), "--process 2: expected a number from 0 to 1, for --processes 2"),
    "below 0": (("host:1", 2, -1), "--process -1: expected a number from 0 to 1"),
    "no port": (("host", 2, 0), "--coordinator 'host': expected the host of process 0 and a free port on it"),
    "port 0": (("host:0", 2, 0), "--coordinator 'host:0'"),
    "a high port": (("host:65536", 2, 0), "--coordinator 'host:65536'"),
    "no host": ((":80", 2, 0), "--coordinator ':80'"),
    "a scheme": (("http://host:80", 2, 0), "--coordinator 'http"),
}


@pytest.mark.parametrize(("given", "message"), MISTAKES.values(), ids=MISTAKES)
def test_impossible_meetings_are_refused(given, message):
    with pytest.raises(InputError) as e:
        meeting(*given, {})
    assert str(e.value).startswith(message)


@pytest.fixture
def ends():
    """The two ends of a connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        return Peer(one, "process 1"), Peer(server.accept()[0], "process 0")


def test_arrays_of_every_kind_pass_unchanged(ends):
    arrays = [
        np.arange(6, dtype=np.float32).reshape(2, 3).T,
        np.zeros((0, 4), np.int32),
        np.array(True),
        np.random.default_rng(0).integers(0, 2**32, (30, 100), np.uint32),
    ]
    ends[0].send({"a": 1}, arrays)
    values, received = ends[1].receive()
    assert values == {"a": 1}
    for sent, got in zip(arrays, received, strict=True):
        np.testing.assert_array_equal(got, sent, strict=True)
    ends[1].send({})
    assert ends[0].receive() == ({}, [])


def test_the_end_of_the_other_process_is_said_and_its_silence_is_noticed(ends):
    keepalive = [
        ends[1]._socket.getsockopt(socket.IPPROTO_TCP, getattr(socket, f"TCP_KEEP{n}"))
        for n in ("IDLE", "INTVL", "CNT")
    ]
    assert keepalive[0] + keepalive[1] * keepalive[2] <= processes.SILENCE_S
    ends[0].close()
    with pytest.raises(ProcessLost, match="process 0 has ended: start all processes again"):
        ends[1].receive()


def test_a_process_that_dies_with_something_unread_has_ended_too(ends):
    ends[1].send({"unread": 1})
    ends[0].close()
    with pytest.raises(ProcessLost, match="process 0 has ended"):
        ends[1].receive()


# Two processes of a toy algorithm, which compiles in a moment -------------------------------------------------------


def walk(key, hparams):
    return {"noise": jax.random.normal(key), "total": jax.numpy.zeros(2), "beta": hparams.beta * 1.0}


def stride(state, hparams, data):
    total = state["total"] + hparams.lambda_i * state["noise"] + data["gain"] * data["vector"]
    return state | {"total": total}, {"total": total.sum(), "first": total[0]}


def stride_together(state, hparams, data):
    """As `stride`, each of two devices with half of the vector."""
    mean = Shards(2).mean(Shards(2).part(data["vector"]).mean())
    return stride(state, hparams, data | {"vector": mean * jax.numpy.ones(2)})


WALKS = {
    shards: Algorithm(walk, step, lambda state, obs, key: obs, shards)
    for shards, step in ((1, stride), (2, stride_together))
}
COUNT = 7
DATA = {"gain": np.arange(COUNT, dtype=np.float32), "vector": np.ones((COUNT, 2), np.float32)}


def walked(out, shards):
    """Trains the toy with whatever processes there are, `shards` devices a lane; writes what comes out."""
    keys = jax.random.split(jax.random.PRNGKey(3), COUNT)
    hparams = HParams(lambda_i=np.arange(1.0, COUNT + 1), beta=0.5)
    forgotten = Lanes(WALKS[shards], keys, hparams, DATA, data_per_lane=True)
    forgotten.init()
    del forgotten
    lanes = Lanes(WALKS[shards], keys, hparams, DATA, data_per_lane=True)
    first, metrics = lanes.run(lanes.init(), 3)
    kept = lanes.take(first)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, np.zeros_like(b), strict=True), lanes.blank(), kept)
    lanes.run(first, 2)
    last, more = lanes.run(lanes.put(kept), 3)
    np.savez(
        out,
        **{f"{name} 1": x for name, x in metrics.items()},
        **{f"{name} 2": x for name, x in more.items()},
        **lanes.take(last),
    )
    return lanes, first


CHILD = """
import os, signal, sys
from eairl_jax import InputError, ProcessLost, blocks, processes, xla
xla.configure_jax()
sys.path.insert(0, {tests!r})
where, role = sys.argv[1], sys.argv[2]
where = processes.meeting(*((where, 2, int(role)) if where else (None, None, None)))
processes.WAIT_S = {wait}
try:
    team = processes.join(where, {{"gamma": {gamma}}})
    if isinstance(team, processes.Team):
        print("devices", *team.devices, flush=True)
        import test_processes
        with processes.leading(team):
            lanes, used = test_processes.walked({out!r}, {shards})
            try:
                lanes.take(used)
            except InputError as e:
                print(e, flush=True)
            if {dies}:
                os.kill(os.getpid(), signal.SIGKILL)
    else:
        print("served", blocks.serve(team))
except (InputError, ProcessLost) as e:
    print(type(e).__name__, e)
"""


def start(where, role, out="", wait=60, gamma="1", dies=False, shards=1, **environ):
    """Starts a process of the toy."""
    code = CHILD.format(
        tests=str(Path(__file__).parent), wait=wait, gamma=gamma, out=str(out), dies=dies, shards=shards
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, where, role],
        env=os.environ | {"JAX_PLATFORMS": "cpu", "NPROC": ""} | environ,  # threads for as many devices as asked for
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def free_port():
    """A port of this host that is free now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


@pytest.mark.parametrize("shards", WALKS)
def test_processes_of_different_size_compute_what_one_computes_and_the_death_of_process_0_ends_the_others(
    tmp_path, shards
):
    where = f"localhost:{free_port()}"
    leader = start(where, "0", tmp_path / "two.npz", dies=True, shards=shards, JAX_NUM_CPU_DEVICES=f"{shards}")
    worker = start(where, "1", JAX_NUM_CPU_DEVICES=f"{3 * shards}")
    printed = leader.communicate(timeout=120)[0].splitlines()
    assert printed == [
        f"devices {shards} {3 * shards}",
        "the lanes are in several processes, which keep one state: the newest one is needed here",
    ]
    assert leader.returncode == -signal.SIGKILL
    assert worker.communicate(timeout=60)[0].splitlines() == [
        "ProcessLost process 0 of 2 (localhost) has ended: start all processes again: a training goes on from its last "
        "checkpoint"
    ]
    walked(tmp_path / "one.npz", shards)
    one, two = (dict(np.load(tmp_path / f"{name}.npz")) for name in ("one", "two"))
    assert one.keys() == two.keys()
    for name in one:
        np.testing.assert_allclose(two[name], one[name], rtol=1e-6, err_msg=name)
    assert one["total 1"].shape == (COUNT, 3)
    assert (np.diff(one["first 2"][:, -1]) != 0).all()


def test_processes_of_a_launcher_that_were_given_different_settings_are_refused_by_name():
    launched = SLURM | {"SLURM_JOB_ID": str(os.getpid()), "JAX_COORDINATOR_PORT": str(free_port())}
    both = [start("", "", gamma=str(i + 1), **launched, SLURM_PROCID=str(i)) for i in range(2)]
    expected = "InputError process 0 and process 1 of 2"
    for each in both:
        printed = each.communicate(timeout=60)[0]
        assert printed.startswith(expected)
        assert printed.endswith("have different settings (gamma: 1 and 2): give every process the same command\n")


def test_a_process_that_nobody_meets_ends_with_one_message():
    alone = start(f"localhost:{free_port()}", "1", wait=1)
    printed = alone.communicate(timeout=60)[0]
    assert alone.returncode == 1
    assert printed.startswith("eairl: not all processes were there at localhost:")
    assert printed.count("\n") == 1


def test_a_port_that_is_taken_and_a_host_without_address_are_refused():
    with socket.create_server(("", 0)) as server:
        where = f"localhost:{server.getsockname()[1]}"
        with pytest.raises(InputError, match=rf"--coordinator {where}: choose another port \("):
            processes.join(Meeting(where, 2, 0), {})
    with pytest.raises(InputError, match=r"nowhere\.invalid:1: no host has this name"):
        processes.join(Meeting("nowhere.invalid:1", 2, 1), {})
