"""How XLA is set up on CPUs, and one way to steer its compiler.

Two properties of XLA on CPUs shape this file.

1. XLA's thread pool must be larger than the number of devices. Two devices that wait for subtasks in the same pool
   hang otherwise. `NPROC` sets the size of the pool.
2. XLA can compile a whole loop into one kernel. A kernel has no access to XLA's fast matrix products. One kernel is
   therefore fast for a physics simulation, and ten times slower for neural networks.

No function here imports jax before it has set the environment variables that jax reads when it is imported.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from eairl_jax.errors import InputError

if TYPE_CHECKING:
    import jax

DEVICE_COUNT_FLAG = "--xla_force_host_platform_device_count"


def configure_jax() -> None:
    """Makes every CPU core a device, and keeps compiled programs on disk for later processes.

    Lanes (seeds) then run side by side. Call the function before the first JAX computation, and best before the first
    `import jax`. The function never overrides what the user has set: `XLA_FLAGS`, `NPROC`, `JAX_NUM_CPU_DEVICES`,
    `JAX_COMPILATION_CACHE_DIR`, `JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS` and `TF_CPP_MIN_LOG_LEVEL`.
    """
    user_flags = os.environ.get("XLA_FLAGS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    devices, threads = cpu_devices(os.environ, cores)
    os.environ["XLA_FLAGS"] = xla_flags(user_flags, version("jaxlib"))
    os.environ.setdefault("NPROC", str(threads))
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    import jax

    settings = {
        "jax_num_cpu_devices": None if DEVICE_COUNT_FLAG in flag_names(user_flags) else devices,
        "jax_compilation_cache_dir": compilation_cache(os.environ),
        "jax_persistent_cache_min_compile_time_secs": 0.2,
    }
    for name, value in settings.items():
        if value is not None and name.upper() not in os.environ:
            jax.config.update(name, value)


def refuse_double_precision() -> None:
    """Raises `InputError` if JAX computes in float64, as `JAX_ENABLE_X64=1` asks: everything here is float32."""
    import jax

    if jax.config.jax_enable_x64:
        raise InputError(
            "JAX_ENABLE_X64 is on, and eairl_jax computes in float32 alone: unset the variable, or call "
            'jax.config.update("jax_enable_x64", False)'
        )


def flag_names(flags: str) -> set[str]:
    """Names of the flags in a value of `XLA_FLAGS`, without their values."""
    return {flag.partition("=")[0] for flag in flags.split()}


def xla_flags(user_flags: str, jaxlib_version: str) -> str:
    """The value of `XLA_FLAGS`: the user's flags first, then those of ours that the user has not set.

    Args:
      user_flags: the value that the user has set, or "".
      jaxlib_version: for example "0.10.2". XLA aborts at a flag that it does not know, and some flags are new.
    """
    # One thread for each device: the devices already use every core.
    flags = ["--xla_cpu_multi_thread_eigen=false"]
    if jaxlib_version.startswith("0.10."):
        flags += [
            # The concurrency-optimised scheduler moves the small kernels of a loop from core to core.
            "--xla_cpu_enable_concurrency_optimized_scheduler=false",
            # A loop becomes one kernel if nothing in the loop needs XLA's runtime. XLA's YNN library needs the
            # runtime, hence the empty value of the last flag. The simulation of a walker becomes 1.6 to 2.6 times
            # faster. Compiling the ant takes a minute.
            "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
            "--xla_cpu_experimental_ynn_fusion_type=",
        ]
    ours = [flag for flag in flags if not flag_names(flag) & flag_names(user_flags)]
    return " ".join([*user_flags.split(), *ours])


def cpu_devices(environ: Mapping[str, str], cores: int) -> tuple[int, int]:
    """`(devices, threads)`: the number of CPU devices, and the size of XLA's thread pool.

    The pool is larger than the number of devices, whichever of the two the user has set.
    """
    if "NPROC" in environ:
        threads = int(environ["NPROC"])
        return int(environ.get("JAX_NUM_CPU_DEVICES", max(1, min(cores, threads - 1)))), threads
    devices = int(environ.get("JAX_NUM_CPU_DEVICES", cores))
    return devices, 2 * max(cores, devices) + 2


def compilation_cache(environ: Mapping[str, str]) -> str | None:
    """The folder of compiled programs; None, and hence no cache on disk, for a user without a home directory.

    The folder is `eairl_jax` in `XDG_CACHE_HOME`, or in `~/.cache` where that variable is unset or empty.
    """
    cache_home = environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(cache_home) if cache_home else Path.home() / ".cache"
    except RuntimeError:  # pathlib finds no home directory
        return None
    return str(folder / "eairl_jax")


def prevent_loop_fusion(scalar: jax.Array) -> jax.Array:
    """Returns the scalar `[]` unchanged, except that NaN becomes infinity. XLA keeps the surrounding loop apart.

    XLA does not compile a loop with a sort in it into one kernel, and this function computes its result by a sort.
    Use the function in loops over networks: see the head of this file.
    """
    import jax.numpy as jnp

    largest = jnp.inf if jnp.issubdtype(scalar.dtype, jnp.floating) else jnp.iinfo(scalar.dtype).max
    return jnp.sort(jnp.stack([scalar, jnp.asarray(largest, scalar.dtype)]))[0]
