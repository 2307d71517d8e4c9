"""How XLA is set up on CPUs, and one way to steer its compiler.

Two properties of XLA on CPUs shape this file.

1. XLA's thread pool must be larger than the number of devices. Two devices that wait for subtasks in the same pool
   hang otherwise. `NPROC` sets the size of the pool.
2. XLA can compile a whole loop into one kernel. A kernel has no access to XLA's fast matrix products. One kernel is
   therefore fast for a physics simulation, and ten times slower for neural networks.

No function here imports jax before it has set the environment variables that jax reads when it is imported.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eairl_jax.errors import InputError

if TYPE_CHECKING:
    import jax

ZSTANDARD = b"\x28\xb5\x2f\xfd"
"""The first bytes of what Zstandard compresses."""
DEVICE_COUNT_FLAG = "--xla_force_host_platform_device_count"
OUR_FLAGS = (
    # One thread for each device: the devices already use every core.
    "--xla_cpu_multi_thread_eigen=false",
    # The concurrency-optimised scheduler moves the small kernels of a loop from core to core.
    "--xla_cpu_enable_concurrency_optimized_scheduler=false",
    # A loop becomes one kernel if nothing in the loop needs XLA's runtime. XLA's YNN library needs the runtime, hence
    # the empty value of the last flag. The simulation of a walker becomes 1.6 to 2.6 times faster. Compiling the ant
    # takes a minute.
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
    "--xla_cpu_experimental_ynn_fusion_type=",
)
"""What XLA is told on CPUs, as far as the installed jaxlib knows it."""
KNOWN_FLAGS = "xla-flags.json"
"""The file in the cache that holds the answer of `known_flags`."""


def configure_jax() -> None:
    """Makes every CPU core a device, and keeps compiled programs on disk for later processes.

    Lanes (seeds) then run side by side. Call the function before the first JAX computation, and best before the first
    `import jax`. The function never overrides what the user has set: `XLA_FLAGS`, `NPROC`, `JAX_NUM_CPU_DEVICES`,
    `JAX_COMPILATION_CACHE_DIR`, `JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS` and `TF_CPP_MIN_LOG_LEVEL`. What such a
    setting costs is said by `costs`.

    Raises:
      InputError: if `NPROC` or a number of devices is no whole number, or if XLA would wait for itself for ever.
    """
    user_flags, cores = os.environ.get("XLA_FLAGS", ""), usable_cores()
    devices, threads = cpu_devices(os.environ, cores)
    cache = compilation_cache(os.environ)
    os.environ["XLA_FLAGS"] = xla_flags(user_flags, known_flags(OUR_FLAGS, cache))
    for name in ("NPROC", "JAX_NUM_CPU_DEVICES"):
        if not os.environ.get(name, "unset").strip():
            del os.environ[name]  # jax cannot read an empty number
    os.environ.setdefault("NPROC", str(threads))
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    import jax

    settings = {
        "jax_num_cpu_devices": None if DEVICE_COUNT_FLAG in flag_names(user_flags) else devices,
        "jax_compilation_cache_dir": cache if can_be_made(cache) else None,
        "jax_persistent_cache_min_compile_time_secs": 0.2,
    }
    for name, value in settings.items():
        if value is not None and name.upper() not in os.environ:
            jax.config.update(name, value)
    if cache and "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        remove_torn(Path(cache))


def refuse_double_precision() -> None:
    """Raises `InputError` if JAX computes in float64, as `JAX_ENABLE_X64=1` asks: everything here is float32."""
    import jax

    if jax.config.jax_enable_x64:
        raise InputError(
            "JAX_ENABLE_X64 is on, and eairl_jax computes in float32 alone: unset the variable, or call "
            'jax.config.update("jax_enable_x64", False)'
        )


def options_of_one_call() -> dict[str, Any]:
    """Compiler options for a program that is called once: it is compiled in half of the time, to the same bits."""
    import jax

    # Level 0 would give other bits. Whoever has asked for fewer optimisations has them already.
    return {} if jax.config.read("jax_disable_most_optimizations") else {"xla_backend_optimization_level": 1}


def flag_names(flags: str) -> set[str]:
    """Names of the flags in a value of `XLA_FLAGS`, without their values."""
    return {flag.partition("=")[0] for flag in flags.split()}


def xla_flags(user_flags: str, flags: Iterable[str]) -> str:
    """The value of `XLA_FLAGS`: the user's flags first, then those of ours that the user has not set.

    Args:
      user_flags: the value that the user has set, or "".
      flags: ours, `known_flags`.
    """
    ours = [flag for flag in flags if not flag_names(flag) & flag_names(user_flags)]
    return " ".join([*user_flags.split(), *ours])


def known_flags(flags: Sequence[str] = OUR_FLAGS, cache: str | None = None) -> list[str]:
    """Those of the flags that the installed jaxlib knows. XLA aborts at a flag that it does not know.

    So a process of its own is asked, which takes a fifth of a second. Its answer is kept in the cache.

    Args:
      cache: folder of the answers, or None.
    """
    kept = Path(cache) / KNOWN_FLAGS if cache else None
    asked = {"jaxlib": version("jaxlib"), "flags": list(flags)}
    if kept:
        with contextlib.suppress(OSError, ValueError):
            answer = json.loads(kept.read_text(encoding="utf-8"))
            is_answer = isinstance(answer, dict) and {name: answer.get(name) for name in asked} == asked
            if is_answer and isinstance(answer.get("known"), list):
                return [flag for flag in flags if flag in answer["known"]]
    known = list(flags) if _knows(flags) else [flag for flag in flags if _knows([flag])]
    if kept and known:  # every version knows some: if none is known, the process could not be asked
        with contextlib.suppress(OSError):
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(asked | {"known": known}), encoding="utf-8")
    return known


def _knows(flags: Sequence[str]) -> bool:
    """Whether the installed jaxlib knows all these flags."""
    program = "from jaxlib import xla_client; xla_client.CompileOptions()"  # reads the flags
    environment = os.environ | {"XLA_FLAGS": " ".join(flags), "PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", program], env=environment, capture_output=True, timeout=60, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return False
    return done.returncode == 0


def cpu_devices(environ: Mapping[str, str], cores: int) -> tuple[int, int]:
    """`(devices, threads)`: the number of CPU devices, and the size of XLA's thread pool.

    The pool is larger than the number of devices, whichever of the two the user has set.

    Raises:
      InputError: if a number is no whole number, or if the user has set both and the pool is too small.
    """
    threads = _whole(environ, "NPROC")
    devices = _flag_devices(environ.get("XLA_FLAGS", "")) or _whole(environ, "JAX_NUM_CPU_DEVICES")
    if threads is None:
        devices = devices or cores
        return devices, 2 * max(cores, devices) + 2
    if devices is not None and 1 < devices >= threads:
        raise InputError(
            f"NPROC={threads} is too small for {devices} devices: XLA's thread pool must be larger than the number of "
            f"devices, or the devices wait for ever; set NPROC={2 * devices + 2}, or unset it"
        )
    return devices or max(1, min(cores, threads - 1)), threads


def usable_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _whole(environ: Mapping[str, str], name: str) -> int | None:
    """A number of at least 1 in the environment; None if it is unset or empty."""
    text = environ.get(name, "").strip()
    if not text:
        return None
    if not (text.isascii() and text.isdigit()) or not 1 <= int(text) <= 4096:
        raise InputError(f"{name}={text!r:.40}: expected a whole number from 1 to 4096, or unset the variable")
    return int(text)


def _flag_devices(flags: str) -> int | None:
    """The number of devices in a value of `XLA_FLAGS`, if it has one; the last of several counts."""
    values = [flag.partition("=")[2] for flag in flags.split() if flag.partition("=")[0] == DEVICE_COUNT_FLAG]
    return _whole({DEVICE_COUNT_FLAG: values[-1]}, DEVICE_COUNT_FLAG) if values else None


def costs(environ: Mapping[str, str], cores: int) -> list[str]:
    """What the user's variables of JAX and XLA cost, one sentence each.

    Args:
      environ: before `configure_jax` has added to it.
      cores: the cores that this process may use.
    """
    found, flags = [], environ.get("XLA_FLAGS", "")
    devices, _ = cpu_devices(environ, cores)
    if devices < cores:
        name = next((n for n in ("JAX_NUM_CPU_DEVICES", "NPROC") if environ.get(n)), "")
        name = DEVICE_COUNT_FLAG if _flag_devices(flags) else name
        found.append(f"{name} leaves {devices} of {cores} cores for seeds that run side by side")
    ours = {flag.partition("=")[0]: flag for flag in OUR_FLAGS}
    changed = [flag for flag in flags.split() if ours.get(flag.partition("=")[0], flag) != flag]
    if changed:
        found.append(f"XLA_FLAGS has {' '.join(changed)}: runs may be slower than with the setting of eairl_jax")
    if not can_be_made(compilation_cache(environ)) and not environ.get("JAX_COMPILATION_CACHE_DIR"):
        found.append(
            "there is no home directory in which compiled programs can be kept, so every command compiles them anew; "
            "XDG_CACHE_HOME=DIR names a folder for them"
        )
    return found


def compilation_cache(environ: Mapping[str, str]) -> str | None:
    """The folder of compiled programs; None, and hence no cache on disk, for a user without a home directory.

    The folder is `eairl_jax` in `XDG_CACHE_HOME`, or in `~/.cache` where that variable is unset, empty or relative: a
    relative folder would be a part of whatever folder the user stands in.
    """
    cache_home = Path(environ.get("XDG_CACHE_HOME", ""))
    if cache_home.is_absolute():
        return str(cache_home / "eairl_jax")
    try:
        home = Path.home()
    except RuntimeError:  # pathlib finds no home directory
        return None
    is_home = home.is_absolute() and home != Path(home.anchor)  # an empty HOME means the root
    return str(home / ".cache" / "eairl_jax") if is_home else None


CHECKED = ".checked"
"""A file in the cache. Its time is that of the last `remove_torn`."""


def remove_torn(cache: Path) -> None:
    """Removes programs from the cache that are not whole, because a process was killed while it wrote them.

    JAX never replaces a program that it cannot read: every later process would warn, and compile the program anew.
    Only programs that were written since the last call are read. A program that another process is writing right now
    may be removed too; it is then compiled once more.
    """
    checked, now = cache / CHECKED, time.time()
    try:
        since = checked.stat().st_mtime if checked.exists() else 0.0
        for path in cache.glob("*-cache"):
            if path.stat().st_mtime >= since and not is_whole(path.read_bytes()):
                path.unlink()
        if cache.is_dir():
            checked.touch()
            os.utime(checked, (now, now))
    except OSError:  # another process removes files too, or the folder can only be read
        pass


def is_whole(program: bytes) -> bool:
    """Whether a compressed program has its end. JAX compresses by zlib or, where Python has it, by Zstandard."""
    if not program:
        return False
    try:
        if program.startswith(ZSTANDARD):
            stream = importlib.import_module("compression.zstd").ZstdDecompressor()  # of Python 3.14
        else:
            stream = zlib.decompressobj()
        stream.decompress(program)
    except ImportError:
        return True  # by a package that is not ours
    except Exception:  # each of the two raises its own
        return False
    return stream.eof


def can_be_made(folder: str | None) -> bool:
    """Whether a folder can be written, or made and then written."""
    if folder is None:
        return False
    path = Path(folder)
    while not path.exists() and path != path.parent:
        path = path.parent
    return path.is_dir() and os.access(path, os.W_OK | os.X_OK)


def prevent_loop_fusion(scalar: jax.Array) -> jax.Array:
    """Returns the scalar `[]` unchanged, except that NaN becomes infinity. XLA keeps the surrounding loop apart.

    XLA does not compile a loop with a sort in it into one kernel, and this function computes its result by a sort.
    Use the function in loops over networks: see the head of this file.
    """
    import jax.numpy as jnp

    largest = jnp.inf if jnp.issubdtype(scalar.dtype, jnp.floating) else jnp.iinfo(scalar.dtype).max
    return jnp.sort(jnp.stack([scalar, jnp.asarray(largest, scalar.dtype)]))[0]
