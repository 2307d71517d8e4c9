"""Tasks as sources and targets: their demonstrations, their recipes, and the returns that normalise scores."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from eairl_jax import InputError, demonstrations
from eairl_jax.experiments.options import Imitate, Transfer
from eairl_jax.experiments.pipeline import places
from eairl_jax.experiments.pipeline.experiment import imitations, transfers
from eairl_jax.experiments.pipeline.places import Reference, make_env, make_target, shipped_demonstrations


def test_restarts_are_the_users_or_the_recipes():
    assert make_target("point_maze_left").recipe.restarts == 4
    assert make_target("point_maze_left", restarts=2).recipe.restarts == 2


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """`(changes) -> path` of the pendulum's demonstrations, their provenance changed; played episodes are refused."""

    def refuse(env):
        raise AssertionError("computed")

    monkeypatch.setattr(places, "random_return", refuse)

    def copy(changes):
        shipped, path = shipped_demonstrations("pendulum"), tmp_path / "mine.npz"
        shutil.copy(shipped, path)
        provenance = json.loads(shipped.with_suffix(".json").read_text())
        path.with_suffix(".json").write_text(json.dumps(provenance | changes))
        return path

    return copy


@pytest.mark.parametrize("name", ["expert_return", "random_return"])
@pytest.mark.parametrize(
    "value", ["-100", None, float("nan"), float("inf"), True, [1.0], pytest.param(10**400, id="huge")]
)
def test_a_reference_that_is_no_number_is_refused_before_anything_is_computed(name, value, copied):
    with pytest.raises(InputError, match=rf"mine.json.*{name} is .*: expected (a finite number|at most 64 bits)"):
        imitations(Imitate("pendulum", demos=copied({name: value})))


def test_an_expert_that_is_as_good_as_random_actions_is_refused(copied):
    with pytest.raises(InputError, match=r"random actions both have the return -7, so no score"):
        imitations(Imitate("pendulum", demos=copied({"expert_return": -7, "random_return": -7.0})))


def test_a_source_without_rewards_has_no_expert(copied, monkeypatch):
    path = copied({})
    provenance = json.loads(path.with_suffix(".json").read_text())
    del provenance["expert_return"]
    path.with_suffix(".json").write_text(json.dumps(provenance))
    load = demonstrations.load
    monkeypatch.setattr(demonstrations, "load", lambda *arguments: load(*arguments)._replace(reward=None))
    (learning,) = imitations(Imitate("pendulum", demos=path))
    assert learning.source.reference == Reference(None, provenance["random_return"])
    assert learning.source.reference.normalized(3.0) is None


TASK = """
import jax, jax.numpy as jnp
from eairl_jax.envs.foreign import ForeignState

class Point:
    observation_size, action_size, episode_length = 3, 1, 10
    def reset(self, rng): return ForeignState((), jnp.zeros(3), jnp.zeros(()), jnp.zeros(()))
    def step(self, state, action): return state.replace(reward=-action[0] ** 2)
"""


@pytest.fixture
def point(tmp_path, monkeypatch):
    """The name of a task in a file of the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "point.py").write_text(TASK)
    monkeypatch.setattr(places, "SCORE_EPISODES", 3)
    make_env.cache_clear()
    yield "point.py:Point"
    make_env.cache_clear()


def test_a_target_needs_no_expert(point, capsys):
    places.say_once.cache_clear()
    (moved,) = transfers(Transfer("pendulum", point, rule=("last",)))
    reference = moved.use.target.reference
    assert (reference.expert, moved.use.target.demos) == (None, None)
    assert -1.0 * 10 < reference.random < 0.0
    assert f"{point} has no recipe: it is trained with defaults" in capsys.readouterr().out
    assert moved.folder_name() == "transfer-pendulum-to-point-Point-eairl-sa-last"


def test_the_recorded_demonstrations_of_a_task_are_found_and_said(point, tmp_path, capsys):
    with pytest.raises(InputError, match=r"no demonstrations of point\.py:Point come with the package"):
        imitations(Imitate(point))
    with np.load(shipped_demonstrations("pendulum")) as archive:
        arrays = {name: x[:, :10] for name, x in archive.items() if x.ndim} | {"task": np.asarray(point)}
    (tmp_path / "demos").mkdir()
    np.savez(tmp_path / "demos" / "point-Point.npz", **arrays)
    places.say_once.cache_clear()
    (learning,) = imitations(Imitate(point))
    assert learning.source.demos_path == Path("demos/point-Point.npz")
    assert f"demonstrations of {point}: demos/point-Point.npz" in capsys.readouterr().out
    assert transfers(Transfer("pendulum", point, rule=("last",)))[0].use.target.reference.expert is not None


@pytest.mark.parametrize(
    ("rule", "settings"), [("best", ()), ("iteration=7", ()), ("last", ("lambda_i=x",)), ("last", ("num_envs=0",))]
)
def test_bad_input_is_refused_before_random_actions_are_played(point, rule, settings, monkeypatch):
    monkeypatch.setattr(places, "random_return", lambda env: pytest.fail("computed"))
    with pytest.raises(InputError):
        transfers(Transfer("pendulum", point, rule=(rule,), set=settings))
