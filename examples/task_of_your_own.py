"""Define a task, train an expert in the task, collect demonstrations, and learn a reward from them.

    python examples/task_of_your_own.py [ITERATIONS]

A task is any class with the two sizes and the two functions of brax's Env. No base class is needed.
"""

import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp

import eairl_jax

iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 60


class State(NamedTuple):
    obs: jax.Array  # [2]: position and velocity
    reward: jax.Array  # []
    done: jax.Array  # []: 1 where the task itself ends the episode; the time limit is Config.episode_length


class Cart:
    """A cart on a rail (m, m/s) that is pushed by a force in [-1, 1] and shall stop at 0."""

    observation_size = 2
    action_size = 1
    obs_mean, obs_std = (0.0, 0.0), (1.0, 1.0)  # optional: centre and scale of the whole state space

    def reset(self, rng: jax.Array) -> State:
        return State(jax.random.uniform(rng, (2,), minval=-1.0, maxval=1.0), jnp.zeros(()), jnp.zeros(()))

    def step(self, state: State, action: jax.Array) -> State:
        position, velocity = state.obs
        obs = jnp.stack([position + 0.1 * velocity, velocity + 0.1 * action[0]])
        return State(obs, -(position**2) - 0.1 * action[0] ** 2, jnp.zeros(()))


env, length, key = Cart(), 50, jax.random.PRNGKey(0)
config = eairl_jax.Config(num_envs=16, rollout_length=length, episode_length=length, iterations=iterations)

# An expert: reinforcement learning on the task's true reward (make_rl without a third argument).
algorithm = eairl_jax.make_rl(env, config)
expert, metrics = jax.jit(lambda state: eairl_jax.scan(algorithm, state, eairl_jax.HParams(), (), iterations))(
    algorithm.init(key, eairl_jax.HParams())
)
# Demonstrations: ten whole episodes of the expert's sampled policy.
returns, steps = eairl_jax.evaluate(key, env, lambda obs, key: algorithm.act(expert, obs, key), 10, length)
demos = eairl_jax.demonstrations.from_steps(steps)
print(f"the expert's true return: {returns.mean():.2f}")

lanes = eairl_jax.Lanes(eairl_jax.make_irl(env, config), key[None], eairl_jax.HParams(), demos)
state, metrics = lanes.run(lanes.init(), iterations)
print(f"true return of the imitating policy: {metrics['true_return'][0, -1]:.2f}")
