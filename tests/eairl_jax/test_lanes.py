"""Lanes against a Python loop over single runs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import Algorithm, Diverged, HParams, InputError, Lanes, scan

SWEEP = HParams(
    lambda_i=np.array([0.0, 0.5, 2.0]), policy_lr=np.array([1e-3, 5e-3, 1e-4]), phi_lr=np.array([0.0, 0.01, 0.1])
)


def walk(key, hparams):
    return {"noise": jax.random.normal(key), "total": jnp.zeros((2,)), "beta": hparams.beta * 1.0}


def stride(state, hparams, data):
    total = state["total"] + hparams.lambda_i * state["noise"] + data["gain"] * data["vector"]
    return state | {"total": total}, {"total": total}


WALK = Algorithm(walk, stride, lambda state, obs, key: obs)
DATA = {"gain": np.float32(2.0), "vector": np.array([1.0, -1.0], np.float32)}


def keys(count):
    return jax.random.split(jax.random.PRNGKey(3), count)


def test_a_sweep_of_eairl_equals_a_loop_over_its_lanes(built, demos):
    """Three lanes, which do not divide two devices."""
    algorithm, init, step = built()
    lanes = Lanes(algorithm, keys(3), SWEEP, demos)
    state, metrics = lanes.run(lanes.init(), 2)
    state = lanes.take(state)
    assert metrics["policy_reward"].shape == (3, 2)
    jax.tree.map(lambda x, y: np.testing.assert_array_equal(x, np.zeros_like(y), strict=True), lanes.blank(), state)
    for lane in range(3):
        hparams = jax.tree.map(lambda x, lane=lane: float(x[lane] if np.ndim(x) else x), SWEEP)
        alone, by_hand = init(keys(3)[lane], hparams), []
        for _ in range(2):
            alone, metric = step(alone, hparams, demos)
            by_hand.append(metric)
        for name, value in metrics.items():
            np.testing.assert_allclose(value[lane], [m[name] for m in by_hand], rtol=1e-3, atol=1e-4, err_msg=name)
        jax.tree.map(lambda a, b, lane=lane: np.testing.assert_allclose(a[lane], b, rtol=1e-3, atol=1e-4), state, alone)
    weights = state.agent.policy.nets.params["actor"]["params"]["MLP_0"]["Dense_1"]["kernel"]
    assert np.abs(weights[0] - weights[1]).max() > 1e-4


@pytest.mark.parametrize("per_lane", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_lanes_have_their_own_key_settings_and_data(count, per_lane):
    lambda_i = np.arange(1.0, count + 1)
    data = jax.tree.map(lambda x: np.stack([x * (i + 1) for i in range(count)]), DATA) if per_lane else DATA
    lanes = Lanes(WALK, keys(count), HParams(lambda_i=lambda_i, beta=0.5), data, data_per_lane=per_lane)
    state, metrics = lanes.run(lanes.init(), 4)
    state = lanes.take(state)
    noise = np.array([jax.random.normal(key) for key in keys(count)])
    scale = lambda_i**2 if per_lane else np.ones(count)  # gain and vector were both scaled
    stride = (lambda_i * noise)[:, None] + scale[:, None] * np.array([2.0, -2.0])
    np.testing.assert_allclose(metrics["total"], np.arange(1, 5)[None, :, None] * stride[:, None], rtol=1e-5)
    np.testing.assert_allclose(state["total"], 4 * stride, rtol=1e-5)
    np.testing.assert_allclose(state["beta"], np.full(count, 0.5))


@pytest.mark.parametrize("count", [1, 3])
def test_what_was_taken_can_be_put_back(count):
    lanes = Lanes(WALK, keys(count), HParams(), DATA)
    state, _ = lanes.run(lanes.init(), 1)
    taken = lanes.take(state)
    assert all(isinstance(leaf, np.ndarray) and len(leaf) == count for leaf in jax.tree.leaves(taken))
    on, _ = lanes.run(lanes.put(taken), 2)
    straight, _ = lanes.run(lanes.init(), 3)
    np.testing.assert_allclose(lanes.take(on)["total"], lanes.take(straight)["total"], rtol=1e-6)


def test_a_chunk_is_compiled_once():
    lanes = Lanes(WALK, keys(2), HParams(), DATA)
    state = lanes.init()
    assert lanes.compile(state, 3) > 0
    assert lanes.compile(state, 3) == 0
    assert lanes.compile(state, 2) > 0


def test_scan_equals_a_loop():
    hparams = HParams(lambda_i=0.25)
    state, metrics = scan(WALK, walk(jax.random.PRNGKey(0), hparams), hparams, DATA, 3)
    by_hand = walk(jax.random.PRNGKey(0), hparams)
    for i in range(3):
        by_hand, metric = stride(by_hand, hparams, DATA)
        np.testing.assert_allclose(metrics["total"][i], metric["total"], rtol=1e-6)
    np.testing.assert_allclose(state["total"], by_hand["total"], rtol=1e-6)


@pytest.mark.parametrize(
    "one_key",
    [
        lambda: jax.random.PRNGKey(0),
        lambda: jax.random.key(0),
        lambda: jnp.zeros((2, 3), jnp.uint32),
        lambda: jnp.zeros((3, 2), jnp.float32),
        lambda: jnp.zeros((0, 2), jnp.uint32),
    ],
    ids=["old-style key", "new-style key", "another size", "floats", "no lane"],
)
def test_keys_that_are_not_one_for_each_lane_are_refused(one_key):
    with pytest.raises(InputError, match=r"expected one random key for each lane.*jax.random.split"):
        Lanes(WALK, one_key(), HParams(), DATA)


def test_new_style_keys_train_like_old_style_keys(equal_trees):
    states = [
        Lanes(WALK, jax.random.split(key, 3), HParams(), DATA).init()
        for key in (jax.random.key(3), jax.random.PRNGKey(3))
    ]
    equal_trees(*states)


def test_hyperparameters_that_no_run_can_have_are_refused():
    for hparams, message in ((HParams(gamma=1.5), "gamma = 1.5"), (HParams(policy_lr=np.array([0.1, -1.0])), "= -1")):
        with pytest.raises(InputError, match=message):
            Lanes(WALK, keys(2), hparams, DATA)


def test_a_training_that_diverges_is_stopped_and_named():
    """From Python too: a NaN must not look like a score."""

    def step(state, hparams, data):
        bad = (state == 2) & (hparams.gamma > 0.5)
        return state + 1, {"loss": jnp.where(bad, jnp.nan, 0.0), "true_return": jnp.full((), jnp.nan)}

    algorithm = Algorithm(lambda key, hparams: jnp.zeros(()), step, lambda *_: None)
    lanes = Lanes(algorithm, jax.random.split(jax.random.PRNGKey(0), 2), HParams(gamma=np.array([0.1, 0.9])))
    state, _ = lanes.run(lanes.init(), 2)
    with pytest.raises(Diverged, match="loss became nan in lane 1 at iteration 1 of 2") as e:
        lanes.run(state, 2)
    assert (e.value.metric, e.value.lane, e.value.iteration) == ("loss", 1, 1)


def test_a_user_can_hunt_a_nan(built, demos):
    """Nothing in an iteration is NaN by design, so `jax_debug_nans` finds the NaN that is a fault."""
    algorithm, init, _ = built()
    with jax.debug_nans(True):
        state = init(jax.random.PRNGKey(0), HParams())
        _, metrics = jax.jit(algorithm.step)(state, HParams(), demos)
        with pytest.raises(FloatingPointError):
            jax.jit(algorithm.step)(state, HParams(policy_lr=np.nan), demos)
    assert all(np.isfinite(value) for name, value in metrics.items() if name != "true_return")


REFUSED = {
    "no algorithm": (lambda: Lanes("eairl", keys(2), HParams(), DATA), "algorithm is 'eairl': expected an Algorithm"),
    "no keys": (lambda: Lanes(WALK, 3, HParams(), DATA), "keys are 3: expected one random key for each lane"),
    "no hparams": (
        lambda: Lanes(WALK, keys(2), {"gamma": 1}, DATA),
        "hparams are an object with gamma: expected HParams",
    ),
    "another number of lanes": (
        lambda: Lanes(WALK, keys(2), SWEEP, DATA),
        r"hparams\.policy_lr has shape \(3,\): .* 2",
    ),
    "data of other lanes": (
        lambda: Lanes(WALK, keys(2), HParams(), {"gain": np.ones(3)}, data_per_lane=True),
        r"data\['gain'\] has shape \(3,\): expected one row for each of the 2 lanes",
    ),
    "no length": (
        lambda: Lanes(WALK, keys(2), HParams(), DATA).run({}, 0),
        "length = 0: expected a whole number from 1",
    ),
    "half a length": (lambda: scan(WALK, {}, HParams(), DATA, 1.5), "length = 1.5: expected a whole number"),
    "scan": (lambda: scan(WALK, {}, HParams(gamma=2.0), DATA, 1), "gamma = 2"),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_arguments_that_do_not_fit_are_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_length_may_be_a_number_of_any_library():
    lanes = Lanes(WALK, keys(1), HParams(), DATA)
    assert lanes.run(lanes.init(), np.int64(2))[1]["total"].shape[:2] == (1, 2)


def test_lanes_of_one_algorithm_share_what_is_compiled(caplog):
    lanes = Lanes(WALK, keys(3), HParams(lambda_i=1.0), DATA)
    assert lanes.compile(lanes.init(), 2) > 0
    other = Lanes(WALK, keys(3), HParams(lambda_i=np.array([1.0, 2.0, 0.0])), DATA)
    with jax.log_compiles():
        other.compile(other.init(), 2)
    assert not any("walk" in each or "chunk" in each for each in caplog.messages)
    with jax.log_compiles():
        other.compile(other.init(), 5)
    assert any("Compiling jit(chunk)" in each for each in caplog.messages)
    (ones, _), (different, _) = lanes.run(lanes.init(), 2), other.run(other.init(), 2)
    noise, total = other.take(different["noise"]), other.take(different["total"])
    np.testing.assert_array_equal(total[0], lanes.take(ones["total"])[0])
    np.testing.assert_allclose(total[1], 2 * (2.0 * noise[1] + [2.0, -2.0]), rtol=1e-6)
