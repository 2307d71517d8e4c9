"""Episodes from anywhere become `Demonstrations`: rollouts of NumPy arrays, and trajectories of other libraries.

A reader of a file format yields `Episode`s. `gather` puts them one after another into float32 arrays, checks them, and
counts what it met. `from_episodes` does the same for episodes that a Python program holds.
"""

from __future__ import annotations

import collections
import contextlib
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from eairl_jax.demonstrations import BLOCK, checked
from eairl_jax.errors import InputError
from eairl_jax.types import Demonstrations

# Names by which other libraries know the columns of an episode.
NAMES = {
    "obs": ("obs", "observations", "observation"),
    "action": ("action", "actions", "acts"),
    "next_obs": ("next_obs", "next_observations", "next_observation"),
    "reward": ("reward", "rewards", "rews"),
    "terminated": ("terminated", "terminals", "terminations"),
    "truncated": ("truncated", "timeouts", "truncations"),
    "done": ("done", "dones", "terminal"),
}
KNOWN_NAMES = {alias for aliases in NAMES.values() for alias in aliases}
ENDS = ("terminated", "truncated", "done")
# How an episode ended. "unknown": it is over, but its library does not say whether a time limit ended it.
TERMINATED, TRUNCATED, UNKNOWN = "terminated", "truncated", "unknown"

# What a reader changed or assumed, each a phrase that follows "1 episode" or "N episodes".
LAST_STEP_LEFT_OUT = "lost the last step, since its next observation is unknown"
ONE_STEP = "had a single step without a next observation, and could not be used"
LAST_OBS_REPEATED = "got the last observation as the next one too, since the task ended there and next_obs is unknown"
AT_A_JUMP = "ended where next_obs is not the obs of the next row, since the data have no column of time limits"
AT_THE_LIMIT = "ended after the time limit of the task, since the data have no column of time limits"
TOO_LONG = "lasted longer than the time limit, and lost the steps after it"
UNFINISHED = "stopped without a flag, which is read as a time limit"


class Episode(NamedTuple):
    """One episode of T steps, as a reader found it: arrays of any type of numbers.

    Attributes:
      obs: `[T + 1, obs]`, or `[T, obs]` beside `next_obs`; or a dictionary of such arrays.
      action: `[T, act]`, or None.
      next_obs: like `obs`, `[T, obs]`; None if `obs` has T + 1 rows.
      reward: `[T]`, or None.
      end: "terminated", "truncated" or "unknown".
      remarks: what the reader had to change or assume, phrases that follow "1 episode".
    """

    obs: Any
    action: Any
    next_obs: Any
    reward: Any
    end: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Options:
    """How episodes are read.

    Attributes:
      obs_key: of dictionary observations, the entry that is the observation; "flatten" puts all entries, in the order
        of their names, into one vector.
      max_episodes: how many episodes are read; None for all.
      action_limit: actions outside `[-action_limit, action_limit]` are counted; None for no limit.
      time_limit: steps after which the task's time limit ends an episode. Longer episodes are cut there. Where the data
        do not say what ended an episode of this length, the time limit did.
    """

    obs_key: str | None = None
    max_episodes: int | None = None
    action_limit: float | None = None
    time_limit: int | None = None

    def __post_init__(self):
        for name in ("max_episodes", "time_limit"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"{name} is {value}: expected at least 1")


@dataclass(frozen=True)
class Origin:
    """Where episodes come from.

    Attributes:
      name: the file or data set, for messages.
      format: "minari", "hf", "hdf5", "npz" or "episodes".
      steps: how many steps there are, if known; arrays of this size are made at once.
      low, high: `[act]`, the bounds of actions, if the format knows them.
      unused: names of columns that no field is read from.
    """

    name: str
    format: str
    steps: int | None = None
    low: Any = None
    high: Any = None
    unused: tuple[str, ...] = ()


