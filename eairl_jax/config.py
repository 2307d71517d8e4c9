"""Everything about a run that is not a float: sizes, counts and names. Hashable, checked when made."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

from eairl_jax.errors import InputError


@dataclass(frozen=True)
class Config:
    """The static settings of a run; the floats are in `HParams`.

    Raises `InputError` when a value is impossible or two values do not fit together.
    """

    # One iteration collects num_envs x rollout_length environment steps.
    num_envs: int = 32
    rollout_length: int = 100
    episode_length: int = 100
    """Time limit of an episode, in environment steps."""
    iterations: int = 100
    """Length of the whole run: annealed rates end here."""

    # ActorCritic. The paper: two hidden layers of 32 ReLU units everywhere (Appendix D.1).
    hidden: tuple[int, ...] = (32, 32)
    """Reward, discriminator and potentials."""
    policy_hidden: tuple[int, ...] = (32, 32)
    """Policy and inverse model."""
    value_hidden: tuple[int, ...] = (64, 64)
    activation: str = "relu"
    """Of every network but the policy and the inverse model."""
    policy_activation: str = "default"
    """Of the policy and the inverse model: "relu" (Appendix D.1), "tanh"; "default": the method's own."""
    state_dependent_std: bool = False
    """Whether the stds of the policy and of the inverse model depend on their inputs."""
    actions: str = "sampled"
    """The actions that policies, rewards and inverse models are about: "sampled", the Gaussian's samples, which the
    environment clips out of sight (the paper's release), or "clipped". Experts draw actions far beyond their bounds;
    how far changes nothing, but a discriminator of drawn actions sees it."""
    log_std_init: float = -0.5
    log_std_min: float = -5.0
    log_std_max: float = 0.5
    normalize_obs: str = "task"
    """"task": the scale that the environment declares for its whole state space (identity if it declares none);
    "running": mean and variance of what the policy has seen; "none": raw observations."""
    reward_obs: str = "normalized"
    """What the reward (and a learned h) sees: "normalized" observations, like every other network, or "raw" ones. The
    coarser its input, the less a reward can single out the path that the expert took."""

    # The policy's optimiser
    optimizer: str = "ppo"
    """"ppo" or "trpo"."""
    ppo_epochs: int = 4
    """Passes over a batch: of PPO, and of TRPO's value function."""
    ppo_minibatches: int = 4
    cg_iterations: int = 10
    """TRPO: conjugate-gradient steps towards the natural gradient."""
    line_search_steps: int = 10
    """TRPO: step sizes tried, each half of the one before."""

    # The adversary. "default" is the method's own, `methods.METHODS`.
    method: str = "eairl"
    """A row of `methods.METHODS`, or "bc"."""
    reward_form: str = "default"
    """"sa": g(s,a); "s": g(s); "separable": g(s) + k(a)."""
    action_part: str = "quadratic"
    """k(a) of a separable reward: "quadratic": -c |a|^2 with a learned c >= 0, a cost and nothing else; "net": any
    function of the action, which can also learn the direction in which the expert mostly went."""
    shaping: str = "default"
    """Potential-based shaping of f: "empowerment" (Phi), "learned" (AIRL's h), "both", "none" (Phi = 0)."""
    shaping_discount: str = "default"
    """"gamma", or "one" as in the authors' release."""
    policy_phi: str = "default"
    """Phi(s') in the policy's reward: the slow copy ("target", Eq. 9) or Phi itself ("online", the release)."""
    discriminates: str = "default"
    """What the discriminator tells apart: "transitions", or whole "trajectories" (GAN-GCL)."""
    history: str = "default"
    """The policy's samples that the discriminator sees. "iterations": evenly from the last `history_length` + 1;
    "paths": half from the current iteration, half from a pool that keeps half of each batch (the release); "all": half
    from the current iteration, half from `history_length` + 1 of all there were, each as likely."""
    history_length: int = 20
    """Iterations whose samples the discriminator sees beside the current ones."""
    policy_reset_every: int = 0
    """Iterations after which the policy starts anew, annealed rates with it, while the reward goes on; 0: never. One
    policy only ever tries what lies on its way, and a reward may pay anything for the rest."""
    update_order: str = "default"
    """"empowerment_first" (Algorithm 1) or "discriminator_first" (the release)."""
    discriminator_updates: int = 10
    discriminator_batch: int = 512
    """Samples of the expert in an update, and as many of the policy. Also behaviour cloning's."""
    penalties: tuple[str, ...] = ()
    """Regularisers of the discriminator that are computed, of `PENALTIES`; their weights are in `HParams`."""

    # Empowerment
    empowerment_updates: int = 10
    """Of the inverse model, and as many of Phi."""
    empowerment_batch: int = 512
    phi_sync_interval: int = 5
    """Iterations between copies of Phi into Phi' (Appendix D.2: 5 to learn a reward, 2 to imitate)."""
    l_i_power: int = 2
    """p of Eq. 7: 1 absolute, 2 squared."""
    l_i_actions: str = "default"
    """The actions of Eq. 7: those "stored", or "resampled" anew, one from q and another from pi (the release)."""
    l_i_in: str = "loss"
    """Where lambda_I l_I enters: the policy's "loss" (Eq. 11) or its "reward" (section 3.4)."""
    inverse_loss: str = "default"
    """Of q: "likelihood" (section 2.3) or "mse" (Eq. 8: the mean alone; the std stays as it began)."""

    @staticmethod
    def from_json(settings: dict) -> Config:
        """The configuration that `dataclasses.asdict` and a JSON file made lists of."""
        return Config(**{name: tuple(v) if isinstance(v, list) else v for name, v in settings.items()})

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps in one iteration."""
        return self.num_envs * self.rollout_length

    @property
    def env_steps(self) -> int:
        """Environment steps of a whole run."""
        return self.iterations * self.steps_per_iteration

    def __post_init__(self):
        for name in ("num_envs", "rollout_length", "episode_length", "iterations", "ppo_epochs", "ppo_minibatches",
                     "discriminator_updates", "discriminator_batch", "empowerment_updates", "empowerment_batch",
                     "phi_sync_interval", "cg_iterations", "line_search_steps"):  # fmt: skip
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}: expected at least 1")
        for name in ("history_length", "policy_reset_every"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} = {getattr(self, name)}: expected 0 (none, never) or more iterations")
        if self.policy_reset_every and self.iterations % self.policy_reset_every:
            raise InputError(
                f"iterations = {self.iterations} is not a multiple of policy_reset_every = {self.policy_reset_every}: the last "
                "policy would be cut short; choose a multiple"
            )
        if self.steps_per_iteration % self.ppo_minibatches:
            raise InputError(
                f"ppo_minibatches = {self.ppo_minibatches} does not divide num_envs x rollout_length = "
                f"{self.num_envs} x {self.rollout_length} = {self.steps_per_iteration} steps: choose a divisor of "
                f"{self.steps_per_iteration}"
            )
        low, start, high = self.log_std_min, self.log_std_init, self.log_std_max
        if not low < start < high:
            raise InputError(f"log_std_init = {start} must lie between log_std_min = {low} and log_std_max = {high}")
        for name in ("hidden", "policy_hidden", "value_hidden"):
            widths = getattr(self, name)
            if not isinstance(widths, tuple) or not widths or min(widths) < 1:
                raise InputError(f"{name} = {widths}: expected a tuple of one or more positive widths, e.g. (32, 32)")
        for name, options in CHOICES.items():
            choose(name, getattr(self, name), options)
        for penalty in self.penalties:
            choose("penalty", penalty, PENALTIES)


PENALTIES = ("gradient", "action_variance", "input_sparsity")

# What a method decides unless the configuration does.
METHOD_DEFAULTS: dict[str, tuple[str, ...]] = {
    "reward_form": ("sa", "s", "separable"),
    "shaping": ("empowerment", "learned", "both", "none"),
    "shaping_discount": ("gamma", "one"),
    "policy_phi": ("target", "online"),
    "discriminates": ("transitions", "trajectories"),
    "history": ("iterations", "paths", "all"),
    "update_order": ("empowerment_first", "discriminator_first"),
    "l_i_actions": ("stored", "resampled"),
    "inverse_loss": ("likelihood", "mse"),
    "policy_activation": ("relu", "tanh"),
}

CHOICES: dict[str, tuple] = {
    "activation": ("relu", "tanh"),
    "actions": ("sampled", "clipped"),
    "normalize_obs": ("task", "running", "none"),
    "reward_obs": ("normalized", "raw"),
    "optimizer": ("ppo", "trpo"),
    "action_part": ("quadratic", "net"),
    "l_i_power": (1, 2),
    "l_i_in": ("loss", "reward"),
    **{name: ("default", *options) for name, options in METHOD_DEFAULTS.items()},
}


def choose(what: str, given, options: Iterable) -> None:
    """Checks that `given` is one of `options`; the error names the nearest ones.

    Raises:
      InputError: if it is not.
    """
    options = list(options)
    if given not in options:
        nearest = difflib.get_close_matches(str(given), [str(o) for o in options], n=3, cutoff=0.4)
        hint = f"; did you mean {' or '.join(nearest)}?" if nearest else ""
        raise InputError(f"unknown {what} {given!r}{hint} Choose one of: {', '.join(str(o) for o in options)}")
