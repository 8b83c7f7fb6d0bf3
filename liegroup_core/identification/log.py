# SPDX-License-Identifier: Apache-2.0
"""Log of a real machine: values that acted on it, and values that were measured, with their times."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from liegroup_core.errors import SceneError

PREVIOUS, LINEAR = "previous", "linear"
HOLDS = (PREVIOUS, LINEAR)
# Third differences of white noise have 20 times its variance, whatever the polynomial of degree two below it.
THIRD, ROBUST = np.sqrt(20.0), 1.4826
LEAST = 1e-6  # of the spread of the values: no sensor is better
APART = 1.0  # s between joined recordings
REPEATED = 0.05  # share of equal neighbours from which on values are rounded


@dataclass(frozen=True, eq=False)
class Given:
    """Values of one input.

    name   : as `linear.channels.Inputs` takes it, such as JOINT.effort
    times  : (k,) s since the start of the log, that increase
    values : (k,) SI units
    hold   : previous: a value acts until the next one; linear: the mean of the straight line between two times acts
    """

    name: str
    times: np.ndarray
    values: np.ndarray
    hold: str = PREVIOUS

    def over(self, times):
        """(m,) values that act in the intervals between times (m + 1,); zero before the first one."""
        if self.hold == LINEAR:
            found = np.interp(times, self.times, self.values, left=0.0)
            return 0.5 * (found[1:] + found[:-1])
        row = np.searchsorted(self.times, times[:-1] + 1e-10, side="right") - 1
        return np.where(row >= 0, self.values[row], 0.0)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of one clock: those of a topic.

    name      : of the topic
    times     : (k,) s since the start of the log, that increase
    channels  : names of p outputs, as `linear.channels.Outputs` takes them
    values    : (k, p) SI units, NaN where nothing was measured
    deviation : (p,) standard deviations of the noise, NaN: estimated from third differences of the values
    delay     : s by which the times are late; None: to be estimated
    """

    name: str
    times: np.ndarray
    channels: tuple
    values: np.ndarray
    deviation: np.ndarray
    delay: float | None = None

    @cached_property
    def noise(self):
        """(p,) standard deviations, given or estimated: those of the values, in which fast motion shows, too."""
        return self.noise_of([self.values])

    @cached_property
    def least(self):
        """(p,) least standard deviations that noise may have."""
        return np.array([_least(values) for values in self.values.T])

    def noise_of(self, parts):
        """(p,) standard deviations, given or estimated from [(r, p)] parts of a signal with this noise."""
        columns = zip(self.deviation, self.values.T, zip(*(part.T for part in parts)))
        return np.array([s if np.isfinite(s) else _noise(values, signal) for s, values, signal in columns])


@dataclass(frozen=True, eq=False)
class Log:
    """Inputs and measurements.

    inputs   : [Given]
    measured : [Measured]
    parts    : [(first, last)] times in s of the measurements of each recording that is joined; none: of all
    Raises SceneError for times that do not increase, or without measurements.
    """

    inputs: tuple
    measured: tuple
    notes: tuple = field(default=())
    parts: tuple = field(default=())

    def __post_init__(self):
        for each in (*self.inputs, *self.measured):
            if len(each.times) == 0 or not (np.diff(each.times) > 0.0).all():
                raise SceneError(f"the times of {each.name} must increase, and there must be some")
        if not self.measured:
            raise SceneError("a log needs measurements")

    @property
    def spans(self):
        """[(first, last)] time in s of the measurements of each recording."""
        whole = min(each.times[0] for each in self.measured), max(each.times[-1] for each in self.measured)
        return self.parts or (whole,)


def joined(logs):
    """Log of several recordings of one machine with one map, as if one followed the other; inputs end in between."""
    if len(logs) == 1:
        return logs[0]
    shifts, end = [], 0.0
    for log in logs:
        times = [each.times[k] for each in (*log.inputs, *log.measured) for k in (0, -1)]
        shifts.append(end - min(times))
        end += max(times) - min(times) + APART
    inputs = []
    for parts in zip(*(log.inputs for log in logs)):
        times, values = [], []
        for each, shift, log in zip(parts, shifts, logs):
            last = max(one.times[-1] for one in (*log.inputs, *log.measured))
            times += [each.times + shift, [last + shift + 0.5 * APART]]
            values += [each.values, [0.0]]
        inputs.append(replace(parts[0], times=np.concatenate(times), values=np.concatenate(values)))
    measured = [
        replace(
            parts[0],
            times=np.concatenate([each.times + shift for each, shift in zip(parts, shifts)]),
            values=np.vstack([each.values for each in parts]),
        )
        for parts in zip(*(log.measured for log in logs))
    ]
    spans = [(first + shift, last + shift) for log, shift in zip(logs, shifts) for first, last in log.spans]
    return Log(tuple(inputs), tuple(measured), tuple(note for log in logs for note in log.notes), tuple(spans))


def _noise(values, parts):
    """Standard deviation of white noise on smooth signals, robust against outliers and jumps.

    It is at least that of rounding to the smallest step of the values, if they repeat.
    """
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    rounding = steps[steps > 0.0].min(initial=np.inf) / np.sqrt(12.0)
    resolved = rounding if len(steps) and (steps == 0.0).mean() > REPEATED and np.isfinite(rounding) else 0.0
    third = np.concatenate([np.diff(part[np.isfinite(part)], 3) for part in parts])
    found = max(ROBUST * float(np.median(np.abs(third))) / THIRD if len(third) else 0.0, resolved)
    return max(found, _least(known))


def _least(values):
    """Least standard deviation: numbers of a file have so many digits."""
    known = values[np.isfinite(values)]
    return max(LEAST * float(np.std(known)) if len(known) else 0.0, 1e-12)