@dataclass(frozen=True)
class Facts:
    """What a reader found and did.

    Attributes:
      source, format: where the episodes come from.
      episodes, steps, shortest, longest: how many episodes, steps in all, and steps of the shortest and longest.
      terminated: episodes that the task ended. The others met a time limit.
      ends_assumed: how an end was read that the data do not explain; empty if the data explain all.
      has_actions, has_rewards: whether the data hold them.
      all_rewards_zero: whether each reward is 0.
      converted: the types that became float32, for example `{"obs": "float64"}`.
      outside, largest_action: steps with an action outside the bounds, and the largest size of an action.
      bounds: the bounds in words; empty if none are known.
      remarks: `{phrase: episodes}` of what was changed.
      unused: names of columns that were not read.
    """

    source: str
    format: str
    episodes: int
    steps: int
    shortest: int
    longest: int
    terminated: int
    ends_assumed: str
    has_actions: bool
    has_rewards: bool
    all_rewards_zero: bool
    converted: dict[str, str]
    outside: int
    largest_action: float
    bounds: str
    remarks: dict[str, int]
    unused: tuple[str, ...]

    def lines(self) -> list[str]:
        """The facts in sentences, those first that every reader has to say."""
        lengths = f"{self.shortest}" if self.shortest == self.longest else f"{self.shortest} to {self.longest}"
        truncated = self.episodes - self.terminated
        lines = [
            f"{self.source} ({self.format}) has {_count(self.episodes, 'episode')} of {lengths} steps, {self.steps} "
            "steps in all.",
            f"The task ended {_count(self.terminated, 'episode')}. A time limit ended {truncated}.",
        ]
        lines += [self.ends_assumed] if self.ends_assumed else []
        lines += [f"{_count(count, 'episode')} {phrase}." for phrase, count in self.remarks.items()]
        if self.converted:
            types = ", ".join(f"{name} from {dtype}" for name, dtype in self.converted.items())
            lines.append(f"Converted to float32: {types}.")
        if not self.has_rewards:
            lines.append("There are no rewards. The expert's return is unknown, so no score is normalised by it.")
        elif self.all_rewards_zero:
            lines.append("All rewards are 0. The expert's return of 0 is no scale for a score.")
        if not self.has_actions:
            lines.append("There are no actions. Only a method that compares observations alone can learn from them.")
        if self.outside:
            lines.append(
                f"{self.outside} of {_count(self.steps, 'step')} have an action outside {self.bounds}, the largest of "
                f"size {self.largest_action:.4g}. The actions are kept as they are."
            )
        if self.unused:
            lines.append(f"Columns that were not read: {', '.join(self.unused)}.")
        return lines


class Read(NamedTuple):
    """What a reader returns.

    Attributes:
      demos: the episodes, checked.
      facts: what the reader found and did.
    """

    demos: Demonstrations
    facts: Facts


def from_episodes(
    episodes: Iterable[Any],
    *,
    obs_key: str | None = None,
    max_episodes: int | None = None,
    action_limit: float | None = None,
    time_limit: int | None = None,
) -> Read:
    """Demonstrations from episodes that a program holds or makes: `demos, facts = from_episodes(episodes)`.

    Args:
      episodes: dictionaries, or objects with attributes. An episode of T steps has `obs [T + 1, obs]`, or
        `obs [T, obs]` and `next_obs [T, obs]`. It may have `action [T, act]` and `reward [T]`. It has `terminated`,
        one truth value or `[T]`: whether the task ended the episode. The names of other libraries are known too
        (`NAMES`), so `imitation`'s trajectories and Minari's episodes fit as they are. An iterator is read one episode
        at a time.
      obs_key: of dictionary observations, the entry to use, or "flatten" for all entries in the order of their names.
      max_episodes: how many episodes are read; None for all.
      action_limit: actions outside `[-action_limit, action_limit]` are counted.
      time_limit: steps after which the task's time limit ends an episode. Longer episodes are cut there. Where only
        `done` or `terminal` is known, the time limit ended the episodes of this length.

    Raises:
      InputError: if there is no episode, if an episode has no step, lacks observations or fits no other episode, or if
        an array holds anything except finite numbers.
    """
    options = Options(obs_key, max_episodes, action_limit, time_limit)
    found = (as_episode(item, f"episode {number}") for number, item in enumerate(episodes))
    return gather(found, Origin("the episodes", "episodes"), options)


