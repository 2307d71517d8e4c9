"""Train Stable-Baselines3's PPO on a learned reward and, beside it, on the true one.

    eairl transfer pendulum pendulum --reward-form separable --rule last --seeds 3 --out runs/sb3
    python examples/sb3_on_a_learned_reward.py runs/sb3/transfer-pendulum-to-pendulum-eairl-separable-last/reward

`eairl transfer` learns with settings for rewards that are used again; those of `eairl imitate` are for the policy. Each
of three seeds takes about a minute for each reward. Needs `pip install "eairl-jax[sb3]"`. PPO has the settings of RL
Baselines3 Zoo for this task, but for gamma (0.99, with which the reward was learned) and the scale of the rewards.
"""

import sys

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from eairl_jax.gymnasium import LearnedReward

folder, steps = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 100_000
SETTINGS = {"gamma": 0.99, "learning_rate": 1e-3, "n_steps": 1024, "use_sde": True, "sde_sample_freq": 4}


def pendulum(reward=None, seed=0):
    """Gymnasium's pendulum, paid by a learned reward if there is one."""
    env = gymnasium.make("Pendulum-v1")
    return env if reward is None else LearnedReward(env, reward, seed)


def true_return(reward, seed):
    """Mean true return of 50 episodes of a policy that PPO trained."""
    env = make_vec_env(pendulum, 4, seed=seed, env_kwargs={"reward": reward, "seed": seed})
    env = VecNormalize(env, norm_obs=False, gamma=SETTINGS["gamma"])  # learned rewards have a scale of their own
    policy = PPO("MlpPolicy", env, seed=seed, device="cpu", **SETTINGS).learn(steps)
    return evaluate_policy(policy, make_vec_env(pendulum, 10, seed=1000 + seed), 50)[0]


def random_return(episodes=50):
    """Mean true return of random actions."""
    env = pendulum()
    env.action_space.seed(0)
    env.reset(seed=0)
    rewards = []
    for _ in range(200 * episodes):
        *_, reward, _, ended, _ = env.step(env.action_space.sample())
        rewards.append(reward)
        if ended:
            env.reset()
    return np.sum(rewards) / episodes


learned, true = (np.array([true_return(reward, seed) for seed in range(3)]) for reward in (folder, None))
floor = random_return()
print(f"true return after {steps} steps, seeds 0 to 2; random actions {floor:.0f}")
print(f"trained on the true reward    {true.mean():8.1f}  {true.round(1)}")
print(f"trained on the learned reward {learned.mean():8.1f}  {learned.round(1)}")
print(f"share of what PPO reaches on the true reward: {(learned.mean() - floor) / (true.mean() - floor):.3f}")
