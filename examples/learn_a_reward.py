"""Learn a reward from 20 demonstrations in the left maze, look at it, and save it.

    python examples/learn_a_reward.py [ITERATIONS]

Takes a few minutes on two CPU cores, compilation included. The reward is saved in runs/my-reward.
"""

import sys
from importlib.resources import files

import jax

import eairl_jax
from eairl_jax import envs

iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 120
seeds = [0, 1]

# 1. A task, and whole episodes of an expert in that task: obs [20, 100, 2], action [20, 100, 2] and so on.
env = envs.make("point_maze_left")
demos = eairl_jax.demonstrations.load(files("eairl_jax.experiments") / "data/point_maze_left.npz")

# 2. What is learned. Config holds sizes and names, HParams holds floats.
config = eairl_jax.Config(
    method="eairl",
    reward_form="separable",  # g(s) - c|a|^2; the paper's form is "sa"
    normalize_obs="none",  # the networks see metres
    episode_length=env.episode_length,
    iterations=iterations,
)
hparams = eairl_jax.HParams(lambda_i=0.01, entropy_weight=0.001)

# 3. Train one policy and one reward for each seed, side by side.
algorithm = eairl_jax.make_irl(env, config)
keys = jax.random.split(jax.random.PRNGKey(0), len(seeds))
lanes = eairl_jax.Lanes(algorithm, keys, hparams, demos)
state, metrics = lanes.run(lanes.init(), iterations)
print("true return of the imitating policies:", metrics["true_return"][:, -1])

# 4. Take the reward out of the state, and describe where it came from.
description = {
    "task": "point_maze_left",
    "obs_size": env.observation_size,
    "action_size": env.action_size,
    "seeds": seeds,
    "iterations": [iterations] * len(seeds),
}
reward = eairl_jax.LearnedReward(description, config, lanes.take(eairl_jax.learned_reward(state)))
print("mean learned reward on the demonstrations:", reward(demos.obs, demos.action, seed=0).mean())

# 5. Save the reward. Another program loads the reward with eairl_jax.load_reward.
eairl_jax.save_reward("runs/my-reward", reward)
print("saved in runs/my-reward")