def as_episode(item: Any, where: str = "the episode") -> Episode:
    """An `Episode` from a dictionary or an object whose fields have any of `NAMES`.

    Args:
      item: the dictionary or object.
      where: which episode, for messages.

    Raises:
      InputError: if observations are missing, if two fields mean the same, or if steps follow the end.
    """
    names = item.keys() if isinstance(item, Mapping) else [name for name in dir(item) if not name.startswith("_")]
    get = item.__getitem__ if isinstance(item, Mapping) else lambda name: getattr(item, name)
    columns, _ = named(where, {name: get(name) for name in {*names} & KNOWN_NAMES})
    if "obs" not in columns:
        found = f"a dictionary of {listed(names)}" if isinstance(item, Mapping) else f"a {type(item).__name__}"
        raise InputError(
            f"{where} is {found}: expected a dictionary or an object with {' or '.join(NAMES['obs'])}, and optionally "
            "action, reward and terminated"
        )
    infos = get("infos") if "infos" in names else None
    flags = {name: last_flag(where, name, columns.pop(name)) for name in ENDS if columns.get(name) is not None}
    fields = {name: columns.get(name) for name in ("obs", "action", "next_obs", "reward")}
    return Episode(**fields, end=end_of(flags, last_info(infos)), remarks=() if flags else (UNFINISHED,))


