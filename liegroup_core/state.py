# SPDX-License-Identifier: Apache-2.0
"""State of a run as one value: all that its continuation depends on.

A part of a simulation names its fields in KEPT: arrays, numbers, texts, lists, tuples and dicts of them, or parts
again. The functions here copy, restore, compare and encode them. The part only says what changes besides its
fields, in setters of properties and in `restored`.
"""

import base64
import math
from typing import Any

import numpy as np

from liegroup_core.fields.arguments import got
from liegroup_core.forces.external import COLUMNS, PULL

LARGEST_COUNT = 1 << 62  # of a step or another count


def kept(part, names=None):
    """Copy of the fields of a part: {name: value}; names: of some of them."""
    return {name.lstrip("_"): _copied(getattr(part, name)) for name in names or part.KEPT}


def _copied(value):
    if hasattr(value, "KEPT"):
        return kept(value)
    if isinstance(value, (np.ndarray, StoredMatrix)):
        return value.copy()
    if isinstance(value, dict):
        return {name: _copied(entry) for name, entry in value.items()}
    if type(value) in (list, tuple):
        return type(value)(map(_copied, value))
    return value


def empty(value):
    """An array of zeros like one of a part, or a StoredMatrix without columns."""
    return StoredMatrix(value.size) if isinstance(value, StoredMatrix) else np.zeros_like(value)


def set_kept(part, values):
    """Set fields of a part to copies of values from `kept`; arrays keep their place in memory."""
    for name in part.KEPT:
        key = name.lstrip("_")
        if key not in values:
            continue
        mine, value = getattr(part, name), values[key]
        if hasattr(mine, "KEPT"):
            set_kept(mine, value)
        elif isinstance(mine, np.ndarray):
            mine[...] = value
        else:
            setattr(part, name, _copied(value))
    if hasattr(part, "restored"):
        part.restored()


class StoredMatrix:
    """A large square matrix in the memory of a method: copies have only the columns that are not zero.

    size   : number of rows
    matrix : (size, size), its columns in rows, or None: this is a copy
    filled : (size,) 0: a column is zero; of a new matrix -1
    known  : False: it has no meaning, and copies are empty
    """

    __slots__ = ("_filled", "_known", "_matrix", "at", "size", "values")

    def __init__(
        self, size: int, matrix: "np.ndarray | None" = None, filled: "np.ndarray | None" = None, known: bool = True
    ) -> None:
        self.size, self._matrix, self._filled, self._known = size, matrix, filled, known
        self.at, self.values = np.empty(0, dtype=np.int64), np.empty((size, 0))

    def copy(self) -> "StoredMatrix":
        """A copy, without the matrix."""
        copy = StoredMatrix(self.size)
        copy.at, copy.values = self.at, self.values
        if self._matrix is not None and self._filled is not None and self._known:
            filled = np.flatnonzero(self._filled)
            copy.at = filled[self._matrix[filled].any(axis=1)]
            copy.values = np.ascontiguousarray(self._matrix[copy.at].T)
        return copy

    def __setitem__(self, where: Any, copy: "StoredMatrix") -> None:
        """Set the matrix to a copy; an empty one has no meaning."""
        if len(copy.at):
            self._matrix[self._filled != 0] = 0.0
            self._matrix[copy.at] = copy.values.T
            self._filled[self._filled != 0] = self._filled[copy.at] = -1

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StoredMatrix) and _equal(self.at, other.at) and _equal(self.values, other.values)

    __hash__ = None  # type: ignore[assignment]

    def as_json(self) -> Any:
        """JSON types."""
        return encoded([self.at, self.values])

    def from_json(self, data: Any, where: str) -> "StoredMatrix":
        """Inverse of `as_json`; earlier versions have the whole matrix. Raises ValueError."""
        if isinstance(data, str):
            whole = decoded(data, np.zeros((self.size, self.size)), where)
            return StoredMatrix(self.size, whole.T, np.ones(self.size)).copy()
        if not (isinstance(data, list) and len(data) == 2 and isinstance(data[0], str)):
            raise ValueError(f"{where} must have columns and their values, {got(data)}")
        copy, count = StoredMatrix(self.size), len(data[0]) * 3 // 4 // self.at.itemsize
        copy.at, copy.values = decoded(data, [np.zeros(count, dtype=np.int64), np.zeros((self.size, count))], where)
        if count and not (copy.at.min() >= 0 and copy.at.max() < self.size):
            raise ValueError(f"{where} must have columns from 0 to {self.size - 1}, {got(copy.at.tolist())}")
        return copy


