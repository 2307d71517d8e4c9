"""Programs that a second thread compiles while the first thread does something else."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

import jax

from eairl_jax.types import PyTree


@contextlib.contextmanager
def compile_thread() -> Iterator[Executor]:
    """A thread for `Program.compile_later`. At the end it drops what it has not begun, and ends what it compiles."""
    thread = ThreadPoolExecutor(1, "compile")
    try:
        yield thread
    finally:
        thread.shutdown(cancel_futures=True)


def row_shapes(tree: PyTree, count: int) -> PyTree:
    """The shapes `[count, ...]` of a pytree `[rows, ...]` of arrays or shapes."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((count, *leaf.shape[1:]), leaf.dtype), tree)


class Program:
    """A function under `jax.jit` that a thread may compile before its first call.

    XLA compiles on about one core, and without Python's lock.

    Args:
      function: what `jax.jit` takes.
    """

    def __init__(self, function: Callable):
        self._jitted = jax.jit(function)
        self._ahead: Future | None = None

    def compile_later(self, thread: Executor, *args: Any) -> None:
        """Has a thread compile the program.

        Args:
          args: those of a later call, or others of the same shapes.
        """
        self._ahead = thread.submit(lambda: self._jitted.lower(*args).compile())

    def __call__(self, *args: Any) -> Any:
        """Calls the function. What the thread has begun to compile is waited for; JAX keeps it in memory."""
        ahead, self._ahead = self._ahead, None
        if ahead and not ahead.cancel():
            ahead.result()
        return self._jitted(*args)
