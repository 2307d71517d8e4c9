"""Learn rewards from demonstrations in JAX: EAIRL and the methods it is measured against.

Functional API, in the order in which a run uses it:

    algorithm = make_irl(env, Config(method="eairl"))       # init, step, act: pure functions
    lanes = Lanes(algorithm, keys, HParams(), demos)         # a lane a seed
    state, metrics = lanes.run(lanes.init(), 100)            # one compiled scan
    reward = learned_reward(state)                           # what can be transferred
"""

from eairl_jax import demonstrations
from eairl_jax.bc import make_bc
from eairl_jax.checkpoint import Checkpoints
from eairl_jax.config import Config
from eairl_jax.errors import InputError
from eairl_jax.evaluate import evaluate, random_policy
from eairl_jax.irl import RewardParams, learned_reward, make_irl, reward_function
from eairl_jax.lanes import Lanes, scan
from eairl_jax.methods import METHODS
from eairl_jax.rl import make_rl
from eairl_jax.saved_reward import LearnedReward, load_reward, save_reward
from eairl_jax.types import Algorithm, Demonstrations, HParams, Transition
from eairl_jax.version import __version__

__all__ = [
    "METHODS",
    "Algorithm",
    "Checkpoints",
    "Config",
    "Demonstrations",
    "HParams",
    "InputError",
    "Lanes",
    "LearnedReward",
    "RewardParams",
    "Transition",
    "__version__",
    "demonstrations",
    "evaluate",
    "learned_reward",
    "load_reward",
    "make_bc",
    "make_irl",
    "make_rl",
    "random_policy",
    "reward_function",
    "save_reward",
    "scan",
]
