"""Recipes of tasks that have none of their own."""

import dataclasses

import pytest

from eairl_jax import envs
from eairl_jax.experiments.recipes import PURPOSE_DEFAULTS, RECIPES, sections_of
from eairl_jax.experiments.settings import has_recipe, recipe
from eairl_jax.methods import METHODS


@dataclasses.dataclass
class Somewhere:
    """What `recipe` asks of a task."""

    episode_length: int


@pytest.mark.parametrize("purpose", PURPOSE_DEFAULTS)
@pytest.mark.parametrize("length", [1, 7, 50, 99, 200, 300, 301, 1000, 3001])
def test_defaults_are_possible_for_every_length_of_episodes(purpose, length):
    for method in METHODS if purpose in ("imitate", "reward") else [None]:
        overrides = {} if method is None else {"method": method}
        config = recipe("brax:nothing", Somewhere(length), purpose, overrides).config
        assert config.episode_length == length
        assert config.normalize_obs == "running"
        if method == "gan_gcl":
            assert config.rollout_length % length == 0


def test_the_scale_is_the_tasks_where_it_declares_one():
    assert sections_of("mine", 1000, True)["all"].get("normalize_obs") is None
    assert sections_of("mine", 1000, False)["all"]["normalize_obs"] == "running"


def test_short_episodes_have_smaller_batches():
    def batch(length):
        return sections_of("mine", length, False)["all"]["num_envs"]

    assert batch(100) < batch(1000)


def test_a_task_of_ours_keeps_its_recipe_whatever_its_arguments():
    ant = envs.make("ant")
    assert has_recipe("ant?fidelity=exact")
    assert recipe("ant?fidelity=exact", ant, "expert", {}) == recipe("ant", ant, "expert", {})
    assert not any(map(has_recipe, ("brax:ant", "playground:ant", "ant.py:ant", "ant:ant")))
    assert set(RECIPES) == set(envs.TASKS)
