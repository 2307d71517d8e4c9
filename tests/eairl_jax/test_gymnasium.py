"""Learned rewards and policies in Gymnasium's environments. The artefacts are the golden ones."""

import dataclasses
import pickle
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from eairl_jax import InputError, load_policy, load_reward, numpy_nets
from eairl_jax.gymnasium import LearnedReward, Policy, VectorLearnedReward

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "v1"
SA, ABSORBING, POLICY = GOLDEN / "rewards" / "sa", GOLDEN / "rewards" / "absorbing", GOLDEN / "policies" / "plain"
END = 3


class Counter(gymnasium.Env):
    """Observations count the steps, always in the same array. The task ends an episode at step `END`."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.obs = np.zeros(4, np.float32)
        return self.obs, {}

    def step(self, action):
        self.obs += 1.0
        return self.obs, 7.0, bool(self.obs[0] >= END), False, {"key": 1}


class Copies(Counter):
    """Gives a new array at every step, as Gymnasium asks for."""

    def step(self, action):
        self.obs = self.obs.copy()
        return super().step(action)


def counted(n):
    return np.full(4, n, np.float32)


@pytest.mark.filterwarnings("ignore::UserWarning")  # advice on spaces, rendering, and the use of wrappers
def test_gymnasiums_own_check_passes():
    check_env(LearnedReward(Copies(), SA), skip_render_check=True)
    check_env(LearnedReward(gymnasium.make("Pendulum-v1"), GOLDEN / "finished" / "reward"), skip_render_check=True)


def test_a_step_is_paid_by_its_observation_before_and_its_action():
    env, reward, action = LearnedReward(Counter(), SA, seed=1), load_reward(SA), np.array([0.3, -0.2], np.float32)
    env.reset(seed=0)
    for n in range(END):
        obs, paid, terminated, truncated, info = env.step(action)
        assert paid == pytest.approx(float(reward(counted(n), action, 1)), abs=1e-5)
        assert (obs.tolist(), terminated, truncated) == (counted(n + 1).tolist(), n + 1 == END, False)
        assert info == {"key": 1, "true_reward": 7.0}


@pytest.mark.parametrize(
    "given",
    [ABSORBING, str(ABSORBING), load_reward, lambda folder: numpy_nets.load_reward(folder, 1)],
    ids=["path", "text", "jax", "NumPy"],
)
def test_an_end_is_paid_what_the_absorbing_state_is_worth(given):
    reward = numpy_nets.load_reward(ABSORBING, 1)
    assert abs(reward.after_end()) > 0.01
    env = LearnedReward(Counter(), given(ABSORBING) if callable(given) else given, 1, gamma=0.9)
    env.reset(seed=0)
    action = np.zeros(2, np.float32)
    paid = [env.step(action)[1] for _ in range(END)]
    expected = [float(reward(counted(n), action)) for n in range(END)]
    expected[-1] += sum(0.9**k * reward.after_end() for k in range(1, 400))
    np.testing.assert_allclose(paid, expected, rtol=1e-5)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_vector_of_environments(mode):
    env = VectorLearnedReward(SyncVectorEnv([Counter] * 2, autoreset_mode=mode), SA)
    reward, action = numpy_nets.load_reward(SA), np.array([[0.3, -0.2], [0.1, 0.5]], np.float32)
    obs, _ = env.reset(seed=0)
    for n in range(2 * END):
        before = obs.copy()
        obs, paid, *_, info = env.step(action)
        is_reset = mode is AutoresetMode.NEXT_STEP and n % (END + 1) == END
        np.testing.assert_allclose(paid, 0.0 if is_reset else reward(before, action), rtol=1e-5)
        assert info["true_reward"].tolist() == ([0.0, 0.0] if is_reset else [7.0, 7.0])


def test_actions_are_known_as_they_are_executed():
    """A reward that was learned of clipped actions reads clipped actions."""
    reward = load_reward(SA)
    clipped = type(reward)(reward.description, dataclasses.replace(reward.config, actions="clipped"), reward.params)
    env, far = LearnedReward(Counter(), clipped), np.array([9.0, -9.0], np.float32)
    env.reset(seed=0)
    assert env.step(far)[1] == pytest.approx(float(reward(counted(0), np.array([1.0, -1.0]))), abs=1e-5)


WRONG = {
    "no environment": (LearnedReward, (None, SA), "env is None: expected a gymnasium.Env"),
    "a vector": (LearnedReward, (SyncVectorEnv([Counter]), SA), "use eairl_jax.gymnasium.VectorLearnedReward"),
    "no vector": (VectorLearnedReward, (Counter(), SA), "expected a gymnasium.vector.VectorEnv"),
    "other sizes": (LearnedReward, (gymnasium.make("Pendulum-v1"), SA), "this environment has observations of length"),
    "discrete actions": (LearnedReward, (gymnasium.make("CartPole-v1"), SA), "the actions are Discrete"),
    "no reward": (LearnedReward, (Counter(), None), "the reward is None: expected a folder"),
    "a policy": (LearnedReward, (Counter(), POLICY), "holds no reward.json"),
    "a seed too many": (LearnedReward, (Counter(), SA, 2), "seed = 2: the run of this reward had 2 seeds"),
    "no absorbing state": (LearnedReward, (Counter(), SA, 0, 0.9), "has no value for the steps after"),
    "a discount factor of 1": (LearnedReward, (Counter(), ABSORBING, 0, 1.0), "gamma = 1.0: expected a discount"),
    "a reward as a policy": (Policy, (SA,), "holds no policy.json"),
}


@pytest.mark.parametrize(("make", "arguments", "message"), WRONG.values(), ids=WRONG)
def test_what_cannot_work_is_refused(make, arguments, message):
    with pytest.raises(InputError, match=message):
        make(*arguments)


def test_a_policy_predicts_as_those_of_stable_baselines():
    policy, obs = load_policy(POLICY), np.stack([counted(n) for n in range(5)])
    predict = Policy(POLICY, seed=1).predict
    action, state = predict(obs, deterministic=True)
    np.testing.assert_allclose(action, policy(obs, seed=1), atol=1e-5)
    assert state is None
    assert Counter.action_space.contains(predict(obs[0])[0])
    samples = [np.concatenate([p.predict(obs)[0] for _ in range(3)]) for p in (Policy(policy), Policy(policy))]
    np.testing.assert_array_equal(*samples)
    assert np.std(samples[0]) > 0.01
    assert not np.array_equal(samples[0], np.concatenate([Policy(policy, rng=1).predict(obs)[0] for _ in range(3)]))


def test_an_environment_with_a_reward_goes_to_another_process():
    env = pickle.loads(pickle.dumps(LearnedReward(Counter(), load_reward(SA))))
    env.reset(seed=0)
    assert np.isfinite(env.step(np.zeros(2, np.float32))[1])
