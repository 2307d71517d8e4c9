"""Ten million steps of random actions in a task, without a NaN: `make test-physics`.

    python tests/physics/random_steps.py                            # every task, 10 million steps of each
    python tests/physics/random_steps.py --task pendulum --steps 1000000

The environments begin whole episodes again and again. A third of them draw each action uniformly. A third draw each
entry of an action as one of its two bounds, and a third hold such an action for 25 steps, which moves a body most.
A NaN, an infinity, or a state beyond MuJoCo's bounds (1e10) makes the exit code 1.
"""

# ruff: noqa: E402

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, NamedTuple

from eairl_jax.xla import configure_jax

configure_jax()

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from eairl_jax import envs

HELD = 25


class Seen(NamedTuple):
    """What the steps of some environments were.

    Attributes:
      bad: steps whose observation or reward was not finite.
      farthest: the largest distance of an entry of an observation from its centre, in the task's `obs_std`.
      lowest, highest: rewards.
    """

    bad: Any
    farthest: Any
    lowest: Any
    highest: Any

    def joined(self, other: Seen) -> Seen:
        """Both together."""
        lowest, highest = jnp.minimum(self.lowest, other.lowest), jnp.maximum(self.highest, other.highest)
        return Seen(self.bad + other.bad, jnp.maximum(self.farthest, other.farthest), lowest, highest)


NOTHING = Seen(jnp.zeros((), jnp.int32), -jnp.inf, jnp.inf, -jnp.inf)


def actions(key: jax.Array, env, count: int) -> jax.Array:
    """Random actions `[T, count, act]` of three kinds."""
    length, third = env.episode_length, count // 3
    uniform_key, bound_key, held_key = jax.random.split(key, 3)
    uniform = jax.random.uniform(uniform_key, (length, third, env.action_size), minval=-1.0, maxval=1.0)
    bounds = jax.random.rademacher(bound_key, (length, third, env.action_size), jnp.float32)
    few = jax.random.rademacher(held_key, (-(-length // HELD), count - 2 * third, env.action_size), jnp.float32)
    held = jnp.repeat(few, HELD, axis=0)[:length]
    return env.action_limit * jnp.concatenate([uniform, bounds, held], axis=1)


def episodes(env, count: int):
    """`key -> Seen`: one whole episode of `count` environments."""
    mean, std = jnp.asarray(env.obs_mean), jnp.asarray(env.obs_std)

    def play(key):
        reset_key, action_key = jax.random.split(key)
        start = jax.vmap(env.reset)(jax.random.split(reset_key, count))

        def step(carry, action):
            state, seen = carry
            state = jax.vmap(env.step)(state, action)
            good = jnp.isfinite(state.obs).all(axis=-1) & jnp.isfinite(state.reward)
            far = jnp.abs((state.obs - mean) / std).max()
            now = Seen((~good).sum(dtype=jnp.int32), far, state.reward.min(), state.reward.max())
            return (state, seen.joined(now)), None

        (_, seen), _ = jax.lax.scan(step, (start, jax.tree.map(jnp.asarray, NOTHING)), actions(action_key, env, count))
        return seen

    return play


def walk(task: str, steps: int, count: int) -> bool:
    """Takes the steps, prints what was seen; returns whether all of them were finite."""
    env, devices = envs.make(task), jax.devices()
    spec = PartitionSpec("devices")
    play = jax.vmap(episodes(env, count))
    spread = jax.shard_map(
        play, mesh=Mesh(np.array(devices), ("devices",)), in_specs=spec, out_specs=spec, check_vma=False
    )
    keys = jax.random.split(
        jax.random.PRNGKey(0), (-(-steps // (count * env.episode_length * len(devices))), len(devices))
    )
    started = time.perf_counter()
    program = jax.jit(spread).lower(keys[0]).compile()
    compiled, total = time.perf_counter() - started, NOTHING
    started = time.perf_counter()
    for row in keys:
        seen = jax.tree.map(np.asarray, program(row))
        for device in range(len(devices)):
            total = total.joined(jax.tree.map(lambda leaf, d=device: leaf[d], seen))
    seconds, done = time.perf_counter() - started, keys.shape[0] * len(devices) * count * env.episode_length
    print(
        f"{task}: {done:,} steps, {int(total.bad)} not finite; observations up to {float(total.farthest):.1f} std, "
        f"rewards {float(total.lowest):.3g} to {float(total.highest):.3g}; {done / seconds:,.0f} steps/s "
        f"({seconds:.0f} s, compiled in {compiled:.0f} s)",
        flush=True,
    )
    return int(total.bad) == 0


def main() -> int:
    """The exit code: 0 if every step of every task was finite."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", action="append", choices=list(envs.TASKS), help="repeatable; default: all")
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--envs", type=int, default=96, help="environments side by side on each device")
    options = parser.parse_args()
    return 0 if all([walk(task, options.steps, options.envs) for task in options.task or envs.TASKS]) else 1


if __name__ == "__main__":
    sys.exit(main())
