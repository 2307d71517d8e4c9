"""How lanes are split over processes. `test_processes` and `test_train` run the blocks themselves."""

import jax
import numpy as np
import pytest

from eairl_jax import InputError
from eairl_jax.blocks import OwnLanes, _exported, share

SHARES = {
    "a lane a device": ((4, [2, 2]), ([2, 2], 1)),
    "five lanes on two devices": ((5, [1, 1]), ([1, 1], 3)),
    "different hosts": ((8, [1, 3]), ([1, 3], 2)),
    "more devices than lanes": ((5, [64, 64]), ([3, 2], 1)),
    "a small host is full first": ((5, [1, 64]), ([1, 4], 1)),
    "one process": ((3, [2]), ([2], 2)),
}


@pytest.mark.parametrize(("given", "expected"), SHARES.values(), ids=SHARES)
def test_lanes_are_shared_out_evenly(given, expected):
    assert share(*given) == expected


def test_no_process_is_left_without_a_lane():
    with pytest.raises(
        InputError, match=r"3 processes are too many for 2 lanes .*: start at most 2, or train more seeds"
    ):
        share(2, [8, 8, 8])


def test_a_block_has_no_other_calls():
    keys = np.asarray(jax.random.split(jax.random.PRNGKey(0), 2))
    own = OwnLanes([keys], hparams=0, devices=2, data_per_lane=False)
    with pytest.raises(InputError, match="a block cannot '__init__'"):
        own.call("__init__", [], {})


def test_a_program_that_asks_the_host_is_refused():
    def asks(x):
        return jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct((), np.float32), x)

    with pytest.raises(InputError, match=r"cannot be computed by several processes \(.*\): run it in one"):
        _exported(asks, 1, jax.ShapeDtypeStruct((), np.float32))
