"""Train one method with several values of a float and several seeds, in one compiled program.

    python examples/vmapped_sweep.py [ITERATIONS [SEEDS]]

Every leaf of HParams may hold one value for each lane. The program is compiled once, whatever the values are.
"""

import sys
from importlib.resources import files

import jax
import jax.numpy as jnp
import numpy as np

import eairl_jax
from eairl_jax import envs

iterations = int(sys.argv[1]) if len(sys.argv) > 1 else 120
seeds = int(sys.argv[2]) if len(sys.argv) > 2 else 3
values = [0.01, 1.0]  # of lambda_I, the weight of the empowerment's loss

env = envs.make("point_maze_left")
demos = eairl_jax.demonstrations.load(files("eairl_jax.experiments") / "data/point_maze_left.npz")
config = eairl_jax.Config(
    method="eairl",
    reward_form="separable",
    normalize_obs="none",
    episode_length=env.episode_length,
    iterations=iterations,
)

# One lane for each pair of a value and a seed. Lanes with the same seed share their random numbers.
keys = jnp.tile(jax.random.split(jax.random.PRNGKey(0), seeds), (len(values), 1))
hparams = eairl_jax.HParams(lambda_i=jnp.repeat(jnp.array(values), seeds), entropy_weight=0.001)
lanes = eairl_jax.Lanes(eairl_jax.make_irl(env, config), keys, hparams, demos)
state, metrics = lanes.run(lanes.init(), iterations)

returns = metrics["true_return"][:, -1].reshape(len(values), seeds)
for value, row in zip(values, returns, strict=True):
    print(f"lambda_i {value}: true return {np.mean(row):.2f}, {seeds} seeds from {row.min():.2f} to {row.max():.2f}")
