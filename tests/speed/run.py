"""What a learned reward costs outside of training: a call from Python, and a step of a Gymnasium environment.

    python tests/speed/run.py

All programs are timed in turns, and the fastest round of each counts: whatever else the machine does only adds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from eairl_jax import load_policy, load_reward
from eairl_jax.gymnasium import LearnedReward

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "v1"
ROUNDS, CALLS = 30, 500


def stepping(reward: Path | None) -> Callable[[], None]:
    """One step of Gymnasium's pendulum, with a learned reward or its own."""
    env = gymnasium.make("Pendulum-v1", max_episode_steps=10**9)
    env = env if reward is None else LearnedReward(env, reward)
    env.reset(seed=0)
    action = np.zeros(1, np.float32)
    return lambda: env.step(action) and None


def programs() -> dict[str, Callable[[], object]]:
    """What is timed."""
    reward, policy = load_reward(GOLDEN / "rewards" / "sa"), load_policy(GOLDEN / "policies" / "plain")
    alone, acting = reward.numpy(), policy.numpy()
    timed: dict[str, Callable[[], object]] = {
        "environment's step": stepping(None),
        "environment's step with a learned reward": stepping(GOLDEN / "finished" / "reward"),
    }
    for batch in (1, 1000):
        obs, action = np.ones((batch, 4), np.float32), np.ones((batch, 2), np.float32)
        timed |= {
            f"reward, batch {batch}, jax": lambda o=obs, a=action: jax.block_until_ready(reward(o, a)),
            f"reward, batch {batch}, NumPy": lambda o=obs, a=action: alone(o, a),
            f"policy, batch {batch}, NumPy": lambda o=obs: acting(o),
        }
    return timed


def main() -> None:
    """Prints the microseconds of each."""
    timed = programs()
    best = dict.fromkeys(timed, np.inf)
    for program in timed.values():
        program()  # compiles
    for _ in range(ROUNDS):
        for name, program in timed.items():
            start = time.perf_counter()
            for _ in range(CALLS):
                program()
            best[name] = min(best[name], (time.perf_counter() - start) / CALLS * 1e6)
    table = Table("call", "microseconds")
    for name, microseconds in best.items():
        table.add_row(name, f"{microseconds:.1f}")
    alone, wrapped = list(best.values())[:2]
    table.add_row("the wrapper's part of a step", f"{wrapped - alone:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
