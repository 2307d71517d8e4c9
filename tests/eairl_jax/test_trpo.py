"""TRPO's parts against dense linear algebra, its update against what the trust region promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from eairl_jax import HParams, Lanes, demonstrations, envs, evaluate, make_rl
from eairl_jax.actor_critic import ActorCritic
from eairl_jax.trpo import conjugate_gradient, fisher_vector_product, line_search, trpo
from eairl_jax.types import no_penalty

HPARAMS = HParams(entropy_weight=0.0, policy_lr=1e-2)
STEPS = 10  # of the line search


@pytest.fixture
def trained(tiny, transitions):
    """`(optimizer, fresh policy, draw, update)`; `draw(policy, seed)` gives transitions whose actions it drew."""

    def make(penalty=no_penalty, hparams=HPARAMS, **changes):
        optimizer = trpo(4, 2, tiny(**changes))

        def draw(policy, seed=0):
            batch = jax.tree.map(jnp.asarray, transitions(seed=seed))
            pi = optimizer.distribution(policy, batch.obs)
            action = pi.sample(batch.action)
            return batch._replace(action=action, log_prob=pi.log_prob(action))

        @jax.jit
        def update(policy, batch, data=(), seed=1, hparams=hparams):
            return optimizer.update(jax.random.PRNGKey(seed), policy, batch, penalty, data, hparams)

        return optimizer, optimizer.init(jax.random.PRNGKey(0)), draw, update

    return make


@pytest.mark.parametrize("state_dependent_std", [False, True])
def test_the_fisher_vector_product_is_the_kls_hessian(tiny, transitions, state_dependent_std):
    nets = ActorCritic.build(2, tiny(policy_hidden=(5,), state_dependent_std=state_dependent_std))
    theta, unravel = ravel_pytree(nets.init(jax.random.PRNGKey(0), 4).nets.params["actor"])
    theta += 0.3 * jax.random.normal(jax.random.PRNGKey(1), theta.shape)  # not the flat start
    obs = jnp.asarray(transitions().obs.reshape(-1, 4))

    def pi(theta):
        return nets.pi(unravel(theta), jnp.zeros(()), obs)

    old = pi(theta)
    hessian = jax.jit(jax.hessian(lambda x: old.kl(pi(x)).mean()))(theta)
    product = jax.jit(lambda v: fisher_vector_product(pi, theta, v))
    for seed in range(3):
        v = jax.random.normal(jax.random.PRNGKey(seed), theta.shape)
        expected = hessian @ v
        assert np.abs(expected).max() > 0.1
        np.testing.assert_allclose(product(v), expected, rtol=1e-4, atol=1e-4)
        assert v @ product(v) >= 0


@pytest.mark.parametrize("size, steps", [(1, 1), (6, 6), (6, 40), (12, 12)])
def test_conjugate_gradient_solves(size, steps):
    """Also after it is done: steps that are left change nothing."""
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size))
    matrix, b = (root @ root.T + size * np.eye(size)).astype(np.float32), rng.normal(size=size).astype(np.float32)
    solved = jax.jit(lambda b: conjugate_gradient(lambda v: matrix @ v, b, steps))(b)
    np.testing.assert_allclose(solved, np.linalg.solve(matrix, b), rtol=1e-3, atol=1e-5)


def test_conjugate_gradient_of_nothing_is_nothing():
    np.testing.assert_array_equal(conjugate_gradient(lambda v: 2 * v, jnp.zeros(3), 5), np.zeros(3))


# A parabola `(x - best)^2` from 0 by a step of 1, whose KL is x^2: `best, limit, fraction`.
SEARCHES = {
    "the whole step": (1.0, 1.0, 1.0),
    "too far to improve": (0.3, 1.0, 0.5),
    "too large a KL": (1.0, 0.1, 0.25),
    "both": (0.05, 0.02, 0.0625),
    "KL just at its limit": (1.0, 0.25, 0.5),
    "uphill": (-1.0, 1.0, 0.0),
    "already there": (0.0, 1.0, 0.0),
    "no KL is small enough": (1.0, 1e-9, 0.0),
    "NaN": (np.nan, 1.0, 0.0),
    "NaN limit": (1.0, np.nan, 0.0),
}


def search(best, limit, step=1.0):
    """Minimises the parabola from 0 in both coordinates' sum; `(reached, fraction)`."""

    def objective(x):
        return ((x[0] - best) ** 2, x[0] ** 2)

    return line_search(objective, jnp.array([0.0, 7.0]), jnp.array([step, 0.0]), limit, STEPS)


@pytest.mark.parametrize("best, limit, fraction", SEARCHES.values(), ids=SEARCHES)
def test_the_line_search_takes_the_longest_step_that_will_do(best, limit, fraction):
    reached, taken = search(best, limit)
    assert taken == fraction
    np.testing.assert_array_equal(reached, [fraction, 7.0])


