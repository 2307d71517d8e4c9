"""Episodes of a program become demonstrations: of any lengths, types and names, or they are refused in plain words."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eairl_jax import InputError, from_episodes
from eairl_jax.episodes import LAST_STEP_LEFT_OUT, NAMES

LENGTHS = st.lists(st.integers(1, 6), min_size=1, max_size=5).filter(lambda lengths: max(lengths) > 1)
REALS = ("<f4", "<f8", ">f8", ">f4", "<f2")


@dataclass
class Trajectory:
    """The fields of `imitation`'s `TrajectoryWithRew`."""

    obs: np.ndarray
    acts: np.ndarray
    infos: Any
    terminal: bool
    rews: np.ndarray = field(default_factory=lambda: np.zeros(0))


@given(LENGTHS, st.lists(st.booleans(), max_size=5), st.sampled_from(REALS), st.data())
def test_any_lengths_types_names_and_orders(make_episodes, expected, same, lengths, ends, dtype, data):
    episodes = make_episodes(lengths, ends, dtype)
    order = data.draw(st.permutations(list(episodes[0])))
    alias = {name: data.draw(st.sampled_from(NAMES[name])) for name in order}
    demos, facts = from_episodes({alias[name]: episode[name] for name in order} for episode in episodes)
    same(demos, expected(episodes))
    assert (facts.episodes, facts.steps) == (len(lengths), sum(lengths))
    assert (facts.shortest, facts.longest) == (min(lengths), max(lengths))
    assert facts.terminated == sum(ends[: len(lengths)])
    assert set(facts.converted) == (set() if dtype == "<f4" else {"obs", "next_obs", "action", "reward"})


def test_next_obs_may_stand_beside_obs_and_flags_for_each_step(make_episodes, expected, same):
    episodes = make_episodes([4, 2], [True])
    rows = [
        {
            "obs": e["obs"][:-1],
            "next_obs": e["obs"][1:],
            "action": e["action"],
            "reward": e["reward"][:, None],
            "terminated": np.eye(len(e["reward"]))[-1] * e["terminated"],
        }
        for e in episodes
    ]
    same(from_episodes(rows).demos, expected(episodes))


def test_whole_numbers_are_observations_and_lists_are_arrays(same, expected):
    episode = {"obs": [[0], [1], [2]], "action": [[0.5], [1.5]], "reward": [1, 0], "terminated": 1}
    demos, facts = from_episodes([episode])
    same(demos, expected([{name: np.array(x) for name, x in episode.items()}]))
    assert facts.converted["obs"] == "int64"


def test_trajectories_of_imitation_fit_and_their_infos_tell_a_time_limit(make_episodes, expected, same):
    episodes = make_episodes([3, 2, 3], [True, False, True])
    infos = [[{}, {}, {"TimeLimit.truncated": False}], [{}, {"TimeLimit.truncated": True}], [{}] * 3]
    found = [Trajectory(e["obs"], e["action"], i, True, e["reward"]) for e, i in zip(episodes, infos, strict=True)]
    demos, facts = from_episodes(found)
    same(demos, expected(episodes))
    assert "do not say what ended 1 episode" in facts.ends_assumed


@pytest.mark.parametrize(
    ("lengths", "limit", "terminated", "words"),
    [
        ([3, 3], None, 0, "All have 3 steps, so a time limit is assumed"),
        ([3, 2], None, 2, "assumed that the task did"),
        ([3], None, 1, "assumed that the task did"),
        ([3, 2], 3, 1, "Those of 3 steps or more met the time limit"),
        ([3, 3], 4, 2, "the task ended the others"),
    ],
)
def test_what_is_assumed_of_an_unexplained_end_is_said(make_episodes, lengths, limit, terminated, words):
    found = [{"obs": e["obs"], "acts": e["action"], "done": True} for e in make_episodes(lengths)]
    demos, facts = from_episodes(found, time_limit=limit)
    assert demos.terminated.sum() == facts.terminated == terminated
    assert words in " ".join(facts.lines())


