"""Does a run come to the same bits, however often it is killed? `make test-kill`.

    python tests/kills/run.py                                        # every command, an hour or more
    python tests/kills/run.py --commands imitate sweep --kills 3     # some of them, with fewer kills
    python tests/kills/run.py --work DIR                             # goes on with what DIR holds already

Each command first runs twice without a kill. Then it is killed by SIGKILL again and again, and finished by the same
command: first at random moments, then just before file events of every kind (`child.py`). Metrics, results, rewards,
states of the last checkpoint and pictures must be those of the run without a kill, bit for bit. Each kill may cost at
most one chunk, which is computed again. If anything differs, or costs more, the exit code is 1.

Python's file events do not show what the C++ library of the checkpoints writes. Only random moments meet it.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import dataclasses
import importlib.util
import json
import os
import pickle
import random
import select
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

CHILD = Path(__file__).with_name("child.py")
RUN, CACHE = "run", "cache"
CHAIN = 6
"""The most kills of one run before it is left to finish."""
SECONDS = 1800
"""A process that takes longer has hung."""
MEASURED = ("compile_seconds", "run_seconds", "peak_memory_gb", "machine")
"""What a summary says of time and machine: it may differ."""
RETRAINED = ("num_envs=2", "rollout_length=20", "ppo_epochs=1", "ppo_minibatches=1", "policy_hidden=4")
TINY_POLICY = (*RETRAINED, "value_hidden=4", "iterations=12", "snapshot_every=2")
TINY = (
    *TINY_POLICY,
    "hidden=4",
    "history_length=1",
    "discriminator_updates=1",
    "discriminator_batch=8",
    "empowerment_updates=1",
    "empowerment_batch=8",
)
TRIALS = ("trials=3", "trial_iterations=2", "random_trials=1", "--restarts", "2")
TRANSFER = ("transfer", "pendulum", "pendulum", "--seeds", "1", "--out", RUN, "--set", *TINY, "--retrain-set")
COMMANDS = {
    "imitate": ("imitate", "pendulum", "--seeds", "2", "--out", RUN, "--set", *TINY),
    "more": ("imitate", "pendulum", "--seeds", "2", "--out", RUN, "--more", "6", "--set", *TINY),
    "more-seeds": ("imitate", "pendulum", "--seeds", "1", "--out", RUN, "--more-seeds", "1", "--set", *TINY),
    "expert": ("expert", "pendulum", "--seeds", "2", "--out", RUN, "--set", *TINY_POLICY),
    "sweep": ("sweep", "pendulum", "--seeds", "1", "--out", RUN, "--set", *TINY, "lambda_i=0,0.1"),
    "search": (
        *("search", "pendulum", "--seeds", "1", "--trials", "4", "--generation", "2", "--out", RUN),
        *("--set", *TINY, "lambda_i=log:1e-3..1"),
    ),
    "transfer-last": (*TRANSFER, *TINY_POLICY, *TRIALS, "--rule", "last"),
    "transfer-source_retrain": (*TRANSFER, *TINY_POLICY, "trials=0", "--restarts", "2", "--rule", "source_retrain"),
    "transfer-policy": (*TRANSFER, *TINY_POLICY, "trials=0", "--rule", "policy"),
    "reproduce": ("reproduce", "table2", "--quick", "--task", "pendulum", "--out", RUN),
}


@dataclasses.dataclass
class Process:
    """What a process did.

    Attributes:
      code: exit code; -9 after SIGKILL.
      ended: the time of its end.
      log: lines of `child.py`, split; each begins with a time.
      printed: everything that it printed.
    """

    code: int
    ended: float
    log: list[list[str]]
    printed: str

    @property
    def events(self) -> list[str]:
        """Kind and place of each file event."""
        return [" ".join(line[2:]) for line in self.log if line[1] == "event"]

    @property
    def chunks(self) -> list[tuple[str, int, int]]:
        """Folder, first iteration and length of each chunk that was begun."""
        return [(line[2], int(line[3]), int(line[4])) for line in self.log if line[1] == "chunk"]

    @property
    def killed_at(self) -> str:
        """Kind and place of the file event before which `child.py` has killed the process."""
        return next((line[2] for line in self.log if line[1] == "killed"), "")

    def times(self, word: str) -> list[float]:
        """When each event happened, or each chunk began, and the end of the process."""
        return [*(float(line[0]) for line in self.log if line[1] == word), self.ended]


@dataclasses.dataclass(frozen=True)
class Moment:
    """A time to kill a process at: so many seconds after its first file event, or after it has begun its Nth chunk."""

    word: str
    number: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.seconds:.2f} s after {self.word} {self.number}"


class Server:
    """A process that runs commands in forks of itself (`child.py --serve`)."""

    def __init__(self) -> None:
        environment = os.environ | {
            "JAX_PLATFORMS": "cpu",
            "JAX_NUM_CPU_DEVICES": "1",
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path[1:])),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore:os.fork", str(CHILD), "--serve"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
            start_new_session=True,
        )

    def run(self, name: str, folder: Path, event: str = "-", moment: Moment | None = None) -> Process:
        """Runs a command in a folder until its end, or until it is killed.

        Args:
          event: at which `child.py` kills the process.
          moment: at which the process is killed from outside.
        """
        assert self._process.stdin
        assert self._process.stdout
        log, printed = folder / "log", folder / "printed"
        log.unlink(missing_ok=True)
        command = {
            "folder": str(folder),
            "environment": {"XDG_CACHE_HOME": str(folder / CACHE)},
            "printed": str(printed),
            "arguments": ["log", os.pathsep.join([RUN, f"{CACHE}/eairl_jax"]), event, *COMMANDS[name]],
        }
        print(json.dumps(command), file=self._process.stdin, flush=True)
        number = int(self._process.stdout.readline())
        began = time.monotonic()
        # The answer that follows is the exit code. It is waited for in the loop.
        answer = self._process.stdout
        while not select.select([answer], [], [], 0.002)[0]:
            now = time.monotonic()
            if now > began + SECONDS or (moment and is_due(moment, log, now)):
                os.kill(number, signal.SIGKILL)
                break
        code, ended = int(answer.readline()), time.monotonic()
        return Process(code, ended, lines_of(log), printed.read_text(errors="replace"))

    def close(self) -> None:
        """Ends the process and its forks: none may go on in a folder that the next call uses."""
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def lines_of(log: Path) -> list[list[str]]:
    """The lines of `child.py`, split; without a line that is being written."""
    text = log.read_text() if log.exists() else ""
    return [line.split("\t") for line in text[: text.rfind("\n") + 1].splitlines()]


def is_due(moment: Moment, log: Path, now: float) -> bool:
    """Whether the time of a moment has come."""
    times = [float(line[0]) for line in lines_of(log) if line[1] == moment.word]
    return len(times) >= moment.number and now > times[moment.number - 1] + moment.seconds


# What must be equal --------------------------------------------------------------------------------------------------


def content(run: Path) -> dict[str, Any]:
    """What the files of a finished run hold, without times and without the files inside of checkpoints."""
    held: dict[str, Any] = {}
    for path in sorted(path for path in run.rglob("*") if path.is_file()):
        name = path.relative_to(run).as_posix()
        if "checkpoints/" in name:
            continue
        if path.suffix == ".npz":
            with np.load(path) as arrays:
                held |= {f"{name}: {each}": arrays[each] for each in arrays.files}
        elif path.suffix == ".db":
            held[name] = trials(path)
        elif path.suffix == ".json":
            held[name] = "" if name.endswith("seconds.json") else without_times(json.loads(path.read_text()))
        else:
            held[name] = path.read_bytes()
    for folder in sorted(run.rglob("checkpoints")):
        name = folder.relative_to(run).as_posix()
        held[f"{name}: iterations"] = sorted(path.name for path in folder.iterdir())
        held |= {f"{name}: {leaf}": array for leaf, array in last_state(folder).items()}
    return held


def trials(database: Path) -> list[tuple]:
    """The trials of a search without their times: number, state, settings and score."""
    query = """
        SELECT number, state, param_name, param_value, value FROM trials
        LEFT JOIN trial_params USING (trial_id) LEFT JOIN trial_values USING (trial_id)
        ORDER BY number, param_name
    """
    with contextlib.closing(sqlite3.connect(database)) as connection:
        return connection.execute(query).fetchall()


def without_times(value: Any) -> Any:
    """A JSON value without the members of the name of `MEASURED`."""
    if isinstance(value, dict):
        return {name: without_times(each) for name, each in value.items() if name not in MEASURED}
    return [without_times(each) for each in value] if isinstance(value, list) else value


def last_state(folder: Path) -> dict[str, np.ndarray]:
    """The arrays of the newest checkpoint in a folder."""
    import orbax.checkpoint as ocp

    newest = max((path for path in folder.iterdir() if path.name.isdigit()), key=lambda path: int(path.name))
    with ocp.StandardCheckpointer() as checkpointer:
        return {name: np.asarray(leaf) for name, leaf in checkpointer.restore((newest / "default").resolve()).items()}


def differences(expected: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Names of what is not equal, bit for bit."""

    def same(a: Any, b: Any) -> bool:
        if isinstance(a, np.ndarray):
            return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        return a == b

    missing = [f"{name} is missing" for name in sorted(set(expected) - set(found))]
    more = [f"{name} is left over" for name in sorted(set(found) - set(expected))]
    return [*missing, *more, *(name for name in expected if name in found and not same(expected[name], found[name]))]


