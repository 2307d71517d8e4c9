"""`eairl demos`: episodes of a trained expert, or of other libraries, with their provenance."""

from __future__ import annotations

import jax

from eairl_jax import Demonstrations, demonstrations, evaluate
from eairl_jax.arguments import count
from eairl_jax.envs.names import file_name
from eairl_jax.experiments.display.console import console
from eairl_jax.experiments.options import Collect
from eairl_jax.experiments.pipeline.convert import convert, refuse_contradictions
from eairl_jax.experiments.pipeline.experiment import checked_seeds
from eairl_jax.experiments.pipeline.places import DEMOS, SCORE_EPISODES, make_env, random_return
from eairl_jax.experiments.pipeline.policies import Policies, best_expert
from eairl_jax.experiments.pipeline.run_folder import check_writable, machine
from eairl_jax.experiments.pipeline.train import RUNS, final_returns

DEMO_SEED = 30_000
MOST_EPISODES = 100_000


def run(options: Collect, command_line: str) -> None:
    """Collects whole episodes of the sampled expert, or converts those of `--from`, and writes their provenance."""
    refuse_contradictions(options)
    if options.source is not None:
        convert(options, command_line)
        return
    task, episodes = options.task, options.episodes
    count("--episodes", episodes, 1, MOST_EPISODES)
    checked_seeds(1, options.seed)
    env = make_env(task)
    expert = best_expert(options.expert or RUNS / f"expert-{file_name(task)}", task)
    path = demonstrations.npz_path(options.out or DEMOS / f"{file_name(task)}.npz")
    check_writable(path)
    scores = _scores(expert, options.seed, options.mean_action)
    demos = _collect(expert, episodes, options.seed, options.mean_action)
    returns = demonstrations.returns(demos)
    assert returns is not None
    provenance = {
        "command_line": command_line,
        "task": task,
        "episodes": episodes,
        "episode_length": env.episode_length,
        "lengths": demos.lengths.tolist(),
        "seed": options.seed,
        "mean_action": options.mean_action,
        "returns": [float(value) for value in returns],
        **scores,
        "score_episodes": SCORE_EPISODES,
        "expert": expert.settings,
        "machine": machine(),
    }
    demonstrations.save(path, demos, provenance)
    other = "sampled" if options.mean_action else "its mean action"
    other_score = scores["expert_return_sampled" if options.mean_action else "expert_return_mean_action"]
    console.print(
        f"{episodes} episodes of {task} in {path}: return {returns.mean():.2f} ± {returns.std():.2f}. Over "
        f"{SCORE_EPISODES} episodes the expert has {scores['expert_return']:.2f} ({other} {other_score:.2f}), "
        f"random actions have {scores['random_return']:.2f}",
        soft_wrap=True,
        markup=False,
    )


def _scores(expert: Policies, seed: int, by_mean_action: bool) -> dict[str, float]:
    """True returns of the expert, sampled and by its mean action, and of random actions, over many episodes.

    `expert_return` is that of the policy that is demonstrated.
    """
    sampled, mean_action = (
        final_returns(expert.env, expert.algorithm, expert.state, [seed], SCORE_EPISODES, is_sampled).mean()
        for is_sampled in (True, False)
    )
    other = {"expert_return_sampled": sampled} if by_mean_action else {"expert_return_mean_action": mean_action}
    return {
        "expert_return": float(mean_action if by_mean_action else sampled),
        **{name: float(score) for name, score in other.items()},
        "random_return": random_return(expert.env),
    }


def _collect(expert: Policies, episodes: int, seed: int, by_mean_action: bool) -> Demonstrations:
    state = expert.lane(0)

    def act(obs, key):
        return expert.algorithm.act(state, obs, None if by_mean_action else key)

    collect = jax.jit(lambda key: evaluate(key, expert.env, act, episodes, expert.env.episode_length)[1])
    return demonstrations.from_steps(collect(jax.random.PRNGKey(DEMO_SEED + seed)))
