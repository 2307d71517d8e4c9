"""Record a policy of a run in Gymnasium's half-cheetah as a Minari data set, which `eairl demos --from` reads.

    eairl expert half_cheetah --seeds 2
    python examples/demonstrations_from_gymnasium.py runs/expert-half_cheetah half_cheetah/gymnasium-v0
    eairl demos half_cheetah --from minari:half_cheetah/gymnasium-v0 --to demos/from_gymnasium.npz
    eairl imitate half_cheetah --method gail --tuned --demos demos/from_gymnasium.npz

Gymnasium simulates in MuJoCo's C engine, one environment at a time: 20 episodes take seconds. Any other policy
can stand in place of the run's. Needs `pip install "eairl-jax[minari]"`.
"""

import sys
from pathlib import Path

import gymnasium
import minari
import numpy as np

from eairl_jax.gymnasium import Policy

STEPS = 500  # the time limit of our half_cheetah
run, name = Path(sys.argv[1]), sys.argv[2]
episodes = int(sys.argv[3]) if len(sys.argv) > 3 else 20

policy = Policy(run / "policy")
env = minari.DataCollector(gymnasium.make("HalfCheetah-v5", max_episode_steps=STEPS))
returns = np.zeros(episodes)
for episode in range(episodes):
    obs, _ = env.reset(seed=episode)
    for _ in range(STEPS):
        action, _ = policy.predict(obs)
        obs, reward, terminated, truncated, _ = env.step(action)
        returns[episode] += reward
    assert truncated
    assert not terminated
env.create_dataset(name, algorithm_name="eairl_jax")
print(f"{episodes} episodes in minari:{name}, return {returns.mean():.1f} ± {returns.std():.1f}")
