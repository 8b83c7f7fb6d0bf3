# SPDX-License-Identifier: Apache-2.0
"""Commands of wrenches, efforts and pulls in a recording, 160 bytes each, and when they act."""

from array import array

import numpy as np

from liegroup_core.forces.commands import AXES, CLEAR, EFFORT, PULL, WRENCH, Command
from liegroup_core.forces.commands import KINDS as SIZES

KINDS = (WRENCH, EFFORT, CLEAR, PULL)
FOREVER = 1 << 62  # ns; end of a command that acts until it is replaced
# Whole numbers and floats of a command.
STAMP, START, END, KIND, IN_AXES, NAME, SOURCE, HAS_POINT = range(8)
INTS, VALUES = 8, SIZES[PULL]
FLOATS = VALUES + 3


class InputTrack:
    """Commands in the order in which they were given.

    Indexing gives the Command of a number, with times in ns since the stamp `base_ns`.
    """

    def __init__(self, base_ns=0, names=None):
        self.base_ns = base_ns
        self._names = {} if names is None else names  # {name or source: number}
        self._ints, self._floats = array("q"), array("d")

    def __len__(self):
        return len(self._ints) // INTS

    def add(self, stamp_ns, base_ns, command):
        """Append a Command that was given at a stamp; base_ns : stamp of step 0."""
        values = *command.values, *(0.0,) * (VALUES - len(command.values))
        numbers = (self._names.setdefault(text, len(self._names)) for text in (command.name, command.source))
        end = FOREVER if command.end_ns is None else base_ns + round(command.end_ns)
        has_point = command.point is not None
        kind, axes = KINDS.index(command.kind), AXES.index(command.axes)
        self._ints.extend((stamp_ns, base_ns + round(command.start_ns), end, kind, axes, *numbers, has_point))
        self._floats.extend((*values, *(command.point if has_point else (0.0, 0.0, 0.0))))

    def between(self, begin, end, base_ns, before=()):
        """InputTrack of the commands given from stamp `begin` until before `end`, after the Commands `before`."""
        found = InputTrack(base_ns, self._names)
        for command in before:
            found.add(begin, base_ns, command)
        inside = np.flatnonzero((self.stamp_ns >= begin) & (self.stamp_ns < end))
        found._ints.frombytes(self._rows[inside].tobytes())
        found._floats.frombytes(self._values[inside].tobytes())
        return found

    @property
    def _rows(self):
        return np.frombuffer(self._ints, dtype=np.int64).reshape(-1, INTS)

    @property
    def _values(self):
        return np.frombuffer(self._floats, dtype=float).reshape(-1, FLOATS)

    @property
    def stamp_ns(self):
        """(m,) stamps at which they were given, ns."""
        return self._rows[:, STAMP]

    def __getitem__(self, k):
        row, numbers = self._rows[k].tolist(), self._values[k].tolist()
        names = list(self._names)
        kind = KINDS[row[KIND]]
        count = SIZES[kind]
        end = None if row[END] == FOREVER else row[END] - self.base_ns
        point = tuple(numbers[VALUES:]) if row[HAS_POINT] else None
        axes, name, source = AXES[row[IN_AXES]], names[row[NAME]], names[row[SOURCE]]
        return Command(kind, name, tuple(numbers[:count]), row[START] - self.base_ns, end, source, axes, point)

    def __iter__(self):
        return (self[k] for k in range(len(self)))

    def __eq__(self, other):
        return (
            isinstance(other, InputTrack)
            and np.array_equal(self.stamp_ns, other.stamp_ns)
            and all(mine == theirs for mine, theirs in zip(self, other))
        )

    def spans(self):
        """(start (m,), end (m,), number (m,)): ns since `base_ns` in which commands that are not zero act.

        A command ends where a later one of the same source, kind and name starts, a pull where one of any source does,
        or its source is cleared.
        """
        rows, order = self._rows.copy(), np.arange(len(self))
        is_clear = rows[:, KIND] == KINDS.index(CLEAR)
        dropped = is_clear.copy()
        for k in np.flatnonzero(is_clear):
            at, mine = rows[k, START], (rows[:, SOURCE] == rows[k, SOURCE]) & (order < k) & ~is_clear
            dropped |= mine & (rows[:, START] >= at)
            rows[mine, END] = np.minimum(rows[mine, END], at)
        order = order[~dropped]
        keys = rows[order][:, [SOURCE, KIND, NAME]]
        keys[keys[:, 1] == KINDS.index(PULL), 0] = -1
        by_key = np.lexsort((order, rows[order, START], *keys.T[::-1]))
        order, keys = order[by_key], keys[by_key]
        start, end = rows[order, START], rows[order, END]
        if len(order) > 1:
            follows = (keys[1:] == keys[:-1]).all(axis=1)
            end[:-1] = np.where(follows, np.minimum(end[:-1], start[1:]), end[:-1])
        acts = (end > start) & self._values[order, :VALUES].any(axis=1)
        by_start = np.argsort(start[acts], kind="stable")
        order = order[acts][by_start]
        return start[acts][by_start] - self.base_ns, _since(end[acts][by_start], self.base_ns), order

    def names(self, numbers):
        """[(kind, name)] of commands."""
        known = list(self._names)
        return [(KINDS[kind], known[name]) for kind, name in self._rows[numbers][:, [KIND, NAME]].tolist()]


def _since(end, base_ns):
    return np.where(end == FOREVER, FOREVER, end - base_ns)