@pytest.mark.parametrize(
    ("flags", "terminated", "words"),
    [
        ({"done": True, "truncated": True}, 0, ""),
        ({"done": True, "truncated": False}, 1, ""),
        ({"done": False}, 0, ""),
        ({}, 0, "1 episode stopped without a flag"),
    ],
)
def test_flags_are_read_together(make_episodes, flags, terminated, words):
    (episode,) = make_episodes([3])
    facts = from_episodes([{"obs": episode["obs"], "action": episode["action"], **flags}]).facts
    assert facts.terminated == terminated
    assert words in " ".join(facts.lines())


def test_actions_and_rewards_may_be_missing(make_episodes, expected, same):
    episodes = [{name: e[name] for name in ("obs", "terminated")} for e in make_episodes([3, 5], [True])]
    demos, facts = from_episodes(episodes)
    same(demos, expected(episodes))
    assert not facts.has_actions
    assert not facts.has_rewards
    lines = " ".join(facts.lines())
    assert "There are no rewards." in lines
    assert "There are no actions." in lines


def test_rewards_that_are_all_zero_are_said(make_episodes):
    episodes = [e | {"reward": 0 * e["reward"]} for e in make_episodes([3, 5])]
    facts = from_episodes(episodes).facts
    assert facts.all_rewards_zero
    assert "All rewards are 0." in " ".join(facts.lines())


def test_actions_outside_their_bounds_are_counted_and_kept(make_episodes, expected, same):
    episodes = make_episodes([4, 5])
    demos, facts = from_episodes(episodes, action_limit=2.5)
    same(demos, expected(episodes))
    size = np.abs(demos.action)
    assert facts.outside == (size > 2.5).any(axis=1).sum() > 0
    assert facts.largest_action == size.max()
    assert f"{facts.outside} of 9 steps have an action outside [-2.5, 2.5]" in " ".join(facts.lines())
    assert "outside" not in " ".join(from_episodes(episodes, action_limit=10).facts.lines())


def test_no_more_episodes_are_made_than_wanted(make_episodes, expected, same):
    episodes = make_episodes([3, 4, 5])

    def endless():
        yield from episodes[:2]
        raise AssertionError("a third episode was asked for")

    same(from_episodes(endless(), max_episodes=2).demos, expected(episodes[:2]))
    with pytest.raises(InputError, match="max_episodes is 0"):
        from_episodes(episodes, max_episodes=0)


def test_an_error_of_the_program_that_makes_the_episodes_stays_what_it_is():
    def broken():
        raise RuntimeError("the simulator stopped")
        yield

    with pytest.raises(RuntimeError, match="the simulator stopped"):
        from_episodes(broken())


# Dictionary observations ---------------------------------------------------------------------------------------------


@pytest.fixture
def dictionaries(make_episodes):
    """Two episodes with nested dictionary observations, their entries not in the order of their names."""
    return [
        e | {"obs": {"z": e["obs"], "a": {"pixels": np.zeros((len(e["obs"]), 2, 2)), "b": e["obs"][:, 0]}}}
        for e in make_episodes([3, 4])
    ]


def test_an_entry_of_dictionary_observations_is_chosen_by_name(dictionaries, make_episodes, expected, same):
    same(from_episodes(dictionaries, obs_key="z").demos, expected(make_episodes([3, 4])))
    assert from_episodes(dictionaries, obs_key="a/b").demos.obs.shape == (7, 1)


