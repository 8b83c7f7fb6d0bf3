# SPDX-License-Identifier: Apache-2.0
"""Log of a real machine: values that acted on it, and values that were measured, with their times."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from liegroup_core.errors import SceneError
from liegroup_core.joints.motion import through, uniform

PREVIOUS, LINEAR, SPLINE = "previous", "linear", "spline"
HOLDS = (PREVIOUS, LINEAR, SPLINE)
MOTION = ".motion"  # end of the name of an input that is the position of a driven joint
# Third differences of white noise have 20 times its variance, whatever the polynomial of degree two below it.
THIRD, ROBUST = np.sqrt(20.0), 1.4826
LEAST = 1e-6  # of the spread of the values: no sensor is better
APART = 1.0  # s between joined recordings
WIDEST, PART_OF_LOG = 30.0, 0.5  # s, and of a recording: largest delay
LONG = 100.0  # s, before which joints move as at the first value: delays may move starts to there
FINER, WIDER = 1.2, 8  # numbers of knots that are compared: ratio, and how far beyond the best one
FEWEST = 4  # values that show a noise
ENOUGH = 9  # third differences from which on their median is known to a third
REPEATED = 0.05  # share of equal neighbours from which on values may be rounded
WHOLE = 0.1  # off a whole number of steps: any other value is farther away than that with a probability of 0.8


@dataclass(frozen=True, eq=False)
class Given:
    """Values of one input.

    name   : as `linear.channels.InputChannels` takes it, such as JOINT.effort, or JOINT.motion
    times  : (k,) s since the start of the log, that increase
    values : (k,) SI units
    hold   : previous: a value acts until the next one; linear: the mean of the straight line between two times acts;
             spline: that of the cubic spline through the values, of a motion the quintic one
    noise  : standard deviation, for a spline that smooths the values; None: it passes through them
    firsts : rows with which a recording begins, or goes on after a gap: a spline of its own
    """

    name: str
    times: np.ndarray
    values: np.ndarray
    hold: str = PREVIOUS
    noise: float | None = None
    firsts: tuple = (0,)

    def over(self, times):
        """(m,) values that act in the intervals between times (m + 1,); zero before the first one."""
        if self.hold == SPLINE:
            total = np.zeros(len(times) - 1)
            begins = [*(first for _, (first, _) in self.splines[1:]), np.inf]
            for (spline, (first, last)), after in zip(self.splines, begins):
                within, integral = np.clip(times, first, last), spline.antiderivative()
                total += np.diff(integral(within)) + spline(last) * np.diff(np.clip(times, last, after))
            return total / np.diff(times)
        if self.hold == LINEAR:
            found = np.interp(times, self.times, self.values, left=0.0)
            return 0.5 * (found[1:] + found[:-1])
        row = np.searchsorted(self.times, times[:-1] + 1e-10, side="right") - 1
        return np.where(row >= 0, self.values[row], 0.0)

    @property
    def _degree(self):
        """Degree of its splines: the acceleration of a motion acts, which a quintic one has ten times as well."""
        return 5 if self.name.endswith(MOTION) else 3

    @cached_property
    def splines(self):
        """[(spline, (first, last) time in s)] of its parts that have enough values. Raises SceneError for none."""
        found = []
        for rows in self._parts:
            times = self.times[rows]
            spline = _smoothed(times, self.values[rows], self.noise, self._degree)
            found.append((scipy.interpolate.PPoly.from_spline(spline), (times[0], times[-1])))
        return found

    @property
    def _parts(self):
        """[Rows] of the parts that have enough values for a spline. Raises SceneError for none."""
        parts = np.split(np.arange(len(self.times)), self.firsts[1:])
        found = [rows for rows in parts if len(rows) > self._degree]
        if not found:
            raise SceneError(f"{self.name} is a spline: it needs at least {self._degree + 1} values without gaps")
        return found

    @cached_property
    def unwrapped(self):
        """The same with angles that go on over whole turns."""
        return replace(self, values=np.unwrap(self.values))

    @cached_property
    def motion(self):
        """(m, 7) prescribed motions (joints/motion.py) along the splines; quintic polynomials join them."""
        points = []
        for spline, (first, last) in self.splines:
            knots = np.unique(spline.x[(spline.x >= first) & (spline.x <= last)])
            points.append(np.column_stack([knots, *(spline(knots, order) for order in range(3))]))
        points = np.vstack(points)
        begin, q, v, _ = points[0]
        rows = through(points[0, 1:], points[:, 0], *points[1:, 1:].T)
        return np.vstack([uniform(begin - LONG, q - LONG * v, v), rows])

    def covers(self, times):
        """(m,) whether a spline goes through times (m,)."""
        ends = [self.times[rows[[0, -1]]] for rows in self._parts]
        return np.any([(first <= times) & (times <= last) for first, last in ends], axis=0)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of one clock: those of a topic.

    name      : of the topic
    times     : (k,) s since the start of the log, that increase
    channels  : names of p outputs, as `linear.channels.OutputChannels` takes them
    values    : (k, p) SI units, NaN where nothing was measured
    deviation : (p,) standard deviations of the noise, NaN: estimated from third differences of the values
    delay     : s by which the times are late; None: to be estimated
    moved     : s by which the times are later than the stamps, as clocks differ by about that
    error     : (p,) errors of values of a simulation, as it estimates them
    """

    name: str
    times: np.ndarray
    channels: tuple
    values: np.ndarray
    deviation: np.ndarray
    delay: float | None = None
    moved: float = 0.0
    error: np.ndarray | float = 0.0

    @cached_property
    def noise(self):
        """(p,) standard deviations, given or estimated: those of the values, in which fast motion shows, too."""
        return self.noise_of([self.values])

    @cached_property
    def spread(self):
        """(p,) standard deviations of the values; 0 where nothing was measured."""
        columns = [column[np.isfinite(column)] for column in self.values.T]
        return np.array([np.std(column) if len(column) else 0.0 for column in columns])

    @cached_property
    def least(self):
        """(p,) least standard deviations that noise may have."""
        return np.array([_least(values) for values in self.values.T])

    def noise_of(self, parts):
        """(p,) standard deviations, given or estimated from [(r, p)] parts of a signal with this noise.

        Values that never change show none: it is that of the other components of their vector, as of one instrument.
        """
        columns = zip(self.deviation, self.values.T, zip(*(part.T for part in parts)))
        found = np.array([s if np.isfinite(s) else _noise(values, signal) for s, values, signal in columns])
        vectors = np.array([name[: len(name) - name.endswith(("x", "y", "z"))] for name in self.channels])
        for k in np.flatnonzero(~np.isfinite(self.deviation) & (self.spread == 0.0)):
            found[k] = found[vectors == vectors[k]].max()
        return found


