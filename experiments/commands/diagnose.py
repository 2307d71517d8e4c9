"""`eairl diagnose`: is the learned reward of a transfer mistaken, or was the training on it not good enough?"""

from __future__ import annotations

from collections import Counter

import numpy as np

from eairl_jax.experiments.display.console import console, mean_and_std, print_rows, say
from eairl_jax.experiments.display.plots import plot_diagnosis
from eairl_jax.experiments.options import Diagnose
from eairl_jax.experiments.pipeline import divergence, policies, run_page
from eairl_jax.experiments.pipeline.diagnosis import FILE, FOUND, TRAINED, Diagnosis, diagnose, played
from eairl_jax.experiments.pipeline.places import restored_target
from eairl_jax.experiments.pipeline.run_folder import RunFolder


def run(options: Diagnose, command_line: str) -> None:
    """Prints a line for each behaviour and the verdict on each seed, and draws them."""
    del command_line
    path, out = options.run_folder, options.out or options.run_folder
    settings = policies.finished_settings(path)
    target, others = restored_target(settings, path), [played(other) for other in options.policies]
    diagnosis = diagnose(path, target, others, out)
    kept = divergence.kept_seeds(RunFolder(path, settings))
    _print(path.name, [settings["seeds"][lane] for lane in kept], diagnosis)
    drawn = {name: (diagnosis.share_of(name), each.true) for name, each in diagnosis.behaviours.items()}
    plot_diagnosis(out / "diagnosis.png", path.name, drawn, diagnosis.reference.expert)
    on_page = ""
    if out == path:
        run_page.write(path)
        on_page = f", also in {path / run_page.PAGE}"
    say(f"every figure: {out / FILE}; as a picture: {out / 'diagnosis.png'}{on_page}")


def _print(title: str, seeds: list[int], diagnosis: Diagnosis) -> None:
    rows = []
    for name, behaviour in diagnosis.behaviours.items():
        share = diagnosis.share_of(name)
        rows.append([name, f"{share.mean():.2f} ({share.min():.2f})", *(_cell(values) for values in behaviour)])
    print_rows(title, ["behaviour", "share of best", "learned, a step", "true return"], rows)
    say("mean ± standard deviation over seeds; share of best: 0 random actions, 1 the best known, in brackets the")
    say("lowest seed. `trained on the reward` is the policy that was scored; the others are here to compare with")
    figures = (diagnosis.share, diagnosis.behaviours[TRAINED].true, diagnosis.best_true, diagnosis.verdicts)
    for seed, share, true, best, verdict in zip(seeds, *figures, strict=True):
        worth = f"{share:.3f} of the best known learned reward; true return {true:.2f}, the best {best:.2f}"
        say(f"seed {seed}: {verdict} ({worth})")
    counts = Counter(diagnosis.verdicts)
    console.print(
        ", ".join(f"{verdict}: {count}" for verdict, count in counts.items())
        + f" (not optimised: below {FOUND:g}; mistaken: the best known was found, and something better is worth less)",
        soft_wrap=True,
    )


def _cell(values: np.ndarray) -> str:
    return mean_and_std(float(values.mean()), float(values.std()))
