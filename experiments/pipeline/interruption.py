"""SIGINT and SIGTERM: a training finishes its chunk, saves it, and stops. A second signal stops at once."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import NoReturn

from eairl_jax import processes

SIGNALS = (signal.SIGINT, signal.SIGTERM)
STOPPED = "stopped; a training goes on from its last checkpoint when its command is given again"
_END = 0  # a byte that is no signal: it ends the thread that waits for signals


class Interrupted(BaseException):
    """A signal has stopped a command in an orderly way.

    Attributes:
      code: with which the process exits: 130 after SIGINT, 143 after SIGTERM.
    """

    def __init__(self, signal_number: int):
        super().__init__(signal.Signals(signal_number).name)
        self.code = 128 + signal_number


def exit_on_sigterm() -> None:
    """From now on SIGTERM raises `Interrupted`, as SIGINT raises `KeyboardInterrupt`. Only for the main thread."""

    def stop(number: int, _frame: object) -> NoReturn:
        raise Interrupted(number)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)


class Interruption:
    """While this context is open, the first signal is noted, and `stop_if_asked` raises `Interrupted`.

    Python runs the handler of a signal only between two of its own instructions, and a chunk of training is one. So a
    thread reads the signals as they arrive: it says what is going to happen, and ends the process at the second one.
    In another thread than the main one, where no handler can be set, the context does nothing.
    """

    def __init__(self) -> None:
        self._asked: int | None = None
        self._is_main = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> Interruption:
        if self._is_main:
            self._read, self._write = os.pipe()
            os.set_blocking(self._write, False)
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
            self._fd_before = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
            self._thread = threading.Thread(target=self._wait, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        if self._is_main:
            signal.set_wakeup_fd(self._fd_before)
            for number, handler in self._before.items():
                signal.signal(number, handler)
            os.write(self._write, bytes([_END]))
            self._thread.join()
            os.close(self._read)
            os.close(self._write)

    @property
    def asked(self) -> int | None:
        """The signal that has arrived, if one has."""
        return self._asked

    def stop_if_asked(self) -> None:
        """Raises `Interrupted` if a signal has arrived, here or in another process of the team."""
        team = processes.current()
        asked = self._asked or (team.asked if team else None)
        if asked is not None:
            raise Interrupted(asked)

    def _note(self, number: int, _frame: object) -> None:
        self._asked = number

    def _wait(self) -> None:
        first = True
        while True:
            number = os.read(self._read, 1)[0]
            if number == _END:
                return
            if number not in SIGNALS:
                continue
            if not first:
                os._exit(128 + number)
            first = False
            sys.stderr.write("\neairl: stopping after this chunk is saved; a second signal stops at once\n")
            sys.stderr.flush()
