"""What the tests share: how jax is set up, a toy environment that compiles fast, compiled steps of every method."""

# ruff: noqa: E402

from __future__ import annotations

import functools
import os
from pathlib import Path

from eairl_jax.xla import known_flags

# Before any backend starts: with two virtual CPU devices and fewer threads than that, XLA waits for itself for ever.
os.environ.setdefault("NPROC", "4")
# And in a variable, which the commands respect however many cores there are.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
# XLA's older way to compile a fusion takes a third of the time, and compiling is what most tests spend their time on.
# Newer versions have no such way, and abort at a flag that they do not know.
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "eairl_jax"
FLAGS = ("--xla_cpu_multi_thread_eigen=false", "--xla_cpu_use_fusion_emitters=false")
os.environ.setdefault("XLA_FLAGS", " ".join(known_flags(FLAGS, str(CACHE / "tests"))))
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax

os.environ.setdefault("HYPOTHESIS_STORAGE_DIRECTORY", str(CACHE / "hypothesis"))
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
# The tests' programs run for milliseconds: compile them fast, not well.
jax.config.update("jax_disable_most_optimizations", True)

import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from hypothesis import settings

import eairl_jax
from eairl_jax import METHODS, NETWORKS, Config, Demonstrations, Transition

# The first call compiles, so no deadline; the same examples every time.
settings.register_profile("eairl_jax", deadline=None, derandomize=True, database=None)
settings.load_profile("eairl_jax")

SCALE = ((2.0, 0.0, 0.5, 1.5), (1.5, 1.0, 0.5, 0.25))  # of Toy's observations, mean and std