@pytest.mark.parametrize("step", [np.nan, np.inf])
def test_a_step_that_is_no_number_is_not_taken(step):
    reached, taken = search(1.0, 1.0, step)
    assert taken == 0
    np.testing.assert_array_equal(reached, [0.0, 7.0])


def test_the_line_search_skips_a_step_that_is_nan_alone():
    def objective(x):
        return jnp.where(x[0] > 0.6, jnp.nan, -x[0]), jnp.zeros(())

    assert line_search(objective, jnp.zeros(1), jnp.ones(1), 1.0, STEPS)[1] == 0.5


def test_the_line_search_vmaps():
    best, limit, fraction = np.array(list(SEARCHES.values()), np.float32).T
    reached, taken = jax.jit(jax.vmap(search))(best, limit)
    np.testing.assert_array_equal(taken, fraction)
    np.testing.assert_array_equal(reached, np.stack([fraction, np.full_like(fraction, 7.0)], axis=1))


def surrogate(pi, batch, advantage):
    """-E[ratio A], from its definition."""
    return -np.mean(np.exp(pi.log_prob(batch.action) - batch.log_prob) * advantage)


@pytest.mark.parametrize("state_dependent_std", [False, True])
def test_an_update_improves_and_stays_in_its_trust_region(trained, tiny, state_dependent_std):
    changes = {"state_dependent_std": state_dependent_std}
    optimizer, start, draw, update = trained(**changes)
    prepare = jax.jit(lambda *x: ActorCritic.build(2, tiny(**changes)).prepare(*x, (), HPARAMS)[1].advantage)
    for limit in (1e-3, 0.01, 0.5):
        policy, fractions, kls = start, [], []
        for seed in range(6):
            batch = draw(policy, seed)
            advantage = np.asarray(prepare(policy, batch))
            old = optimizer.distribution(policy, batch.obs)
            policy, metrics = update(policy, batch, seed=seed, hparams=HPARAMS.replace(kl_limit=limit))
            new = optimizer.distribution(policy, batch.obs)
            # KL(old || new) of two Gaussians, by hand.
            ratio, moved = np.exp(old.log_std - new.log_std), (old.mean - new.mean) / np.exp(new.log_std)
            kl = (0.5 * (ratio**2 + moved**2 - 1) - np.log(ratio)).sum(-1).mean()
            assert kl <= limit * 1.001 + 1e-6
            np.testing.assert_allclose(metrics["kl"], kl, rtol=1e-2, atol=1e-6)
            before, after = surrogate(old, batch, advantage), surrogate(new, batch, advantage)
            np.testing.assert_allclose(metrics["policy_loss"], after, atol=1e-5)
            assert (after < before) if metrics["step_fraction"] > 0 else (after == before)
            fractions.append(float(metrics["step_fraction"]))
            kls.append(kl)
        assert sum(f > 0 for f in fractions) >= 5
        assert max(kls) > 0.3 * limit, "the trust region is used"


def test_the_step_is_the_natural_gradient(trained, tiny):
    """The direction is that of a dense solve, its length that of the quadratic model of the KL."""
    config = tiny(policy_hidden=(3,), cg_iterations=60)
    hparams = HPARAMS.replace(kl_limit=1e-4)
    _, policy, draw, update = trained(hparams=hparams, policy_hidden=(3,), cg_iterations=60)
    batch = draw(policy)
    nets = ActorCritic.build(2, config)
    advantage = nets.prepare(policy, batch, (), hparams)[1].advantage
    theta, unravel = ravel_pytree(policy.nets.params["actor"])

    def pi(theta):
        return nets.pi(unravel(theta), jnp.zeros(()), batch.obs)

    old = pi(theta)
    gradient = jax.grad(lambda x: -(jnp.exp(pi(x).log_prob(batch.action) - batch.log_prob) * advantage).mean())(theta)
    fisher = jax.jit(jax.hessian(lambda x: old.kl(pi(x)).mean()))(theta)
    damped = np.asarray(fisher, np.float64) + hparams.cg_damping * np.eye(theta.size)
    direction = np.linalg.solve(damped, -np.asarray(gradient, np.float64))
    full = np.sqrt(2 * hparams.kl_limit / (direction @ damped @ direction)) * direction
    after, metrics = update(policy, batch)
    assert metrics["step_fraction"] == 1
    moved = ravel_pytree(after.nets.params["actor"])[0] - theta
    np.testing.assert_allclose(moved, full, atol=0.02 * np.abs(full).max())