def computed_again(processes: list[Process]) -> list[int]:
    """For each process after the first, the iterations that a process before it had begun; and whether they are more
    than one chunk: then the number is negative."""
    begun: set[tuple[str, int, int]] = set()
    again = []
    for process in processes:
        repeated = [chunk[2] for chunk in process.chunks if chunk in begun]
        again.append(sum(repeated) if len(repeated) < 2 else -sum(repeated))
        begun |= set(process.chunks)
    return again[1:]


# Kills ---------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Record:
    """What is known of a command; it is kept in a file.

    Attributes:
      kills: `[moment or event, kind and place]` of each.
      most_again: iterations that were computed again after one kill, at most.
      runs: killed runs that were finished.
      faults: what differed, what cost too much, what could not be finished.
    """

    kills: list[list[str]] = dataclasses.field(default_factory=list)
    most_again: int = 0
    runs: int = 0
    faults: list[str] = dataclasses.field(default_factory=list)

    def count(self, mode: str) -> int:
        """Kills at random moments, or at file events."""
        return sum(kill[0] == mode for kill in self.kills)


@dataclasses.dataclass
class Reference:
    """A command that was not killed.

    Attributes:
      content: of its folder.
      events: its file events; those of an empty cache are among them.
      event_seconds: from its first file event to its end, with a full cache.
      chunk_seconds: from the start of each chunk to that of the next one, or to the end.
    """

    content: dict[str, Any]
    events: list[str]
    event_seconds: float
    chunk_seconds: list[float]


