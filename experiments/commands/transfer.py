"""`eairl transfer`: learn a reward in one task, train fresh policies on it alone in another, score them truly."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from eairl_jax import InputError, load_reward
from eairl_jax.experiments.commands.saturation import warn_if_saturated
from eairl_jax.experiments.display.console import Line, print_table, say, say_if_no_expert, with_references
from eairl_jax.experiments.options import Transfer
from eairl_jax.experiments.paper import published
from eairl_jax.experiments.pipeline import cluster, divergence, user_networks
from eairl_jax.experiments.pipeline.default_folder import changed_options, default_path
from eairl_jax.experiments.pipeline.experiment import target_of, transfers
from eairl_jax.experiments.pipeline.places import measured, refuse_other_sizes
from eairl_jax.experiments.pipeline.run import Result, learning_folder, reuse
from eairl_jax.experiments.pipeline.run import run as run_experiment
from eairl_jax.experiments.pipeline.train import RUNS

# The options that say how a reward is learned.
LEARNING = ("method", "reward_form", "tuned", "seeds", "first_seed", "rule", "demos", "horizon", "set")


def run(options: Transfer, command_line: str) -> None:
    """Runs an experiment for each method, reward form and rule, and prints one table."""
    out = options.out or RUNS
    if options.net and not options.reward:
        raise InputError("--net is of a saved reward (--reward): to learn a reward with a network say --set net=...")
    if options.reward and options.cluster:
        raise InputError("--cluster is for what is learned: a saved reward (--reward) is one program")
    results = [_reuse(options, out, command_line)] if options.reward else _learn_and_use(options, out, command_line)
    if results and options.program is None:
        _print(options, results)


def _learn_and_use(options: Transfer, out: Path, command_line: str) -> list[Result]:
    results = []
    jobs = cluster.groups(transfers(options), lambda each: learning_folder(each, out).path)
    for experiment in cluster.mine(options, jobs, out / "jobs", command_line):
        path = out / experiment.folder_name()
        if not options.out:
            path = default_path(options, experiment.folder_name(), experiment.settings())
        results.append(run_experiment(experiment, path, command_line))
        learning = learning_folder(experiment, out).path
        say(f"{experiment.name}, {results[-1].rule}: in {path}/; the reward was learned in {learning}/")
        warn_if_saturated(results[-1])
    return results


def _reuse(options: Transfer, out: Path, command_line: str) -> Result:
    """`--reward DIR`: uses a saved reward."""
    defaults = {field.name: field.default for field in dataclasses.fields(options)}
    changed = [f"--{name.replace('_', '-')}" for name in LEARNING if getattr(options, name) != defaults[name]]
    if changed:
        raise InputError(
            f"{', '.join(changed)}: these options say how a reward is learned, and --reward gives a learned reward; "
            "remove them, or remove --reward"
        )
    refuse_other_sizes(options.source, options.target)
    target = target_of(options)
    user_networks.register(options.net)
    reward = load_reward(options.reward, target.env.observation_size, target.env.action_size)
    if reward.description["task"] != options.source:
        raise InputError(
            f"{options.reward} was learned in {reward.description['task']}, not in {options.source}: name the task "
            "in which the reward was learned"
        )
    changed = "" if options.out else changed_options(options)
    return reuse(options.reward, reward, measured(target), out, command_line, changed)


def _print(options: Transfer, results: list[Result]) -> None:
    target, ceiling, reference = options.target, np.array(results[0].ceiling), results[0].reference
    expert = published.figure(published.TRANSFER, target, "expert")
    asked = len(results[0].settings["seeds"])
    ceiling_note = divergence.note(results[0].ceiling_dropped, asked)
    alike = "; ".join(filter(None, ("trained alike on the true reward", ceiling_note)))
    lines = [Line("ceiling", ceiling, None, reference.normalized(ceiling.mean()), alike)]
    for result in results:
        figure = published.figure(published.TRANSFER, target, result.method) if result.is_published else None
        iterations = " ".join(map(str, result.chosen_iterations))
        learned = " ".join(f"{value:.3g}" for value in result.learned_rewards)
        share = " ".join(f"{value:.2f}" for value in result.learned_share)
        note = f"rule {result.rule}" + (f", reward of iteration {iterations}" if iterations else "")
        note += f", learned reward a step {learned}, {share} of the best known" if learned else ""
        note = "; ".join(filter(None, (note, divergence.note(result.dropped, asked))))
        name = result.name if len(options.rule) == 1 else f"{result.name}, {result.rule}"
        lines.append(Line(name, np.array(result.returns), figure, result.normalized, note))
    lines = with_references(lines, reference.expert, reference.random, expert)
    print_table(f"Reward learned in {options.source}, used in {target}: true return, {asked} seeds", lines)
    say_if_no_expert(target, reference.expert)
    restarts = (results[0].retrain_settings or results[0].settings)["restarts"]
    if restarts > 1:
        say(f"each score is that of the best of {restarts} policies by the reward that they were trained on")
    compiled, ran = (sum(getattr(result, f"{name}_seconds") for result in results) for name in ("compile", "run"))
    peak = max(result.peak_memory_gb for result in results)
    say(f"compiled {compiled:.0f} s, ran {ran:.0f} s, peak memory {peak:.1f} GB")
