"""A training goes on where it was killed, and stops at a NaN."""

import numpy as np
import pytest

from eairl_jax import Checkpoints, InputError, Lanes, lanes
from eairl_jax.experiments.pipeline import policies, train
from eairl_jax.experiments.pipeline.run_folder import RunFolder


def test_a_killed_run_goes_on_bit_identically(finished, tmp_path, tiny, monkeypatch, imitate):
    class Killed(Checkpoints):
        """Dies before the second checkpoint: the second chunk's metrics are on disk, its state is not."""

        def save(self, iteration, state):
            if iteration == 4:
                raise KeyboardInterrupt
            super().save(iteration, state)

    monkeypatch.setattr(train, "Checkpoints", Killed)
    assert imitate(tmp_path / "killed", tiny) == 130
    assert Checkpoints(tmp_path / "killed" / "checkpoints").latest() == 2
    monkeypatch.setattr(train, "Checkpoints", Checkpoints)
    assert imitate(tmp_path / "killed", tiny) == 0
    for name in ("metrics.csv", "reward/reward.npz"):
        assert (tmp_path / "killed" / name).read_bytes() == (finished / name).read_bytes(), name
    states = [read_state(folder) for folder in (finished, tmp_path / "killed")]
    assert states[0].keys() == states[1].keys()
    for name, leaf in states[0].items():
        np.testing.assert_array_equal(leaf, states[1][name], err_msg=name)


def test_chunks_of_another_length_give_the_same_run(finished, tmp_path, tiny, imitate, metrics_lines):
    """Up to rounding: programs of other lengths may add in another order."""
    one_chunk = [setting.replace("snapshot_every=2", "snapshot_every=4") for setting in tiny]
    assert one_chunk != list(tiny)
    assert imitate(tmp_path / "one", one_chunk) == 0
    two_chunks, one_chunk = metrics_lines(finished), metrics_lines(tmp_path / "one")
    assert len(two_chunks) == len(one_chunk) == 8
    for a, b in zip(two_chunks, one_chunk, strict=True):
        values = [[float(value) for value in line.values()] for line in (a, b)]
        np.testing.assert_allclose(*values, rtol=1e-2, atol=1e-3)


def read_state(folder):
    """The last checkpoint's leaves."""
    import orbax.checkpoint as ocp

    manager = ocp.CheckpointManager((folder / "checkpoints").resolve())
    return manager.restore(4, args=ocp.args.StandardRestore())


def test_nan_stops_the_run_and_keeps_the_last_good_checkpoint(tmp_path, tiny, monkeypatch, capsys, imitate):
    run_lanes = Lanes.run

    def poisoned(self, state, length):
        state, metrics = run_lanes(self, state, length)
        if (tmp_path / "run" / "snapshots" / "000002").exists():
            metrics["value_loss"] = metrics["value_loss"].copy()
            metrics["value_loss"][1, 1] = np.nan
        lanes.refuse_not_finite(metrics)
        return state, metrics

    monkeypatch.setattr(Lanes, "run", poisoned)
    assert imitate(tmp_path / "run", tiny) == 1
    message = capsys.readouterr().err
    assert "value_loss" in message
    assert "iteration 4" in message
    assert "seed 1" in message
    assert Checkpoints(tmp_path / "run" / "checkpoints").latest() == 2


def test_a_disk_that_fails_is_reported_and_nothing_is_lost(tmp_path, tiny, monkeypatch, capsys, imitate):
    def full(*_arguments, **_more):
        raise OSError(28, "No space left on device", "metrics.csv")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "append_metrics", full)
        assert imitate(tmp_path / "run", tiny) == 2
    assert "No space left" in capsys.readouterr().err
    assert imitate(tmp_path / "run", tiny) == 0
    (tmp_path / "file").write_text("")
    assert imitate(tmp_path / "file" / "run", tiny) == 2
    assert "cannot write" in capsys.readouterr().err


def test_a_damaged_checkpoint_is_made_again(finished, tmp_path, tiny, capsys, imitate):
    """The newest checkpoint of a run is damaged: the run goes on from the one before, to the same bits."""
    wanted = {name: (finished / name).read_bytes() for name in ("metrics.csv", "reward/reward.npz")}
    for path in (finished / "checkpoints" / "4").rglob("manifest.ocdbt"):
        path.write_bytes(b"")
    with pytest.raises(InputError, match=r"last checkpoint .* \(4\) is damaged"):
        policies.load(finished)
    (finished / "summary.json").unlink()
    (finished / "reward" / "reward.npz").unlink()
    assert imitate(finished, tiny) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "the checkpoint of iteration 4 is damaged" in printed
    assert "going on from iteration 2" in printed
    assert {name: (finished / name).read_bytes() for name in wanted} == wanted


def test_every_phase_and_every_seed_draws_other_random_numbers():
    keys = [np.asarray(train.lane_keys(phase, seeds)) for phase in range(8) for seeds in ([0, 1, 2], [3])]
    assert len(np.unique(np.concatenate(keys), axis=0)) == 8 * 4
    # What the lanes beside a seed are does not matter.
    np.testing.assert_array_equal(train.lane_keys(3, [7, 1])[1], train.lane_keys(3, [1])[0])
