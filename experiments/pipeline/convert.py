"""Demonstrations of other libraries as this library's, and this library's as a Minari data set."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from eairl_jax import InputError, demonstration_files, demonstrations, minari_sets
from eairl_jax.demonstration_files import PREFIX
from eairl_jax.envs.names import file_name
from eairl_jax.episodes import Read
from eairl_jax.experiments.display.console import console
from eairl_jax.experiments.options import Collect
from eairl_jax.experiments.pipeline.places import DEMOS, make_env, shipped_demonstrations
from eairl_jax.experiments.pipeline.run_folder import check_writable, machine

SHIPPED = "shipped"
# What the provenance of a file of this library says of its expert, and stays true of any copy.
KEPT = (
    "expert_return", "expert_return_mean_action", "expert_return_sampled", "mean_action", "random_return",
    "score_episodes", "seed", "expert",
)  # fmt: skip
# Options that mean something with --from only.
OF_CONVERSION = ("to", "format", "obs_key", "max_episodes")


def refuse_contradictions(options: Collect) -> None:
    """Raises `InputError` for options of which one is without effect."""
    if options.source is None:
        given = [name for name in OF_CONVERSION if getattr(options, name) is not None]
        if given:
            flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
            raise InputError(
                f"{flags} without --from: give the demonstrations with --from SOURCE, e.g. --from {SHIPPED} for those "
                "that come with the package"
            )
    elif options.expert is not None:
        raise InputError("--from reads demonstrations and --expert collects new ones: give one of them")
    elif options.to is not None and options.out is not None:
        raise InputError("--to and --out both name the file to write: give one of them")


def convert(options: Collect, command_line: str) -> None:
    """Reads `--from`, checks that the task is demonstrated, writes `--to`, and says what was found and done.

    Raises:
      InputError: if the source cannot be read, does not fit the task, or the destination cannot be written.
    """
    assert options.source is not None
    task = options.task
    env = make_env(task)
    source = str(shipped_demonstrations(task)) if options.source == SHIPPED else options.source
    destination = options.to or str(options.out or DEMOS / f"{file_name(task)}.npz")
    is_minari = destination.startswith(PREFIX)
    path = demonstrations.npz_path(destination)
    if is_minari:
        minari_sets.free_folder(destination.removeprefix(PREFIX))
    else:
        _refuse_same(path, source)
        check_writable(path)
    read = demonstration_files.read(
        source,
        options.format,
        obs_key=options.obs_key,
        max_episodes=options.max_episodes,
        action_limit=env.action_limit,
        time_limit=env.episode_length,
        task=task,
    )
    demos = demonstrations.checked(read.demos, source, env.observation_size, env.action_size)
    demonstrations.check_fits(demos, env, source)
    provenance = {"command_line": command_line, "task": task, **_description(read), **_origin(source)}
    provenance |= {"episode_length": env.episode_length, "machine": machine()}
    for line in read.facts.lines():
        _say(line)
    if is_minari:
        scores = [provenance.get(name) for name in ("random_return", "expert_return")]
        folder = minari_sets.write(
            destination.removeprefix(PREFIX),
            demos,
            task=task,
            action_limit=env.action_limit,
            reference=None if None in scores else (scores[0], scores[1]),
            metadata={"eairl_provenance": provenance},
        )
        _say(f"Written to {folder}: minari.load_dataset({destination.removeprefix(PREFIX)!r}) reads it.")
        return
    demonstrations.save(path, demos, provenance)
    appended = "" if path == Path(destination) else f" The suffix .npz was appended to {destination}."
    _say(f"Written to {path}, with {demonstrations.provenance_path(path).name} beside it.{appended}")
    method = "" if read.facts.has_actions else "--method gaifo "
    _say(f"`eairl imitate {task} {method}--demos {path}` learns from them.")


def _say(text: str) -> None:
    console.print(text, soft_wrap=True, markup=False)


def _refuse_same(path: Path, source: str) -> None:
    if path.exists() and Path(source).exists() and path.samefile(source):
        raise InputError(f"--from and the file to write are the same, {path}: choose another file with --to")


def _origin(source: str) -> dict:
    """What the JSON beside a file of this library says of its expert; empty for other sources."""
    path = Path(source)
    if path.suffix != ".npz" or not demonstrations.provenance_path(path).exists():
        return {}
    content = demonstrations.provenance(path)
    return {name: content[name] for name in KEPT if name in content}


def _description(read: Read) -> dict:
    """Source, lengths and returns of demonstrations. `expert_return` is their mean return, where rewards are known."""
    returns = demonstrations.returns(read.demos)
    description = {
        "source": read.facts.source,
        "episodes": read.facts.episodes,
        "lengths": read.demos.lengths.tolist(),
        "facts": dataclasses.asdict(read.facts),
    }
    if returns is not None:
        description |= {"returns": [float(value) for value in returns], "expert_return": float(returns.mean())}
    return description
