# SPDX-License-Identifier: Apache-2.0
"""Accuracy control: the tolerance of the steps follows the estimate of the global error.

The error bound at time t is accuracy * max(1, t / horizon). Steps are taken with error control. Their
tolerance, in rad or relative to the characteristic length, is set at every checkpoint of the running error. A
velocity error acts on the poses forever, so step errors, tol per second, add up to

    V = int tol dt ,   X = int V dt ,   estimated error E = gain X

with a measured gain. Over the next r seconds, with another tolerance, X becomes

    X + V r + tol r^2 / 2 ,   and gain times that must not exceed AIM times the error bound.

r is the horizon, or the time so far if that is longer: velocity errors must leave room for all the time
to come.

The gain shows whether errors decay, oscillate or grow exponentially. Past error cannot be undone: tol is
never lowered below the value that adds NEW of it. Once the motion is unpredictable, the tolerance is that
of the start, which conserves the energy. Decisions depend only on states and wrenches, so that a repeated
run is bit-identical.
"""

import math

from liegroup_core.settings import SETTINGS

METHOD = "rkmk853"
AIM, NEW = 0.1, 0.03
KEPT = 0.85  # fraction of the gain kept from one checkpoint to the next, because it oscillates with the motion
# Conservative motions have a gain of 5 to 10, once it can be measured. So at least this gain is assumed up to the
# fraction SHOWN of the horizon, and later at least the error that it gives there.
LEAST_GAIN, SHOWN = 2.0, 0.1
# Tolerance relative to the accuracy: at the start with a horizon of 1 s, and largest. It starts small, because
# the errors of the first steps remain, and grows to the allowed value within a few checkpoints.
FIRST, LARGEST = 3e-4, 0.03
LEAST_TOLERANCE = 1e-15
FASTER, SLOWER = 2.0, 0.1  # bounds of the ratio of two successive tolerances
_FOUND = ("time", "error", "wanted", "tenfold", "room", "finer")
# Decades below the error bound in which the growth is measured, and the ratio to a finer accuracy.
DECADES, FINER = 3, 100.0
RESOLVED = 8.0  # least time of these decades, in checkpoints
# Gain up to which errors that grow are those of rounding, and not of the tolerances, which a finer accuracy lowers.
SEEDED = 1.0
# Mean of the tolerances, as a multiple of the least one, up to which errors are round-off.
ROUNDING = 2.0


