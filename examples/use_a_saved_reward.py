"""Train fresh policies on a saved reward in another task, and score them by that task's true reward.

    python examples/use_a_saved_reward.py [FOLDER [ITERATIONS]]

FOLDER is a folder with reward.npz and reward.json. The default, runs/my-reward, is what examples/learn_a_reward.py
leaves; the reward/ folder of any finished run of `eairl imitate` or `eairl transfer` serves as well.
"""

import sys

import jax

import eairl_jax
from eairl_jax import envs

folder = sys.argv[1] if len(sys.argv) > 1 else "runs/my-reward"
iterations = int(sys.argv[2]) if len(sys.argv) > 2 else 80

# 1. Load the reward. A reward fits every task with observations and actions of the same sizes.
env = envs.make("point_maze_right")
reward = eairl_jax.load_reward(folder, env.observation_size, env.action_size)
seeds = reward.description["seeds"]
print(f"a reward of {reward.description['task']}, {len(seeds)} seeds")

# 2. Reinforcement learning on the learned reward. The true reward is measured, and never trained on.
config = eairl_jax.Config(
    actions=reward.config.actions,  # the actions that the reward knows: as sampled, or as clipped
    episode_length=env.episode_length,
    iterations=iterations,
    log_std_init=1.0,  # start wide: the way round the barrier has to be found
    log_std_max=1.2,
    ppo_minibatches=8,
)
hparams = eairl_jax.HParams(
    gamma=0.999,  # the passage pays late
    gae_lambda=1.0,
    policy_lr=1.5e-3,
    policy_lr_final_fraction=0.1,
    entropy_weight=0.01,
    entropy_final_fraction=0.0,
    std_final_fraction=0.05,  # end narrow
)
function = eairl_jax.reward_function(reward.config)
algorithm = eairl_jax.make_rl(env, config, lambda params, steps: function(params, steps.obs, steps.action))

# 3. One policy for each seed of the reward. data_per_lane gives each lane the reward of its seed.
keys = jax.random.split(jax.random.PRNGKey(1), len(seeds))
lanes = eairl_jax.Lanes(algorithm, keys, hparams, reward.params, data_per_lane=True)
state, metrics = lanes.run(lanes.init(), iterations)
for lane, seed in enumerate(seeds):
    learned, true = (metrics[name][lane, -1] for name in ("policy_reward", "true_return"))
    print(f"seed {seed}: learned reward {learned:.2f} a step, true return {true:.2f} an episode")
