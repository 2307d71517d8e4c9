"""What was computed before a kill is there after it, bit for bit."""

import errno
import os
import shutil

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


def test_what_a_killed_process_was_about_to_remove_is_removed(tmp_path, equal_trees):
    """After the last save of a run no other save would remove it."""
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, TREE)
    shutil.copytree(tmp_path / "1", tmp_path / "kept")
    for iteration in (2, 3):
        checkpoints.save(iteration, TREE)
    (tmp_path / "kept").rename(tmp_path / "1")
    (tmp_path / "1" / "sha256.txt").unlink()
    again = Checkpoints(tmp_path)
    restored = again.restore_newest(lambda: jax.tree.map(np.zeros_like, TREE))
    assert restored.iteration == 3
    equal_trees(restored.state, TREE)
    assert {path.name for path in tmp_path.iterdir()} == {"2", "3"}
    again.save(4, TREE)
    assert {path.name for path in tmp_path.iterdir()} == {"3", "4"}


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


DAMAGE = {
    "missing": lambda path: path.unlink(),
    "emptied": lambda path: path.write_bytes(b""),
    "truncated": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "flipped": lambda path: path.write_bytes(bytes([path.read_bytes()[0] ^ 1]) + path.read_bytes()[1:]),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"x"),
}


@pytest.fixture(scope="module")
def two_checkpoints(tmp_path_factory):
    """The folder of the checkpoints 1 and 2 of a tree."""
    folder = tmp_path_factory.mktemp("two")
    for iteration in (1, 2):
        Checkpoints(folder).save(iteration, TREE | {"count": np.int32(iteration)})
    return folder


@pytest.mark.parametrize("damage", DAMAGE)
def test_any_damage_to_the_newest_is_found_and_the_one_before_is_read(tmp_path, two_checkpoints, equal_trees, damage):
    """Each file of the newest checkpoint, one after another."""
    names = [p.relative_to(two_checkpoints) for p in sorted((two_checkpoints / "2").rglob("*")) if p.is_file()]
    assert len(names) > 5
    for number, name in enumerate(names):
        copy = shutil.copytree(two_checkpoints, tmp_path / str(number))
        if not (copy / name).stat().st_size and damage != "longer":
            continue  # an empty file that orbax writes as a mark
        DAMAGE[damage](copy / name)
        checkpoints = Checkpoints(copy)
        is_digest = name.name == "sha256.txt" and damage == "missing"  # as in a version that wrote none
        restored = checkpoints.restore_newest(lambda: jax.tree.map(np.zeros_like, TREE | {"count": np.int32(0)}))
        assert (restored.iteration, restored.damaged) == ((2, []) if is_digest else (1, [2])), name
        equal_trees(restored.state, TREE | {"count": np.int32(restored.iteration)})
        checkpoints.save(3, TREE)  # and training can go on
        assert checkpoints.latest() == 3


def test_a_flip_at_any_place_is_found(tmp_path, two_checkpoints):
    """A hundred random bits of the newest checkpoint, one after another."""
    rng = np.random.default_rng(0)
    copy = shutil.copytree(two_checkpoints, tmp_path / "copy")
    files = [p for p in sorted((copy / "2").rglob("*")) if p.is_file() and p.stat().st_size]
    checkpoints = Checkpoints(copy)
    for _ in range(100):
        path = files[rng.integers(len(files))]
        whole = path.read_bytes()
        flipped = bytearray(whole)
        flipped[rng.integers(len(flipped))] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        assert not checkpoints.is_intact(2), path
        path.write_bytes(whole)
    assert checkpoints.is_intact(2)


def test_if_all_are_damaged_there_is_none(tmp_path, two_checkpoints):
    copy = shutil.copytree(two_checkpoints, tmp_path / "copy")
    for path in copy.rglob("manifest.ocdbt"):
        path.write_bytes(b"")
    restored = Checkpoints(copy).restore_newest(lambda: TREE)
    assert restored == (None, None, [2, 1])
    assert Checkpoints(copy).latest() is None


@pytest.mark.parametrize("how", ["before", "meanwhile"])
def test_a_full_disk_is_one_error_and_the_last_checkpoint_stays(tmp_path, monkeypatch, how):
    checkpoints, state = Checkpoints(tmp_path), {"net": np.ones((2, 3), np.float32)}
    checkpoints.save(1, state)

    def no_space(*_arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def failing_save(*_arguments, **_more):
        raise ValueError("RESOURCE_EXHAUSTED: Failed to write 448 bytes [os_error_code='28']")

    with monkeypatch.context() as patch:
        if how == "before":
            patch.setattr(os, "posix_fallocate", no_space, raising=False)
        else:
            patch.setattr(checkpoints._manager, "save", failing_save)
        with pytest.raises(OSError, match=r"No space left on device") as e:
            checkpoints.save(2, state)
    assert (e.value.errno, e.value.filename) == (errno.ENOSPC, str(tmp_path / "2" if how == "meanwhile" else tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["1"]
    restored = Checkpoints(tmp_path).restore_newest(lambda: state)
    assert (restored.iteration, restored.damaged) == (1, [])
