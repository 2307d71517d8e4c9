"""`eairl export`: the reward and the policy of a run as programs for other software."""

from __future__ import annotations

from pathlib import Path

from eairl_jax import InputError, export, load_policy, load_reward
from eairl_jax.artefacts import POLICY, REWARD, Kind
from eairl_jax.experiments.display.console import say
from eairl_jax.experiments.options import Export
from eairl_jax.experiments.pipeline import user_networks
from eairl_jax.experiments.pipeline.policies import finished_settings
from eairl_jax.schema import listed

LOAD = {REWARD: load_reward, POLICY: load_policy}


def run(options: Export, command_line: str) -> None:
    """Prints the files that it writes."""
    path = options.run_folder
    finished_settings(path)
    user_networks.register(options.net)
    for kind in _kinds(path, options.what):
        learned = LOAD[kind](path / kind.noun)
        seeds = learned.description["seeds"]
        seed = seeds[0] if options.seed is None else options.seed
        if seed not in seeds:
            raise InputError(f"--seed {seed}: {path} has the seeds {listed(map(str, seeds))}")
        origin = {"run": path.resolve().name, "command_line": command_line}
        for file in export(learned, options.out, options.format, seeds.index(seed), origin):
            say(f"{kind.noun} of seed {seed}: {file}")


def _kinds(path: Path, what: tuple[str, ...]) -> list[Kind]:
    """What to export.

    Raises:
      InputError: if the run does not hold it.
    """
    held = [kind for kind in LOAD if (path / kind.noun / f"{kind.noun}.json").is_file()]
    missing = sorted(set(what) - {kind.noun for kind in held})
    if missing or not held:
        raise InputError(
            f"{path} holds no {listed(missing or ['reward', 'policy'])}: an expert learns no reward; a run of an "
            "earlier version gets its policy when the command that made it is repeated"
        )
    return [kind for kind in held if not what or kind.noun in what]