def named(where: str, columns: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Columns by the names of this library, and the names of the columns that are none of `NAMES`.

    Raises:
      InputError: if two columns mean the same.
    """
    fields: dict[str, Any] = {}
    for name, aliases in NAMES.items():
        found = [alias for alias in aliases if alias in columns]
        if len(found) > 1:
            raise InputError(f"{where} has {' and '.join(found)}, which mean the same: keep one of them")
        if found:
            fields[name] = columns[found[0]]
    return fields, tuple(sorted(str(name) for name in columns if name not in KNOWN_NAMES))


def completed(columns: Mapping[str, Any], end: str) -> Episode:
    """An episode of rows `[T, ...]`. Without next_obs its last step has no successor.

    Then the last step is left out. If the task ended the episode, its last step is kept, and the last observation
    stands for the next one: the value of what follows an end is 0 in any case. An episode of which no step remains has
    the remark `ONE_STEP`.
    """
    obs, action, reward = columns["obs"], columns.get("action"), columns.get("reward")
    if "next_obs" in columns:
        return Episode(obs, action, columns["next_obs"], reward, end)
    if end == TERMINATED:
        return Episode(_with_last_row_twice(obs), action, None, reward, end, (LAST_OBS_REPEATED,))
    action, reward = (None if x is None else x[:-1] for x in (action, reward))
    return Episode(obs, action, None, reward, end, (LAST_STEP_LEFT_OUT if rows(obs) > 1 else ONE_STEP,))


def rows(x: Any) -> int:
    """Rows of an array, or of the first array in nested dictionaries."""
    while isinstance(x, Mapping):
        if not len(x):
            return 0
        x = x[next(iter(x))]
    return len(x)


def cut(x: Any, start: int, stop: int) -> Any:
    """The rows `start` to `stop` (exclusive) of an array, or of each array in nested dictionaries."""
    return {key: cut(x[key], start, stop) for key in x} if isinstance(x, Mapping) else x[start:stop]


def _with_last_row_twice(x: Any) -> Any:
    if isinstance(x, Mapping):
        return {key: _with_last_row_twice(value) for key, value in x.items()}
    return np.concatenate([x, x[-1:]])


def end_of(flags: Mapping[str, bool], info: Mapping[str, Any]) -> str:
    """How an episode ended, from its flags at the last step and the last `info` of Gymnasium or Stable-Baselines3."""
    if flags.get("terminated"):
        return TERMINATED
    if "terminated" in flags or flags.get("truncated") or not flags.get("done"):
        return TRUNCATED
    if "TimeLimit.truncated" in info:
        return TRUNCATED if info["TimeLimit.truncated"] else TERMINATED
    return TERMINATED if "truncated" in flags else UNKNOWN


def last_info(infos: Any) -> Mapping[str, Any]:
    """The last of the dictionaries that a library keeps for each step; empty if there are none."""
    if isinstance(infos, Mapping) or infos is None or not hasattr(infos, "__getitem__") or not len(infos):
        return {}
    return infos[-1] if isinstance(infos[-1], Mapping) else {}


def flags_of(where: str, name: str, x: Any) -> np.ndarray:
    """A column of truth values as booleans `[...]`.

    Raises:
      InputError: if a value is neither 0 nor 1.
    """
    x = numbers(where, name, x)
    wrong = (x != 0) & (x != 1)
    if wrong.any():
        raise InputError(f"{where}: {name} holds {x[wrong].flat[0]}: expected 0 or 1 for each step")
    return x.astype(bool)


def last_flag(where: str, name: str, x: Any) -> bool:
    """The truth value at the end of an episode, from one value or one for each step.

    Raises:
      InputError: if a value is neither 0 nor 1, or if it is 1 before the last step.
    """
    x = flags_of(where, name, x).reshape(-1)
    if x[:-1].any():
        raise InputError(
            f"{where} has {name} at step {np.argmax(x)}, and {len(x)} steps: cut the episode after this step"
        )
    return bool(x[-1]) if len(x) else False


def numbers(where: str, name: str, x: Any) -> np.ndarray:
    """An array of numbers.

    Raises:
      InputError: if it holds text, objects, complex numbers or lists of different lengths.
    """
    try:
        x = np.asarray(x)
    except ValueError:
        raise InputError(f"{where}: {name} is a list of lists of different lengths: expected an array") from None
    if x.dtype.kind not in "biuf":
        raise InputError(f"{where}: {name} has dtype {x.dtype}; expected numbers")
    return x


@contextlib.contextmanager
def readable(where: str) -> Iterator[None]:
    """Turns whatever a file library raises for a damaged file into one `InputError`."""
    try:
        yield
    except InputError:
        raise
    except Exception as e:  # h5py, pyarrow, datasets, Minari and zipfile raise dozens of different exceptions
        reason = " ".join(str(e).split())[:200] or type(e).__name__
        raise InputError(
            f"{where} cannot be read ({reason}): the file is damaged, or not in this format; write it again, or choose "
            "another format"
        ) from None


# Gathering -----------------------------------------------------------------------------------------------------------


def gather(episodes: Iterable[Episode], origin: Origin, options: Options) -> Read:
    """Puts episodes one after another into float32 arrays, checks them, and counts what it met.

    Raises:
      InputError: if there is no episode, or an episode is no demonstration or does not fit the others.
    """
    gathering = _Gathering(origin, options)
    for episode in itertools.islice(episodes, options.max_episodes):
        gathering.add(episode)
    return gathering.read()


def described(demos: Demonstrations, origin: Origin, options: Options) -> Read:
    """Demonstrations that are checked already, with their facts; copied only if fewer steps are wanted."""
    few, limit = options.max_episodes, options.time_limit
    if (few is not None and few < len(demos.lengths)) or (limit is not None and limit < demos.lengths.max()):
        return gather(_split(demos), origin, options)
    chosen(origin.name, demos.obs, options.obs_key)
    gathering = _Gathering(origin, options)
    gathering.lengths = demos.lengths.tolist()
    action = np.zeros((0, 1)) if demos.action is None else demos.action
    for start in range(0, len(action), BLOCK):
        gathering.count_outside(action[start : start + BLOCK])
    return Read(demos, gathering.facts(demos, int(demos.terminated.sum()), ""))


def _split(demos: Demonstrations) -> Iterator[Episode]:
    stops = np.cumsum(demos.lengths)
    for start, stop in zip(stops - demos.lengths, stops, strict=True):
        action, reward = (None if x is None else x[start:stop] for x in (demos.action, demos.reward))
        end = TERMINATED if demos.terminated[stop - 1] else TRUNCATED
        yield Episode(demos.obs[start:stop], action, demos.next_obs[start:stop], reward, end)


class _Rows:
    """Rows that arrive in blocks, in one float32 array that grows in place."""

    def __init__(self, size: tuple[int, ...], capacity: int):
        self.rows, self.used = np.empty((capacity, *size), np.float32), 0

    def add(self, block: np.ndarray) -> None:
        until = self.used + len(block)
        if until > len(self.rows):
            self.rows.resize((max(until, len(self.rows) * 3 // 2), *self.rows.shape[1:]), refcheck=False)
        with np.errstate(over="ignore"):
            self.rows[self.used : until] = block
        self.used = until

    def take(self) -> np.ndarray:
        """The rows. Nothing can be added afterwards."""
        self.rows.resize((self.used, *self.rows.shape[1:]), refcheck=False)
        return self.rows


class _Gathering:
    """What is known of the episodes so far."""

    def __init__(self, origin: Origin, options: Options):
        self.origin, self.options = origin, options
        self.columns: dict[str, _Rows] = {}
        self.lengths: list[int] = []
        self.ends: list[str] = []
        self.dtypes: dict[str, set[str]] = collections.defaultdict(set)
        self.remarks: collections.Counter[str] = collections.Counter()
        self.outside, self.largest = 0, 0.0

    def add(self, episode: Episode) -> None:
        if ONE_STEP in episode.remarks:
            self.remarks[ONE_STEP] += 1
            return
        where = f"{self.origin.name}, episode {len(self.lengths)}"
        columns = _columns(where, episode, self.options.obs_key)
        steps, limit = len(columns["obs"]), self.options.time_limit
        if limit is not None and steps > limit:
            columns, steps = {name: x[:limit] for name, x in columns.items()}, limit
            episode = episode._replace(end=TRUNCATED, remarks=(TOO_LONG,))
        if not self.columns:
            capacity = self.origin.steps if self.origin.steps and self.options.max_episodes is None else steps
            self.columns = {name: _Rows(x.shape[1:], max(capacity, steps)) for name, x in columns.items()}
        _refuse_different(where, columns, {name: rows.rows.shape[1:] for name, rows in self.columns.items()})
        for name, x in columns.items():
            self.columns[name].add(x)
            self.dtypes[name].add(x.dtype.name if x.dtype.isnative else f"byte-swapped {x.dtype.name}")
        if "action" in columns:
            self.count_outside(columns["action"])
        self.lengths.append(steps)
        self.ends.append(episode.end)
        self.remarks.update(episode.remarks)

    def count_outside(self, action: np.ndarray) -> None:
        low, high = self.bounds()
        if low is not None:
            is_outside = ((action < low) | (action > high)).any(axis=1)
            self.outside += int(is_outside.sum())
        self.largest = max(self.largest, float(np.abs(action.astype(np.float64)).max()))

    def bounds(self) -> tuple[Any, Any]:
        """The lowest and highest action, numbers or `[act]`; None where nothing is known."""
        if self.options.action_limit is not None:
            return -self.options.action_limit, self.options.action_limit
        return self.origin.low, self.origin.high

    def read(self) -> Read:
        if not self.lengths:
            left_out = f" ({self.remarks[ONE_STEP]} {ONE_STEP})" if self.remarks else ""
            raise InputError(f"{self.origin.name} holds no episodes{left_out}: give at least one episode")
        lengths = np.asarray(self.lengths, np.int32)
        ends, assumed = _resolved(self.ends, lengths, self.options.time_limit)
        terminated = np.zeros(lengths.sum(), np.float32)
        terminated[np.cumsum(lengths) - 1] = ends
        arrays = {name: rows.take() for name, rows in self.columns.items()}
        self.columns = {}
        where = self.origin.name
        demos = checked(
            Demonstrations(
                arrays["obs"],
                arrays.get("action"),
                arrays["next_obs"],
                arrays.get("reward"),
                terminated,
                lengths,
            ),
            where,
        )
        return Read(demos, self.facts(demos, int(ends.sum()), assumed))

    def facts(self, demos: Demonstrations, terminated: int, assumed: str) -> Facts:
        low, high = self.bounds()
        others = {name: sorted(dtypes - {"float32"}) for name, dtypes in self.dtypes.items()}
        return Facts(
            source=self.origin.name,
            format=self.origin.format,
            episodes=len(self.lengths),
            steps=int(sum(self.lengths)),
            shortest=min(self.lengths),
            longest=max(self.lengths),
            terminated=terminated,
            ends_assumed=assumed,
            has_actions=demos.action is not None,
            has_rewards=demos.reward is not None,
            all_rewards_zero=demos.reward is not None and not np.any(demos.reward),
            converted={name: " and ".join(dtypes) for name, dtypes in others.items() if dtypes},
            outside=self.outside,
            largest_action=self.largest,
            bounds="" if low is None else f"[{np.min(low):g}, {np.max(high):g}]",
            remarks=dict(self.remarks),
            unused=self.origin.unused,
        )


def _columns(where: str, episode: Episode, obs_key: str | None) -> dict[str, np.ndarray]:
    """The columns of one episode: `obs [T, obs]`, `next_obs [T, obs]`, and `action [T, act]`, `reward [T]` if known."""
    obs = vectors(where, "obs", chosen(where, episode.obs, obs_key), obs_key)
    if episode.next_obs is None:
        obs, next_obs = obs[:-1], obs[1:]
        expected = "one row of obs more than steps, or next_obs"
    else:
        next_obs = vectors(where, "next_obs", chosen(where, episode.next_obs, obs_key), obs_key)
        expected = "one row for each step"
    columns = {"obs": obs, "next_obs": next_obs}
    if episode.action is not None:
        columns["action"] = vectors(where, "action", _continuous(where, episode.action))
    if episode.reward is not None:
        reward = numbers(where, "reward", episode.reward)
        columns["reward"] = reward[:, 0] if reward.ndim == 2 and reward.shape[1] == 1 else reward
        if columns["reward"].ndim != 1:
            raise InputError(f"{where}: reward has shape {reward.shape}; expected one number for each step")
    steps = len(obs)
    different = [f"{name} {len(x)}" for name, x in columns.items() if len(x) != steps]
    if different:
        raise InputError(f"{where} has {steps} steps by obs, but {', '.join(different)}: expected {expected}")
    if steps == 0:
        raise InputError(f"{where} has no steps: remove it")
    return columns


def chosen(where: str, obs: Any, obs_key: str | None) -> Any:
    """The observation that a user chose among the entries of a dictionary; an array is returned as it is.

    Raises:
      InputError: if an entry must be chosen, or the chosen entry does not exist.
    """
    obs = obs.unwrap() if hasattr(obs, "unwrap") else obs  # `imitation`'s DictObs
    if not isinstance(obs, Mapping):
        if obs_key not in (None, "flatten"):
            raise InputError(f"{where}: obs is one array and has no entry {obs_key!r}: leave obs_key out")
        return obs
    entries = dict(_entries(obs))
    if obs_key in entries:
        return entries[obs_key]
    if obs_key == "flatten" and entries:
        parts = [numbers(where, f"obs[{key}]", entries[key]) for key in sorted(entries)]
        if len({len(part) for part in parts}) > 1:
            raise InputError(f"{where}: the entries of obs have different lengths, {[len(part) for part in parts]}")
        return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
    problem = "obs is a dictionary" if obs_key is None else f"obs has no entry {obs_key!r}"
    raise InputError(
        f"{where}: {problem} of {', '.join(sorted(entries)) or 'nothing'}: choose an entry with obs_key (--obs-key), "
        'or "flatten" for all of them'
    )


def _entries(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The arrays of nested dictionaries by their paths, for example "robot/joints"."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _entries(value, f"{prefix}{key}/")
        else:
            yield f"{prefix}{key}", value


def vectors(where: str, name: str, x: Any, obs_key: str | None = None) -> np.ndarray:
    """`[T, size]` from an array of numbers; `[T]` becomes `[T, 1]`, more axes are put into one if asked.

    Raises:
      InputError: if the rows are no vectors.
    """
    x = numbers(where, name, x)
    if x.ndim == 1:
        return x[:, None]
    if x.ndim > 2 and obs_key == "flatten":
        return x.reshape(len(x), -1)
    if x.ndim != 2:
        flatten = "; flatten them with obs_key (--obs-key) flatten" if x.ndim > 2 and name != "action" else ""
        raise InputError(f"{where}: {name} has shape {x.shape}; expected one vector for each step{flatten}")
    return x


def _continuous(where: str, action: Any) -> np.ndarray:
    """Actions as an array; `InputError` if they are whole numbers, so that they choose among alternatives."""
    action = numbers(where, "action", action)
    if action.dtype.kind != "f":
        raise InputError(
            f"{where}: actions are whole numbers ({action.dtype}), so they are discrete: this library needs continuous "
            "actions; if yours are continuous, store them as floats"
        )
    return action


def _refuse_different(where: str, columns: dict[str, np.ndarray], sizes: dict[str, tuple[int, ...]]) -> None:
    """Raises `InputError` unless an episode has the columns and sizes of the first episode."""
    if columns.keys() != sizes.keys():
        lacking = sorted(columns.keys() ^ sizes.keys())
        raise InputError(f"{where}: {', '.join(lacking)} are in some episodes only: expected them in all or in none")
    for name, x in columns.items():
        if x.shape[1:] != sizes[name]:
            raise InputError(f"{where}: {name} has size {x.shape[1]}, and {sizes[name][0]} in the episodes before")


def _resolved(ends: list[str], lengths: np.ndarray, time_limit: int | None) -> tuple[np.ndarray, str]:
    """Whether the task ended each episode `[E]`, and a sentence on what was assumed."""
    kinds = np.asarray(ends)
    is_unknown = kinds == UNKNOWN
    if not is_unknown.any():
        return kinds == TERMINATED, ""
    if time_limit is not None:
        met = lengths >= time_limit
        sentence = (
            f"The data do not say what ended {_count(int(is_unknown.sum()), 'episode')}. Those of {time_limit} steps "
            "or more met the time limit; the task ended the others."
        )
    elif len(lengths) > 1 and (lengths == lengths[0]).all():
        met = np.ones(len(lengths), bool)
        sentence = (
            f"The data do not say what ended the episodes. All have {lengths[0]} steps, so a time limit is assumed."
        )
    else:
        met = np.zeros(len(lengths), bool)
        sentence = (
            f"The data do not say what ended {_count(int(is_unknown.sum()), 'episode')}. It is assumed that the task "
            "did, since the lengths differ or only one episode is known; a time_limit says otherwise."
        )
    return (kinds == TERMINATED) | (is_unknown & ~met), sentence


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(names: Iterable[Any]) -> str:
    """Names in a message: sorted, with commas; "nothing" if there are none."""
    return ", ".join(sorted(map(str, names))) or "nothing"
