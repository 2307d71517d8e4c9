"""Episodes that the tests of the readers write in the formats of other libraries, and what must be read of them."""

import numpy as np
import pytest

from eairl_jax import Demonstrations

OBS, ACT = 3, 2


@pytest.fixture(scope="session")
def make_episodes():
    """Makes episodes of given lengths and ends: dictionaries of `obs [T + 1, 3]`, `action`, `reward`, `terminated`."""

    def make(lengths, ends=(), dtype="<f8"):
        rng = np.random.default_rng(len(lengths))

        def draw(*shape):  # quarters, which no type of number rounds
            return (rng.integers(-40, 40, shape) / 4).astype(dtype)

        ends = [*ends, *[False] * len(lengths)]
        return [
            {"obs": draw(n + 1, OBS), "action": draw(n, ACT), "reward": draw(n), "terminated": end}
            for n, end in zip(lengths, ends, strict=False)
        ]

    return make


@pytest.fixture(scope="session")
def expected():
    """The demonstrations that hold given episodes."""

    def make(episodes):
        def joined(parts):
            return np.concatenate(parts).astype(np.float32)

        return Demonstrations(
            obs=joined([e["obs"][:-1] for e in episodes]),
            action=joined([e["action"] for e in episodes]) if "action" in episodes[0] else None,
            next_obs=joined([e["obs"][1:] for e in episodes]),
            reward=joined([e["reward"] for e in episodes]) if "reward" in episodes[0] else None,
            terminated=joined([[0] * (len(e["obs"]) - 2) + [float(e["terminated"])] for e in episodes]),
            lengths=np.array([len(e["obs"]) - 1 for e in episodes], np.int32),
        )

    return make


@pytest.fixture(scope="session")
def same():
    """Asserts that demonstrations are bit-equal, arrays of float32 and lengths of int32."""

    def check(found, wanted):
        for name, x, y in zip(Demonstrations._fields, found, wanted, strict=True):
            assert (x is None) == (y is None), name
            if x is not None:
                assert x.dtype == (np.int32 if name == "lengths" else np.float32), name
                np.testing.assert_array_equal(x, y, err_msg=name)

    return check


@pytest.fixture(scope="session")
def flat_columns():
    """Flat columns of episodes, as in D4RL, by the names of D4RL."""

    def make(episodes, with_next_obs=True):
        def joined(parts):
            return np.concatenate(parts).astype(parts[0].dtype)  # concatenate makes native byte order

        columns = {
            "observations": joined([e["obs"][:-1] for e in episodes]),
            "actions": joined([e["action"] for e in episodes]),
            "rewards": joined([e["reward"] for e in episodes]),
        }
        lengths = np.array([len(e["reward"]) for e in episodes])
        terminals = np.zeros(lengths.sum(), bool)
        terminals[np.cumsum(lengths) - 1] = [e["terminated"] for e in episodes]
        timeouts = np.zeros(lengths.sum(), bool)
        timeouts[np.cumsum(lengths) - 1] = [not e["terminated"] for e in episodes]
        if with_next_obs:
            columns["next_observations"] = joined([e["obs"][1:] for e in episodes])
        return columns | {"terminals": terminals, "timeouts": timeouts}

    return make
