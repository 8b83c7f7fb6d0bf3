# SPDX-License-Identifier: Apache-2.0
"""Predictions beside a running machine: runs from where it was at past instants, against what was measured since.

The last seconds are divided into segments. Each one shows the state at its start, and a run goes on from there to the
present. Time ahead counts from the end of the segment, as measurements in it are no test of a prediction.
"""

import numpy as np

from .comparison import PART, continued, refined, runs_of
from .fit import ORDER, Fit
from .horizon import horizons
from .runs import Unknowns
from .starts import ROUGHLY, shortest

ENDS = np.array([0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0])  # s, of the intervals of times ahead
START = 0.3  # s, of the measurements that show a start: multiples of this
PRESENT = 1.0  # s: the last measurements, with which predictions are compared


class Shadow:
    """Runs of a scene beside a machine, whose log grows; all calls are of one thread.

    scene : Scene
    """

    def __init__(self, scene):
        self._scene, self._runs, self._point, self._channels = scene, None, None, None

    def horizons(self, log):
        """[Horizon] of the outputs of a Log, up to ENDS ahead; [] before a second segment begins.

        log : of the last seconds, at least `seconds`; its times go on from call to call, and its delays are known
        Raises SceneError for unknown channels, or where a log does not show its noise; SimulationError if no run from
        a measured state succeeds.
        """
        log = log.usable
        self._follow(log)
        bounds = self._bounds(log)
        if len(bounds) < 2:
            return []
        fit = Fit(self._runs, [each.noise for each in log.measured], [False] * len(log.measured), workers=1)
        delays = np.array([each.delay or 0.0 for each in log.measured])
        point = self._point or Unknowns(bounds[:0], delays, self._runs.numbers.values, ())
        self._point = None  # a start anew, should this fail
        near = fit.solve(continued(fit, bounds, point), ROUGHLY)
        near = refined(fit, near)
        found = horizons(fit, near, near, ENDS, log.spans[0][1] - PRESENT)
        self._point = self._next(near.point, bounds, found)
        return found

    @staticmethod
    def seconds(log):
        """Time in s of the last measurements that `horizons` uses."""
        return float(ENDS[-1]) + 3.0 * _length(log)

    def _follow(self, log):
        """Take a log, without building the machine anew if its channels are the same."""
        channels = [each.name for each in log.inputs], [each.channels for each in log.measured]
        if channels == self._channels and not log.drives:
            self._runs.use(log)
        else:
            self._runs, self._channels, self._point = runs_of(self._scene, log), channels, None

    def _bounds(self, log):
        """(s, 2) s, of segments at multiples of their length; the last one goes on to the end of the log."""
        (first, last), length = log.spans[0], _length(log)
        count = int(np.ceil(ENDS[-1] / length)) + 2
        begins = length * np.arange(np.ceil(first / length), np.floor(last / length))[-count:]
        return np.column_stack([begins, np.append(begins, last + 1e-6)[1:]])

    @staticmethod
    def _next(point, bounds, found):
        """Unknowns with which the next call begins: without the last segment, which is not over."""
        worst = max(((each.numerical[0] / each.noise) for each in found), default=PART)
        fewer = point.halves > 0 and worst * 2**ORDER < PART  # the motion has become slow
        return Unknowns(bounds[:-1], point.delays, point.values, point.states[:-1], point.halves - fewer)


def _length(log):
    """Length of segments in s."""
    return START * np.ceil(shortest(log) / START - 1e-9)
