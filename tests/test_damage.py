"""A damaged file is refused with an `InputError`, or it holds what the intact one holds: demonstrations and rewards."""

import io
import json
import zipfile

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eairl_jax import (
    Config,
    Demonstrations,
    InputError,
    LearnedReward,
    RewardParams,
    demonstrations,
    discriminator,
    load_reward,
    save_reward,
)
from eairl_jax.methods import with_method_defaults
from eairl_jax.normalize import ObsStats

FEW, MANY = 150, 10_000
KNOWN = ("task", "expert_return", "random_return", "returns")

# Damage to bytes -----------------------------------------------------------------------------------------------------

places = st.floats(0, 1, exclude_max=True)


def changed(data, place, new, removed=0):
    """The bytes with `new` at a place, in the stead of as many bytes as are removed."""
    at = int(place * len(data))
    return data[:at] + new + data[at + removed :]


def flipped(data, flips):
    """The bytes with some of them changed."""
    data = bytearray(data)
    for place, mask in flips:
        data[int(place * len(data))] ^= mask
    return bytes(data)


of_bytes = st.one_of(
    st.lists(st.tuples(places, st.integers(1, 255)), min_size=1, max_size=4).map(lambda f: lambda d: flipped(d, f)),
    places.map(lambda p: lambda d: d[: int(p * len(d))]),
    places.map(lambda p: lambda d: d[int(p * len(d)) :]),
    st.tuples(places, st.binary(max_size=40)).map(lambda a: lambda d: changed(d, *a)),
    st.tuples(places, st.binary(max_size=40), st.integers(0, 400)).map(lambda a: lambda d: changed(d, *a)),
    st.tuples(places, st.sampled_from([b"\0", b"\xff"]), st.integers(1, 99)).map(
        lambda a: lambda d: changed(d, a[0], a[1] * a[2], a[2])
    ),
    st.just(lambda d: d + d),
)

# Damage to the members of an archive ---------------------------------------------------------------------------------