def reference(server: Server, name: str, folder: Path) -> Reference:
    """Runs a command twice, first with an empty cache; reads what an earlier call has written."""
    kept, runs = folder / "reference.pickle", []
    if kept.exists():
        return pickle.loads(kept.read_bytes())
    shutil.rmtree(folder / CACHE, ignore_errors=True)
    for number in range(2):
        shutil.rmtree(folder / RUN, ignore_errors=True)
        process = server.run(name, folder)
        if process.code:
            sys.exit(f"{name} fails without a kill:\n{process.printed[-2000:]}")
        runs.append((content(folder / RUN), process))
        seconds = process.ended - process.times("event")[0]
        print(f"{name}: {seconds:.0f} s without a kill, {len(process.events)} file events", flush=True)
        if not number:
            shutil.rmtree(folder / "full-cache", ignore_errors=True)
            shutil.copytree(folder / CACHE, folder / "full-cache")
    (first, cold), (second, warm) = runs
    unequal = differences(first, second)
    if unequal:
        sys.exit(f"{name} gives other bits without a kill: {', '.join(unequal[:5])}")
    events, chunks = warm.times("event"), warm.times("chunk")
    known = Reference(first, cold.events, events[-1] - events[0], np.diff(chunks).tolist())
    kept.write_bytes(pickle.dumps(known))
    return known


def chosen_moment(known: Reference, done: int, dice: random.Random) -> Moment:
    """A random moment: in one of four cases any, and otherwise one after a chunk has begun, since chunks are short.

    Args:
      done: chunks that are not begun again.
    """
    left = len(known.chunk_seconds) - done
    if left < 1 or dice.random() < 0.25:
        return Moment("event", 1, dice.uniform(0, known.event_seconds))
    number = dice.randint(1, left)
    return Moment("chunk", number, dice.uniform(0, known.chunk_seconds[done + number - 1]))


def chosen_events(events: list[str], kills: int, dice: random.Random) -> list[str]:
    """Events as `child.py` takes them: the kinds in turn, and of each kind one place after another."""
    places = collections.Counter(events)
    places.update({f"opened {event[5:]}": count for event, count in places.items() if event.startswith("open ")})
    of_kind: dict[str, list[str]] = {}
    for place in dice.sample(sorted(places), len(places)):
        of_kind.setdefault(place.split()[0], []).append(place)
    queue: list[str] = []
    for turn in range(kills if kills else max(map(len, of_kind.values()))):
        for in_kind in of_kind.values():
            if kills or turn < len(in_kind):
                place = in_kind[turn % len(in_kind)]
                queue.append(f"{dice.randint(1, places[place])} {place}")
    return queue[: kills or None]


