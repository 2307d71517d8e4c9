"""How XLA is set up: the user's settings stay, and devices never outnumber the threads."""

import os
import subprocess
import sys
import zlib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import InputError, xla

ROOT = Path(__file__).resolve().parents[2]
LOOPS = "--xla_cpu_experimental_ynn_fusion_type="


def test_the_users_flags_come_first_and_win():
    user = "--xla_dump_to=/tmp/x --xla_cpu_multi_thread_eigen=true"
    flags = xla.xla_flags(user, xla.OUR_FLAGS)
    assert flags.startswith(user + " ")
    assert flags.count("xla_cpu_multi_thread_eigen") == 1
    assert LOOPS in flags.split()
    assert xla.xla_flags(flags, xla.OUR_FLAGS) == flags
    assert xla.xla_flags("", xla.OUR_FLAGS) == " ".join(xla.OUR_FLAGS)


def test_jaxlib_is_asked_which_flags_it_knows(tmp_path):
    """All of ours, in every version so far; one that it does not know would abort the process."""
    assert xla.known_flags() == list(xla.OUR_FLAGS)
    assert xla.known_flags([*xla.OUR_FLAGS, "--xla_no_such_flag=1"], str(tmp_path)) == list(xla.OUR_FLAGS)
    assert xla.known_flags(["--xla_no_such_flag=1"]) == []


