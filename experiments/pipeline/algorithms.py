"""Which function builds a method by its name, and which settings mean nothing to it."""

from __future__ import annotations

from eairl_jax import Algorithm, Config, Demonstrations, InputError, make_bc, make_irl
from eairl_jax.discriminator_data import check_segments
from eairl_jax.envs.mjx_task import MjxTask
from eairl_jax.methods import with_method_defaults, uses_empowerment

EMPOWERMENT = frozenset({
    "lambda_i", "beta", "phi_lr", "inverse_lr", "empowerment_updates", "empowerment_batch", "inverse_loss",
    "phi_sync_interval", "l_i_power", "l_i_actions", "l_i_in", "policy_phi",
})  # fmt: skip
ADVERSARY = frozenset({
    "discriminator_lr", "history", "history_length", "policy_reset_every", "shaping", "shaping_discount", "reward_form",
    "reward_obs", "action_part", "discriminates", "update_order", "gradient_penalty", "action_variance", "input_sparsity",
    "hidden",
})  # fmt: skip
TRPO = frozenset({"kl_limit", "cg_damping", "cg_iterations", "line_search_steps"})
PPO = frozenset({"clip_eps", "max_grad_norm"})
SOFT = frozenset({"temperature", "temperature_final_fraction"})  # of a reward that is given
REINFORCEMENT = frozenset({"gamma", "gae_lambda", "entropy_weight", "entropy_final_fraction", "std_final_fraction"})


def make(env: MjxTask, config: Config) -> Algorithm:
    """The algorithm that `config.method` names.

    Raises:
      InputError: for a setting that it cannot work with.
    """
    return make_bc(env, config) if config.method == "bc" else make_irl(env, config)


def meaningless(config: Config) -> frozenset[str]:
    """The settings that a method and its optimiser never read."""
    unread = PPO if config.optimizer == "trpo" else TRPO
    if config.method == "bc":
        return PPO | TRPO | EMPOWERMENT | ADVERSARY | REINFORCEMENT
    resolved = with_method_defaults(config)
    if resolved.reward_form != "separable":
        unread |= {"action_part"}
    return unread if uses_empowerment(resolved) else unread | EMPOWERMENT


def refuse_meaningless(configs: list[Config], given: set[str], purpose: str | None = None) -> None:
    """Raises `InputError` for a setting that none of the methods of a command reads.

    Args:
      purpose: what is done instead of imitation, which reads no setting of an adversary.
    """
    unread = frozenset.intersection(*(meaningless(config) for config in configs))
    unread |= EMPOWERMENT | ADVERSARY | {"method", "discriminator_updates", "discriminator_batch"} if purpose else SOFT
    unread &= given
    if unread:
        names = purpose or ", ".join(dict.fromkeys(f"{config.method} with {config.optimizer}" for config in configs))
        raise InputError(f"{', '.join(sorted(unread))}: not a setting of {names}; leave it out")


def check(config: Config, demos: Demonstrations) -> None:
    """Raises `InputError` where a method cannot work with its settings or its demonstrations."""
    if config.method != "bc":
        check_segments(with_method_defaults(config), demos.reward.shape[1])