@struct.dataclass
class ToyState:
    """The fields that every brax state has."""

    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class Toy:
    """An environment that writes down what happened to it.

    Observation (4): steps since the reset, the two actions as they were executed, the episode's tag (random, in
    [1, 2)). Reward: `-|executed - 0.5|^2`. Ends at step `ends_at`, if given. Declares a `scale` (mean, std), if given.
    """

    observation_size = 4
    action_size = 2
    episode_length = 5

    def __init__(self, ends_at: int | None = None, action_limit: float | None = None, scale: tuple | None = None):
        self.ends_at, self.ends = ends_at, ends_at is not None
        if scale is not None:
            self.obs_mean, self.obs_std = scale
        if action_limit is not None:
            self.action_limit = action_limit

    def reset(self, rng):
        tag = jax.random.uniform(rng, (1,), minval=1.0, maxval=2.0)
        return ToyState(jnp.concatenate([jnp.zeros(3), tag]), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        steps = state.obs[0] + 1
        obs = jnp.concatenate([steps[None], action, state.obs[3:]])
        done = (steps >= self.ends_at).astype(jnp.float32) if self.ends_at else jnp.zeros(())
        return ToyState(obs, -jnp.sum((action - 0.5) ** 2), done)


@pytest.fixture(autouse=True, scope="module")
def forget_programs():
    """Compiled programs are dropped when a process holds many, or it would hold those of all files (4 GB)."""
    yield
    if resident_gb() > 1.8:
        jax.clear_caches()


def resident_gb():
    """The memory that this process holds, in GB; 0 where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9


@pytest.fixture
def no_trace():
    """Methods and networks that a test makes known are forgotten after it."""
    before = [(table, dict(table)) for table in (METHODS, NETWORKS)]
    yield
    for table, content in before:
        table.clear()
        table.update(content)


@pytest.fixture(scope="session")
def toy():
    """Makes a `Toy`."""
    return Toy


@pytest.fixture(scope="session")
def scale():
    """Mean and std that the `Toy` of `built` declares."""
    return np.array(SCALE)


@pytest.fixture(scope="session")
def tiny():
    """Makes a `Config` of the smallest sizes that still have every loop and every axis."""
    sizes = {
        "num_envs": 4, "rollout_length": 6, "episode_length": 5, "iterations": 10, "hidden": (8,),
        "policy_hidden": (8,), "value_hidden": (8,), "ppo_epochs": 2, "ppo_minibatches": 2, "history_length": 1,
        "discriminator_updates": 2, "discriminator_batch": 8, "empowerment_updates": 2, "empowerment_batch": 8,
        "phi_sync_interval": 2, "horizon": "variable",
    }  # fmt: skip
    return lambda **changes: Config(**(sizes | changes))


@pytest.fixture(scope="session")
def flat():
    """`Demonstrations` of arrays `[E, T, ...]`: obs, action, next_obs, reward, terminated."""

    def make(*arrays):
        episodes, steps = arrays[0].shape[:2]
        rows = (np.asarray(x).reshape(episodes * steps, *x.shape[2:]) for x in arrays)
        return Demonstrations(*rows, np.full(episodes, steps, np.int32))

    return make


@pytest.fixture(scope="session")
def demos(flat):
    """Three made-up expert episodes of five steps in `Toy`."""
    rng = np.random.default_rng(0)

    def draw(*tail):
        return rng.normal(size=(3, 5, *tail)).astype(np.float32)

    obs, action = draw(4), 0.5 + 0.1 * draw(2)
    next_obs = np.concatenate([obs[:, 1:], draw(4)[:, :1]], axis=1)
    return jax.tree.map(jnp.asarray, flat(obs, action, next_obs, draw(), np.zeros((3, 5), np.float32)))


@pytest.fixture(scope="session")
def built(toy, tiny):
    """`(algorithm, jitted init, jitted step)` of a method in a scaled `Toy`; compiled once a session.

    The episodes of the `Toy` end early, except for a method that needs whole ones.
    """

    @functools.cache
    def build(**changes):
        ends_at = None if "gan_gcl" in changes.values() or "trajectories" in changes.values() else 4
        algorithm = eairl_jax.make_irl(toy(ends_at=ends_at, scale=SCALE), tiny(**changes))
        return algorithm, jax.jit(algorithm.init), jax.jit(algorithm.step)

    return build


@pytest.fixture
def one_step(built, demos):
    """`(state before, state after, metrics)` of the first iteration of a method."""

    def run(hparams, seed=0, **changes):
        _, init, step = built(**changes)
        before = init(jax.random.PRNGKey(seed), hparams)
        return before, *step(before, hparams, demos)

    return run


@pytest.fixture(scope="session")
def mlp():
    """A perceptron in NumPy, double precision: `(params of a flax network, inputs) -> [..., out]`."""

    def apply(params, *inputs):
        layers = params["params"]["MLP_0"]
        x = np.concatenate([np.asarray(i, np.float64) for i in inputs], axis=-1)
        last = sum(name.startswith("Dense") for name in layers) - 1
        for i in range(last + 1):
            layer, norm = layers[f"Dense_{i}"], layers.get(f"LayerNorm_{i}")
            x = x @ np.asarray(layer["kernel"], np.float64) + np.asarray(layer["bias"], np.float64)
            if norm:
                mean, var = x.mean(axis=-1, keepdims=True), x.var(axis=-1, keepdims=True)
                x = (x - mean) / np.sqrt(var + 1e-6) * np.asarray(norm["scale"]) + np.asarray(norm["bias"])
            x = np.maximum(x, 0.0) if i < last else x
        return x

    return apply


@pytest.fixture(scope="session")
def numpy_reward(mlp):
    """The reward of any form in NumPy: `(params of a discriminator, obs, action) -> [...]`."""

    def apply(params, obs, action):
        takes_action = params["g"]["params"]["MLP_0"]["Dense_0"]["kernel"].shape[0] > obs.shape[-1]
        g = (mlp(params["g"], obs, action) if takes_action else mlp(params["g"], obs))[..., 0]
        if "k" not in params:
            return g
        if "raw_cost" in params["k"]:
            return g - np.log1p(np.exp(float(params["k"]["raw_cost"]))) * np.sum(np.asarray(action) ** 2, axis=-1)
        return g + mlp(params["k"], action)[..., 0]

    return apply


@pytest.fixture
def transitions():
    """Makes random `Transition`s `[T, N, ...]`, a tenth of them the last of an episode."""

    def make(length=6, num_envs=4, seed=0):
        rng = np.random.default_rng(seed)

        def draw(*tail):
            return rng.normal(size=(length, num_envs, *tail)).astype(np.float32)

        terminated = (rng.random((length, num_envs)) < 0.1).astype(np.float32)
        truncated = (rng.random((length, num_envs)) < 0.1) * (1 - terminated)
        return Transition(draw(4), draw(2), draw(), draw(4), draw(), terminated, truncated.astype(np.float32))

    return make


@pytest.fixture(scope="session")
def equal_trees():
    """Asserts that two pytrees have one structure and bit-equal leaves."""

    def check(a, b):
        assert jax.tree.structure(a) == jax.tree.structure(b)
        for (path, x), y in zip(jax.tree_util.tree_leaves_with_path(a), jax.tree.leaves(b), strict=True):
            np.testing.assert_array_equal(np.asarray(x), np.asarray(y), err_msg=jax.tree_util.keystr(path))

    return check
