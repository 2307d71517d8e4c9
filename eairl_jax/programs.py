"""Programs that a second thread compiles while the first thread compiles others."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

import jax

T = TypeVar("T")


class Task(Generic[T]):
    """Work that a `CompileThread` may do before its result is asked for."""

    def __init__(self, thread: CompileThread, work: Callable[[], T]):
        self._thread, self._work, self._future = thread, work, Future()

    def now(self) -> T:
        """The result. Work that the thread has begun is waited for; work that it has not begun is done here."""
        with self._thread.beside():
            return self._work() if self._future.cancel() else self._future.result()

    def run(self) -> None:
        """Does the work, unless it is done elsewhere."""
        if not self._future.set_running_or_notify_cancel():
            return
        try:
            self._future.set_result(self._work())
        except BaseException as e:  # it is raised where the result is asked for
            self._future.set_exception(e)


class CompileThread:
    """A thread that does tasks in their order, while its context is open.

    XLA compiles most programs on one core and without Python's lock, so two programs compile in little more than the
    time of one. A program that runs on CPUs uses all cores. Beside it nothing is won. So on CPUs the thread begins a
    task only while another thread waits in `Task.now`; on other devices it begins at once.

    At the end of the context the thread finishes the task that it is doing, and drops the others.
    """

    def __init__(self) -> None:
        self._tasks: deque[Task] = deque()
        self._changed = threading.Condition()
        self._beside = 0 if jax.default_backend() == "cpu" else 1
        self._is_over = False
        self._thread = threading.Thread(target=self._work, name="compile", daemon=True)

    def later(self, work: Callable[[], T]) -> Task[T]:
        """A task for the thread."""
        task = Task(self, work)
        with self._changed:
            self._tasks.append(task)
            self._changed.notify()
        return task

    @contextlib.contextmanager
    def beside(self) -> Iterator[None]:
        """A context in which the thread may begin tasks."""
        self._allow(+1)
        try:
            yield
        finally:
            self._allow(-1)

    def _allow(self, change: int) -> None:
        with self._changed:
            self._beside += change
            self._changed.notify()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._is_over or (self._tasks and self._beside))
                if self._is_over:
                    return
                task = self._tasks.popleft()
            task.run()

    def __enter__(self) -> CompileThread:
        self._thread.start()
        return self

    def __exit__(self, *_exception) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join()


class Program:
    """A function under `jax.jit` that a thread may compile before its first call.

    Args:
      function: what `jax.jit` takes.
      options: of `jax.jit`.
    """

    def __init__(self, function: Callable, **options: Any):
        self.jitted = jax.jit(function, **options)
        self._task: Task[jax.stages.Compiled] | None = None

    def compile_later(self, thread: CompileThread, *args: Any) -> None:
        """Has a thread compile the program.

        Args:
          args: of a later call, or their shapes (`jax.ShapeDtypeStruct`).
        """
        self._task = thread.later(lambda: self.jitted.lower(*args).compile())

    def compiled(self, *args: Any) -> jax.stages.Compiled:
        """The program for the given arguments, which may be shapes."""
        return self._from_thread() or self.jitted.lower(*args).compile()

    def __call__(self, *args: Any) -> Any:
        """Calls the function. What was compiled before is in the memory of `jax.jit`."""
        self._from_thread()
        return self.jitted(*args)

    def _from_thread(self) -> jax.stages.Compiled | None:
        task, self._task = self._task, None
        return task.now() if task else None
