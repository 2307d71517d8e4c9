"""`eairl watch`: the curves of a run while it trains."""

from __future__ import annotations

import math
import time

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.text import Text

from eairl_jax import InputError
from eairl_jax.experiments.display.console import console, say
from eairl_jax.experiments.display.plain import encodable
from eairl_jax.experiments.options import Watch
from eairl_jax.experiments.pipeline import overview
from eairl_jax.experiments.pipeline.following import Followed

BARS, PLAIN_BARS = "▁▂▃▄▅▆▇█", "_.-=+*#@"
# The metrics that say how a training goes, those that the run has.
SHOWN = (
    "true_return",
    "accuracy",
    "reward_expert",
    "reward_policy",
    "policy_reward",
    "log_prob_expert",
    "kl",
    "entropy",
)
SHORTEST, LONGEST = 10, 100  # characters of a curve
VALUE = 10  # characters of a number


def run(options: Watch, command_line: str) -> None:
    """Shows the curves until the run is finished."""
    del command_line
    path = options.run_folder
    if not (path / "config.json").is_file():
        raise InputError(f"{path} is no run's folder: give one that `eairl expert`, imitate, sweep or transfer makes")
    if not (math.isfinite(options.every) and options.every > 0):
        raise InputError(f"--every {options.every:g}: expected a number of seconds above 0")
    followed = Followed(path)
    if not console.is_terminal:
        _follow(options, followed, lambda state: console.print(_line(state, followed), soft_wrap=True))
        return
    with Live(console=console, auto_refresh=False) as live:
        _follow(options, followed, lambda state: live.update(_picture(state, followed), refresh=True))


def _follow(options: Watch, followed: Followed, show) -> None:
    path, is_told = options.run_folder, False
    while True:
        state = overview.read(path, path.name)
        if state.problem:
            raise InputError(f"{path}: {state.problem}")
        if followed.update() or (state.is_finished and not len(followed.iterations)):
            show(state)
        elif not len(followed.iterations) and not is_told:
            say(f"{path} has no metrics yet: they come with its first chunk")
            is_told = True
        if state.is_finished:
            return
        time.sleep(options.every)


def _title(state: overview.Overview, followed: Followed) -> str:
    done = followed.iterations[-1] if len(followed.iterations) else state.done
    score = "" if state.score is None or not state.is_finished else f", finished: true return {state.score:.2f}"
    return f"{state.method} in {state.task}: iteration {done} of {state.planned}{score}"


def _line(state: overview.Overview, followed: Followed) -> str:
    names = [name for name in SHOWN[:4] if name in followed.curves and np.isfinite(followed.curves[name][-1])]
    return ", ".join(
        [_title(state, followed), *(f"{name.replace('_', ' ')} {followed.curves[name][-1]:.4g}" for name in names)]
    )


def _picture(state: overview.Overview, followed: Followed) -> Group:
    """For each metric its mean over the seeds, from the first iteration to the last one, and its last value."""
    lines = [Text(_title(state, followed), overflow="fold")]
    names = [name for name in SHOWN if name in followed.curves]
    labels = {name: name.replace("_", " ").ljust(max(map(len, names))) for name in names}
    for name in names:
        values, last = followed.curves[name], followed.curves[name][-1]
        now = f"{last:.4g}" if np.isfinite(last) else ""
        width = console.width - len(labels[name]) - VALUE - 2
        if width < SHORTEST:  # the curve gets a line of its own
            lines += [Text(f"{labels[name]} {now}"), Text(sparkline(values, console.width))]
        else:
            curve = sparkline(values, min(LONGEST, width)).ljust(min(LONGEST, width))
            lines.append(Text(f"{labels[name]} {curve} {now:>{VALUE}}"))
    return Group(*lines)


def sparkline(values: np.ndarray, width: int) -> str:
    """A curve in one line of text: each character is the mean of a part of the values; a space where none is finite."""
    bars = BARS if encodable(BARS, console.encoding) == BARS else PLAIN_BARS
    parts = [part[np.isfinite(part)] for part in np.array_split(values, min(width, max(1, len(values))))]
    means = np.array([part.mean() if len(part) else np.nan for part in parts])
    if not np.isfinite(means).any():
        return " " * len(means)
    low, high = np.nanmin(means), np.nanmax(means)
    heights = (means - low) / (high - low) if high > low else 0.0 * means
    return "".join(" " if np.isnan(height) else bars[round(height * (len(bars) - 1))] for height in heights)