@dataclass(frozen=True, eq=False)
class Log:
    """Inputs and measurements.

    inputs   : [Given] that act
    measured : [Measured]
    parts    : [(first, last)] times in s of the measurements of each recording that is joined; none: of all
    drives   : [Given] positions of driven joints
    acting   : [(time in s, Acting)] what acts from then on, in place of the scene's; none: by the scene
    Raises SceneError for times that do not increase, or without measurements.
    """

    inputs: tuple
    measured: tuple
    notes: tuple = field(default=())
    parts: tuple = field(default=())
    drives: tuple = field(default=())
    acting: tuple = field(default=())

    def __post_init__(self):
        for each in (*self.inputs, *self.drives, *self.measured):
            if len(each.times) == 0 or not (np.diff(each.times) > 0.0).all():
                raise SceneError(f"the times of {each.name} must increase, and there must be some")
        if not self.measured:
            raise SceneError("a log needs measurements")
        names = [each.name for each in self.inputs]
        for each in self.drives:
            effort = f"{each.name.removesuffix(MOTION)}.effort"
            if effort in names:
                raise SceneError(f"{effort} and {each.name} are both inputs: remove one, or measure the effort")

    @property
    def usable(self):
        """The same without outputs whose noise is not given nor can be estimated. Raises SceneError for no others."""
        measured, notes = [], []
        for each in self.measured:
            counts = np.isfinite(each.values).sum(axis=0)
            few = ~np.isfinite(each.deviation) & (counts < FEWEST)
            for name, count in zip(np.array(each.channels)[few], counts[few]):
                notes.append(f"{name} in {each.name}: {count} values do not show their noise: left out; give it")
            measured.append(replace(each, values=np.where(few, np.nan, each.values)) if few.any() else each)
        if not any(np.isfinite(each.values).any() for each in measured):
            raise SceneError(f"no output has {FEWEST} values: give its noise")
        return replace(self, measured=tuple(measured), notes=(*self.notes, *notes)) if notes else self

    @property
    def spans(self):
        """[(first, last)] time in s of the measurements of each recording."""
        whole = min(each.times[0] for each in self.measured), max(each.times[-1] for each in self.measured)
        return self.parts or (whole,)

    @cached_property
    def reach(self):
        """Largest delay in s: farther ones leave less than half of a recording to the inputs that acted."""
        return min(WIDEST, PART_OF_LOG * min(last - first for first, last in self.spans))