def test_the_value_function_is_fitted(trained):
    """To rewards that depend on the state alone, every step an episode: V(s) is the scaled reward."""
    _, policy, draw, update = trained(ppo_epochs=8, value_hidden=(32,))
    batch = draw(policy)
    ones = jnp.ones_like(batch.reward)
    batch = batch._replace(reward=batch.obs[..., 0] - 1.0, terminated=ones, truncated=0 * ones)
    losses, explained = [], []
    for seed in range(20):
        policy, metrics = update(policy, batch, seed=seed)
        losses.append(metrics["value_loss"])
        explained.append(metrics["explained_variance"])
    assert losses[-1] < 0.05 * losses[0]
    assert explained[0] < 0.5
    assert explained[-1] > 0.9


def test_the_value_functions_adam_leaves_the_actor_alone(trained, equal_trees):
    """However far the critic goes: the actor moves by the natural gradient, and not at all where there is none."""
    _, policy, draw, update = trained()
    batch = draw(policy)
    slow, fast = (update(policy, batch, hparams=HPARAMS.replace(policy_lr=lr))[0].nets for lr in (0.0, 0.1))
    equal_trees(slow.params["actor"], fast.params["actor"])
    equal_trees(slow.params["critic"], policy.nets.params["critic"])
    still = policy
    for seed in range(3):
        still, metrics = update(still, batch, seed=seed, hparams=HPARAMS.replace(kl_limit=0.0))
        assert metrics["step_fraction"] == metrics["kl"] == 0
    for nets in (fast, still.nets):
        assert not any(np.any(leaf) for leaf in jax.tree.leaves(nets.adam.mu["actor"]))
        changed = jax.tree.map(lambda a, b: np.abs(a - b).max(), nets.params["critic"], policy.nets.params["critic"])
        assert max(jax.tree.leaves(changed)) > 1e-3
    equal_trees(still.nets.params["actor"], policy.nets.params["actor"])


def test_any_penalty_reaches_the_policy(trained):
    """One on pi itself, by data of each transition: the mean goes there, the trust region holds all the same."""

    def penalty(pi, _log_prob, wanted):
        return 100.0 * (pi.mean[..., 0] - wanted) ** 2

    optimizer, policy, draw, update = trained(penalty, HPARAMS.replace(kl_limit=0.05), policy_hidden=(16,))
    errors = []
    for seed in range(25):
        batch = draw(policy, seed)
        wanted = 0.5 + 0.3 * batch.obs[..., 1]
        errors.append(float(np.mean((optimizer.distribution(policy, batch.obs).mean[..., 0] - wanted) ** 2)))
        policy, metrics = update(policy, batch, wanted, seed=seed)
        assert metrics["kl"] <= 0.05 * 1.001
    assert errors[0] > 0.2
    assert np.mean(errors[-3:]) < 0.1 * errors[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_entropy_bonus_reaches_the_policy(trained, sign):
    _, policy, draw, update = trained(hparams=HPARAMS.replace(entropy_weight=100.0 * sign))
    after, metrics = update(policy, draw(policy))
    assert metrics["step_fraction"] > 0
    assert (sign * after.nets.params["actor"]["params"]["raw_log_std"] > 1e-3).all()


def test_the_std_follows_its_schedule(trained):
    optimizer, policy, draw, update = trained(hparams=HPARAMS.replace(kl_limit=1e-6, std_final_fraction=0.5))
    batch = draw(policy)
    after, metrics = update(policy, batch)
    assert metrics["kl"] <= 1.1e-6, "the schedule is no step of the policy's"
    before, now = (optimizer.distribution(p, batch.obs).log_std for p in (policy, after))
    np.testing.assert_allclose(now - before, np.log(0.5), atol=0.01)


@pytest.mark.slow
def test_trpo_makes_as_good_a_pendulum_expert_as_ppo():
    """The best of two seeds, by the recipe of `eairl expert pendulum --optimizer trpo`."""
    from eairl_jax.experiments.pipeline.places import shipped_demonstrations
    from eairl_jax.experiments.settings import recipe

    with_ppo = demonstrations.provenance(shipped_demonstrations("pendulum"))["expert_return"]
    env = envs.make("pendulum")
    own = recipe("pendulum", env, "expert", {"optimizer": "trpo"})
    algorithm = make_rl(env, own.config)
    lanes = Lanes(algorithm, jax.random.split(jax.random.PRNGKey(0), 2), own.hparams)
    state, _ = lanes.run(lanes.init(), own.config.iterations)

    def score(state):
        return evaluate(jax.random.PRNGKey(7), env, lambda *x: algorithm.act(state, *x), 200, 200)[0].mean()

    returns = jax.jit(jax.vmap(score))(state)
    assert np.max(returns) > with_ppo - max(30.0, 0.1 * abs(with_ppo)), returns
