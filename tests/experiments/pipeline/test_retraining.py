"""Where fresh policies begin, and which policy is kept."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from eairl_jax import (
    Algorithm,
    Config,
    Demonstrations,
    Diverged,
    HParams,
    InputError,
    Lanes,
    LearnedReward,
    RewardParams,
)
from eairl_jax.experiments.pipeline import retraining, train
from eairl_jax.experiments.pipeline.places import Reference, Target
from eairl_jax.experiments.pipeline.retraining import (
    Training,
    retrain,
    score,
    worth,
)
from eairl_jax.experiments.pipeline.run_folder import RunFolder
from eairl_jax.experiments.pipeline.train import RETRAIN
from eairl_jax.experiments.settings import Recipe
from eairl_jax.plans import Search
from eairl_jax.storage import write_json

SEEDS = (0, 1)


def test_the_restart_that_its_own_reward_rates_best_is_kept(tmp_path, metrics):
    folder = RunFolder(tmp_path, {})
    labels = [{"restart": restart, "seed": seed} for restart in range(3) for seed in SEEDS]
    # While they were trained another policy was the best, by both returns.
    metrics(folder, labels, policy_reward=[[9, 1], [2, 8], [9, 9]], true_return=[[9, 1], [2, 8], [9, 9]])
    with pytest.raises(InputError, match="repeat the command"):
        retraining.best_restarts(folder, 3, 2)
    write_json(tmp_path / retraining.WORTH, {"policies": [[1, 6], [3, 5], [2, 4]], "compared": {}})
    kept = retraining.best_restarts(folder, 3, 2)
    assert [labels[lane] for lane in kept] == [{"restart": 1, "seed": 0}, {"restart": 0, "seed": 1}]
    np.testing.assert_array_equal(retraining.best_restarts(folder, 1, 3), [0, 1, 2])


@struct.dataclass
class PointState:
    """The fields that every environment's state has."""

    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class Point:
    """A point in [-1, 1] that moves by its action. The true reward is NaN, so that nothing can be chosen by it."""

    observation_size, action_size, action_limit, episode_length = 1, 1, 0.2, 10

    def reset(self, rng):
        return PointState(jax.random.uniform(rng, (1,), minval=-0.01, maxval=0.01), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return PointState(jnp.clip(state.obs + action, -1.0, 1.0), jnp.full((), jnp.nan), jnp.zeros(()))


def pays(_params, obs, _action):
    """A reward of 0.5 at -0.6 and of 1 at 0.8, and less farther away."""
    x = obs[..., 0]
    return 0.5 * jnp.maximum(0, 1 - jnp.abs(x + 0.6) / 0.6) + jnp.maximum(0, 1 - jnp.abs(x - 0.8) / 0.6)


@pytest.fixture
def point(monkeypatch):
    """`Point` with a small recipe, and a learned reward that stands for `pays`."""
    config = Config(
        num_envs=8,
        rollout_length=10,
        episode_length=10,
        iterations=6,
        policy_hidden=(32,),
        value_hidden=(8,),
        ppo_epochs=2,
        ppo_minibatches=2,
        log_std_init=-2.5,
    )
    training = dict(restarts=2, trials=4, trial_iterations=2, random_trials=1, random_std=3.0)
    recipe = Recipe(config, HParams(policy_lr=1e-3, std_final_fraction=0.5), 2, **training)
    monkeypatch.setattr(retraining, "reward_function", lambda _config: pays)
    monkeypatch.setattr(retraining, "SEARCH", Search(plans=256, repeats=4, updates=200, batch=64, lr=1e-2))
    params = RewardParams(np.zeros((2, 1), np.float32), None)
    return Target("point", Point(), recipe, Reference(1.0, 0.0)), LearnedReward({}, Config(), params)


def test_the_temperature_belongs_to_a_learned_reward(point):
    target, reward = point
    hparams = dataclasses.replace(target.recipe.hparams, temperature=0.3)
    target = dataclasses.replace(target, recipe=dataclasses.replace(target.recipe, hparams=hparams))
    for each, expected in ((reward, 0.3), (None, 0.0)):
        training = Training(target, each, [{"seed": 0}, {"seed": 1}], RETRAIN)
        assert training.hparams(training.restarts(2)).temperature == expected


@pytest.mark.parametrize(
    ("learned", "kept"),
    [("default", "fixed"), ("fixed", "fixed"), ("absorbing", "absorbing"), ("variable", "variable")],
)
def test_policies_are_trained_with_the_horizon_that_the_reward_knows(point, learned, kept):
    """Where the reward was learned no episode could end ("default"); in the target one can."""
    assert point[0].for_reward(Config(horizon=learned)).recipe.config.horizon == kept


def test_plans_stay_with_the_reward_that_chose_them(tmp_path, point, monkeypatch):
    target, reward = point
    reward = LearnedReward({}, Config(), RewardParams(np.array([[5.0], [6.0]], np.float32), None))

    def made_up(_env, _config, places, *_more):
        """Policies that remember the number of their plan and the reward that chose it."""

        def init(_key, _hparams):
            return {"plan": jnp.arange(places), "reward": jnp.zeros(places)}

        def step(state, _hparams, paid):
            number = paid.params.params[0]
            return state | {"reward": jnp.full(places, number)}, {"score": number}

        return Algorithm(init, step, None)

    monkeypatch.setattr(retraining, "make_planner", made_up)
    inner = retraining.trials_folder(RunFolder(tmp_path, {}))
    state = retraining.planned(inner, Training(target, reward, [{"seed": 0}, {"seed": 1}], RETRAIN))
    np.testing.assert_array_equal(state["plan"], [0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(state["reward"], [5, 6, 5, 6, 5, 6])


class Pays(Point):
    """Pays for being far to the right, and never ends."""

    ends = False

    def step(self, state, action):
        after = super().step(state, action)
        return after.replace(reward=after.obs[0])


def test_the_true_reward_is_paid_by_the_program_of_a_learned_one(tmp_path, point):
    target, reward = point
    target = dataclasses.replace(target, env=Pays(), recipe=dataclasses.replace(target.recipe, trials=0))
    labels = [{"seed": 0}, {"seed": 1}]
    alone, beside = (Training(target, None, labels, RETRAIN, like) for like in (None, reward))
    learned = Training(target, reward, labels, RETRAIN)
    assert learned.algorithm(labels) is beside.algorithm(labels)
    assert learned.algorithm(labels) is not alone.algorithm(labels)
    states = [retrain(RunFolder(tmp_path / name, {}), "", each)[1] for name, each in (("a", alone), ("b", beside))]
    # Another program may add in another order.
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), *states)
    curves = [RunFolder(tmp_path / name, {}).curve("policy_reward", 4) for name in ("a", "b")]
    np.testing.assert_allclose(*curves, rtol=1e-4, atol=1e-5)
    assert (np.abs(curves[0]) < 1).all()  # `pays` gives 0.5 or more near the start


class Short(Point):
    """Ends at the first step."""

    def step(self, state, action):
        return super().step(state, action).replace(reward=jnp.zeros(()), done=jnp.ones(()))


def test_policies_are_judged_with_the_absorbing_steps_that_their_reward_knows(point, monkeypatch):
    """The reward is 1 in the absorbing state and 0 elsewhere: of ten steps nine are there."""
    monkeypatch.setattr(retraining, "reward_function", lambda _config: lambda _params, obs, _action: obs[..., -1] * 1.0)
    target, reward = dataclasses.replace(point[0], env=Short()), point[1]
    reward = LearnedReward({}, Config(horizon="absorbing"), reward.params)
    training = Training(target, reward, [{"seed": 0}, {"seed": 1}], RETRAIN)
    still = Algorithm(None, None, lambda _state, obs, _key: jnp.zeros((len(obs), 1)))
    judged = retraining.final_rewards(training, still, np.zeros((2, 1)), training.labels)
    np.testing.assert_allclose(judged, [0.9, 0.9], rtol=1e-6)
    steps = retraining.random_steps(target.env, 4)
    np.testing.assert_allclose(retraining.rewards_of(training, steps), [0.9, 0.9], rtol=1e-6)


@pytest.mark.parametrize(("actions", "largest"), [("sampled", 0.5), ("clipped", 0.2)])
def test_the_expert_is_judged_by_the_actions_that_the_reward_knows(point, actions, largest):
    target, reward = point
    rows = np.zeros((10, 1), np.float32)
    demos = Demonstrations(rows, rows + 0.5, rows, rows[:, 0], rows[:, 0], np.array([10], np.int32))
    reward = LearnedReward({}, Config(actions=actions), reward.params)
    training = Training(dataclasses.replace(target, demos=demos), reward, [{"seed": 0}], RETRAIN)
    np.testing.assert_allclose(retraining.expert_steps(training)["action"], largest)


@pytest.mark.parametrize(
    ("random_trials", "restarts", "kept"),
    [(0, 2, [[2, 1], [1, 2]]), (1, 2, [[0, 0], [2, 1]]), (3, 2, [[2, 1], [1, 2]]), (3, 1, [[2, 1]])],
)
def test_random_trials_go_on_before_others_and_of_either_kind_the_best(
    tmp_path, random_trials, restarts, kept, metrics
):
    folder = RunFolder(tmp_path, {})
    labels = [{"restart": restart, "seed": seed} for restart in range(3) for seed in SEEDS]
    metrics(folder, labels, policy_reward=[[1, 1], [2, 8], [9, 3]])
    recipe = Recipe(Config(), HParams(), restarts=restarts, trials=3, trial_iterations=1, random_trials=random_trials)
    np.testing.assert_array_equal(retraining.kept_trials(folder, recipe, 2), np.array(kept) * 2 + [0, 1])


def test_what_pays_most_is_reached_though_it_is_far_and_the_true_reward_is_unknown(tmp_path, point, monkeypatch):
    target, reward = point
    folder = RunFolder(tmp_path, {"seeds": list(SEEDS)})
    with pytest.raises(Diverged, match="seed 0 has a true return of nan"):  # it is no score
        score(folder, "point", target, reward, SEEDS)
    monkeypatch.setattr(train, "final_returns", lambda _env, _algorithm, _state, seeds, **_: np.zeros((len(seeds), 1)))
    scored = score(folder, "point", target, reward, SEEDS)
    assert scored.curves.shape == (2, 6)
    learned = worth(folder).policies
    assert learned.shape == (2, 2)
    # A policy that goes to -0.6, which is nearer, is paid at most 0.41.
    assert (scored.worth.kept > 0.45).all()
    np.testing.assert_array_equal(scored.worth.kept, learned.max(axis=0))
    # The task has no demonstrations. Random actions stay near the start, and no plan holds the best place.
    compared = scored.worth.compared
    assert set(compared) == {retraining.RANDOM, retraining.BEST_PLAN}
    assert (compared[retraining.RANDOM] < compared[retraining.BEST_PLAN]).all()
    assert (scored.worth.share > 0.8).all()
    np.testing.assert_array_equal(learned.ravel()[retraining.best_restarts(folder, 2, 2)], learned.max(axis=0))
    # Of the four trials the wide one went on, and of the others the one of the highest reward.
    inner = retraining.trials_folder(folder)
    late = inner.curve("policy_reward", 8)[:, -1].reshape(4, 2)
    went_on = retraining.kept_trials(inner, target.recipe, 2)
    np.testing.assert_array_equal(late.ravel()[went_on], [late[0], late[1:].max(axis=0)])
    entropy = inner.curve("entropy", 8)[:, 0].reshape(4, 2)
    assert (entropy[0] > entropy[1:] + 0.5).all()
    # The curves of the kept policies hold their trials.
    curves = retraining.kept_curves(folder, target, 2, "policy_reward")
    kept = went_on.ravel()[retraining.best_restarts(folder, 2, 2)]
    np.testing.assert_array_equal(curves[:, :2], inner.curve("policy_reward", 8)[kept])
    assert [line["iteration"] for line in folder.metrics()[::4]] == ["3", "4", "5", "6"]


def test_a_retraining_that_was_killed_goes_on_bit_for_bit(tmp_path, point, monkeypatch, equal_trees):
    target, reward = point
    training = Training(target, reward, [{"seed": seed} for seed in SEEDS], RETRAIN)
    whole = retrain(RunFolder(tmp_path / "whole", {}), "point", training)[1]

    def killed(*_):
        raise KeyboardInterrupt

    def go_on():
        return retrain(RunFolder(tmp_path / "killed", {}), "point", training)[1]

    run_lanes, chunks = Lanes.run, []

    def run_one_chunk(*arguments, **more):
        chunks.append(0)
        return run_lanes(*arguments, **more) if len(chunks) == 1 else killed()

    # Before the plans are made, after the trials, and in the middle of the rest.
    for module, name, instead in [
        (retraining, "planned", killed),
        (retraining, "kept_trials", killed),
        (Lanes, "run", run_one_chunk),
    ]:
        with monkeypatch.context() as patch:
            patch.setattr(module, name, instead)
            with pytest.raises(KeyboardInterrupt):
                go_on()
    assert (tmp_path / "killed" / "checkpoints" / "4").is_dir()
    equal_trees(whole, go_on())
    for name in ("metrics.csv", "trials/metrics.csv"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
