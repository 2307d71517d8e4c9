"""Rewards in NumPy against those in jax, and that they need no jax. Policies: `test_saved_policy`."""

import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from eairl_jax import InputError, config, load_reward, numpy_nets

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "v1" / "rewards"
FORMS = sorted(path.name for path in GOLDEN.iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def steps():
    """Observations and actions `[1000, ...]`, some of them far away."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(1000, 3)) * rng.choice([1.0, 30.0], (1000, 1)), rng.normal(size=(1000, 1))


@pytest.mark.parametrize("form", FORMS)
def test_numpy_and_jax_agree(steps, form):
    with np.load(GOLDEN / "expected.npz") as expected:
        obs, action = expected["obs"], expected["action"]
    reward = load_reward(GOLDEN / form)
    for seed in range(2):
        alone = numpy_nets.load_reward(GOLDEN / form, seed)
        np.testing.assert_allclose(alone(obs, action), reward(obs, action, seed), rtol=1e-5, atol=1e-5)
        assert alone(obs.reshape(-1, obs.shape[-1])[0], action.reshape(-1, action.shape[-1])[0]).shape == ()
        assert reward.numpy(seed)(obs, action).tolist() == alone(obs, action).tolist()
    if form == "absorbing":
        assert alone.after_end() == pytest.approx(reward.after_end(1), rel=1e-5)
    else:
        with pytest.raises(InputError, match="no value for the steps after"):
            alone.after_end()


@pytest.mark.parametrize("name", config.ACTIVATIONS)
def test_activations_are_those_of_jax(name):
    x = np.concatenate([np.linspace(-8, 8, 97), [-200.0, 200.0, 0.0]]).astype(np.float32)
    expected = getattr(jax.nn, name)(x)
    assert expected.shape == x.shape
    found = numpy_nets.ACTIVATIONS[name](x)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=2e-6)
    assert found.dtype == np.float32


def test_no_jax_is_imported():
    program = (
        f"from eairl_jax import numpy_nets; import sys; r = numpy_nets.load_reward({str(GOLDEN / FORMS[0])!r})\n"
        "import eairl_jax.gymnasium; assert not {'jax', 'flax', 'brax'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_call_is_checked():
    reward = numpy_nets.load_reward(GOLDEN / FORMS[0])
    with pytest.raises(InputError, match="observations of length 0"):
        reward(1.0, np.zeros(1))
    with pytest.raises(InputError, match="seed = 2: the run of this reward had 2 seeds"):
        numpy_nets.load_reward(GOLDEN / FORMS[0], 2)