class State:
    """State of a Simulation, from `Simulation.snapshot`: it can be held, copied, compared and pickled.

    identity : {name: value} scene text and arguments of the simulation
    parts    : {name: value} nested fields, arrays and plain values

    Two states are equal if their continuations are.
    """

    __slots__ = ("identity", "parts")

    def __init__(self, identity: dict[str, Any], parts: dict[str, Any]) -> None:
        self.identity, self.parts = identity, parts

    @property
    def steps(self) -> int:
        """Number of steps since the start or the last reset."""
        return self.parts["steps"]

    @property
    def pose(self) -> np.ndarray:
        """(n, 12) of the frames at the centres of mass, as `Simulation.state`."""
        return self.parts["pose"]

    @property
    def twist(self) -> np.ndarray:
        """(n, 6) rad/s, m/s of the frames at the centres of mass."""
        return self.parts["twist"]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, State):
            return NotImplemented
        return self.identity == other.identity and _equal(self.parts, other.parts)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"State(step {self.steps}, {len(self.pose)} bodies)"

    def __getstate__(self):
        return self.identity, self.parts

    def __setstate__(self, values):
        self.identity, self.parts = values


def _equal(one, other):
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_equal(one[name], other[name]) for name in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(_equal, one, other))
    return one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other))


def encoded(value):
    """A value of `kept` as JSON types; arrays as base64, numbers exactly."""
    if isinstance(value, np.ndarray):
        return base64.b64encode(value.tobytes()).decode()
    if isinstance(value, dict):
        return {name: encoded(entry) for name, entry in value.items()}
    if hasattr(value, "as_json"):
        return value.as_json()
    if isinstance(value, (list, tuple)):
        return [encoded(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return value.item() if isinstance(value, np.generic) else value


def with_pulls(data, like):
    """Encoded array of an earlier version, in which external wrenches had no pulls, with the size of `like`.

    like : (n, COLUMNS), or (1 + n COLUMNS + others,)
    """
    pulls = COLUMNS - PULL
    if (
        not isinstance(data, str)
        or isinstance(like, StoredMatrix)
        or like.dtype != float
        or len(data) == len(encoded(like))
    ):
        return data
    try:
        before = np.frombuffer(base64.b64decode(data, validate=True))
    except ValueError:
        return data
    n, rest = divmod(like.size - before.size, pulls)
    first = 0 if like.ndim == 2 else 1
    if rest or n < 1 or before.size < first + n * PULL:
        return data
    rows = before[first : first + n * PULL].reshape(n, PULL)
    return encoded(
        np.concatenate([before[:first], np.pad(rows, ((0, 0), (0, pulls))).ravel(), before[first + n * PULL :]])
    )


def decoded(data, like, where="state"):
    """Inverse of `encoded`. Raises ValueError for data without the types and shapes of `like`."""
    if isinstance(like, np.generic):  # of kernels that are not compiled
        like = like.item()
    if isinstance(like, np.ndarray):
        try:
            raw = base64.b64decode(data, validate=True) if isinstance(data, str) else None
        except ValueError:
            raw = None
        if raw is None or len(raw) != like.nbytes:
            raise ValueError(f"{where} must have {like.nbytes} bytes in base64, {got(data)}")
        return np.frombuffer(raw, like.dtype).reshape(like.shape).copy()
    if isinstance(like, dict):
        if not isinstance(data, dict) or data.keys() != like.keys():
            raise ValueError(f"{where} must have the entries {', '.join(like)}, {got(data)}")
        return {name: decoded(data[name], entry, f"{where}.{name}") for name, entry in like.items()}
    if hasattr(like, "from_json"):
        return like.from_json(data, where)
    if isinstance(like, (list, tuple)):
        if not isinstance(data, list) or len(data) != len(like):
            raise ValueError(f"{where} must have {len(like)} entries, {got(data)}")
        return type(like)(decoded(entry, mine, f"{where}[{k}]") for k, (entry, mine) in enumerate(zip(data, like)))
    if isinstance(like, float) and isinstance(data, str) and data in ("inf", "-inf", "nan"):
        return float(data)
    if isinstance(like, float) and type(data) is int:
        data = float(data) if abs(data) < LARGEST_COUNT else data
    if type(data) is not type(like) or (type(data) is int and abs(data) > LARGEST_COUNT):
        raise ValueError(f"{where} must be of type {type(like).__name__}, {got(data)}")
    return data