def test_flattened_entries_stand_in_the_order_of_their_names(dictionaries, make_episodes):
    obs = from_episodes(dictionaries, obs_key="flatten").demos.obs
    z = np.concatenate([e["obs"][:-1] for e in make_episodes([3, 4])])
    np.testing.assert_array_equal(obs, np.concatenate([z[:, :1], np.zeros((7, 4)), z], axis=1))


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (None, r"obs is a dictionary of a/b, a/pixels, z: choose an entry with obs_key \(--obs-key\)"),
        ("y", r"obs has no entry 'y' of a/b, a/pixels, z"),
        ("a/pixels", r"obs has shape \(4, 2, 2\); expected one vector for each step; flatten"),
    ],
)
def test_dictionary_observations_without_a_fitting_key_are_refused(dictionaries, key, message):
    with pytest.raises(InputError, match=message):
        from_episodes(dictionaries, obs_key=key)


def test_a_key_for_observations_without_entries_is_refused(make_episodes):
    with pytest.raises(InputError, match="obs is one array and has no entry 'state'"):
        from_episodes(make_episodes([3]), obs_key="state")


# What is refused -----------------------------------------------------------------------------------------------------


def change(**fields):
    """Episodes of 3 and 4 steps whose second one is changed."""
    return lambda episodes: [episodes[0], {k: v for k, v in (episodes[1] | fields).items() if v is not None}]


BAD = {
    "no episodes": (lambda episodes: [], "holds no episodes"),
    "no observations": (change(obs=None), "episode 1 is a dictionary of action, reward, terminated: expected"),
    "NaN": (change(obs=np.full((5, 3), np.nan)), "obs is NaN or infinite at episode 1, step 0"),
    "too large": (change(action=np.full((4, 2), 1e300)), "action is NaN or infinite at episode 1, step 0"),
    "other size": (change(obs=np.zeros((5, 2))), "episode 1: obs has size 2, and 3 in the episodes before"),
    "other lengths": (
        change(action=np.zeros((5, 2))),
        "has 4 steps by obs, but action 5: expected one row",
    ),
    "no steps": (change(obs=np.zeros((1, 3)), action=np.zeros((0, 2)), reward=np.zeros(0)), "episode 1 has no steps"),
    "text": (change(reward=np.full(4, "good")), "reward has dtype <U4; expected numbers"),
    "objects": (change(obs=np.full((5, 3), None)), "obs has dtype object; expected numbers"),
    "ragged": (change(obs=[[0.0], [0.0, 1.0]]), "obs is a list of lists of different lengths"),
    "complex": (change(obs=np.zeros((5, 3), complex)), "obs has dtype complex128"),
    "discrete": (change(action=np.zeros(4, int)), "actions are whole numbers .* continuous actions"),
    "end inside": (change(terminated=np.array([0, 1, 0, 1])), "terminated at step 1, and 4 steps: cut the episode"),
    "no truth value": (change(terminated=255), "terminated holds 255: expected 0 or 1"),
    "one reward missing": (change(reward=None), "reward are in some episodes only"),
    "two names": (change(observations=np.zeros((5, 3))), "obs and observations, which mean the same"),
    "rewards with two axes": (change(reward=np.zeros((4, 2))), r"reward has shape \(4, 2\)"),
    "a number": (change(obs=np.float64(3)), r"obs has shape \(\)"),
}


@pytest.mark.parametrize(("changed", "message"), BAD.values(), ids=BAD.keys())
def test_bad_episodes_are_refused(make_episodes, changed, message):
    with pytest.raises(InputError, match=message):
        from_episodes(changed(make_episodes([3, 4])))


def test_a_tuple_is_no_episode(make_episodes):
    with pytest.raises(InputError, match="episode 0 is a tuple: expected a dictionary or an object with obs"):
        from_episodes([tuple(episode.values()) for episode in make_episodes([3])])


def test_every_fact_is_a_sentence(make_episodes):
    episodes = [e | {"reward": 0 * e["reward"]} for e in make_episodes([3, 4], [True])]
    for line in from_episodes(episodes, action_limit=1).facts.lines():
        assert line[0].isupper() or line[0].isdigit() or line.startswith("the episodes"), line
        assert line.endswith("."), line
    assert not LAST_STEP_LEFT_OUT.endswith(".")
