"""The returns that scores are measured against, and the demonstrations that we ship."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import jax

from eairl_jax import Demonstrations, InputError, demonstrations, evaluate, random_policy
from eairl_jax.envs.mjx_task import MjxTask

SCORE_EPISODES = 500
RANDOM_SEED = 20_000


class Reference(NamedTuple):
    """The two returns that a score is normalised by."""

    expert: float
    random: float

    def normalized(self, value):
        """A return, or an array of them, on a scale from 0 for random actions to 1 for the expert."""
        return (value - self.random) / (self.expert - self.random)


def shipped(task: str) -> Path:
    """The demonstrations of a task that come with the package.

    Raises:
      InputError: if there are none.
    """
    path = Path(str(files("eairl_jax.experiments") / "data" / f"{task}.npz"))
    if not path.exists():
        raise InputError(
            f"no demonstrations of {task} come with the package: make some with `eairl expert {task}` and "
            f"`eairl demos {task}`, then give them with --demos or, for a target task, put them at {path}"
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