class AccuracyControl:
    """Sets the tolerances of a simulation and of its companion.

    accuracy : largest error of a pose, relative to the characteristic length or in rad
    horizon  : s, in which the error may grow by the accuracy
    tighten  : function of a tolerance as a fraction of `accuracy`

    given    : accuracy at the start
    accuracy : present one, see `change`
    ended    : s, the last checkpoint or change of the accuracy before the estimate exceeded the error bound; inf: never
    found    : where it did: "time", "error" and "wanted", "tenfold": time in s in
               which errors grow tenfold, 0 if they do not grow exponentially, "room": mean of the
               tolerances so far, as a multiple of the least one, and "finer": whether smaller tolerances help
    """

    KEPT = (
        *("accuracy", "_begin", "_last", "_below", "_sum", "_double_sum", "_gain", "_early", "ended", "found"),
        "tolerance",
    )

    def __init__(self, accuracy, horizon, tighten):
        self.given, self.horizon, self._tighten = accuracy, horizon, tighten
        self.restart(0.0)

    def restart(self, time):
        """Clear errors and changes of the accuracy, because the state was set."""
        self.accuracy = self.given
        self._begin = self._last = time
        # Last times with an estimate 10, 100, 1000 times below the error bound.
        self._below = [time] * DECADES
        self._sum = self._double_sum = self._gain = self._early = 0.0
        self.ended = math.inf
        self.found = dict.fromkeys(_FOUND, math.nan)
        self.tolerance = self._first

    @property
    def _first(self):
        return FIRST * self.accuracy / max(1.0, self.horizon)

    @property
    def tolerance(self):
        """Present tolerance, rad or relative to the characteristic length."""
        return self._tolerance

    @tolerance.setter
    def tolerance(self, tolerance):
        self._tolerance = max(LEAST_TOLERANCE, min(LARGEST * self.accuracy, tolerance))
        self._tighten(self._tolerance / self.given)

    def wanted(self, time):
        """Error bound at a time in s."""
        return self.accuracy * max(1.0, (time - self._begin) / self.horizon)

    def change(self, accuracy, time, error):
        """Continue with another accuracy; the estimated error at a time in s may exceed that, too."""
        self._pass(time)
        tolerance = self._tolerance * accuracy / self.accuracy
        self.accuracy = accuracy
        if not error > self.wanted(time):
            self.ended = math.inf
        elif self.ended == math.inf:
            self._end(time, time, error)
        self.tolerance = tolerance

    def _pass(self, time):
        """Add the steps up to a time in s, of the present tolerance; returns when the last ones ended."""
        before, self._last = self._last, time
        span = time - before
        self._double_sum += (self._sum + 0.5 * self._tolerance * span) * span
        self._sum += self._tolerance * span
        return before

    def _end(self, before, time, error):
        """Note an estimate at a time in s that exceeds the error bound, and did not before."""
        self.ended, room = before, self._sum / (time - self._begin) / LEAST_TOLERANCE
        tenfold = self._tenfold(time, time - before)
        self.found = dict(zip(_FOUND, (time, error, self.wanted(time), tenfold, room, float(self._early > SEEDED))))

    def update(self, time, error, predictable):
        """Set the tolerance from the estimated error at a checkpoint."""
        since, wanted = time - self._begin, self.wanted(time)
        before = self._pass(time)
        if error <= wanted * 10.0**-DECADES:
            self._early = error / self._double_sum
        if not error <= wanted and self.ended == math.inf:
            self._end(before, time, error)
        self._below = [time if error <= wanted * 10.0**-k else below for k, below in enumerate(self._below, 1)]
        if not predictable:
            self.tolerance = self._first
        if not (predictable and math.isfinite(error)):
            return
        ahead = max(self.horizon, since)
        allowed = AIM * self.wanted(time + ahead)
        shown = min(1.0, SHOWN * self.horizon / since)
        self._gain = max(error / self._double_sum, KEPT * self._gain)
        gain = max(LEAST_GAIN * shown**2, self._gain)
        committed = self._double_sum + self._sum * ahead
        tolerance = 2.0 * max(allowed / gain - committed, NEW * committed) / ahead**2
        self.tolerance = min(max(tolerance, SLOWER * self._tolerance), FASTER * self._tolerance)

    def find_first(self, span, error_after):
        """Reduce the first tolerance while the error after the first `span` s shows that it is too large.

        error_after : function that returns the estimated error there, with the present tolerance; NaN: it is not needed
        Errors of fast motions add up faster: those of a body that spins at w grow with w^2. An error that does not
        fall with the tolerance is round-off.
        """
        found = None
        while (error := error_after()) < math.inf:
            if found is not None and error > 0.5 * found[1]:
                self.tolerance = found[0]
                return
            found = self._tolerance, error
            gain = error / (0.5 * self._tolerance * span**2)
            needed = 2.0 * AIM * self.accuracy / (gain * self.horizon**2) if gain > LEAST_GAIN else math.inf
            if needed > SLOWER * self._tolerance or self._tolerance <= LEAST_TOLERANCE:
                return
            self.tolerance = needed

    def _tenfold(self, time, span):
        """Time in s in which the estimate grows tenfold; 0 if it does not grow exponentially.

        Growth is exponential if the last decade took no longer than the two before. Powers of the time up to
        the fourth take longer. A jump passes the decades within a few checkpoints, span : s between two.
        """
        all_of_them = time - self._below[-1]
        last, *earlier = (end - start for end, start in zip([time, *self._below], self._below))
        jumps = min(earlier) <= 0.0 or all_of_them < RESOLVED * span
        return 0.0 if jumps or last > sum(earlier) else all_of_them / DECADES

    @property
    def reason(self):
        """Text that says why the accuracy ended and what can be done; empty if that is unknown."""
        if self.ended == math.inf:
            return ""
        tenfold, room = self.found["tenfold"], self.found["room"]
        if room <= ROUNDING:
            return "this is round-off: smaller steps do not help, a larger accuracy holds longer"
        if not tenfold:
            return ""
        grow = f"errors grow tenfold in about {tenfold:.2g} s"
        if not self.found["finer"] or min(room, self.found["wanted"] / SETTINGS["accuracy"].low) < FINER:
            return grow
        return (
            f"{grow}: with an accuracy {FINER:g} times smaller they would reach this size about "
            f"{math.log10(FINER) * tenfold:.2g} s later"
        )
