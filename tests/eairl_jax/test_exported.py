"""Exported programs give what the artefacts give, in a process without this library."""

import dataclasses
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from eairl_jax import InputError, export, load_policy, load_reward

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden" / "v1"
REWARDS = sorted(path.name for path in (GOLDEN / "rewards").iterdir() if path.is_dir())
POLICIES = sorted(path.name for path in (GOLDEN / "policies").iterdir() if path.is_dir())
BATCHES, SEED = (1, 7, 1000), 1

CALL = {
    "stablehlo": """
from jax import export
def caller(path):
    call = export.deserialize(bytearray(path.read_bytes())).call
    return lambda **inputs: call(*inputs.values())
""",
    "onnx": """
import onnxruntime
def caller(path):
    session = onnxruntime.InferenceSession(path)
    return lambda **inputs: session.run(None, inputs)[0]
""",
}
PROGRAM = """
import json, sys
from pathlib import Path
import numpy as np
folder, out = map(Path, sys.argv[1:])
results = {}
for path in sorted(folder.glob("*/*.export.json")):
    call = caller(path.with_name(path.name.replace(".export.json", f".{FORMAT}")))
    names = [each["name"] for each in json.loads(path.read_text())["inputs"]]
    with np.load(folder / "inputs.npz") as inputs:
        for batch in (1, 7, 1000):
            found = call(**{name: inputs[f"{name} {batch}"] for name in names})
            results[f"{path.parent.name} {batch}"] = np.asarray(found)
assert not any(name.startswith("eairl_jax") for name in sys.modules)
np.savez(out, **results)
"""


def learned_things():
    """Every form of reward and policy; a reward that was learned of clipped actions is one of them."""
    for name in REWARDS:
        yield f"reward-{name}", load_reward(GOLDEN / "rewards" / name)
    sa = load_reward(GOLDEN / "rewards" / "sa")
    yield "reward-clipped", type(sa)(sa.description, dataclasses.replace(sa.config, actions="clipped"), sa.params)
    yield "reward-layer norm", with_layer_norm(sa)
    for name in POLICIES:
        yield f"policy-{name}", load_policy(GOLDEN / "policies" / name)


def with_layer_norm(reward):
    """A reward whose hidden layers are normalised, with the weights of another."""
    params, rng = reward.params.params, np.random.default_rng(0)
    seeds, layers = len(reward.description["seeds"]), dict(params["g"]["params"]["MLP_0"])
    for i, width in enumerate(reward.config.hidden):
        layers[f"LayerNorm_{i}"] = {
            name: rng.normal(size=(seeds, width)).astype(np.float32) for name in ("scale", "bias")
        }
    params = dataclasses.replace(reward.params, params={"g": {"params": {"MLP_0": layers}}})
    return type(reward)(reward.description, dataclasses.replace(reward.config, layer_norm=True), params)


def inputs():
    """Observations, actions and noise of each batch, some of them far away."""
    rng, drawn = np.random.default_rng(0), {}
    for batch in BATCHES:
        far = rng.choice([1.0, 20.0], (batch, 1))
        sizes = {"obs": 4, "action": 2, "noise": 2}
        drawn |= {
            f"{name} {batch}": (far * rng.normal(size=(batch, n))).astype(np.float32) for name, n in sizes.items()
        }
    return drawn


@pytest.mark.parametrize("form", ["stablehlo", pytest.param("onnx", marks=pytest.mark.onnx)])
def test_programs_give_what_the_artefacts_give_where_this_library_is_not(tmp_path, form):
    if form == "onnx":
        pytest.importorskip("jax2onnx")
    given = inputs()
    np.savez(tmp_path / "inputs.npz", **given)
    things = dict(learned_things())
    for name, learned in things.items():
        export(learned, tmp_path / name, [form], SEED)
    program = f"FORMAT = {form!r}\n{CALL[form]}{PROGRAM}"
    command = [sys.executable, "-c", program, tmp_path, tmp_path / "found.npz"]
    subprocess.run([str(x) for x in command], check=True, cwd=tmp_path)
    with np.load(tmp_path / "found.npz") as found:
        assert len(found.files) == len(things) * len(BATCHES)
        for name, learned in things.items():
            for batch in BATCHES:
                obs, action, noise = (given[f"{each} {batch}"] for each in ("obs", "action", "noise"))
                if name == "reward-clipped":
                    action = np.clip(action, -1.0, 1.0)
                expected = (
                    learned(obs, action, SEED) if name.startswith("reward") else learned.function(SEED)(obs, noise)
                )
                scale = max(1.0, float(np.abs(expected).max()))
                np.testing.assert_allclose(found[f"{name} {batch}"], expected, atol=1e-5 * scale)


def test_the_json_says_what_the_program_is(tmp_path):
    reward = load_reward(GOLDEN / "rewards" / "absorbing")
    *_, path = export(reward, tmp_path / "out", seed=SEED, provenance={"run": "a run"})
    about = json.loads(path.read_text())
    expected = {"task": "toy", "method": "airl_sa", "seed": 6, "iteration": 9, "run": "a run", "action_limit": 1.0}
    assert expected.items() <= about.items()
    assert about["reward_after_end"] == pytest.approx(reward.after_end(SEED))
    assert [(each["name"], each["shape"]) for each in about["inputs"]] == [
        ("obs", ["batch", 4]),
        ("action", ["batch", 2]),
    ]
    content = (tmp_path / "out" / "reward.stablehlo").read_bytes()
    assert about["sha256"] == {"reward.stablehlo": hashlib.sha256(content).hexdigest()}
    namespace = {"obs": np.zeros((3, 4), np.float32), "action": np.zeros((3, 2), np.float32)}
    line = about["how_to_call"]["stablehlo"].replace("reward.stablehlo", str(tmp_path / "out" / "reward.stablehlo"))
    exec(line, namespace)
    assert namespace["reward"].shape == (3,)


def test_the_documented_programs_run_alone(tmp_path):
    export(load_reward(GOLDEN / "rewards" / "s"), tmp_path)
    example = ROOT / "examples" / "call_an_exported_reward.py"
    found = subprocess.run([sys.executable, example, tmp_path], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("toy [")


@pytest.mark.onnx
def test_the_documented_program_of_onnx_runs_alone(tmp_path):
    pytest.importorskip("jax2onnx")
    export(load_policy(GOLDEN / "policies" / "plain"), tmp_path, ["onnx"])
    example = ROOT / "examples" / "call_an_onnx_policy.py"
    found = subprocess.run([sys.executable, example, tmp_path], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("toy [[")


WRONG = {
    "another thing": ({"learned": 3}, "3 is exported: expected a LearnedReward or a LearnedPolicy"),
    "no formats": ({"formats": ()}, "formats is .*: expected a sequence of stablehlo, onnx"),
    "one word": ({"formats": "onnx"}, "formats is 'onnx': expected a sequence"),
    "another format": ({"formats": ["onxn"]}, "unknown format 'onxn'; did you mean onnx"),
    "a seed too many": ({"seed": 2}, "seed = 2: the run of this reward had 2 seeds"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_wrong_arguments_are_refused_and_nothing_is_written(tmp_path, changes, message):
    arguments = {"learned": load_reward(GOLDEN / "rewards" / "s")} | changes
    with pytest.raises(InputError, match=message):
        export(directory=tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


def test_a_missing_jax2onnx_is_one_message(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jax2onnx", None)
    with pytest.raises(InputError, match=r"ONNX needs jax2onnx.*make onnx"):
        export(load_reward(GOLDEN / "rewards" / "s"), tmp_path / "out", ["stablehlo", "onnx"])
    assert not (tmp_path / "out").exists()
