"""Rewards and policies as programs that need none of this library: StableHLO (by `jax.export`) and ONNX (by jax2onnx).

A program holds everything: the normaliser, the networks of one seed, the clipping of actions. A JSON beside it says
what it was learned from, what its inputs mean, and how to call it.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax import export as jax_export

from eairl_jax import artefacts, storage
from eairl_jax.config import choose
from eairl_jax.errors import InputError
from eairl_jax.saved_policy import LearnedPolicy
from eairl_jax.saved_reward import LearnedReward
from eairl_jax.schema import shown
from eairl_jax.version import __version__

PLATFORMS = ("cpu", "cuda", "rocm", "tpu")
"""One StableHLO program runs on each of these."""
BATCH = "batch"
"""The name of the first axis, which may have any length."""
ONNX_NEEDS = 'pip install "eairl-jax[onnx]" and then pip install --no-deps jax2onnx==0.17.0'


@dataclass(frozen=True)
class Program:
    """What is exported.

    Attributes:
      noun: "reward" or "policy".
      function: of arrays `[batch, size]`.
      inputs: name, size and meaning of each argument.
      output: name, size (0: the axis is absent) and meaning of the result.
    """

    noun: str
    function: Callable[..., jax.Array]
    inputs: tuple[tuple[str, int, str], ...]
    output: tuple[str, int, str]


def export(
    learned: LearnedReward | LearnedPolicy,
    directory: Path | str,
    formats: Sequence[str] = ("stablehlo",),
    seed: int = 0,
    provenance: dict | None = None,
) -> list[Path]:
    """Writes a reward or a policy of one seed as programs for other software, and a JSON that describes them.

    The files are `reward.stablehlo`, `reward.onnx` and `reward.export.json`, or `policy.` and the same. A reward takes
    `obs` and `action` and gives `reward` `[batch]`. A policy takes `obs` and `noise` `[batch, act]` and gives `action`:
    its mean for zeros, a sample for draws from a standard normal distribution. All are float32.

    Args:
      directory: is created.
      formats: any of "stablehlo" and "onnx".
      seed: the position of the seed in the run, from 0.
      provenance: more members for the JSON, for example the run's name.

    Returns:
      The files.

    Raises:
      InputError: if an argument is none of the above, if the run had fewer seeds, or if a library is missing.
    """
    if isinstance(formats, str) or not formats:
        raise InputError(f"formats is {shown(formats)}: expected a sequence of {', '.join(WRITERS)}")
    for name in formats:
        choose("format", name, WRITERS)
    program, about = _program(learned, seed)
    made = {f"{program.noun}.{name}": WRITERS[name](program) for name in dict.fromkeys(formats)}
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    for name, content in made.items():
        with storage.replacing(directory / name) as unfinished:
            unfinished.write_bytes(content)
    versions = {"eairl_jax": __version__, "jax": jax.__version__}
    if "onnx" in formats:
        versions["jax2onnx"] = importlib.metadata.version("jax2onnx")
    description = {
        "kind": f"eairl_jax exported {program.noun}",
        "format": 1,
        **about,
        **(provenance or {}),
        "inputs": [_described(*each) for each in program.inputs],
        "outputs": [_described(*program.output)],
        "how_to_call": {Path(name).suffix[1:]: _how_to_call(program, name) for name in made},
        "sha256": {name: hashlib.sha256(content).hexdigest() for name, content in made.items()},
        "made_with": versions,
    }
    path = directory / f"{program.noun}.export.json"
    storage.write_json(path, description)
    return [*(directory / name for name in made), path]


def _program(learned: Any, seed: Any) -> tuple[Program, dict]:
    """The program of one seed, and what the JSON says of its origin."""
    if not isinstance(learned, LearnedReward | LearnedPolicy):
        raise InputError(f"{shown(learned)} is exported: expected a LearnedReward or a LearnedPolicy")
    noun = "reward" if isinstance(learned, LearnedReward) else "policy"
    found = learned.description
    row = artefacts.seed_row(seed, len(found["seeds"]), noun)
    obs_size, action_size = found["obs_size"], found["action_size"]
    kept = ("task", "method", "reward_form", "action_limit")
    about = {name: found[name] for name in kept if name in found} | {"seed": found["seeds"][row]}
    if "iterations" in found:
        about["iteration"] = found["iterations"][row]
    obs = ("obs", obs_size, "observations as the task gives them, in its units; the program normalises them")
    if isinstance(learned, LearnedPolicy):
        noise = ("noise", action_size, "zeros for the mean action, draws from a standard normal for a sample")
        action = ("action", action_size, "actions in the task's units, within action_limit")
        return Program(noun, learned.function(row), (obs, noise), action), about
    if learned.config.horizon == "absorbing":
        about["reward_after_end"] = learned.after_end(row)
    action = ("action", action_size, "the actions that were taken at these observations, in the task's units")
    value = ("reward", 0, "the learned reward of each step; higher is better; it has no unit")
    return Program(noun, learned.function(row), (obs, action), value), about


def _stablehlo(program: Program) -> bytes:
    (batch,) = jax_export.symbolic_shape(BATCH)
    given = [jax.ShapeDtypeStruct((batch, size), jnp.float32) for _, size, _ in program.inputs]
    return bytes(jax_export.export(jax.jit(program.function), platforms=PLATFORMS)(*given).serialize())


def _onnx(program: Program) -> bytes:
    try:
        to_onnx = importlib.import_module("jax2onnx").to_onnx
    except ImportError as e:
        raise InputError(
            f"ONNX needs jax2onnx, which is missing ({e}): {ONNX_NEEDS}; from a clone of the project, `make onnx` "
            "makes an environment that has it"
        ) from None
    model = to_onnx(
        program.function,
        [(BATCH, size) for _, size, _ in program.inputs],
        model_name=program.noun,
        input_names=[name for name, _, _ in program.inputs],
        output_names=[program.output[0]],
    )
    return model.SerializeToString()


WRITERS: dict[str, Callable[[Program], bytes]] = {"stablehlo": _stablehlo, "onnx": _onnx}


def _described(name: str, size: int, meaning: str) -> dict:
    shape = [BATCH, size] if size else [BATCH]
    return {"name": name, "shape": shape, "dtype": "float32", "meaning": meaning}


def _how_to_call(program: Program, file: str) -> str:
    names = [name for name, _, _ in program.inputs]
    if file.endswith(".onnx"):
        given = ", ".join(f'"{name}": {name}' for name in names)
        return f'{program.output[0]} = onnxruntime.InferenceSession("{file}").run(None, {{{given}}})[0]'
    given = ", ".join(names)
    return (
        f'from jax import export; {program.output[0]} = export.deserialize(open("{file}", "rb").read()).call({given})'
    )
