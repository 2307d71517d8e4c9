"""Runs `eairl` and notes what it does to files; kills the process by SIGKILL at one of these moments.

    python tests/kills/child.py LOG ROOT[:ROOT...] EVENT arguments of eairl...
    python tests/kills/child.py --serve

LOG is a file that gets a line for each file event inside the ROOT folders and a line for each chunk that is begun.
EVENT is the number of the event before which the process is killed, for example 17. Or it is the number, the kind and
the place of an event, `2 rename run/config.json`: then only events of this kind in this place count. The kind `opened`
means a file that was opened for writing and in which nothing is written yet. `-` kills the process never.

With `--serve` the process imports everything, and then takes commands from its standard input: a line of JSON with the
folder, the environment, the file for what is printed and the arguments above. Each command runs in a fork of this
process, which spares it half of its time. The answers are the number of the new process and, at its end, its exit code.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import time
import traceback
from typing import Any

KINDS = {
    "open": "open",
    "os.rename": "rename",
    "os.mkdir": "mkdir",
    "os.remove": "unlink",
    "os.rmdir": "rmdir",
    "shutil.rmtree": "rmtree",
    "os.truncate": "truncate",
    "os.link": "link",
    "os.symlink": "symlink",
}
"""What Python's audit events are called here. Python has no event of `os.fsync`: it is replaced by `Watch.fsync`."""


class Watch:
    """Notes the file events of this process, and kills it before one of them.

    Args:
      log: file to append lines to.
      roots: folders whose events count.
      event: as in the head of this file.
    """

    def __init__(self, log: str, roots: list[str], event: str):
        self._log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._roots = [os.path.realpath(root) for root in roots]
        number, _, site = event.partition(" ")
        self._left, self._site = (int(number) if number.isdigit() else 0), site
        self._is_ours = False  # whether the next event is made by this class
        self._fsync, os.fsync = os.fsync, self.fsync
        sys.addaudithook(self.audit)

    def audit(self, event: str, arguments: tuple) -> None:
        """Python calls this before each of its events."""
        kind = KINDS.get(event)
        if kind is None or self._is_ours or (kind == "open" and not _is_writing(arguments[0], arguments[2])):
            return
        # A rename is known by where the file goes. A folder is given to those that read a path relative to it.
        path = arguments[1] if kind in ("rename", "link", "symlink") else arguments[0]
        folder = {"rename": 3, "mkdir": 2, "unlink": 1, "rmdir": 1}.get(kind)
        self.happens(kind, path, arguments[folder] if folder else -1, arguments)

    def fsync(self, file: Any) -> None:
        """Takes the place of `os.fsync`."""
        number = file if isinstance(file, int) else file.fileno()
        self.happens("fsync", os.readlink(f"/proc/self/fd/{number}"))
        self._fsync(file)

    def happens(self, kind: str, path: Any, folder: int = -1, arguments: tuple = ()) -> None:
        """Notes an event, and kills the process if it is the one."""
        if not isinstance(path, (str, bytes, os.PathLike)):
            return
        path = os.fsdecode(path)
        if folder is not None and folder >= 0:
            path = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), path)
        path = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
        root = next((root for root in self._roots if path == root or path.startswith(root + os.sep)), None)
        if root is None:
            return
        site = place(os.path.relpath(path, os.path.dirname(root)))
        self.note("event", kind, site)
        self._count(f"{kind} {site}")
        if kind == "open":
            if self._left == 1 and self._site == f"opened {site}":
                self._is_ours = True
                os.open(path, arguments[2], 0o666)  # creates or empties the file, as the caller is about to do
            self._count(f"opened {site}")

    def _count(self, event: str) -> None:
        if self._left > 0 and self._site in ("", event):
            self._left -= 1
            if not self._left:
                self.note("killed", event)
                os.kill(os.getpid(), signal.SIGKILL)

    def note(self, *words: Any) -> None:
        """Appends a line to the log, with the time. A killed process leaves all its lines."""
        os.write(self._log, ("\t".join(map(str, (time.monotonic(), *words))) + "\n").encode())


def _is_writing(path: Any, flags: int) -> bool:
    return bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC)) and not os.path.isdir(path)


def place(path: str) -> str:
    """A path without what differs from run to run: the digests of compiled programs, and numbers."""
    return re.sub(r"[0-9]+", "#", re.sub(r"[0-9a-f]{32,}", "*", path))


def watch_chunks(watch: Watch) -> None:
    """Notes each chunk before it is computed: the folder that it is computed for, its first iteration, its length.

    Plans have no iteration; they are noted as `plan`.
    """
    from eairl_jax import Lanes

    compute = Lanes.run

    def run(self: Lanes, state: Any, length: int, check: bool = True) -> Any:
        known = sys._getframe(1).f_locals  # of `train.train`, or of `retraining.planned`
        if "done" in known:
            watch.note("chunk", known["folder"].path, known["done"], length)
        else:
            watch.note("plan", known["inner"].path if "inner" in known else "", 0, 0)
        return compute(self, state, length, check)

    Lanes.run = run


def run_command(log: str, roots: str, event: str, *arguments: str) -> None:
    """Runs the command line of `eairl`."""
    from eairl_jax.experiments import cli
    from eairl_jax.xla import configure_jax

    watch = Watch(log, roots.split(os.pathsep), event)
    configure_jax()  # before `watch_chunks` imports jax
    watch_chunks(watch)
    cli.main(arguments)
    watch.note("finished")


def serve() -> None:
    """Runs commands in forks of this process."""
    import orbax.checkpoint  # noqa: F401

    from eairl_jax.experiments.commands import expert, imitate, reproduce, sweep, transfer  # noqa: F401

    for line in sys.stdin:
        command = json.loads(line)
        sys.stdout.flush()
        process = os.fork()
        if not process:
            os.chdir(command["folder"])
            os.environ.update(command["environment"])
            printed = os.open(command["printed"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(printed, 1)
            os.dup2(printed, 2)
            try:
                run_command(*command["arguments"])
                code = 0
            except SystemExit as e:
                code = e.code if isinstance(e.code, int) else 1
            except BaseException:
                traceback.print_exc()
                code = 1
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        print(process, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)


if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # nothing of this folder is taken for a module
    if sys.argv[1:] == ["--serve"]:
        serve()
    else:
        run_command(*sys.argv[1:])
