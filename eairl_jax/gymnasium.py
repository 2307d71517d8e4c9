"""Learned rewards and policies in Gymnasium, for Stable-Baselines3 and its relatives. Needs Gymnasium and NumPy alone.

env = LearnedReward(gymnasium.make("Pendulum-v1"), "runs/NAME/reward")
action, _ = Policy("runs/NAME/policy").predict(obs)
"""

from __future__ import annotations

import os
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper

from eairl_jax import artefacts, numpy_nets
from eairl_jax.errors import InputError
from eairl_jax.schema import shown

TRUE_REWARD = "true_reward"
"""The entry of `info` with the reward that the learned one replaces."""


class LearnedReward(gymnasium.Wrapper, RecordConstructorArgs):
    """Replaces the reward of an environment by a learned one. `info["true_reward"]` keeps the environment's own.

    Args:
      env: observations and actions are flat boxes (`Box`) of the sizes that the reward was learned with.
      reward: the folder of a saved reward, `eairl_jax.LearnedReward`, or `numpy_nets.Reward`.
      seed: the position of the seed in the reward's run, from 0; a `numpy_nets.Reward` has one seed.
      gamma: the discount factor of your algorithm, for rewards learned with the horizon "absorbing". A step at which
        the task ends the episode is then also paid what an endless stay in the absorbing state is worth. None: it is
        not, and the sign of the reward decides how long a policy wants to live.

    Raises:
      InputError: if the sizes differ, if a space is no flat box, or if the reward has no absorbing state.
    """

    def __init__(self, env: gymnasium.Env, reward: Any, seed: int = 0, gamma: float | None = None):
        if isinstance(env, VectorEnv):
            raise InputError("env is a vector environment: use eairl_jax.gymnasium.VectorLearnedReward")
        if not isinstance(env, gymnasium.Env):
            raise InputError(f"env is {shown(env)}: expected a gymnasium.Env")
        RecordConstructorArgs.__init__(self, reward=reward, seed=seed, gamma=gamma)
        gymnasium.Wrapper.__init__(self, env)
        self._pay = _Payment(reward, seed, gamma, env.observation_space, env.action_space)
        self._obs = np.zeros(0)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Any, dict]:
        """Starts an episode."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._obs = np.array(obs)  # a copy: some environments write into the array that they have given
        return obs, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        """Takes a step; its reward is the learned reward of the observation before it and of its action."""
        obs, true, terminated, truncated, info = self.env.step(action)
        learned = float(self._pay(self._obs, action, terminated))
        self._obs = np.array(obs)
        return obs, learned, terminated, truncated, {**info, TRUE_REWARD: true}


class VectorLearnedReward(VectorWrapper):
    """`LearnedReward` for Gymnasium's vector environments; the arguments are the same.

    Where the environment resets itself in the step after an episode (Gymnasium's default), that step is paid 0.
    """

    def __init__(self, env: VectorEnv, reward: Any, seed: int = 0, gamma: float | None = None):
        if not isinstance(env, VectorEnv):
            raise InputError(f"env is {shown(env)}: expected a gymnasium.vector.VectorEnv")
        super().__init__(env)
        self._pay = _Payment(reward, seed, gamma, env.single_observation_space, env.single_action_space)
        mode = env.metadata.get("autoreset_mode")
        self._resets_in_next_step = getattr(mode, "name", str(mode)) in ("NEXT_STEP", "None")
        self._obs, self._ended = np.zeros(0), np.zeros(env.num_envs, bool)

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple[Any, dict]:
        """Starts all episodes."""
        obs, info = self.env.reset(seed=seed, options=options)
        self._obs, self._ended = np.array(obs), np.zeros(self.num_envs, bool)
        return obs, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict]:
        """Takes a step in every environment."""
        obs, true, terminated, truncated, info = self.env.step(actions)
        learned = np.where(self._ended, 0.0, self._pay(self._obs, actions, terminated)).astype(np.float64)
        self._obs = np.array(obs)
        self._ended = (terminated | truncated) & self._resets_in_next_step
        return obs, learned, terminated, truncated, {**info, TRUE_REWARD: true}


class _Payment:
    """The learned reward `[...]` of a step."""

    def __init__(self, reward: Any, seed: int, gamma: float | None, obs_space: Any, action_space: Any):
        self._reward = _of_seed(reward, seed, numpy_nets.Reward, numpy_nets.load_reward)
        sizes = _size("observations", obs_space), _size("actions", action_space)
        artefacts.refuse_other_sizes(self._reward.description, "reward", *sizes, "this environment")
        if gamma is not None and not 0 <= gamma < 1:
            raise InputError(f"gamma = {shown(gamma)}: expected a discount factor from 0 to below 1")
        self._at_end = 0.0 if gamma is None else gamma / (1.0 - gamma) * self._reward.after_end()

    def __call__(self, obs: Any, action: Any, terminated: Any) -> Any:
        return self._reward(obs, self._reward.executed(action)) + self._at_end * np.asarray(terminated)


class Policy:
    """A learned policy, with the `predict` of Stable-Baselines3.

    Args:
      policy: the folder of a saved policy, `eairl_jax.LearnedPolicy`, or `numpy_nets.Policy`.
      seed: the position of the seed in the policy's run, from 0; a `numpy_nets.Policy` has one seed.
      rng: of its samples: a seed or a `numpy.random.Generator`.
    """

    def __init__(self, policy: Any, seed: int = 0, rng: Any = 0):
        self._policy = _of_seed(policy, seed, numpy_nets.Policy, numpy_nets.load_policy)
        self._rng = np.random.default_rng(rng)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[np.ndarray, Any]:
        """Actions `[..., act]` for observations `[..., obs]`, and the state as it was given: the policy has none.

        Args:
          deterministic: the mean action instead of a sample.
        """
        return self._policy(observation, None if deterministic else self._rng), state


def _of_seed(given: Any, seed: int, kind: type, load: Any) -> Any:
    """One seed's function in NumPy, from a folder, from a function of all seeds, or as it is."""
    if isinstance(given, kind):
        return given
    if isinstance(given, str | os.PathLike):
        return load(given, seed)
    if hasattr(given, "numpy"):
        return given.numpy(seed)
    name = kind.__name__.lower()
    raise InputError(
        f"the {name} is {shown(given)}: expected a folder, eairl_jax.Learned{kind.__name__}, or its numpy()"
    )


def _size(what: str, space: Any) -> int:
    if isinstance(space, Box) and len(space.shape) == 1:
        return space.shape[0]
    raise InputError(
        f"the {what} are {space}: expected a Box of one axis; wrap the environment, for example in "
        "gymnasium.wrappers.FlattenObservation"
    )