def _smoothed(times, values, sigma, degree):
    """Spline whose number of knots has the least expected error by Mallows' Cp; it may pass through the values.

    sigma : of the noise; None: it passes through the values
    """
    through_all = scipy.interpolate.make_interp_spline(times, values, degree)
    if sigma is None:
        return through_all
    # As many knots as a third of the values, as with more there may be none between two knots.
    n, count = len(times), 0
    best = 2.0 * n, n, through_all
    while count <= n // 3 and count <= WIDER * (best[1] + degree):
        inner = np.quantile(times, np.linspace(0.0, 1.0, count + 2)[1:-1])
        knots = np.concatenate([np.full(degree + 1, times[0]), inner, np.full(degree + 1, times[-1])])
        spline = scipy.interpolate.make_lsq_spline(times, values, knots, degree)
        expected = (((values - spline(times)) / sigma) ** 2).sum() + 2.0 * (count + degree + 1)
        best = min(best, (expected, count, spline), key=lambda each: each[0])
        count = max(count + 1, int(FINER * count))
    return best[2]


def joined(logs):
    """Log of several recordings of one machine with one map, as if one followed the other; inputs end in between."""
    if len(logs) == 1:
        return logs[0]
    shifts, end = [], 0.0
    for log in logs:
        times = [each.times[k] for each in (*log.inputs, *log.drives, *log.measured) for k in (0, -1)]
        shifts.append(end - min(times))
        end += max(times) - min(times) + APART
    inputs, drives = [], []
    for parts in zip(*((*log.inputs, *log.drives) for log in logs)):
        times, values, firsts = [], [], []
        for each, shift, log in zip(parts, shifts, logs):
            firsts += [sum(map(len, times)) + row for row in each.firsts]
            times.append(each.times + shift)
            values.append(each.values)
            if each.hold != SPLINE:
                last = max(one.times[-1] for one in (*log.inputs, *log.measured))
                times.append([last + shift + 0.5 * APART])
                values.append([0.0])
        whole = {"times": np.concatenate(times), "values": np.concatenate(values), "firsts": tuple(firsts)}
        (drives if parts[0].name.endswith(MOTION) else inputs).append(replace(parts[0], **whole))
    measured = [
        replace(
            parts[0],
            times=np.concatenate([each.times + shift for each, shift in zip(parts, shifts)]),
            values=np.vstack([each.values for each in parts]),
            error=np.max([each.error + np.zeros(len(each.channels)) for each in parts], axis=0),
        )
        for parts in zip(*(log.measured for log in logs))
    ]
    spans = [(first + shift, last + shift) for log, shift in zip(logs, shifts) for first, last in log.spans]
    notes = tuple(note for log in logs for note in log.notes)
    return Log(tuple(inputs), tuple(measured), notes, tuple(spans), tuple(drives))


def _noise(values, parts):
    """Standard deviation of white noise on smooth signals, robust against outliers and jumps.

    It is at least that of rounding to the smallest step of the values, if they repeat and all steps are whole numbers
    of it: values that only rest for a while are not rounded. Parts that are too short for differences are all noise.
    """
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    least = steps[steps > 0.0].min(initial=np.inf)
    parts_off = np.abs(steps / least - np.round(steps / least))
    is_rounded = len(steps) and (steps == 0.0).mean() > REPEATED and np.isfinite(least) and parts_off.max() < WHOLE
    resolved = least / np.sqrt(12.0) if is_rounded else 0.0
    parts = [part[np.isfinite(part)] for part in parts]
    third = np.concatenate([np.diff(part, 3) for part in parts])
    if len(third) >= ENOUGH:
        found = ROBUST * float(np.median(np.abs(third))) / THIRD
    else:  # all of a signal may be noise
        rest = np.concatenate(parts)
        found = min(float(np.sqrt(np.mean(rest**2))), float(np.std(known))) if len(rest) else 0.0
    return max(found, resolved, _least(known))


def _least(values):
    """Least standard deviation: numbers of a file have so many digits."""
    known = values[np.isfinite(values)]
    return max(LEAST * float(np.std(known)) if len(known) else 0.0, 1e-12)
