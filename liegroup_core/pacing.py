# SPDX-License-Identifier: Apache-2.0
"""Pacing of simulated time to the wall clock, with statistics of the scheduling latency.

Simulated time t is due at the wall time w0 + (t - t0) / factor. The anchor (t0, w0) is set at
start, resume and change of the factor: none of them causes a burst, and errors do not accumulate
from tick to tick. After a late tick the next ones follow without waiting until the delay is made
up. If the delay exceeds CATCH_UP, the anchor is reset and the event is counted.

All times are in seconds, wall times from a monotonic clock. Latency is reported in microseconds.
"""

import math
import time

# A run is too slow below this fraction of the requested real-time factor.
SLOW = 0.95

# The operating system wakes a sleeping thread 5 to 150 us late. So it is woken earlier, and polls the clock up to the
# deadline, with the GIL: this makes the median latency 0.1 us. With sleep(0) in the loop it is 18 us. It is woken
# earlier by the lateness that all but LATE of the recent ticks had, in s at most WATCH, because polling takes the core:
# each tick lowers this by LATE of its part CHANGE, and a tick that was later still raises it by the rest of that.
WATCH, LATE, CHANGE = 150e-6, 0.01, 0.1
SHORTEST = 50e-6  # s: to sleep and wake takes about as much CPU time

# Largest delay that is made up by ticks without waiting, s.
CATCH_UP = 0.1


class LatenessHistogram:
    """Histogram of scheduling latencies with bins of equal width on a log scale.

    Covers 0.1 us to 100 s; values outside count in the first or last bin. A quantile is the upper
    edge of its bin, at most the largest value: never too low, and too high by a factor of at most
    10^(1/PER_DECADE), 7.5 % (test_pacing.py). The largest value is exact.
    """

    PER_DECADE = 32
    LOWEST = 1e-7  # s
    DECADES = 9

    def __init__(self):
        self._counts = [0] * (self.PER_DECADE * self.DECADES)
        self.count = 0
        self.largest = 0.0  # s

    def add(self, lateness):
        """Count one latency in s."""
        bins = 0
        if lateness > self.LOWEST:
            bins = min(int(math.log10(lateness / self.LOWEST) * self.PER_DECADE), len(self._counts) - 1)
        self._counts[bins] += 1
        self.count += 1
        self.largest = max(self.largest, lateness)

    def quantile(self, fraction):
        """Latency in s that `fraction` of the values do not exceed; 0 without values."""
        rank = max(1, math.ceil(fraction * self.count))
        seen = 0
        for i, count in enumerate(self._counts):
            seen += count
            if seen >= rank:
                edge = self.LOWEST * 10.0 ** ((i + 1) / self.PER_DECADE)
                return min(edge, self.largest)
        return 0.0

    def microseconds(self):
        """{"p50", "p99", "max"} in us."""
        return {"p50": 1e6 * self.quantile(0.5), "p99": 1e6 * self.quantile(0.99), "max": 1e6 * self.largest}


class Pacer:
    """Waits until simulated time is due.

    factor : simulated seconds per wall second; 0: as fast as possible. After a change call `start`
    clock  : function that returns monotonic seconds
    sleep  : function of seconds; if it returns early it must return a true value

    ticks      : times that `wait` returned True
    early      : ticks before their deadline, as `earliest` allows
    overruns   : deadline misses: ticks whose deadline had passed when `wait` was called
    reanchored : number of anchor resets because of a delay beyond CATCH_UP
    lateness   : LatenessHistogram of all ticks that had a deadline, without those before it
    """

    def __init__(self, factor=1.0, clock=time.monotonic, sleep=time.sleep):
        self.factor = factor
        self._clock = clock
        self._sleep = sleep
        self.ticks = self.early = self.overruns = self.reanchored = 0
        self.lateness = LatenessHistogram()
        self._anchor = self._start = self._last = self._mark = (0.0, 0.0)
        self._spans = (0.0, 0.0)  # simulated and wall seconds of the finished stretches
        self._factor_seen = 0.0
        self._watch = WATCH  # s, how long before a deadline the thread is woken

    def start(self, sim_time):
        """Set the anchor at simulated time `sim_time`: at start, resume, or change of the factor."""
        self.stop()
        self._factor_seen = 0.0
        self._anchor = self._start = self._last = self._mark = (sim_time, self._clock())

    def stop(self):
        """End the stretch: the time until the next `start` is not counted."""
        self._spans = self._totals()
        self._start = self._last

    def wait(self, sim_time, longest=math.inf, earliest=None):
        """Wait until `sim_time` is due, at most about `longest` wall seconds.

        earliest : simulated time; the tick may be taken from the deadline of this time on. Deadlines of
                   later ticks do not change. None: not before its own deadline
        returns True if it is due: take the tick. False: call again.
        """
        now = self._clock()
        if self.factor > 0.0:
            t0, w0 = self._anchor
            deadline = w0 + (sim_time - t0) / self.factor
            allowed = deadline if earliest is None else w0 + (earliest - t0) / self.factor
            if allowed > now:
                if allowed - now > self._watch + SHORTEST:
                    wake = min(allowed - self._watch, now + longest)
                    if self._sleep(wake - now):
                        return False
                    now = self._clock()
                    change = CHANGE * ((now - wake > self._watch) - LATE)
                    self._watch = min(WATCH, (1.0 + change) * self._watch)
                    if allowed - now > WATCH:
                        return False
                while now < allowed:
                    now = self._clock()
            elif deadline <= now:
                self.overruns += 1
            if now < deadline:
                self.early += 1
                now = deadline  # the run is not faster than requested
            else:
                self.lateness.add(now - deadline)
            if now - deadline > CATCH_UP:
                self._anchor = (sim_time, now)
                self.reanchored += 1
        self.ticks += 1
        self._last = (sim_time, now)
        return True

    def _totals(self):
        """Simulated and wall seconds of all stretches, up to the last tick."""
        return tuple(span + last - start for span, last, start in zip(self._spans, self._last, self._start))

    def recent_factor(self):
        """Achieved real-time factor between the previous call and this one, at tick times."""
        sim, wall = (last - mark for last, mark in zip(self._last, self._mark))
        if wall > 0.0:
            self._factor_seen = sim / wall
            self._mark = self._last
        return self._factor_seen

    def report(self):
        """Statistics of all stretches as JSON types; pauses are not counted."""
        sim, wall = self._totals()
        return {
            "ticks": self.ticks,
            "overruns": self.overruns,
            "reanchored": self.reanchored,
            "lateness_us": self.lateness.microseconds(),
            "real_time_factor": sim / wall if wall > 0.0 else 0.0,
            "wall_seconds": wall,
            "sim_seconds": sim,
        }
