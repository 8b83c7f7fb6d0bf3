# SPDX-License-Identifier: Apache-2.0
"""Drift of conserved quantities, computed block by block: largest and final change, trend, curve."""

import numpy as np

MOST_POINTS = 20_000  # of a curve; it keeps minimum and maximum of each group of neighbouring points
MOST_PIECES = 2000  # intervals in a curve; the figures cover all intervals


def extremes(values, every):
    """Rows of the minimum and the maximum of values (k,) in each group of 2 * every neighbours."""
    count = len(values)
    if every <= 1 or count <= 1:
        return np.arange(count)
    size = 2 * every
    rows = np.arange(-(-count // size) * size).clip(max=count - 1).reshape(-1, size)
    groups = np.arange(len(rows))
    indices = [rows[groups, values[rows].argmin(axis=1)], rows[groups, values[rows].argmax(axis=1)]]
    return np.unique(indices)


def thinned(times, values, every):
    """Times (k,) and values (k,), reduced to the extremes of groups of neighbours."""
    rows = extremes(values, every)
    return times[rows], values[rows]


class Drift:
    """Change of c conserved quantities since the start of each interval without a wrench.

    bodies   : a wrench on any of them ends an interval
    expected : number of samples to be added

    worst (c,), final (c,) : largest and last change; intervals of one sample do not count
    intervals, seconds     : number and total length of the evaluated intervals
    trend (c,)             : slope per s of a least-squares line, common to all intervals
    explained (c,)         : fraction of the variance that the trend explains, 0 to 1
    curves                 : c lists of (times, change), one per interval
    """

    def __init__(self, count, bodies, expected):
        self._bodies = bodies
        self._every = -(-expected // MOST_POINTS)
        self.worst, self.final = np.zeros(count), np.zeros(count)
        self.intervals, self.seconds = 0, 0.0
        self.curves = [[] for _ in range(count)]
        self._sums = np.zeros(1), np.zeros(count), np.zeros(count)  # xx, xy, yy
        self._stretch = self._open = None

    def add(self, block, values):
        """Add the values (k, c) of a Block."""
        if block.stretch is not self._stretch:
            self.close()
            self._stretch = block.stretch
            self._left = block.stretch.free(self._bodies)
            self._next = 0
        steps, times = block.steps, block.log_times
        while self._next < len(self._left):
            first, last = self._left[self._next]
            a = int(np.searchsorted(steps, first))
            b = int(np.searchsorted(steps, last, "right"))
            if a < b:
                self._take(times[a:b], values[a:b])
            if last >= steps[-1]:
                break
            self.close()
            self._next += 1

    def _take(self, times, values):
        if self._open is None:
            self._open = _Interval(times[0], values[0])
        self._open.add(times, values, self._every)

    def close(self):
        """End the current interval. Call it also after the last block."""
        done, self._open = self._open, None
        if done is None or done.count < 2:
            return
        self.intervals += 1
        self.seconds += float(done.last - done.since)
        self.worst = np.maximum(self.worst, done.worst)
        self.final = done.final
        for total, part in zip(self._sums, done.centred()):
            total += part
        for curve, parts in zip(self.curves, done.parts):
            if len(curve) < MOST_PIECES:
                curve.append(tuple(np.concatenate(part) for part in zip(*parts)))

    @property
    def trend(self):
        xx, xy, _ = self._sums
        return xy / xx if xx[0] > 0.0 else np.zeros_like(xy)

    @property
    def explained(self):
        xx, xy, yy = self._sums
        return np.divide(xy * xy, xx * yy, out=np.zeros_like(xy), where=xx * yy > 0.0)


class _Interval:
    """Sums over one interval that has not ended."""

    def __init__(self, time, start):
        self.since = self.last = time
        self._start = start.copy()
        self.count = 0
        self.worst = self.final = np.zeros(len(start))
        self.parts = [[] for _ in start]
        self._sums = np.zeros((5, len(start)))  # x, y, xx, xy, yy

    def add(self, times, values, every):
        change, x = values - self._start, (times - self.since)[:, None]
        self.count += len(times)
        self.last, self.final = times[-1], change[-1]
        self.worst = np.maximum(self.worst, np.abs(change).max(axis=0))
        for row, part in zip(self._sums, (x, change, x * x, x * change, change * change)):
            row += part.sum(axis=0)
        for curve, column in zip(self.parts, change.T):
            curve.append(tuple(part.copy() for part in thinned(times, column, every)))

    def centred(self):
        """Sums of squares and products about the means: xx, xy, yy."""
        x, y, xx, xy, yy = self._sums
        n = self.count
        return (xx - x * x / n)[:1], xy - x * y / n, yy - y * y / n
