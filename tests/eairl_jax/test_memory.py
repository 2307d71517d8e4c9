"""A training that does not fit into the memory is refused before it begins."""

import jax
import jax.numpy as jnp
import pytest

from eairl_jax import Algorithm, HParams, InputError, Lanes, memory

MB = 1_000_000


def large(key, hparams):
    del key, hparams
    return {"history": jnp.zeros(MB // 4)}


def step(state, hparams, data):
    """Needs four times the memory of its state: all products are there before their sum."""
    del hparams, data
    products = jax.lax.optimization_barrier(jnp.outer(state["history"], jnp.arange(4.0)))
    return {"history": products.sum(axis=1)}, {"total": products.max()}


LARGE = Algorithm(large, step, lambda state, obs, key: obs)


def lanes(count):
    return Lanes(LARGE, jax.random.split(jax.random.key(0), count), HParams(), devices=jax.local_devices()[:1])


@pytest.mark.parametrize(("free", "fits"), [(2.9, False), (3.1, True), (None, True)])
def test_the_states_of_all_lanes_must_fit(monkeypatch, free, fits):
    monkeypatch.setattr(memory, "host_free", lambda: free and int(free * MB))
    if fits:
        assert lanes(3).init()["history"].shape == (3, MB // 4)
        return
    with pytest.raises(InputError, match=r"the states of 3 lanes need 0.0 GB .*train fewer seeds"):
        lanes(3).init()


def test_what_the_iterations_need_beside_the_states_must_fit(monkeypatch):
    few = lanes(1)
    state = few.init()
    monkeypatch.setattr(memory, "host_free", lambda: 3 * MB)
    with pytest.raises(InputError, match="the iterations of 1 lane need"):
        few.compile(state, 2)
    monkeypatch.setattr(memory, "host_free", lambda: 20 * MB)
    few.compile(state, 2)
    needed = few.memory(2)
    assert needed.states == MB
    assert needed.beside >= 3 * MB
    with pytest.raises(InputError, match="compile them first"):
        few.memory(3)
    assert few.run(state, 2)[1]["total"].shape == (1, 2)


def test_the_cores_of_a_host_share_its_memory(monkeypatch):
    class Core:
        platform = "cpu"

    monkeypatch.setattr(memory, "host_free", lambda: 3 * MB)
    memory.refuse_too_much(MB, "the states", [Core()] * 3)
    with pytest.raises(InputError):
        memory.refuse_too_much(MB, "the states", [Core()] * 4)


def test_each_gpu_has_memory_of_its_own():
    class Gpu:
        platform, device_kind = "gpu", "H100"

        def __init__(self, used):
            self.used = used

        def memory_stats(self):
            return {"bytes_limit": 3 * MB, "bytes_in_use": self.used}

    memory.refuse_too_much(2 * MB, "the states", [Gpu(MB)] * 4)
    with pytest.raises(InputError, match="on H100"):
        memory.refuse_too_much(2 * MB, "the states", [Gpu(MB), Gpu(2 * MB)])


def test_the_limit_of_a_container_counts(tmp_path):
    meminfo = tmp_path / "meminfo"
    assert memory.host_free(meminfo, tmp_path) is None
    meminfo.write_text("MemTotal:       24684084 kB\nMemAvailable:   5000 kB\nHugePages_Total:       0\n")
    assert memory.host_free(meminfo, tmp_path) == 5000 * 1024
    for limit, free in (("max", 5000 * 1024), ("3000000", 1_000_000), ("90000000", 5000 * 1024)):
        (tmp_path / "memory.max").write_text(f"{limit}\n")
        (tmp_path / "memory.current").write_text("2000000\n")
        assert memory.host_free(meminfo, tmp_path) == free
