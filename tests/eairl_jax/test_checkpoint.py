"""What was computed before a kill is there after it, bit for bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eairl_jax import Checkpoints, HParams, InputError, Lanes

TREE = {
    "key": jax.random.PRNGKey(7),
    "nested": {"nan": np.float32(np.nan), "tiny": np.float32(1e-42), "count": np.int32(3), "none": None},
    "array": np.arange(6.0, dtype=np.float32).reshape(2, 3) / 7,
}


@pytest.mark.parametrize("dtype", [np.float32, np.int32, np.uint32, bool])
@pytest.mark.parametrize("shape", [(), (3,), (2, 1, 4), (0,), (2, 0)])
def test_a_round_trip_is_bit_equal(tmp_path, equal_trees, dtype, shape):
    tree = TREE | {"leaf": (np.random.default_rng(0).normal(size=shape) * 99).astype(dtype)}
    Checkpoints(tmp_path).save(4, tree)
    restored = Checkpoints(tmp_path).restore(4, jax.tree.map(np.zeros_like, tree))
    equal_trees(restored, tree)
    assert restored["leaf"].dtype == dtype
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(restored))


def test_training_goes_on_after_a_restart_as_if_it_had_never_stopped(tmp_path, built, demos, equal_trees):
    def lanes():
        rates = HParams(lambda_i=np.array([0.0, 0.5, 2.0]), policy_lr_final_fraction=0.1)
        return Lanes(built()[0], jax.random.split(jax.random.PRNGKey(3), 3), rates, demos)

    run = lanes()
    state, _ = run.run(run.init(), 2)
    Checkpoints(tmp_path).save(2, run.take(state))
    state, metrics = run.run(state, 2)
    # From here on as in a new process: nothing but the folder is left.
    again, checkpoints = lanes(), Checkpoints(tmp_path)
    restored = checkpoints.restore(checkpoints.latest(), again.blank())
    resumed, resumed_metrics = again.run(again.put(restored), 2)
    assert np.all(restored.agent.iteration == 2)
    equal_trees(again.take(resumed), run.take(state))
    equal_trees(resumed_metrics, metrics)


def test_the_newest_two_are_kept(tmp_path):
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.latest() is None
    for iteration in (1, 5, 10):
        checkpoints.save(iteration, {"iteration": np.int32(iteration)})
    assert Checkpoints(tmp_path).latest() == 10
    assert {path.name for path in tmp_path.iterdir() if path.name.isdigit()} == {"5", "10"}
    assert checkpoints.restore(5, {"iteration": np.int32(0)})["iteration"] == 5


def test_one_whose_writing_was_cut_off_is_not_there(tmp_path):
    Checkpoints(tmp_path).save(1, TREE)
    half = tmp_path / "2.orbax-checkpoint-tmp"  # what a kill leaves behind
    (half / "default").mkdir(parents=True)
    (half / "default" / "manifest").write_bytes(b"half")
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.latest() == 1
    checkpoints.save(2, TREE)
    assert checkpoints.latest() == 2
    assert not half.exists()


@pytest.mark.parametrize(
    ("like", "named"),
    [
        ({"a": jnp.zeros(3), "b": jnp.zeros((2, 3))}, "b"),
        ({"a": jnp.zeros(3), "b": jnp.zeros(4), "c": jnp.zeros(1)}, "c"),
        ({"a": jnp.zeros(3)}, "b"),
    ],
    ids=["other shape", "leaf not saved", "leaf not expected"],
)
def test_a_checkpoint_of_other_settings_is_refused_by_name(tmp_path, like, named):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, {"a": jnp.zeros(3), "b": jnp.zeros(4)})
    with pytest.raises(InputError, match=f"checkpoint 1 does not fit.*{named}"):
        checkpoints.restore(1, like)
