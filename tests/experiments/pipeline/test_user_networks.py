"""Networks of a user's own file, in the commands."""

import pytest

from eairl_jax import NETWORKS, InputError
from eairl_jax.experiments.options import Imitate
from eairl_jax.experiments.pipeline import user_networks
from eairl_jax.experiments.pipeline.experiment import imitations

CODE = """
import flax.linen as nn

class Linear(nn.Module):
    @nn.compact
    def __call__(self, x):
        return nn.Dense(1)(x)[..., 0]

class Column(nn.Module):
    @nn.compact
    def __call__(self, x):
        return nn.Dense(1)(x)

width = 3
"""


@pytest.fixture(autouse=True)
def nets(tmp_path, monkeypatch, no_trace):
    """The current folder holds `nets.py`; networks that a test makes known are forgotten after it."""
    (tmp_path / "nets.py").write_text(CODE)
    monkeypatch.chdir(tmp_path)


def test_a_run_has_the_network_that_set_names(tiny):
    (experiment,) = imitations(Imitate("pendulum", set=("net=nets.py:Linear",)))
    assert NETWORKS["nets.py:Linear"].__name__ == "Linear"
    assert experiment.settings()["config"]["net"] == "nets.py:Linear"
    user_networks.register("nets.py:Linear")
    user_networks.register("mlp")
    user_networks.register(None)
    assert "mlp" not in NETWORKS


WRONG = {
    "net=no.py:Linear": "net=no.py:Linear: no file no.py",
    "net=nets.py:Linaer": "has no class or function Linaer; did you mean Linear",
    "net=nets.py:width": "has no class or function width",
    "net=brax:hopper": "names no network: expected mlp, FILE.py:NAME",
    "net=mpl": "names no network: expected mlp, FILE.py:NAME",
    "net=nets.py:Column": r"gives \(1,\) for inputs of shape \(3,\)",
}


@pytest.mark.parametrize(("setting", "message"), WRONG.items(), ids=WRONG)
def test_what_is_no_network_is_refused_before_a_folder_is_made(tmp_path, setting, message):
    with pytest.raises(InputError, match=message):
        imitations(Imitate("pendulum", set=(setting,)))
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["nets.py"]


def test_widths_say_nothing_of_another_network():
    with pytest.raises(InputError, match="hidden: not a setting of eairl"):
        imitations(Imitate("pendulum", set=("net=nets.py:Linear", "hidden=8")))


def test_a_network_is_given_to_a_saved_reward_alone(run, capsys):
    assert run("transfer", "pendulum", "pendulum", "--net", "nets.py:Linear") == 2
    assert "to learn a reward with a network say --set net=" in capsys.readouterr().err