def killed_run(
    server: Server, name: str, folder: Path, known: Reference, queue: list[str], dice: random.Random, record: Record
) -> None:
    """Kills a run up to `CHAIN` times and finishes it; the events that have happened leave `queue`.

    Without a `queue` the kills are at random moments.
    """
    shutil.rmtree(folder / RUN, ignore_errors=True)
    shutil.rmtree(folder / CACHE, ignore_errors=True)
    shutil.copytree(folder / "full-cache", folder / CACHE)
    at_events, processes, sites = bool(queue), [], []
    while True:
        event, moment = "-", None
        if len(processes) < CHAIN and at_events and queue:
            event = queue[0]
            forget_programs(folder / CACHE, event)
        elif len(processes) < CHAIN and not at_events:
            begun = {chunk for each in processes for chunk in each.chunks}
            moment = chosen_moment(known, len(begun), dice)
        process = server.run(name, folder, event, moment)
        processes.append(process)
        if process.code != -signal.SIGKILL:
            break
        if at_events:
            queue.pop(0)
        sites.append(process.killed_at if at_events else str(moment))
        record.kills.append(["event" if at_events else "moment", sites[-1]])
    story = f"{name}, killed at {', '.join(sites) or 'nothing'}"
    if at_events and not sites:
        queue.pop(0)
        print(f"{story}: {event} did not happen", flush=True)
    again = computed_again(processes)
    record.most_again = max([record.most_again, *map(abs, again)])
    record.runs += bool(sites)
    faults = [f"{-number} iterations were computed again" for number in again if number < 0]
    if process.code:
        faults.append(f"exit code {process.code}: {' '.join(process.printed.split())[-300:]}")
    else:
        faults += differences(known.content, content(folder / RUN))[:5]
        faults += [line.strip() for line in process.printed.splitlines() if "Warning" in line][:2]
    record.faults += [f"{story}: {fault}" for fault in faults]
    print(f"{story}: {'; '.join(faults) or 'equal'} (again {again})", flush=True)


def forget_programs(cache: Path, event: str) -> None:
    """Removes the compiled programs that an event in the cache is about to write."""
    if event.split()[-1].startswith("eairl_jax/"):
        for path in cache.glob("eairl_jax/" + event.rpartition("/")[2].replace("#", "*")):
            path.unlink() if path.is_file() else None


def test(server: Server, name: str, kills: int, work: Path, seed: int) -> Record:
    """Kills a command often enough, going on with what `work` holds."""
    folder = work / name
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "record.json"
    record = Record(**json.loads(kept.read_text())) if kept.exists() else Record()
    known = reference(server, name, folder)
    dice = random.Random(f"{name} {seed} {len(record.kills)}")
    queue = chosen_events(known.events, max(0, kills - record.count("event")), dice) if kills else []
    if kills and record.count("event") >= kills:
        queue = []
    while record.count("moment") < kills:
        killed_run(server, name, folder, known, [], dice, record)
        kept.write_text(json.dumps(dataclasses.asdict(record)))
    while queue:
        killed_run(server, name, folder, known, queue, dice, record)
        kept.write_text(json.dumps(dataclasses.asdict(record)))
    return record


def show(records: dict[str, Record]) -> None:
    """Prints the table."""
    print(f"\n{'command':<25}{'at moments':>11}{'at events':>10}{'runs':>6}{'most again':>12}  result")
    for name, record in records.items():
        result = f"{len(record.faults)} FAULTS" if record.faults else "equal"
        events, moments = record.count("event"), record.count("moment")
        print(f"{name:<25}{moments:>11}{events:>10}{record.runs:>6}{record.most_again:>12}  {result}")
        kinds = collections.Counter(site.split()[0] for mode, site in record.kills if mode == "event")
        print(f"    {', '.join(f'{kind} {count}' for kind, count in sorted(kinds.items()))}")
        for fault in record.faults:
            print(f"    {fault}")


def possible() -> list[str]:
    """The commands whose packages are installed: a search needs Optuna."""
    return [name for name in COMMANDS if name != "search" or importlib.util.find_spec("optuna")]


def main() -> int:
    """The exit code: 0 if all is equal."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=possible(), metavar="NAME")
    parser.add_argument("--kills", type=int, default=20, help="of each command at moments, and as many at file events")
    parser.add_argument("--seed", type=int, default=0, help="of the moments and events")
    parser.add_argument("--work", type=Path, help="folder to keep, and to go on with; default: one that is removed")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kills-") as temporary:
        work = (options.work or Path(temporary)).resolve()
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that `server` is closed
        server = Server()
        try:
            records = {name: test(server, name, options.kills, work, options.seed) for name in options.commands}
        finally:
            server.close()
        show(records)
    return 1 if any(record.faults for record in records.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
