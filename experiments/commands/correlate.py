"""`eairl correlate`: do the returns of a learned reward rank episodes as the true returns do?"""

from __future__ import annotations

from pathlib import Path

from eairl_jax import InputError, LearnedReward, load_reward
from eairl_jax.demonstration_files import read
from eairl_jax.experiments.display.console import Layout, print_rows, say
from eairl_jax.experiments.options import Correlate
from eairl_jax.experiments.pipeline.agreement import Agreement, agreement
from eairl_jax.experiments.pipeline.run_folder import check_writable
from eairl_jax.storage import write_json
from eairl_jax.types import Demonstrations

TITLES = ("seed", "Pearson's r", "Spearman's rho")


def run(options: Correlate, command_line: str) -> None:
    """Prints a line for each seed of the reward, and their mean."""
    if options.json:
        check_writable(options.json)
    reward = load_reward(options.reward / "reward" if (options.reward / "reward").is_dir() else options.reward)
    found = agreement(reward, [(path, _episodes(path, reward)) for path in options.demos])
    seeds = reward.description["seeds"]
    rows = [[str(seed), *_cells(found, lane)] for lane, seed in enumerate(seeds)]
    if len(seeds) > 1:
        means = (f"{values.mean():.3f} ± {values.std():.3f}" for values in (found.pearson, found.spearman))
        rows.append(["mean ± std", *means])
    episodes = found.true.size
    title = f"{options.reward.resolve().name}: learned and true returns of {episodes} episodes"
    print_rows(title, TITLES, rows, Layout(apart=int(len(seeds) > 1)))
    say(f"true returns from {found.true.min():.2f} to {found.true.max():.2f}; 1: the reward ranks them as they are")
    if options.json:
        figures = {name: values.tolist() for name, values in found._asdict().items()}
        write_json(options.json, {"command_line": command_line, "seeds": seeds, **figures})


def _cells(found: Agreement, lane: int) -> list[str]:
    return [f"{values[lane]:.3f}" for values in (found.pearson, found.spearman)]


def _episodes(path: Path, reward: LearnedReward) -> Demonstrations:
    """The episodes of a file, checked against the reward.

    Raises:
      InputError: if the file holds no actions or no true rewards, or if sizes differ.
    """
    demos = read(path).demos
    missing = [name for name in ("action", "reward") if getattr(demos, name) is None]
    if missing or demos.action is None:
        raise InputError(f"{path} lacks {' and '.join(missing)}: a reward is compared by both; use other episodes")
    reward.check_sizes(demos.obs.shape[-1], demos.action.shape[-1], str(path))
    return demos