def test_the_answer_is_kept_for_this_version_and_these_flags(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(xla, "_knows", lambda flags: asked.append(list(flags)) or flags == ["--a=1"])
    flags, cache = ["--a=1", "--b=2"], tmp_path / "new"
    for _ in range(2):
        assert xla.known_flags(flags, str(cache)) == ["--a=1"]
    assert asked == [flags, ["--a=1"], ["--b=2"]]
    assert xla.known_flags(["--a=1"], str(cache)) == ["--a=1"]
    assert len(asked) == 4
    monkeypatch.setattr(xla, "version", lambda _: "99.0")
    assert xla.known_flags(["--a=1"], str(cache)) == ["--a=1"]
    assert len(asked) == 5


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", "null", "\xff", '{"known": 3}'])
def test_a_damaged_answer_is_asked_for_again(tmp_path, monkeypatch, content):
    monkeypatch.setattr(xla, "_knows", lambda flags: True)
    (tmp_path / xla.KNOWN_FLAGS).write_text(content, encoding="latin-1")
    assert xla.known_flags(["--a=1"], str(tmp_path)) == ["--a=1"]
    (tmp_path / "file").write_text("")
    assert xla.known_flags(["--a=1"], str(tmp_path / "file")) == ["--a=1"]  # no folder can be made there


def test_without_a_process_to_ask_no_flag_is_known(tmp_path, monkeypatch):
    def no_process(*_, **__):
        raise OSError

    monkeypatch.setattr(xla.subprocess, "run", no_process)
    assert xla.known_flags(["--a=1"], str(tmp_path)) == []
    assert not list(tmp_path.iterdir()), "the next process asks again"


@pytest.mark.parametrize(
    ("environ", "cores", "expected"),
    [
        ({}, 2, (2, 6)),
        ({}, 16, (16, 34)),
        ({"JAX_NUM_CPU_DEVICES": "8"}, 2, (8, 18)),
        ({"NPROC": "4"}, 2, (2, 4)),
        ({"NPROC": "4"}, 16, (3, 4)),
        ({"NPROC": "1"}, 16, (1, 1)),
        ({"NPROC": "9", "JAX_NUM_CPU_DEVICES": "4"}, 2, (4, 9)),
        ({"NPROC": "", "JAX_NUM_CPU_DEVICES": " "}, 2, (2, 6)),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=8"}, 2, (8, 18)),
        ({"NPROC": "1", "JAX_NUM_CPU_DEVICES": "1"}, 2, (1, 1)),
    ],
)
def test_the_pool_of_threads_is_larger_than_the_number_of_devices(environ, cores, expected):
    assert xla.cpu_devices(environ, cores) == expected


@pytest.mark.parametrize(
    ("environ", "folder"),
    [
        ({"XDG_CACHE_HOME": "/var/cache"}, "/var/cache/eairl_jax"),
        ({"XDG_CACHE_HOME": "here"}, "/home/someone/.cache/eairl_jax"),
        ({"XDG_CACHE_HOME": ""}, "/home/someone/.cache/eairl_jax"),
        ({}, "/home/someone/.cache/eairl_jax"),
    ],
)
def test_the_cache_is_where_the_desktop_standard_says(monkeypatch, environ, folder):
    monkeypatch.setattr(xla.Path, "home", lambda: Path("/home/someone"))
    assert xla.compilation_cache(environ) == folder


def test_without_a_home_directory_there_is_no_cache(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(xla.Path, "home", no_home)
    assert xla.compilation_cache({}) is None
    assert xla.compilation_cache({"XDG_CACHE_HOME": "/var/cache"}) == "/var/cache/eairl_jax"


@pytest.mark.parametrize("home", ["/", "", "here"])
def test_a_home_that_is_none_holds_no_cache(monkeypatch, home):
    monkeypatch.setattr(xla.Path, "home", lambda: Path(home))
    assert xla.compilation_cache({}) is None


@pytest.mark.parametrize(
    ("environ", "message"),
    [
        ({"NPROC": "two"}, "NPROC='two': expected a whole number"),
        ({"NPROC": "-1"}, "NPROC='-1': expected"),
        ({"JAX_NUM_CPU_DEVICES": "0"}, "JAX_NUM_CPU_DEVICES='0': expected a whole number from 1"),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=x"}, "device_count='x': expected"),
        ({"NPROC": "4", "JAX_NUM_CPU_DEVICES": "4"}, "NPROC=4 is too small for 4 devices: .* set NPROC=10"),
        ({"NPROC": "3", "XLA_FLAGS": "--xla_force_host_platform_device_count=8"}, "NPROC=3 is too small for 8"),
    ],
)
def test_variables_with_which_nothing_runs_are_refused(environ, message):
    with pytest.raises(InputError, match=message):
        xla.cpu_devices(environ, 2)


HOME = {"JAX_COMPILATION_CACHE_DIR": "/var/cache"}


@pytest.mark.parametrize(
    ("environ", "said"),
    [
        ({}, []),
        ({"JAX_NUM_CPU_DEVICES": "2", "NPROC": "6"}, []),
        ({"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false --xla_dump_to=x"}, []),
        ({"JAX_NUM_CPU_DEVICES": "1"}, ["JAX_NUM_CPU_DEVICES leaves 1 of 2 cores"]),
        ({"NPROC": "2"}, ["NPROC leaves 1 of 2 cores"]),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=1"}, ["device_count leaves 1 of 2 cores"]),
        ({"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=true"}, ["XLA_FLAGS has --xla_cpu_multi_thread_eigen=true: runs"]),
    ],
)
def test_what_the_users_variables_cost_is_said(environ, said):
    found = xla.costs(HOME | environ, 2)
    assert len(found) == len(said)
    assert all(words in text for words, text in zip(said, found, strict=True))


def test_a_process_without_a_home_says_that_it_compiles_anew(monkeypatch):
    monkeypatch.setattr(xla.Path, "home", lambda: Path("/"))
    assert "there is no home directory" in xla.costs({}, 2)[0]
    assert not xla.costs({"JAX_COMPILATION_CACHE_DIR": "/var/cache"}, 2)


def test_a_folder_can_be_made_below_a_folder_and_not_below_a_file(tmp_path):
    (tmp_path / "file").touch()
    assert xla.can_be_made(str(tmp_path / "a" / "b"))
    assert not xla.can_be_made(str(tmp_path / "file" / "b"))
    assert not xla.can_be_made(None)


REPORT = """
import os, sys
from eairl_jax.xla import configure_jax
assert "jax" not in sys.modules
configure_jax()
import jax
cache, least = jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs
print(len(jax.devices()), os.environ["NPROC"], cache, least, os.environ["XLA_FLAGS"])
"""


def test_a_process_takes_the_users_settings_and_ours_for_the_rest(tmp_path):
    settings = {
        "JAX_PLATFORMS": "cpu",
        "JAX_NUM_CPU_DEVICES": "3",
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=true",
        "NPROC": "7",
    }
    result = subprocess.run(
        [sys.executable, "-c", REPORT], env=os.environ | settings, cwd=ROOT, capture_output=True, text=True, check=True
    )
    devices, threads, cache, least, *flags = result.stdout.split()
    assert (devices, threads, cache, least) == ("3", "7", str(tmp_path), "0.2")
    assert flags == xla.xla_flags("--xla_cpu_multi_thread_eigen=true", xla.OUR_FLAGS).split()


@pytest.mark.parametrize("number", [0.0, -2.5, np.inf])
def test_a_scalar_passes_unchanged(number):
    given = jnp.asarray(number, jnp.float32)
    result = jax.jit(xla.prevent_loop_fusion)(given)
    assert (result.dtype, result.shape, float(result)) == (jnp.float32, (), number)
    assert int(xla.prevent_loop_fusion(jnp.asarray(7, jnp.int32))) == 7


def test_nan_becomes_infinity_and_the_loop_holds_a_sort():
    assert xla.prevent_loop_fusion(jnp.asarray(jnp.nan)) == jnp.inf
    assert "sort" in str(jax.make_jaxpr(xla.prevent_loop_fusion)(0.5))


COMPILES = """
import warnings
warnings.simplefilter("error")  # JAX warns of a program that it cannot read
from eairl_jax.xla import configure_jax
configure_jax()
import jax
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: x + 1)(1.0)
"""


def compiled_in_a_process(folder):
    """The programs that a process with this folder for its cache leaves there."""
    environ = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    environ |= {"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(folder)}
    subprocess.run([sys.executable, "-c", COMPILES], env=environ, cwd=ROOT, check=True)
    return {path.name: path.read_bytes() for path in (folder / "eairl_jax").glob("*-cache")}


def test_a_program_that_a_kill_has_torn_is_compiled_and_kept_again(tmp_path):
    """Without care JAX leaves the torn file for ever, and each process warns and compiles anew."""
    whole = compiled_in_a_process(tmp_path)
    assert whole
    for name, program in whole.items():
        (tmp_path / "eairl_jax" / name).write_bytes(program[: len(program) // 2])
    again = compiled_in_a_process(tmp_path)
    assert again.keys() == whole.keys()
    assert all(xla.is_whole(program) for program in again.values())


def test_only_torn_programs_leave_the_cache_and_each_program_is_read_once(tmp_path, monkeypatch):
    program = zlib.compress(bytes(10_000))
    contents = {"whole-cache": program, "half-cache": program[:-5], "empty-cache": b"", "notes": b"no program"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    os.utime(tmp_path / "whole-cache", (1, 1))
    xla.remove_torn(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"whole-cache", "notes", xla.CHECKED}
    monkeypatch.setattr(xla, "is_whole", lambda program: pytest.fail("read again"))
    xla.remove_torn(tmp_path)
    xla.remove_torn(tmp_path / "no such folder")
    assert not (tmp_path / "no such folder").exists()
