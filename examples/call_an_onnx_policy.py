"""Act by an exported policy in a program without eairl_jax and without jax. Needs onnxruntime and NumPy.

    eairl export runs/NAME --what policy --format onnx --out exported
    python examples/call_an_onnx_policy.py exported

An exported reward is called in the same way, with {"obs": obs, "action": action}.
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

folder = Path(sys.argv[1])
about = json.loads((folder / "policy.export.json").read_text())
policy = onnxruntime.InferenceSession(folder / "policy.onnx")

obs_size, action_size = (each["shape"][-1] for each in about["inputs"])
obs, no_noise = np.zeros((1, obs_size), np.float32), np.zeros((1, action_size), np.float32)
print(about["task"], policy.run(None, {"obs": obs, "noise": no_noise})[0])
