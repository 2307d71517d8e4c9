"""The settings of a run that are not floats of training: sizes, counts and names. Hashable, and checked when made."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eairl_jax.arguments import LARGEST_COUNT, Range, real_number, whole_number
from eairl_jax.errors import InputError
from eairl_jax.schema import listed, shown

MOST_LAYERS, LARGEST_WIDTH = 100, 2**16
LOG_STD = Range(-30.0, 30.0)
LAYER_NORM_EPSILON = 1e-6
"""Is added to the variance of a hidden layer, so that a layer of equal values can be normalised."""


@dataclass(frozen=True)
class Config:
    """The static settings of a run; the floats of training are in `HParams`.

    A setting of "default" takes the value of the method (`methods.METHODS`).

    Raises:
      InputError: if a value is impossible, or if two values contradict each other.
    """

    # Batches
    num_envs: int = 32
    """Environments that run in parallel. One iteration collects num_envs x rollout_length environment steps."""
    rollout_length: int = 100
    """Steps of each environment in one iteration."""
    episode_length: int = 0
    """Time limit of an episode, in environment steps; 0 for the task's own (`env.episode_length`)."""
    horizon: str = "default"
    """How learning treats an episode that the task ends. "fixed": the simulation goes on until the time limit.
    "absorbing": an absorbing state follows, for expert and policy alike (Kostrikov et al. 2019). One step there stands
    for all; a policy is paid reward / (1 - gamma) for it. Methods of whole trajectories see all steps until the limit.
    "variable": the episode ends, and the sign of the reward decides how long a policy wants to live. "default" is
    "variable" for the true reward; for a learned reward it is "absorbing", or "fixed" where no episode can end."""
    iterations: int = 100
    """Iterations of the whole run; annealed rates reach their final values after the last."""

    # Networks. The paper uses two hidden layers of 32 ReLU units everywhere (Appendix D.1).
    hidden: tuple[int, ...] = (32, 32)
    """Widths of the hidden layers of the reward and of every potential (Phi and h)."""
    net: str = "mlp"
    """Network of the reward and of every potential. "mlp": a multilayer perceptron of the widths `hidden`. Or a flax
    module of yours, by its import path: FILE.py:NAME in the commands, MODULE:NAME, or a key of `eairl_jax.NETWORKS`.
    It maps `[..., n]` (observation and action in one vector) to `[...]`."""
    policy_hidden: tuple[int, ...] = (32, 32)
    """Widths of the hidden layers of the policy and of the inverse model."""
    value_hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of the value function."""
    activation: str = "relu"
    """Activation of the reward, the potentials and the value function: the name of a function in `jax.nn`."""
    policy_activation: str = "default"
    """Activation of the policy and the inverse model: the name of a function in `jax.nn`, or "default" ("relu", as in
    Appendix D.1)."""
    layer_norm: bool = False
    """Whether each hidden layer of the reward, the potentials and the value function is normalised before its
    activation (layer normalisation, Ba et al. 2016)."""
    policy_layer_norm: bool = False
    """Whether each hidden layer of the policy and of the inverse model is normalised before its activation."""
    state_dependent_std: bool = False
    """Whether the stds of the policy and of the inverse model depend on their inputs."""
    actions: str = "sampled"
    """Which actions the policy, the reward and the inverse model are about. "sampled": the Gaussian's samples, which
    the environment clips internally (the paper's release). "clipped": the actions after clipping, as executed. An
    expert's samples often lie far beyond the bounds. How far has no effect, but a discriminator of sampled actions
    sees it."""
    log_std_init: float = -0.5
    """Log of the policy's std before the first update; between log_std_min and log_std_max. All three are from -30 to
    30."""
    log_std_min: float = -5.0
    """Lower bound on the log of the policy's std."""
    log_std_max: float = 0.5
    """Upper bound on the log of the policy's std."""
    normalize_obs: str = "task"
    """How observations are normalised. "task": by the scale that the environment declares for its whole state space
    (not at all if it declares none). "running": by the mean and variance of the policy's observations so far. "none":
    not at all."""
    reward_obs: str = "normalized"
    """Observations that the reward and the learned potential h receive: "normalized", like every other network, or
    "raw". The coarser the observations, the less a reward can single out the path of the expert."""

    # The policy's optimiser
    optimizer: str = "ppo"
    """Optimiser of the policy: "ppo" or "trpo"."""
    ppo_epochs: int = 4
    """Passes over a batch in one iteration: of PPO, and of the value function under TRPO."""
    ppo_minibatches: int = 4
    """Minibatches in one pass over a batch; must divide num_envs x rollout_length."""
    cg_iterations: int = 10
    """TRPO: conjugate-gradient steps towards the natural gradient."""
    line_search_steps: int = 10
    """TRPO: number of step sizes that the line search tries, each half of the one before."""

    # The adversary
    method: str = "eairl"
    """Name of the method: a key of `methods.METHODS`, or "bc" (behaviour cloning)."""
    reward_form: str = "default"
    """Form of the reward. "sa": g(s,a). "s": g(s). "separable": g(s) + k(a)."""
    action_part: str = "quadratic"
    """k(a) of a separable reward. "quadratic": -c |a|^2 with a learned c >= 0, which can only be a cost. "net": any
    function of the action, which can also learn the direction in which the expert mostly moved."""
    shaping: str = "default"
    """Potential-based shaping of f: "empowerment" (Phi), "learned" (AIRL's h), "both", or "none". "exact_empowerment":
    Phi is computed from the simulator and not learned; l_I keeps the learned Phi. Only tasks of at most two observed
    quantities that can start at rest anywhere have an exact Phi: the point mazes."""
    shaping_discount: str = "default"
    """Discount factor in the shaping term: "gamma", or "one" as in the authors' release."""
    policy_phi: str = "default"
    """Phi(s') in the policy's reward: "target" is the slow copy Phi' (Eq. 9), "online" is Phi itself (the release)."""
    discriminates: str = "default"
    """What the discriminator classifies: single "transitions", or whole "trajectories" (GAN-GCL)."""
    history: str = "default"
    """Which samples of the policy the discriminator sees. "iterations": evenly drawn from the current iteration and the
    last `history_length`. "paths": half from the current iteration, half from a pool that keeps half of each batch (the
    release). "all": half from the current iteration, half from `history_length` + 1 iterations that are drawn evenly
    from all iterations so far. "default": that of the method; "all" where an absorbing state follows an end."""
    history_length: int = 20
    """Number of past iterations whose samples the discriminator sees beside the current samples."""
    policy_reset_every: int = 0
    """Iterations after which the policy starts anew, with its annealed rates; the reward is kept. 0: never. A single
    policy visits few states; elsewhere the reward is unconstrained. A fresh policy visits new states."""
    update_order: str = "default"
    """Order of updates in an iteration: "empowerment_first" (Algorithm 1) or "discriminator_first" (the release)."""
    discriminator_updates: int = 10
    """Updates of the discriminator in one iteration; of the policy, for behaviour cloning."""
    discriminator_batch: int = 512
    """Samples of the expert in one update of the discriminator, and as many samples of the policy. For behaviour
    cloning: samples of the expert in one update of the policy."""
    context_size: int = 0
    """Last entries of an observation that the reward does not see, and policy and potentials do: which of several
    sources a step is from. Set by the task (`envs.several`); 0 for a single source."""
    penalties: tuple[str, ...] = ()
    """Penalties on the reward that are computed: any of "gradient", "action_variance", "input_sparsity" and, for
    several sources, "own_part", with which each source has a part of the reward for itself (`discriminator.own_part`).
    Their weights are in `HParams`."""

    # Empowerment
    empowerment_updates: int = 10
    """Updates of the inverse model in one iteration, and as many of Phi."""
    empowerment_batch: int = 512
    """Samples of the policy in one update of the inverse model or of Phi."""
    empowerment_steps: int = 1
    """K of an exact Phi: steps after which the observation is read (`exact_empowerment`)."""
    phi_sync_interval: int = 5
    """Iterations between copies of Phi into Phi' (Appendix D.2: 5 to learn a reward, 2 to imitate)."""
    l_i_power: int = 2
    """Power p of the loss l_I (Eq. 7): 1 (absolute) or 2 (squared)."""
    l_i_actions: str = "default"
    """Actions in l_I (Eq. 7). "stored": the actions of the transitions. "resampled": new samples, one from q and
    another from pi (the release)."""
    l_i_in: str = "loss"
    """Where lambda_I l_I enters: the policy's "loss" (Eq. 11) or the policy's "reward" (section 3.4)."""
    inverse_loss: str = "default"
    """Loss of the inverse model q. "likelihood": -log q (section 2.3). "mse": the squared error of q's mean (Eq. 8), in
    which case q's std never changes."""

    @staticmethod
    def from_json(settings: Any, where: Path | str = "these settings") -> Config:
        """The configuration that `dataclasses.asdict` and a JSON file have turned into a dict with lists.

        Args:
          where: what to call the settings in an error message, for example their file.

        Raises:
          InputError: if a value is impossible, or if this version has no such setting.
        """
        refuse_unknown(settings, Config, where)
        try:
            return Config(**{name: tuple(v) if isinstance(v, list) else v for name, v in settings.items()})
        except InputError as e:
            raise InputError(f"{where}: {e}") from None

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps in one iteration."""
        return self.num_envs * self.rollout_length

    @property
    def env_steps(self) -> int:
        """Environment steps of a whole run."""
        return self.iterations * self.steps_per_iteration

    def __post_init__(self):
        for field in dataclasses.fields(self):
            # The dataclass is frozen; a NumPy number becomes a Python number here, before anyone has seen the object.
            object.__setattr__(self, field.name, _as_type(field.name, getattr(self, field.name), str(field.type)))
        self._check_ranges()
        for name, options in CHOICES.items():
            choose(name, getattr(self, name), options)
        for penalty in self.penalties:
            choose("penalty", penalty, PENALTIES)
        self._check_combinations()

    def _check_ranges(self) -> None:
        """Raises `InputError` where a number is too small, or larger than any computer needs."""
        for name in AT_LEAST_1:
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {shown(getattr(self, name))}: expected at least 1")
        for name in AT_LEAST_0:
            if getattr(self, name) < 0:
                raise InputError(f"{name} = {shown(getattr(self, name))}: expected 0 or more")
        for name in (*AT_LEAST_1, *AT_LEAST_0):
            if getattr(self, name) > LARGEST_COUNT:
                raise InputError(f"{name} = {shown(getattr(self, name))}: expected at most {LARGEST_COUNT}")
        if self.steps_per_iteration > LARGEST_COUNT:
            raise InputError(
                f"num_envs x rollout_length = {self.steps_per_iteration} steps in one iteration: expected at most "
                f"{LARGEST_COUNT}"
            )
        for name in ("hidden", "policy_hidden", "value_hidden"):
            widths = getattr(self, name)
            if min(widths, default=0) < 1 or max(widths) > LARGEST_WIDTH or len(widths) > MOST_LAYERS:
                raise InputError(
                    f"{name} = {shown(widths)}: expected 1 to {MOST_LAYERS} widths, each from 1 to {LARGEST_WIDTH}, "
                    "for example (32, 32)"
                )
        for name in ("log_std_init", "log_std_min", "log_std_max"):
            LOG_STD.check(name, getattr(self, name), type(self).__dataclass_fields__[name].default)

    def _check_combinations(self) -> None:
        """Raises `InputError` where two settings contradict each other."""
        if self.policy_reset_every and self.iterations % self.policy_reset_every:
            raise InputError(
                f"iterations = {self.iterations} is not a multiple of policy_reset_every = {self.policy_reset_every}: "
                "the last policy would be trained for fewer iterations than the others; choose a multiple"
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
        normalised = {"hidden": self.layer_norm, "value_hidden": self.layer_norm}
        for name, is_on in (normalised | {"policy_hidden": self.policy_layer_norm}).items():
            if is_on and 1 in getattr(self, name):
                raise InputError(
                    f"{name} = {shown(getattr(self, name))}: layer normalisation makes a layer of width 1 a constant; "
                    "expected widths of at least 2, or no layer normalisation"
                )


AT_LEAST_1 = (
    "num_envs",
    "rollout_length",
    "iterations",
    "ppo_epochs",
    "ppo_minibatches",
    "discriminator_updates",
    "discriminator_batch",
    "empowerment_updates",
    "empowerment_batch",
    "empowerment_steps",
    "phi_sync_interval",
    "cg_iterations",
    "line_search_steps",
)

AT_LEAST_0 = ("history_length", "policy_reset_every", "episode_length", "context_size")

OWN_PART = "own_part"
PENALTIES = ("gradient", "action_variance", "input_sparsity", OWN_PART)

ACTIVATIONS = (
    "relu", "tanh", "celu", "elu", "gelu", "hard_sigmoid", "hard_silu", "hard_swish", "hard_tanh", "identity",
    "leaky_relu", "log_sigmoid", "mish", "relu6", "selu", "sigmoid", "silu", "soft_sign", "softplus", "sparse_plus",
    "sparse_sigmoid", "squareplus", "swish",
)  # fmt: skip
"""The functions of `jax.nn` that change each number by itself."""

# Settings that the method decides if their value is "default", and their other values.
METHOD_DEFAULTS: dict[str, tuple[str, ...]] = {
    "reward_form": ("sa", "s", "separable"),
    "shaping": ("empowerment", "learned", "both", "none", "exact_empowerment"),
    "shaping_discount": ("gamma", "one"),
    "policy_phi": ("target", "online"),
    "discriminates": ("transitions", "trajectories"),
    "history": ("iterations", "paths", "all"),
    "update_order": ("empowerment_first", "discriminator_first"),
    "l_i_actions": ("stored", "resampled"),
    "inverse_loss": ("likelihood", "mse"),
    "policy_activation": ACTIVATIONS,
}

CHOICES: dict[str, tuple] = {
    "activation": ACTIVATIONS,
    "actions": ("sampled", "clipped"),
    "horizon": ("default", "fixed", "absorbing", "variable"),
    "normalize_obs": ("task", "running", "none"),
    "reward_obs": ("normalized", "raw"),
    "optimizer": ("ppo", "trpo"),
    "action_part": ("quadratic", "net"),
    "l_i_power": (1, 2),
    "l_i_in": ("loss", "reward"),
    **{name: ("default", *options) for name, options in METHOD_DEFAULTS.items()},
}


def refuse_unknown(settings: Any, cls: type, where: Path | str) -> None:
    """Raises `InputError` unless `settings` are a dict of fields of the dataclass `cls`.

    Args:
      where: what to call the settings in an error message.
    """
    if not isinstance(settings, dict):
        raise InputError(f"{where}: the {cls.__name__} is {shown(settings)}: expected an object of settings")
    unknown = sorted(set(map(str, settings)) - {field.name for field in dataclasses.fields(cls)})
    if unknown:
        raise InputError(
            f"{where} has settings that this version does not have: {listed(unknown)}; use the version that wrote "
            "them, or make the run again"
        )


def choose(what: str, value: Any, options: Iterable) -> None:
    """Checks that `value` is one of `options`.

    Raises:
      InputError: if the value is not; the message names the nearest options.
    """
    options = list(options)
    if value not in options:
        nearest = difflib.get_close_matches(str(value), [str(o) for o in options], n=3, cutoff=0.4)
        hint = f"; did you mean {' or '.join(nearest)}?" if nearest else "."
        raise InputError(f"unknown {what} {shown(value)}{hint} Choose one of: {', '.join(str(o) for o in options)}")


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _tuple_of(one: Callable[[Any], Any]) -> Callable[[Any], tuple]:
    def convert(value: Any) -> tuple:
        if not isinstance(value, tuple):
            raise TypeError
        return tuple(one(x) for x in value)

    return convert


# Type of a field -> (what an error message calls it, conversion that raises TypeError for another type).
TYPES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "int": ("a whole number", whole_number),
    "float": ("a number", real_number),
    "str": ("a name", _text),
    "bool": ("True or False", _flag),
    "tuple[int, ...]": ("a tuple of whole numbers, for example (32, 32)", _tuple_of(whole_number)),
    "tuple[str, ...]": ('a tuple of names, for example ("gradient",)', _tuple_of(_text)),
}


def _as_type(name: str, value: Any, type_name: str) -> Any:
    """The value of a field, a NumPy number turned into a Python number; `InputError` if it has another type."""
    expected, convert = TYPES[type_name]
    try:
        return convert(value)
    except TypeError:
        raise InputError(f"{name} = {shown(value)}: expected {expected}") from None
