"""The first signal ends a training after its chunk, the second one at once."""

import os
import signal
import subprocess
import sys
import time

import pytest

from eairl_jax import Checkpoints, processes
from eairl_jax.experiments.pipeline.interruption import Interrupted, Interruption


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_training_after_its_chunk(tmp_path, tiny, number):
    """The chunk is saved, the message says how to go on, and the exit code is the signal's."""
    command = [sys.executable, "-P", "-m", "eairl_jax.experiments.cli", "imitate", "pendulum", "--method", "bc"]
    settings = [each for each in tiny if not each.startswith(("iterations", "history", "empowerment", "hidden"))]
    long = ["--seeds", "1", "--out", str(tmp_path / "run"), "--set", *settings, "iterations=1000000"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen([*command, *long], stderr=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
    try:
        checkpoints = tmp_path / "run" / "checkpoints"
        deadline = time.monotonic() + 120
        while not (checkpoints.is_dir() and any(path.name.isdigit() for path in checkpoints.iterdir())):
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + number
    message = " ".join(err.decode().split())
    assert "stopping after this chunk is saved" in message
    assert "goes on from its last checkpoint" in message
    assert "Traceback" not in message
    done = Checkpoints(checkpoints).latest()
    lines = (tmp_path / "run" / "metrics.csv").read_text().splitlines()
    assert len(lines) == 1 + done  # what the checkpoint claims is on disk, and nothing more


def test_the_first_signal_is_noted_and_the_handlers_come_back(capfd):
    before = signal.getsignal(signal.SIGINT)
    with Interruption() as interruption:
        interruption.stop_if_asked()
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(Interrupted) as e:
            interruption.stop_if_asked()
        assert e.value.code == 130
    assert signal.getsignal(signal.SIGINT) is before
    assert "a second signal stops at once" in capfd.readouterr().err


def test_the_second_signal_ends_the_process_though_it_never_comes_back_to_python():
    """A chunk of training is one call into compiled code; here it is a sleep that no handler interrupts."""
    code = """
import ctypes, sys
from eairl_jax.experiments.pipeline.interruption import Interruption
with Interruption():
    print("ready", flush=True)
    while True:
        ctypes.CDLL(None).usleep(100_000_000)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    )
    assert process.stdout.readline() == b"ready\n"
    process.send_signal(signal.SIGTERM)
    assert b"stopping after this chunk" in process.stderr.readline() + process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 143
    assert b"Traceback" not in err


def test_a_signal_to_another_process_of_the_team_stops_the_training_too():
    team = processes.Team([], [1])
    with processes.leading(team), Interruption() as interruption:
        interruption.stop_if_asked()
        assert interruption.asked is None
        team.asked = signal.SIGTERM
        with pytest.raises(Interrupted) as e:
            interruption.stop_if_asked()
    assert e.value.code == 143
    assert processes.current() is None
