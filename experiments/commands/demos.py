"""`eairl demos`: episodes of a trained expert, with their provenance."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np

from eairl_jax import Demonstrations, InputError, demonstrations, evaluate
from eairl_jax.experiments.pipeline.policies import best_expert
from eairl_jax.experiments.pipeline.run_folder import machine, writable
from eairl_jax.experiments.pipeline.scores import SCORE_EPISODES, random_return
from eairl_jax.experiments.pipeline.train import console, default_out, final_returns
from eairl_jax.experiments.recipes import make_env

DEMO_SEED = 30_000


def command(task: str, expert: Path | None, episodes: int, seed: int, out: Path | None, line: str) -> None:
    """Collects whole episodes of the sampled expert and writes them with their provenance."""
    if episodes < 1:
        raise InputError(f"--episodes {episodes}: expected at least 1")
    make_env(task)
    best = best_expert(expert or default_out(f"expert-{task}"), task)
    path = out or Path("demos") / f"{task}.npz"
    writable(path)
    env, algorithm = best.env, best.algorithm
    sampled, mean = (final_returns(env, algorithm, best.state, [seed], SCORE_EPISODES, s) for s in (True, False))
    scores = {
        "expert_return": float(sampled.mean()),
        "expert_return_mean_action": float(mean.mean()),
        "random_return": random_return(env),
    }

    def act(obs, key):
        return algorithm.act(best.lane(0), obs, key)

    collect = jax.jit(lambda key: evaluate(key, env, act, episodes, env.episode_length)[1])
    demos = Demonstrations(**jax.tree.map(np.asarray, collect(jax.random.PRNGKey(DEMO_SEED + seed))))
    returns = demos.reward.sum(axis=1)
    provenance = {
        "command": line,
        "task": task,
        "episodes": episodes,
        "episode_length": env.episode_length,
        "seed": seed,
        "returns": [float(r) for r in returns],
        **scores,
        "score_episodes": SCORE_EPISODES,
        "expert": best.settings,
        "machine": machine(),
    }
    demonstrations.save(path, demos, provenance)
    console.print(
        f"{episodes} episodes of {task} in {path}: return {returns.mean():.2f} ± {returns.std():.2f}; over "
        f"{SCORE_EPISODES} episodes the expert has {scores['expert_return']:.2f} "
        f"(its mean action {scores['expert_return_mean_action']:.2f}), random actions {scores['random_return']:.2f}",
        soft_wrap=True,
    )
