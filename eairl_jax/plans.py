"""Plans: sequences of actions from which policies begin to train in different places of the state space.

A policy explores by the noise of its actions. So it visits the states near its way, and it settles for the best of
these states. The states that a reward pays most for may lie elsewhere, for example behind a wall.

Actions that are held for a while go far, and a simulator runs thousands of such plans in less time than one training
takes. The plans are grouped by the place to which they lead (k-means). In each place the plan that the reward pays most
for is cloned: a policy learns to act as the plan acted. The reward of the plans does not decide which place is the
best, since a plan cannot hold a position, and a policy can. The training of the clones decides between the places.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from eairl_jax import agent, horizon, normalize, train_state
from eairl_jax.config import Config
from eairl_jax.policy_optimizers import make_optimizer
from eairl_jax.rl import Reward, RLState, make_rl, true_reward
from eairl_jax.rollout import action_limit
from eairl_jax.types import Algorithm, Env, HParams, Key, PolicyOptimizer, PyTree, Transition

# raw transitions [T, N, ...] -> reward [T, N]
BatchReward = Callable[[Transition], jax.Array]

MAX_ACTIONS = 6
"""The most different actions in one plan."""
KMEANS_ROUNDS = 20
"""Times that k-means moves its centres."""


@dataclass(frozen=True)
class Search:
    """How many plans are tried, and how a chosen plan is cloned."""

    plans: int = 4096
    """Plans that are simulated."""
    repeats: int = 20
    """Episodes of a chosen plan from which the policy learns; each episode has other noise."""
    noise: float = 0.3
    """Standard deviation of the noise on the actions of these episodes, as a share of `action_limit`."""
    updates: int = 600
    """Adam steps of the cloning."""
    batch: int = 256
    """Samples of each Adam step."""
    lr: float = 3e-3
    """Learning rate of the first Adam step. The rate falls linearly to 0."""


def draw(key: Key, count: int, length: int, action_size: int, limit: float) -> jax.Array:
    """Draws random plans `[count, length, act]`.

    A plan has 2 to `MAX_ACTIONS` random actions, and each action is held until the next one begins. The size of the
    actions is random too: a plan of small actions, which hardly moves, is thus no rare event. Some plans change their
    actions early and then hold the last action for long.

    Args:
      limit: the largest magnitude of an action.
    """
    number_key, action_key, size_key, moment_key, haste_key = jax.random.split(key, 5)
    number = jax.random.randint(number_key, (count, 1), 2, MAX_ACTIONS + 1)
    action = jax.random.uniform(action_key, (count, MAX_ACTIONS, action_size), minval=-limit, maxval=limit)
    action = action * jax.random.uniform(size_key, (count, MAX_ACTIONS, 1))
    moment = jax.random.uniform(moment_key, (count, MAX_ACTIONS - 1)) * jax.random.uniform(haste_key, (count, 1))
    moment = jnp.where(jnp.arange(MAX_ACTIONS - 1) < number - 1, moment, 1.0)  # at moment 1 the plan is over
    now = (jnp.arange(length) / length)[None, :, None]
    return jnp.take_along_axis(action, (moment[:, None, :] <= now).sum(axis=-1)[..., None], axis=1)


def simulate(key: Key, env: Env, plans: jax.Array, noise: float = 0.0) -> Transition:
    """Executes plans `[N, T, act]` from fresh starts.

    Args:
      noise: standard deviation of Gaussian noise on the executed actions, in units of the actions.

    Returns:
      Raw transitions `[T, N, ...]`. `action` is the action of the plan, without the noise. `truncated` is 1 at every
      step after the end of an episode: these steps do not count. `log_prob` is 0.
    """
    reset_key, noise_key = jax.random.split(key)
    limit = action_limit(env)
    start = jax.vmap(env.reset)(jax.random.split(reset_key, plans.shape[0]))
    planned = jnp.swapaxes(plans, 0, 1)
    executed = jnp.clip(planned + noise * jax.random.normal(noise_key, planned.shape), -limit, limit)

    def step(carry, actions):
        (state, ended), (planned_t, executed_t) = carry, actions
        after = jax.vmap(env.step)(state, executed_t)
        done = after.done.astype(jnp.float32)
        log_prob = jnp.zeros_like(after.reward)
        transition = Transition(state.obs, planned_t, log_prob, after.obs, after.reward, done * (1.0 - ended), ended)
        return (after, jnp.maximum(ended, done)), transition

    _, transitions = jax.lax.scan(step, (start, jnp.zeros(plans.shape[0])), (planned, executed))
    return transitions


def scores(reward: BatchReward, transitions: Transition) -> jax.Array:
    """What the reward pays for each plan `[N]`: the sum up to the end of the episode, divided by the plan's length."""
    return jnp.where(transitions.truncated > 0, 0.0, reward(transitions)).mean(axis=0)


