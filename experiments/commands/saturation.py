"""A warning that several commands print."""

from __future__ import annotations

from eairl_jax.experiments.display.console import console
from eairl_jax.experiments.pipeline.run import Result
from eairl_jax.experiments.pipeline.stages import SATURATED_ACCURACY


def warn_if_saturated(result: Result) -> None:
    """Warns if a discriminator was right about nearly everything in most iterations: its reward then says little."""
    if result.saturated_lanes:
        lanes = "; ".join(result.saturated_lanes)
        console.print(
            f"{result.name}: the discriminator's accuracy was above {SATURATED_ACCURACY:.0%} in most "
            f"iterations ({lanes}). The reward of such a discriminator says little. Try --set "
            "discriminator_lr=0.0003, discriminator_updates=3, gradient_penalty=1 or a larger entropy_weight",
            style="yellow",
            soft_wrap=True,
        )
