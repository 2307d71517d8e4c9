"""Every float of training."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import struct

from eairl_jax.arguments import Range
from eairl_jax.config import refuse_unknown
from eairl_jax.errors import InputError
from eairl_jax.schema import shown

RATE = Range(high=100.0)
# The range of a float, if it is not `Range()`: 0, or from `arguments.SMALLEST` to `arguments.LARGEST`.
RANGES: dict[str, Range] = {
    "gamma": Range(high=1.0),
    "gae_lambda": Range(high=1.0),
    "policy_lr": RATE,
    "discriminator_lr": RATE,
    "inverse_lr": RATE,
    "phi_lr": RATE,
    "kl_limit": Range(included=False),
    "std_initial_fraction": Range(included=False),
    "std_final_fraction": Range(included=False),
}


@struct.dataclass
class HParams:
    """The floats of training; sizes, counts and names are in `Config`.

    Every field is a leaf of a pytree and may be vmapped over, so a sweep is one compiled program. A value is 0, or from
    1e-12 to 1e6, unless the field says another range. Anything else is refused (`check_hparams`).
    """

    gamma: float | jax.Array = 0.99
    """Discount factor of returns, from 0 to 1."""
    gae_lambda: float | jax.Array = 0.95
    """Lambda of generalised advantage estimation, from 0 to 1."""
    policy_lr: float | jax.Array = 1e-3
    """Adam's learning rate of the policy and the value function in the first iteration; at most 100."""
    policy_lr_final_fraction: float | jax.Array = 1.0
    """Fraction of `policy_lr` that is left after the last iteration; the rate is linear in between."""
    clip_eps: float | jax.Array = 0.2
    """PPO: the probability ratio is clipped to 1 - clip_eps and 1 + clip_eps."""
    max_grad_norm: float | jax.Array = 0.5
    """PPO: a gradient with a larger global norm is scaled down to this norm."""
    kl_limit: float | jax.Array = 0.01
    """TRPO: bound on KL(old policy || new policy) in one iteration, in nats; above 0."""
    cg_damping: float | jax.Array = 0.1
    """TRPO: multiple of the identity that is added to the Fisher matrix."""
    entropy_weight: float | jax.Array = 0.001
    """Weight of the policy's entropy in its objective (Appendix D.2: 0.1 to learn a reward, 0.001 to imitate)."""
    entropy_final_fraction: float | jax.Array = 1.0
    """Fraction of `entropy_weight` that is left after the last iteration; the weight is linear in between."""
    std_initial_fraction: float | jax.Array = 1.0
    """The policy's std is multiplied by this number before the first iteration, above 0. A policy with a large fraction
    explores first."""
    std_final_fraction: float | jax.Array = 1.0
    """The policy's std is multiplied by this number after the last iteration, above 0; the factor is geometric between
    the first iteration and the last. A policy with a small fraction settles at the end."""
    temperature: float | jax.Array = 0.0
    """Maximum-entropy RL on a reward that is not learned at the same time: `-temperature log pi(a|s)` is added to the
    reward. The policies of AIRL and EAIRL do not use the setting: their reward f - log pi has a temperature of 1."""
    temperature_final_fraction: float | jax.Array = 1.0
    """Fraction of `temperature` that is left after the last iteration; the temperature is linear in between."""
    lambda_i: float | jax.Array = 0.001
    """lambda_I: weight of the loss l_I in the policy's objective (Eq. 11)."""
    beta: float | jax.Array = 1.0
    """Weight of log q(a|s,s') against log pi(a|s) in the empowerment (Eq. 6, 7)."""
    gradient_penalty: float | jax.Array = 0.0
    """Weight of the penalty on the size of the reward's gradient (`discriminator.gradient_penalty`)."""
    action_variance: float | jax.Array = 0.0
    """Weight of the penalty on differences of the reward between actions (`discriminator.action_variance`)."""
    input_sparsity: float | jax.Array = 0.0
    """Weight of the penalty on each entry of the observation that the reward uses (`discriminator.input_sparsity`)."""
    own_part: float | jax.Array = 0.0
    """Several sources: weight of the penalty on the part of the reward that each source has for itself
    (`discriminator.own_part`). With 0 there are no such parts."""
    discriminator_lr: float | jax.Array = 1e-3
    """Adam's learning rate of the discriminator D, and hence of the reward; at most 100."""
    inverse_lr: float | jax.Array = 1e-3
    """Adam's learning rate of the inverse model q(a|s,s'); at most 100."""
    phi_lr: float | jax.Array = 1e-3
    """Adam's learning rate of the empowerment Phi(s); at most 100."""

    @staticmethod
    def from_json(settings: Any, where: Path | str = "these settings") -> HParams:
        """The floats that `dataclasses.asdict` and a JSON file have turned into a dict.

        Args:
          where: what to call the settings in an error message, for example their file.

        Raises:
          InputError: if a value is impossible, or if this version has no such setting.
        """
        refuse_unknown(settings, HParams, where)
        hparams = HParams(**settings)
        try:
            check_hparams(hparams)
        except InputError as e:
            raise InputError(f"{where}: {e}") from None
        return hparams

    def at(self, progress: jax.Array) -> HParams:
        """The settings at `progress` `[]` of the run, from 0 to 1: annealed rates have their present values.

        `std_final_fraction` becomes the present factor of the std.
        """
        progress = jax.numpy.clip(progress, 0.0, 1.0)

        def annealed(value, final_fraction):
            return value * (1.0 - progress * (1.0 - final_fraction))

        return dataclasses.replace(
            self,
            policy_lr=annealed(self.policy_lr, self.policy_lr_final_fraction),
            entropy_weight=annealed(self.entropy_weight, self.entropy_final_fraction),
            std_final_fraction=self.std_initial_fraction ** (1.0 - progress) * self.std_final_fraction**progress,
            temperature=annealed(self.temperature, self.temperature_final_fraction),
        )


def check_hparams(hparams: HParams) -> None:
    """Checks every value that is concrete; values inside a JAX transformation (tracers) are not checked.

    Raises:
      InputError: if `hparams` are no `HParams`; if a value is NaN, infinite, negative or no number; if it is above 1e6
        (`gamma` and `gae_lambda`: 1, a learning rate: 100), or between 0 and 1e-12; if `kl_limit` or a fraction of the
        std is 0.
    """
    if not isinstance(hparams, HParams):
        raise InputError(f"hparams are {shown(hparams)}: expected HParams, for example HParams(gamma=0.99)")
    for field in dataclasses.fields(hparams):
        value = getattr(hparams, field.name)
        if isinstance(value, jax.core.Tracer):
            continue
        values = _numbers(field.name, value)
        allowed = RANGES.get(field.name, Range())
        possible = allowed.contains(values)
        if not possible.all():
            allowed.check(field.name, float(values[~possible].flat[0]), getattr(HParams(), field.name))


def _numbers(name: str, value: Any) -> np.ndarray:
    """A number or an array `[lanes]` of numbers, in double precision."""
    try:
        values = np.asarray(value)
        if values.dtype.kind in "iuf" and values.ndim <= 1 and values.size:
            return values.astype(np.float64)
        if isinstance(value, int) and not isinstance(value, bool):  # of more than 64 bits
            return np.asarray(float(value))
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{name} = {shown(value)}: expected a number, or an array with one for each lane")
