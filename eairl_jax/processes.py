"""Several processes, on one host or on many, that train the lanes of one run.

Process 0 runs the program. The other processes serve process 0: they get compiled programs and rows of lanes, and send
rows back (`blocks`). So process 0 alone reads and writes files, and the others need neither the demonstrations nor the
code of a user's task.

The processes find each other by `jax.distributed.initialize`: JAX knows the launchers (SLURM, Open MPI, Kubernetes).
JAX's service is closed as soon as all are there, before any backend is made, for two reasons. That service would abort
a process whose peer dies, with a stack trace of C++. And a backend that is made while the service is open makes
checkpoints wait for all processes, and keeps compiled programs in process 0 alone. From then on each process talks to
process 0 by a TCP connection. A process that dies closes it; a host that goes silent is noticed after `SILENCE_S`.

Nobody has to prove who he is, neither to JAX's service nor here beyond a random token: use a network that you trust.

No function here imports jax before it is needed, so that `xla.configure_jax` can come first.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import signal
import socket
import struct
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from eairl_jax.errors import InputError, ProcessLost

WAIT_S = 300
"""How long the processes wait for each other at the start, in seconds."""
SILENCE_S = 30
"""After how many seconds without a sign of life a host is taken for dead."""
LAUNCHERS = {
    "SLURM": ("SLURM_PROCID", "SLURM_NTASKS", ("SLURM_JOB_ID", "SLURM_STEP_NODELIST", "SLURM_LOCALID")),
    "Open MPI": ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", ("OMPI_MCA_orte_hnp_uri",)),
    "Kubernetes": ("JOB_COMPLETION_INDEX", "", ("KUBERNETES_SERVICE_HOST",)),
}
"""Launchers that JAX knows: the variables of the number of the process and of all processes, and the other variables by
which JAX finds the launcher. JAX asks Kubernetes itself how many there are."""
GO_ON = "start all processes again: a training goes on from its last checkpoint"
ALONE = "--processes 1 runs a process alone"
KEY = "eairl_jax"
PACKAGES = ("eairl-jax", "jax", "jaxlib")

Arrays = list[np.ndarray]


class Meeting(NamedTuple):
    """Where processes meet. If a launcher has started them, JAX asks the launcher for the fields that are None.

    Attributes:
      coordinator: "host:port" of process 0.
      processes: how many there are.
      process: which of them this one is, from 0.
    """

    coordinator: str | None = None
    processes: int | None = None
    process: int | None = None


def meeting(
    coordinator: str | None, processes: int | None, process: int | None, environ: Mapping[str, str] | None = None
) -> Meeting | None:
    """Where this process has to meet others; None if it is alone. A launcher with one process leaves it alone.

    Args:
      coordinator: "host:port" of process 0, the same for every process.
      processes: how many there are. 1 means alone, whatever a launcher says.
      process: number of this process, from 0.
      environ: in which a launcher is sought; `os.environ` if None.

    Raises:
      InputError: if an argument is missing or impossible.
    """
    if processes is not None and processes < 1:
        raise InputError(f"--processes {processes}: expected at least 1")
    if coordinator is None and process is None:
        if processes == 1:
            return None
        if processes is None:
            return _launched(os.environ if environ is None else environ)
    if coordinator is None or processes is None or process is None:
        given = {"--coordinator": coordinator, "--processes": processes, "--process": process}
        missing = " and ".join(name for name, value in given.items() if value is None)
        raise InputError(
            f"{missing} missing: processes that are started by hand need --coordinator HOST:PORT (of process 0), "
            "--processes N and --process I; under srun, mpirun or in an indexed job of Kubernetes give none of them"
        )
    if not 0 <= process < processes:
        raise InputError(
            f"--process {process}: expected a number from 0 to {processes - 1}, for --processes {processes}"
        )
    split = re.fullmatch(r"([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):([0-9]{1,5})", coordinator)
    if split is None or not 1 <= int(split[2]) <= 65535:
        raise InputError(
            f"--coordinator {coordinator!r:.80}: expected the host of process 0 and a free port on it, for example "
            "node1:12345"
        )
    return None if processes == 1 else Meeting(coordinator, processes, process)


def _launched(environ: Mapping[str, str]) -> Meeting | None:
    """The meeting of processes that a launcher has started; None if there is no launcher, or if it started one."""
    for process, count, others in LAUNCHERS.values():
        if all(environ.get(each, "").strip() for each in (process, *filter(None, [count]), *others)):
            is_alone = bool(count) and environ[count].strip() == "1"
            return None if is_alone else Meeting(process=int(environ[process]))
    return None


# Messages ------------------------------------------------------------------------------------------------------------


class Peer:
    """The other end of a connection. A message is JSON values and arrays.

    Args:
      name: for messages of errors, for example "process 1 of 2 (node2)".
    """

    def __init__(self, connection: socket.socket, name: str):
        self.name, self._socket = name, connection
        connection.settimeout(None)
        options = {
            "SO_KEEPALIVE": (socket.SOL_SOCKET, 1),
            "TCP_NODELAY": (socket.IPPROTO_TCP, 1),
            "TCP_KEEPIDLE": (socket.IPPROTO_TCP, max(1, SILENCE_S // 3)),
            "TCP_KEEPINTVL": (socket.IPPROTO_TCP, max(1, SILENCE_S // 6)),
            "TCP_KEEPCNT": (socket.IPPROTO_TCP, 4),
            "TCP_USER_TIMEOUT": (socket.IPPROTO_TCP, SILENCE_S * 1000),
        }
        for option, (level, value) in options.items():
            if hasattr(socket, option):  # not every system has all of them
                connection.setsockopt(level, getattr(socket, option), value)

    def send(self, values: dict[str, Any], arrays: Sequence[np.ndarray] = ()) -> None:
        """Sends a message.

        Raises:
          ProcessLost: if the other end is gone.
        """
        whole = [np.asarray(each, order="C") for each in arrays]
        head = json.dumps({"values": values, "arrays": [[each.dtype.name, each.shape] for each in whole]}).encode()
        try:
            self._socket.sendall(struct.pack("!Q", len(head)) + head)
            for each in whole:
                self._socket.sendall(each.reshape(-1).view(np.uint8).data)
        except OSError as e:
            raise self._lost(e) from None

    def receive(self) -> tuple[dict[str, Any], Arrays]:
        """Waits for a message.

        Raises:
          ProcessLost: if the other end is gone.
        """
        (size,) = struct.unpack("!Q", self._read(8))
        head = json.loads(bytes(self._read(size)))
        arrays = []
        for dtype, shape in head["arrays"]:
            kind = np.dtype(dtype)
            arrays.append(self._read(int(np.prod(shape)) * kind.itemsize).view(kind).reshape(shape))
        return head["values"], arrays

    def close(self) -> None:
        """Closes the connection."""
        self._socket.close()

    def _read(self, size: int) -> np.ndarray:
        content, done = np.empty(size, np.uint8), 0
        while done < size:
            try:
                more = self._socket.recv_into(content[done:].data)
            except OSError as e:
                raise self._lost(e) from None
            if not more:
                raise self._lost(None)
            done += more
        return content

    def _lost(self, error: OSError | None) -> ProcessLost:
        reason = "has ended"
        if error and not isinstance(error, ConnectionError):  # a dead process resets what it had not read
            reason = f"does not answer any more ({error.strerror or error})"
        return ProcessLost(f"{self.name} {reason}: {GO_ON}")


# Process 0 -----------------------------------------------------------------------------------------------------------


@dataclass
class Team:
    """The processes that serve this one, process 0.

    Attributes:
      workers: the others, in the order of their numbers.
      devices: of every process, this one first.
      asked: a signal that has asked one of the others to stop; None if none has.
    """

    workers: list[Peer]
    devices: list[int]
    asked: int | None = None
    _sent: int = 0
    _blocks: int = 0
    _freed: list[int] = field(default_factory=list)

    def new_block(self) -> int:
        """A number for a new block of lanes."""
        self._blocks += 1
        return self._blocks

    def free(self, block: int) -> None:
        """Lets the others forget a block, with the next request. The garbage collector may call this at any moment."""
        self._freed.append(block)

    def ask(self, block: int, call: str, values: Sequence[dict[str, Any]], arrays: Sequence[Arrays]) -> None:
        """Asks every worker to call a method of its block.

        Args:
          values, arrays: of the method, for each worker.

        Raises:
          ProcessLost: if one of them is gone.
        """
        self._sent += 1
        freed, self._freed = self._freed, []
        request = {"number": self._sent, "block": block, "call": call, "freed": freed}
        for worker, of_worker, its_arrays in zip(self.workers, values, arrays, strict=True):
            worker.send(request | {"values": of_worker}, its_arrays)

    def answers(self) -> list[tuple[dict[str, Any], Arrays]]:
        """What every worker has to say to the last request.

        Raises:
          ProcessLost: if one of them is gone, or has failed.
        """
        found = []
        for worker in self.workers:
            values, arrays = worker.receive()
            while values["number"] < self._sent:  # of a request whose caller has failed meanwhile
                values, arrays = worker.receive()
            if "error" in values:
                raise ProcessLost(f"{worker.name} has failed: {values['error']}")
            self.asked = values["asked"] or self.asked
            found.append((values, arrays))
        return found

    def end(self, failed: bool) -> None:
        """Lets the others end."""
        for worker in self.workers:
            with contextlib.suppress(ProcessLost):
                worker.send({"call": "end", "failed": failed})
            worker.close()


def check_lanes(lanes: int, processes: int) -> None:
    """Raises `InputError` if there are more processes than lanes."""
    if lanes < processes:
        raise InputError(
            f"{processes} processes are too many for {lanes} lanes (seeds, or points of a sweep times seeds): start at "
            f"most {lanes}, or train more seeds"
        )


_TEAM: ContextVar[Team | None] = ContextVar("team", default=None)


def current() -> Team | None:
    """The processes that serve this one; None if it is alone."""
    return _TEAM.get()


@contextlib.contextmanager
def leading(team: Team) -> Iterator[Team]:
    """While this context is open, `Lanes` are spread over all processes of the team. At its end the others end."""
    token = _TEAM.set(team)
    failed = True
    try:
        yield team
        failed = False
    finally:
        _TEAM.reset(token)
        team.end(failed)


# The start -----------------------------------------------------------------------------------------------------------


def join(where: Meeting, settings: dict[str, str]) -> Team | Peer:
    """Meets the other processes: JAX makes them known to each other. No backend of jax may have been made before.

    Args:
      settings: what must be the same in every process, each by its name.

    Returns:
      In process 0 the team; in the others process 0, for `blocks.serve`.

    Raises:
      InputError: if the settings, the versions or the kinds of devices differ.
      ProcessLost: if the others do not come within `WAIT_S`, or if one of them is gone again.
    """
    import jax

    number, count, client = _initialize(where)
    settings = settings | {f"version of {name}": version(name) for name in PACKAGES}
    if number == 0:
        return _gather(client, count, settings)
    server = json.loads(client.blocking_key_value_get(KEY, WAIT_S * 1000))
    host = _coordinator_address().rpartition(":")[0].strip("[]")
    try:
        connection = socket.create_connection((host, server["port"]), timeout=WAIT_S)
        connection.sendall(server["token"].encode())
    except OSError as e:
        raise ProcessLost(f"process 0 ({host}) cannot be reached ({e.strerror or e}); {ALONE}") from None
    leader = Peer(connection, f"process 0 of {count} ({host})")
    leader.send({"process": number, "host": socket.gethostname(), "settings": settings})
    _check(leader)
    _close()
    leader.send({"devices": jax.local_device_count(), "platform": jax.default_backend()})
    _check(leader)
    return leader


def _check(leader: Peer) -> None:
    refused = leader.receive()[0]["refused"]
    if refused:
        raise InputError(refused)


def _initialize(where: Meeting) -> tuple[int, int, Any]:
    """`(this process, all processes, client)` of JAX's service, when all are there."""
    import jax
    from jax._src import distributed  # its key-value store has no public name

    _check_coordinator(where)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    # JAX waits in C++, where no handler of Python runs, and would abort the process with a stack trace.
    for number in handlers:
        signal.signal(number, signal.SIG_DFL)
    alarm = threading.Timer(WAIT_S, _give_up, (where,))
    alarm.daemon = True
    alarm.start()
    try:
        jax.distributed.initialize(*where, initialization_timeout=2 * WAIT_S + 60, shutdown_timeout_seconds=SILENCE_S)
    except Exception as e:  # JAX, its launchers and gRPC raise many
        raise ProcessLost(f"the processes cannot find each other ({e}); {ALONE}") from None
    finally:
        alarm.cancel()
        for number, handler in handlers.items():
            signal.signal(number, handler or signal.SIG_DFL)
    state = distributed.global_state
    return state.process_id, state.num_processes, state.client


