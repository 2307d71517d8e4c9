"""CONTRIBUTING's worked example is run as it stands: its row trains, and its test can fail."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

from eairl_jax import METHODS, HParams, make_irl

CONTRIBUTING = Path(__file__).parents[1] / "CONTRIBUTING.md"


@pytest.fixture
def example(monkeypatch):
    """Runs the example, a text of it replaced, and gives its names; its row is gone after the test."""
    assert "fairl" not in METHODS

    def run(old="", new=""):
        text = CONTRIBUTING.read_text(encoding="utf-8")
        code = "\n".join(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))
        assert old in code
        monkeypatch.setitem(METHODS, "fairl", None)  # so that its end takes the row away
        exec(compile(code.replace(old, new) if old else code, "CONTRIBUTING.md", "exec"), names := {})
        return names

    return run


def test_its_test_passes(example):
    example()["test_fairls_reward_follows_from_d"]()


@pytest.mark.parametrize(
    ("old", "new"), [("-jnp.exp", "jnp.exp"), ("jnp.exp(logit)", "1.0"), ("gail_logit", "airl_logit")]
)
def test_its_test_fails_on_another_reward(example, old, new):
    names = example(old, new)
    with pytest.raises(AssertionError):
        names["test_fairls_reward_follows_from_d"]()


def test_its_row_trains_the_policy_on_its_reward(example, toy, tiny, demos, numpy_reward):
    example()
    algorithm, hparams = make_irl(toy(), tiny(method="fairl")), HParams(discriminator_lr=0.05)
    before = algorithm.init(jax.random.PRNGKey(0), hparams)
    after, metrics = jax.jit(algorithm.step)(before, hparams, demos)
    x = jax.tree.map(lambda ring: np.asarray(ring[0]), after.replay.transitions)
    h = numpy_reward(after.discriminator.params, x.obs, x.action)
    np.testing.assert_allclose(metrics["policy_reward"], np.mean(-np.exp(h) * h), rtol=1e-4)
    assert abs(metrics["policy_reward"] - np.log1p(np.exp(h)).mean()) > 0.1  # GAIL's
    kernels = [x.agent.policy.nets.params["actor"]["params"]["MLP_0"]["Dense_1"]["kernel"] for x in (before, after)]
    assert np.abs(kernels[1] - kernels[0]).max() > 1e-4
