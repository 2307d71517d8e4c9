"""`eairl demos`: episodes of a trained expert, with their provenance; and the demonstrations we ship."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from eairl_jax import Demonstrations, InputError, demonstrations, evaluate, random_policy
from envs.mjx_task import MjxTask
from experiments.expert import load_expert
from experiments.folder import machine
from experiments.settings import make_env
from experiments.training import console, default_out, final_returns

SCORE_EPISODES = 500
RANDOM_SEED, DEMO_SEED = 20_000, 30_000


class Reference(NamedTuple):
    """The two returns that a score is normalised by."""

    expert: float
    random: float


def shipped(task: str) -> Path:
    """The demonstrations of a task that come with the package.

    Raises:
      InputError: if there are none.
    """
    path = Path(str(files("experiments") / "data" / f"{task}.npz"))
    if not path.exists():
        raise InputError(
            f"no demonstrations of {task} come with the package: make some with `eairl expert {task}` and "
            f"`eairl demos {task}`, then give them with --demos"
        )
    return path


def reference(task: str, env: MjxTask, path: Path, demos: Demonstrations) -> Reference:
    """Expert's and random policy's returns: from the provenance if it says so, else from the episodes themselves."""
    said = demonstrations.provenance(path) if path.with_suffix(".json").exists() else {}
    if said and said.get("task") != task:
        raise InputError(f"{path.with_suffix('.json')} describes {said.get('task')!r}, not {task!r}")
    expert = said.get("expert_return", float(demos.reward.sum(axis=1).mean()))
    return Reference(expert, said["random_return"] if "random_return" in said else random_return(env))


def random_return(env: MjxTask) -> float:
    """Mean true return of uniformly random actions over 500 episodes."""
    run = jax.jit(lambda key: evaluate(key, env, random_policy(env), SCORE_EPISODES, env.episode_length)[0])
    return float(run(jax.random.PRNGKey(RANDOM_SEED)).mean())


def command(task: str, expert: Path | None, episodes: int, seed: int, out: Path | None, line: str) -> None:
    """Collects whole episodes of the sampled expert and writes them with their provenance."""
    env = make_env(task)
    if episodes < 1:
        raise InputError(f"--episodes {episodes}: expected at least 1")
    source = expert or default_out(f"expert-{task}")
    algorithm, state, settings = load_expert(source, task, env)
    lane = jax.tree.map(lambda leaf: leaf[None], state)
    scores = {
        "expert_return": float(final_returns(env, algorithm, lane, SCORE_EPISODES).mean()),
        "expert_return_mean_action": float(final_returns(env, algorithm, lane, SCORE_EPISODES, sampled=False).mean()),
        "random_return": random_return(env),
    }

    def act(obs, key):
        return algorithm.act(jax.tree.map(jnp.asarray, state), obs, key)

    collect = jax.jit(lambda key: evaluate(key, env, act, episodes, env.episode_length)[1])
    demos = Demonstrations(**jax.tree.map(np.asarray, collect(jax.random.PRNGKey(DEMO_SEED + seed))))
    returns = demos.reward.sum(axis=1)
    path = out or Path("demos") / f"{task}.npz"
    provenance = {
        "command": line,
        "task": task,
        "episodes": episodes,
        "episode_length": env.episode_length,
        "seed": seed,
        "returns": [float(r) for r in returns],
        **scores,
        "score_episodes": SCORE_EPISODES,
        "expert": settings,
        "machine": machine(),
    }
    demonstrations.save(path, demos, provenance)
    console.print(
        f"{episodes} episodes of {task} in {path}: return {returns.mean():.2f} ± {returns.std():.2f}; over "
        f"{SCORE_EPISODES} episodes the expert has {scores['expert_return']:.2f} "
        f"(its mean action {scores['expert_return_mean_action']:.2f}), random actions {scores['random_return']:.2f}"
    )
