import os
from importlib.metadata import version
from pathlib import Path

def configure_jax() -> None:
    """Lets lanes use every CPU core, and keeps compiled programs from one command to the next.

    A CPU core becomes a device of its own. XLA's thread pool must then be larger than the number of devices, or
    programs that wait for each other's subtasks in it hang; NPROC is how it learns its size.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    os.environ.setdefault("NPROC", str(2 * cores + 2))
    # One device, one thread: with XLA's scheduler for concurrency a loop's small kernels hop from core to core.
    flags = ["--xla_cpu_multi_thread_eigen=false"]
    if version("jaxlib").startswith("0.10."):  # XLA aborts at a flag that it does not know
        # Loops are compiled into one kernel if nothing in them needs XLA's runtime (`envs.one_kernel`), as its YNN
        # library does: the walkers' simulation is then 1.6 to 2.6 times as fast. Compiling the ant's takes a minute.
        flags += [
            "--xla_cpu_enable_concurrency_optimized_scheduler=false",
            "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
            "--xla_cpu_experimental_ynn_fusion_type=",
        ]
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    import jax

    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "eairl_jax"
    jax.config.update("jax_num_cpu_devices", cores)
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