def _check_coordinator(where: Meeting) -> None:
    """Raises `InputError` if the host of process 0 has no address, or if process 0 cannot have its port."""
    if where.coordinator is None:
        return
    host, _, port = where.coordinator.rpartition(":")
    try:
        if where.process:
            socket.getaddrinfo(host.strip("[]"), int(port))
        else:
            socket.create_server(("", int(port))).close()
    except OSError as e:
        if where.process:
            raise InputError(f"--coordinator {where.coordinator}: no host has this name ({e.strerror})") from None
        raise InputError(f"--coordinator {where.coordinator}: choose another port ({e.strerror})") from None


def _give_up(where: Meeting) -> None:
    """Ends this process, from a thread."""
    place = f" at {where.coordinator}" if where.coordinator else ""
    sys.stderr.write(
        f"eairl: not all processes were there{place} within {WAIT_S} s: is each of them started, with its own number, "
        f"and can their hosts reach each other? {ALONE}\n"
    )
    sys.stderr.flush()
    os._exit(1)


def _coordinator_address() -> str:
    """The "host:port" of process 0, as the user or a launcher has named it."""
    from jax._src import distributed

    return distributed.global_state.coordinator_address or ""


def _close() -> None:
    """Closes JAX's service. What is computed from now on is computed as in a process that is alone."""
    import jax
    from jax._src import distributed

    jax.distributed.shutdown()
    # JAX keeps these two, and would number the devices by them. Only process 0 would keep compiled programs on disk.
    distributed.global_state.process_id, distributed.global_state.num_processes = 0, 1