def places(transitions: Transition) -> jax.Array:
    """Where plans lead, `[N, obs]`: the mean observation of the second half, in standard deviations over all plans."""
    second_half = transitions.next_obs[transitions.next_obs.shape[0] // 2 :].mean(axis=0)
    return second_half / (second_half.std(axis=0) + 1e-6)


def clusters(points: jax.Array, count: int) -> jax.Array:
    """Groups points `[N, d]` by k-means (Lloyd 1982).

    The first centre is the point that is farthest from the mean. Each further centre is the point that is farthest from
    all centres before it (Gonzalez 1985), so that small groups far away get a centre too.

    Returns:
      `[N]` the number of each point's group, from 0 to `count - 1`.
    """

    def squared_distance(centre):
        return ((points - centre) ** 2).sum(axis=-1)

    def add_farthest(nearest, _):
        centre = points[jnp.argmax(nearest)]
        return jnp.minimum(nearest, squared_distance(centre)), centre

    def group_of(centres):
        return jax.vmap(squared_distance)(centres).argmin(axis=0)

    def move(centres, _):
        member = jax.nn.one_hot(group_of(centres), count)
        size = member.sum(axis=0)[:, None]
        return jnp.where(size > 0, member.T @ points / jnp.maximum(size, 1.0), centres), None

    _, centres = jax.lax.scan(add_farthest, squared_distance(points.mean(axis=0)), length=count)
    centres, _ = jax.lax.scan(move, centres, length=KMEANS_ROUNDS)
    return group_of(centres)


def choose(
    key: Key, env: Env, reward: BatchReward, count: int, length: int, search: Search
) -> tuple[jax.Array, jax.Array]:
    """Draws random plans and takes, in each of `count` places, the plan that the reward pays most for.

    Args:
      length: steps of a plan.

    Returns:
      The plans `[count, length, act]`, and their scores `[count]`.
    """
    draw_key, simulate_key = jax.random.split(key)
    plans = draw(draw_key, search.plans, length, env.action_size, action_limit(env))
    transitions = simulate(simulate_key, env, plans)
    paid, place = scores(reward, transitions), clusters(places(transitions), count)
    best = jnp.where(place == jnp.arange(count)[:, None], paid, -jnp.inf).argmax(axis=1)
    return plans[best], paid[best]


def clone(
    key: Key, env: Env, optimizer: PolicyOptimizer, before: agent.Agent, plan: jax.Array, search: Search
) -> agent.Agent:
    """A policy that acts as a plan `[T, act]` acts, in the states to which the plan and some noise lead.

    See `fit`.
    """
    noise_key, fit_key = jax.random.split(key)
    noise = search.noise * action_limit(env)
    raw = simulate(noise_key, env, jnp.broadcast_to(plan, (search.repeats, *plan.shape)), noise)
    return fit(fit_key, optimizer, before, (raw.obs, raw.action, 1.0 - raw.truncated), search)


def fit(
    key: Key,
    optimizer: PolicyOptimizer,
    before: agent.Agent,
    samples: tuple[jax.Array, jax.Array, jax.Array],
    search: Search,
) -> agent.Agent:
    """A policy whose mean action is fitted to given actions by least squares.

    The policy's standard deviation and its value function stay those of the agent `before`.

    Args:
      samples: raw observations `[T, N, obs]`, actions `[T, N, act]`, and the weight of each sample `[T, N]`.
    """
    policy, (obs, action, weight) = before.policy, samples

    def loss(params: PyTree, minibatch):
        obs, action, weight = minibatch
        fitted = dataclasses.replace(policy, nets=dataclasses.replace(policy.nets, params=params))
        pi = optimizer.distribution(fitted, obs)
        return (weight * ((pi.mean - action) ** 2).sum(axis=-1)).mean()

    samples = normalize.normalize(before.obs_stats, obs), action, weight
    rates = search.lr * (1.0 - jnp.arange(search.updates) / search.updates)

    def update(fitted, minibatch_and_rate):
        minibatch, rate = minibatch_and_rate
        return train_state.adam_step(fitted, jax.grad(loss)(fitted.params, minibatch), rate), None

    minibatches = train_state.draw_minibatches(key, samples, 2, search.updates, search.batch)
    fitted, _ = jax.lax.scan(update, policy.nets, (minibatches, rates))
    # The training of the clone begins with moments of 0.
    return dataclasses.replace(before, policy=dataclasses.replace(policy, nets=train_state.init(fitted.params)))


def make_planner(env: Env, config: Config, count: int, search: Search, reward: Reward = true_reward) -> Algorithm:
    """An algorithm that makes, in one step, `count` policies which begin in different places.

    Its state is that of `count` policies of `make_rl(env, config, reward)`, every leaf `[count, ...]`. Before the step
    they are fresh policies, after the step they are clones of plans. The metric `score` is the best plan's score.

    Args:
      reward: `(data, raw transitions [T, N, ...]) -> reward [T, N]`; `data` is the `data` of `step`.

    Raises:
      InputError: if the environment's observations are not flat vectors.
    """
    config = horizon.resolved(env, config, "variable")
    policies, env = make_rl(env, config, reward), horizon.learning_env(env, config, whole=True)
    optimizer = make_optimizer(env, config)

    def init(key: Key, hparams: HParams) -> RLState:
        return jax.vmap(policies.init, in_axes=(0, None))(jax.random.split(key, count), hparams)

    def step(state: RLState, hparams: HParams, data: PyTree):
        del hparams
        choose_key, clone_key = jax.random.split(jax.random.fold_in(state.key[0], count))
        plans, paid = choose(choose_key, env, lambda raw: reward(data, raw), count, config.episode_length, search)
        clones = jax.vmap(lambda key, before, plan: clone(key, env, optimizer, before, plan, search))(
            jax.random.split(clone_key, count), state.agent, plans
        )
        return dataclasses.replace(state, agent=clones), {"score": paid.max()}

    def act(state: RLState, obs, key=None):
        return jax.vmap(policies.act, in_axes=(0, 0, None))(state, obs, key)

    return Algorithm(init, step, act)