def npy(x):
    """The bytes of an `.npy`."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, x, allow_pickle=True)
    return stream.getvalue()


def array(data):
    """The array of an `.npy`."""
    return np.lib.format.read_array(io.BytesIO(data))


def spoiled(x, value):
    """The array with one wrong value."""
    x = np.array(x, np.float64 if x.dtype.kind in "iuf" else None)
    if x.size and x.dtype.kind == "f":
        x.flat[x.size // 2] = value
    return x


ARRAYS = [
    *(lambda x, v=v: spoiled(x, v) for v in (np.nan, np.inf, -np.inf, 1e300, -1.0, 0.5, 1e9)),
    *(lambda x, t=t: np.zeros(x.shape, t) for t in ("i1", "u8", "f2", "c8", "M8[s]", "S3", "U2", "?", "f8", "f4")),
    lambda x: np.array([{"a": 1}], dtype=object),
    lambda x: np.zeros((0, *x.shape[1:]), x.dtype),
    lambda x: x[None],
    lambda x: x.ravel()[: x.size // 2],
    lambda x: np.concatenate([np.atleast_1d(x)] * 2),
    lambda x: np.atleast_1d(x)[::-1],
    lambda x: np.atleast_1d(x).T,
    lambda x: np.array("another_task"),
    lambda x: np.zeros((), np.float32),
    lambda x: np.broadcast_to(np.float32(1), (3, 1, 1, 2)),
]

# (members [(name, bytes)], position) -> members
edits = st.one_of(
    st.just(lambda m, i: m[:i] + m[i + 1 :]),
    st.just(lambda m, i: [*m, m[i]]),
    st.just(lambda m, i: [*m, (m[i][0], m[0][1])]),
    st.just(lambda m, i: [*m[:i], (m[i][0], m[i - 1][1]), *m[i + 1 :]]),
    st.just(lambda m, i: m[::-1]),
    st.just(lambda m, i: []),
    st.one_of(st.text(min_size=1, max_size=5), st.sampled_from(["lengths", "task.npy", "../x.npy", "a/b/c.npy"])).map(
        lambda name: lambda m, i: [*m[:i], (name, m[i][1]), *m[i + 1 :]]
    ),
    st.sampled_from(ARRAYS).map(lambda f: lambda m, i: [*m[:i], (m[i][0], npy(f(array(m[i][1])))), *m[i + 1 :]]),
    st.sampled_from(ARRAYS).map(lambda f: lambda m, i: [*m, (f"more{i}.npy", npy(f(array(m[i][1]))))]),
    of_bytes.map(lambda f: lambda m, i: [*m[:i], (m[i][0], f(m[i][1])), *m[i + 1 :]]),
    # The header is the first 128 bytes.
    of_bytes.map(lambda f: lambda m, i: [*m[:i], (m[i][0], f(m[i][1][:128]) + m[i][1][128:]), *m[i + 1 :]]),
)


def edited(data, edit, place, method):
    """The archive with changed members."""
    with zipfile.ZipFile(io.BytesIO(data)) as f:
        members = [(name, f.read(name)) for name in f.namelist()]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as f:
        for name, content in edit(members, int(place * len(members))):
            f.writestr(name, content)
    return stream.getvalue()


methods = st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2])
of_archive = st.one_of(
    of_bytes, st.tuples(edits, places, methods).map(lambda a: lambda d: edited(d, *a)), of_bytes.map(lambda f: f)
)

# Damage to JSON ------------------------------------------------------------------------------------------------------

single = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from([10**9, -1, 0, 2**31, 2**32, 2**63, 10**40, 10**400, 1e300, -1e300, "x" * 5000, "\ud800", "a\nb"]),
)
values = st.recursive(
    single, lambda x: st.one_of(st.lists(x, max_size=4), st.dictionaries(st.text(max_size=5), x, max_size=4))
)


def nodes(value, path=()):
    """The path of every value of a JSON value."""
    yield path
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, each in inside:
        yield from nodes(each, (*path, name))


def replaced(data, place, change):
    """The JSON text with one value changed; `change` is called with the container and the name of the value."""
    content = json.loads(data)
    paths = list(nodes(content))[1:]
    *path, name = paths[int(place * len(paths))]
    container = content
    for each in path:
        container = container[each]
    change(container, name)
    return json.dumps(content).encode()


def put(value):
    """Changes a value to another."""
    return lambda container, name: container.__setitem__(name, value)


def renamed(new):
    """Changes the name of a member."""

    def change(container, name):
        value = container.pop(name)
        container.update({new: value}) if isinstance(container, dict) else container.append(value)

    return change


changes = st.one_of(
    values.map(put), st.just(lambda container, name: container.pop(name)), st.text(max_size=6).map(renamed)
)
RAW = [
    b"[" * 100_000,
    b"[" * 50 + b"]" * 50,
    b"null",
    b"[]",
    b"{}",
    b'"text"',
    b"NaN",
    b"1" * 10_000,
    b"\xff\xfe{}",
    b"",
]
of_json = st.one_of(
    of_bytes,
    st.tuples(places, changes).map(lambda a: lambda d: replaced(d, *a)),
    st.sampled_from(RAW).map(lambda raw: lambda d: raw),
    st.tuples(places, st.sampled_from([b"NaN", b"1e999", b"Infinity", b"{", b'"task": 1, ', b"9" * 6000])).map(
        lambda a: lambda d: changed(d, *a)
    ),
)

# The intact files ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def demos(tmp_path_factory):
    """A folder with intact demonstrations, and what they hold."""
    rng, path = np.random.default_rng(0), tmp_path_factory.mktemp("demos") / "x.npz"
    lengths = np.array([5, 4, 6])
    walks = [rng.normal(size=(n + 1, 3)).astype(np.float32) for n in lengths]
    obs, next_obs = (np.concatenate([walk[part] for walk in walks]) for part in (slice(0, -1), slice(1, None)))
    action, reward = rng.normal(size=(15, 2)).astype(np.float32), rng.normal(size=15).astype(np.float32)
    terminated = np.zeros(15, np.float32)
    terminated[8] = 1
    given = Demonstrations(obs, action, next_obs, reward, terminated, lengths.astype(np.int32))
    provenance = {"task": "toy", "expert_return": 2.5, "random_return": -1.0, "returns": [1.0, 2.0, 3.0], "seed": 0}
    demonstrations.save(path, given, provenance | {"expert": {"config": {"hidden": [32, 32]}, "done": True}})
    return path


def read_demos(path):
    """What demonstrations hold, of which a run makes use."""
    provenance = demonstrations.provenance(path)
    return demonstrations.load(path, "toy"), {name: provenance.get(name) for name in KNOWN}


@pytest.fixture(scope="module", params=["sa", "separable"])
def reward(tmp_path_factory, request):
    """A folder with an intact reward of two seeds."""
    config = Config(reward_form=request.param, hidden=(4, 3), horizon="absorbing")
    folder, rng = tmp_path_factory.mktemp("reward"), np.random.default_rng(0)
    keys, resolved = jax.random.split(jax.random.PRNGKey(0)), with_method_defaults(config)
    made = jax.vmap(lambda key: discriminator.init(key, 4, 2, resolved))(keys)
    stats = ObsStats(rng.normal(size=(2, 4)), np.ones((2, 4)), np.zeros(2))
    params = RewardParams({name: made[name] for name in ("g", "k") if name in made}, stats)
    params = jax.tree.map(lambda x: np.asarray(x, np.float32), params)
    description = {"task": "toy", "obs_size": 3, "action_size": 2, "seeds": [5, 6], "iterations": [4, 4]}
    more = {"method": config.method, "reward_form": request.param, "action_limit": 1.0, "hparams": {"gamma": 0.9}}
    save_reward(folder, LearnedReward(description | more, config, params))
    return folder


def read_reward(folder):
    """What a saved reward holds."""
    loaded = load_reward(folder)
    return loaded.params, loaded.config, loaded.description


# The tests -----------------------------------------------------------------------------------------------------------


def same(found, intact):
    """Whether two readings are equal, arrays by their types too."""
    a, b = jax.tree.flatten(found), jax.tree.flatten(intact)
    pairs = zip(a[0], b[0], strict=True)
    return a[1] == b[1] and all(
        np.asarray(x).dtype == np.asarray(y).dtype and np.array_equal(x, y) if isinstance(y, np.ndarray) else x == y
        for x, y in pairs
    )


def check_refused_or_same(count, read, path, file, strategy):
    """Damages a file many times. Returns the number of refusals."""
    data, intact, refused = file.read_bytes(), read(path), []

    @settings(max_examples=count, suppress_health_check=list(HealthCheck))
    @given(damage=strategy)
    def attempt(damage):
        damaged = damage(data)
        file.write_bytes(damaged)
        try:
            found = read(path)
        except InputError as e:
            refused.append(str(e))
        else:
            assert same(found, intact)

    try:
        attempt()
    finally:
        file.write_bytes(data)
    assert same(read(path), intact)
    assert len(refused) > count / 2
    assert max(map(len, refused)) < 1000 + 3 * len(str(path))
    print(f"{file.name}: {len(refused)} refused")


sizes = pytest.mark.parametrize("count", [FEW, pytest.param(MANY // 2, marks=pytest.mark.slow)])
KINDS = {"json": of_json, "npz": of_archive}
kinds = pytest.mark.parametrize("kind", KINDS)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@sizes
@kinds
def test_damaged_demonstrations_are_refused_or_the_same(demos, count, kind):
    check_refused_or_same(count, read_demos, demos, demos.with_suffix(f".{kind}"), KINDS[kind])


@pytest.mark.filterwarnings("ignore:Duplicate name")
@sizes
@kinds
def test_damaged_rewards_are_refused_or_the_same(reward, count, kind):
    check_refused_or_same(count, read_reward, reward, reward / f"reward.{kind}", KINDS[kind])
