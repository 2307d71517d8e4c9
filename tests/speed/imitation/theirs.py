"""Trains `imitation`'s GAIL or AIRL on half-cheetah, in an environment that has `imitation` instead of eairl_jax.

    python theirs.py DEMONSTRATIONS.npz SECONDS gail|airl FOLDER

Settings are those that `imitation` was tuned to on its own half-cheetah (its `tuned_hps`, release 1.0), with its 8
environments in this process. Each environment writes its episodes into FOLDER as Stable-Baselines3's monitor does: the
true return of the policy that explores, the length, and the seconds since the start. `summary.json` says how many steps
were taken in how many seconds.
"""

import contextlib
import json
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
from imitation.algorithms.adversarial.airl import AIRL
from imitation.algorithms.adversarial.gail import GAIL
from imitation.data.types import Transitions
from imitation.policies.base import FeedForward32Policy, NormalizeFeaturesExtractor
from imitation.rewards.reward_nets import BasicRewardNet, BasicShapedRewardNet, NormalizedRewardNet
from imitation.util.networks import RunningNorm
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

ENVIRONMENTS, EPISODE_STEPS, SEED = 8, 500, 0
SETTINGS = {
    "gail": dict(
        trainer=GAIL, net=BasicRewardNet, batch=4096, demo_batch=8192, updates=8, lr=0.00026250519057717037,
        entropy=3.992371122209408e-6,
    ),
    "airl": dict(
        trainer=AIRL, net=BasicShapedRewardNet, batch=8192, demo_batch=2048, updates=16, lr=0.00047248619386801587,
        entropy=0.0005544771755195421,
    ),
}  # fmt: skip


class TimeIsUp(Exception):
    """Ends a training."""


def main(demonstrations: Path, seconds: float, name: str, folder: Path) -> None:
    """Trains for `seconds`, counted from here, and then to the end of the round."""
    started = time.time()
    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    folder.mkdir(parents=True)
    settings = SETTINGS[name]

    def environment(number: int) -> Monitor:
        env = gymnasium.make("HalfCheetah-v4", max_episode_steps=EPISODE_STEPS)
        return Monitor(env, str(folder / f"{number}"))

    venv = DummyVecEnv([lambda number=number: environment(number) for number in range(ENVIRONMENTS)])
    venv.seed(SEED)
    learner = PPO(
        FeedForward32Policy,
        venv,
        n_steps=settings["batch"] // ENVIRONMENTS,
        batch_size=64,
        clip_range=0.1,
        ent_coef=settings["entropy"],
        gae_lambda=0.95,
        gamma=0.95,
        learning_rate=settings["lr"],
        max_grad_norm=0.8,
        n_epochs=5,
        vf_coef=0.11483689492120866,
        policy_kwargs=dict(
            features_extractor_class=NormalizeFeaturesExtractor,
            features_extractor_kwargs=dict(normalize_class=RunningNorm),
        ),
        seed=SEED,
        device="cpu",
    )
    net = settings["net"](venv.observation_space, venv.action_space, normalize_input_layer=RunningNorm)
    trainer = settings["trainer"](
        demonstrations=read(demonstrations),
        demo_batch_size=settings["demo_batch"],
        gen_replay_buffer_capacity=512,
        n_disc_updates_per_round=settings["updates"],
        venv=venv,
        gen_algo=learner,
        reward_net=NormalizedRewardNet(net, normalize_output_layer=RunningNorm),
    )
    ready = time.time()

    def stop(_round: int) -> None:
        if time.time() - started >= seconds:
            raise TimeIsUp

    with contextlib.suppress(TimeIsUp):
        trainer.train(10_000_000, callback=stop)
    now = time.time()
    summary = {"env_steps": learner.num_timesteps, "seconds": now - started, "training_seconds": now - ready}
    (folder / "summary.json").write_text(json.dumps(summary | {"started": started}))


def read(demonstrations: Path) -> Transitions:
    """Episodes of eairl_jax, one transition after another."""
    with np.load(demonstrations) as file:
        obs, acts, next_obs = (file[key].reshape(-1, file[key].shape[-1]) for key in ("obs", "action", "next_obs"))
    acts = np.clip(acts, -1, 1)  # as the motors do; these environments refuse other actions
    dones = np.zeros(len(obs), bool)  # they end by the time limit alone
    infos = np.array([{}] * len(obs))
    return Transitions(obs=obs, acts=acts, infos=infos, next_obs=next_obs, dones=dones)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))
