"""Programs that a thread compiles before they are called."""

import threading

import jax
import jax.numpy as jnp
import pytest

from eairl_jax.programs import Program, compile_thread


@pytest.fixture
def doubled():
    """A program that doubles, and the threads that have traced it."""
    threads = []

    def double(x):
        threads.append(threading.current_thread().name)
        return 2 * x

    return Program(double), threads


def test_what_the_thread_compiles_is_compiled_once(doubled, caplog):
    program, threads = doubled
    with compile_thread() as thread:
        program.compile_later(thread, jnp.zeros(3))
        thread.submit(lambda: None).result()  # the program is compiled
    with jax.log_compiles():
        assert program(jnp.ones(3)).tolist() == [2, 2, 2]
    assert threads == ["compile_0"]
    assert not any("Compiling jit(double)" in each for each in caplog.messages)
    assert program(jnp.ones(2)).tolist() == [2, 2]  # of other shapes
    assert threads == ["compile_0", "MainThread"]


def test_what_the_thread_is_compiling_is_waited_for():
    begun, release = threading.Event(), threading.Event()

    def slow(x):
        begun.set()
        release.wait()
        return 2 * x

    program = Program(slow)
    with compile_thread() as thread:
        program.compile_later(thread, jnp.zeros(3))
        begun.wait()
        threading.Timer(0.1, release.set).start()
        assert program(jnp.ones(3)).tolist() == [2, 2, 2]


def test_what_the_thread_has_not_begun_is_compiled_by_the_caller(doubled):
    program, threads = doubled
    release = threading.Event()
    with compile_thread() as thread:
        thread.submit(release.wait)
        program.compile_later(thread, jnp.zeros(3))
        assert program(jnp.ones(3)).tolist() == [2, 2, 2]  # the thread is still waiting
        release.set()
    assert threads == ["MainThread"]


def test_what_the_thread_has_not_begun_is_dropped_at_the_end(doubled):
    program, threads = doubled
    release = threading.Event()
    with compile_thread() as thread:
        thread.submit(release.wait)
        program.compile_later(thread, jnp.zeros(3))
        threading.Timer(0.1, release.set).start()
    assert threads == []


def test_an_error_of_the_thread_is_raised_where_the_program_is_called():
    def fails(x):
        raise ValueError("no such program")

    program = Program(fails)
    with compile_thread() as thread:
        program.compile_later(thread, jnp.zeros(3))
        thread.submit(lambda: None).result()  # the program has been tried
        with pytest.raises(ValueError, match="no such program"):
            program(jnp.ones(3))