def _gather(client: Any, count: int, settings: dict[str, str]) -> Team:
    """Process 0: the connections of all others, in the order of their numbers."""
    import jax

    token, workers = secrets.token_hex(16), {}
    with _server() as server:
        client.key_value_set(KEY, json.dumps({"port": server.getsockname()[1], "token": token}))
        while len(workers) < count - 1:
            try:
                connection = server.accept()[0]
            except TimeoutError:
                raise ProcessLost(f"{count - 1 - len(workers)} of {count} processes are gone again: {GO_ON}") from None
            if not _knows(connection, token):
                connection.close()
                continue
            peer = Peer(connection, "a process")
            hello, _ = peer.receive()
            peer.name = f"process {hello['process']} of {count} ({hello['host']})"
            workers[hello["process"]] = peer, hello["settings"]
    peers = [workers[number][0] for number in sorted(workers)]
    _answer(peers, next(filter(None, (_difference(settings, theirs, peer) for peer, theirs in workers.values())), ""))
    _close()
    facts = [peer.receive()[0] for peer in peers]
    platform = jax.default_backend()
    others = [peer.name for peer, each in zip(peers, facts, strict=True) if each["platform"] != platform]
    _answer(peers, f"{others[0]} computes on another kind of device than process 0 ({platform})" if others else "")
    return Team(peers, [jax.local_device_count(), *(each["devices"] for each in facts)])


def _knows(connection: socket.socket, token: str) -> bool:
    """Whether the other end begins with the token. A stranger may have found the port."""
    connection.settimeout(SILENCE_S)
    try:
        return secrets.compare_digest(connection.recv(len(token), socket.MSG_WAITALL), token.encode())
    except OSError:
        return False


def _server() -> socket.socket:
    both = socket.has_dualstack_ipv6()
    family = socket.AF_INET6 if both else socket.AF_INET
    server = socket.create_server(("", 0), family=family, dualstack_ipv6=both, backlog=1024)
    server.settimeout(WAIT_S)
    return server


def _answer(peers: list[Peer], refused: str) -> None:
    """Says whether all is well; raises `InputError` if it is not."""
    for peer in peers:
        peer.send({"refused": refused})
    if refused:
        raise InputError(refused)


def _difference(ours: dict[str, str], theirs: dict[str, str], peer: Peer) -> str:
    different = [name for name in sorted(ours | theirs) if ours.get(name) != theirs.get(name)]
    if not different:
        return ""
    shown = "; ".join(
        f"{name}: {ours.get(name, 'not given')} and {theirs.get(name, 'not given')}" for name in different[:4]
    )
    return f"process 0 and {peer.name} have different settings ({shown}): give every process the same command"
