"""Call an exported reward in a program without eairl_jax. Needs jax, flatbuffers and NumPy.

    eairl export runs/NAME --out exported
    python examples/call_an_exported_reward.py exported

An exported policy is called in the same way: `policy.call(obs, noise)`.
"""

import json
import sys
from pathlib import Path

import numpy as np
from jax import export

folder = Path(sys.argv[1])
about = json.loads((folder / "reward.export.json").read_text())
reward = export.deserialize(bytearray((folder / "reward.stablehlo").read_bytes()))

obs_size, action_size = (each["shape"][-1] for each in about["inputs"])
obs, action = np.zeros((7, obs_size), np.float32), np.zeros((7, action_size), np.float32)
print(about["task"], reward.call(obs, action))
