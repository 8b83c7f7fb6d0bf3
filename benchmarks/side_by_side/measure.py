# SPDX-License-Identifier: Apache-2.0
"""Cost and error of each configuration of each code, measured in the same way.

A ladder of ever finer settings is run once to its end for the errors. Then only the rungs around
a target are timed, all codes in turn, round by round, so that slow moments of the machine affect
all of them. Time is the CPU time of this process, all threads, over native loops.
"""

import math
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

TARGETS = (1e-3, 1e-6, 1e-9)
# Least CPU time of a timing, s: a call from Python takes some 1e-5 s, which is then negligible.
SHORTEST = 0.03
# Runs above this CPU time, s, are timed once.
LONG = 0.5


class Run(Protocol):
    """A code with a problem and a configuration, ready to run."""

    def reset(self):
        """Restore the initial state."""

    def advance(self, times):
        """Advance by `count` problem durations in a native loop; ArithmeticError on failure."""

    def end(self):
        """Attitudes (n, 3, 3) of all bodies, and the largest gap of a joint, m or rad."""

    def steps_per_duration(self):
        """Steps that `advance(1)` takes."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A code and its configuration.

    levels  : settings from coarse to fine: steps per duration, or tolerances
    start   : level -> Run
    counted : False for entries outside of the ranking, shown for comparison only
    kind    : group of a code's settings that are compared with each other
    """

    code: str
    setting: str
    levels: Iterable
    start: Callable
    counted: bool = True
    kind: str = ""


@dataclass(eq=False)
class Rung:
    """One refinement level of an entry with its results; steps and CPU s per simulated second."""

    level: float
    attitude_error: float
    gap: float
    steps: float
    estimate: float
    run: Run | None
    times: list = field(default_factory=list)

    @property
    def error(self):
        """Larger of the attitude error and the constraint residual."""
        return max(self.attitude_error, self.gap)

    @property
    def cost(self):
        return statistics.median(self.times) if self.times else self.estimate


@dataclass(frozen=True)
class Cost:
    """Cost of reaching a target error: CPU s and steps, both per simulated second."""

    cost: float
    steps: float
    gap: float


def geometric(first, ratio, last=10_000_000):
    """Integers from first to last, growing by about `ratio`."""
    return [round(first * ratio**k) for k in range(math.floor(math.log(last / first) / math.log(ratio)) + 1)]


def _finite(value):
    return float(value) if np.isfinite(value) else math.inf


def climb(entry, problem, exact, budget):
    """Rungs of an entry until two meet the last target or the next would exceed `budget` s."""
    rungs, took = [], 0.0
    for level in entry.levels:
        run = entry.start(level)
        run.reset()
        start = time.process_time()
        error = gap = math.inf
        steps, before = 0, took
        try:
            run.advance(1)
            took = time.process_time() - start
            rotations, gap = run.end()
            error = _finite(np.linalg.norm(np.asarray(rotations) - exact, axis=(1, 2)).max())
            steps = run.steps_per_duration()
        except ArithmeticError:
            took = time.process_time() - start
        rungs.append(Rung(level, error, _finite(gap), steps / problem.duration, took / problem.duration, run))
        if len(rungs) > 1 and max(rung.error for rung in rungs[-2:]) <= TARGETS[-1]:
            break
        if took * max(1.0, took / before if before > SHORTEST else 1.0) > budget:
            break
    return rungs


def _settled_errors(rungs):
    """Largest error of each rung and all finer ones, which removes accidentally small errors."""
    return np.maximum.accumulate([rung.error for rung in rungs[::-1]])[::-1]


def bracket(rungs, target):
    """Indices (coarser or None, finer) of the rungs around a target, or None if it is not met."""
    errors = _settled_errors(rungs)
    met = np.flatnonzero(errors <= target)
    if not len(met):
        return None
    i = int(met[0])
    return (i - 1 if i and errors[i - 1] < math.inf else None), i


def cost_at(rungs, target):
    """Cost of meeting a target, or None; the error is interpolated as a power of the cost."""
    found = bracket(rungs, target)
    if found is None:
        return None
    coarse, fine = found[0], rungs[found[1]]
    if coarse is None:
        part, coarse = 1.0, fine
    else:
        errors = _settled_errors(rungs)[list(found)]
        part = math.log(errors[0] / target) / math.log(errors[0] / max(errors[1], 1e-16))
        coarse = rungs[coarse]
    return Cost(coarse.cost ** (1 - part) * fine.cost**part, coarse.steps ** (1 - part) * fine.steps**part, fine.gap)


def time_run(run, duration, estimate):
    """CPU s per simulated second of a run, timed over at least SHORTEST."""
    times = max(1, math.ceil(SHORTEST / max(estimate * duration, 1e-7)))
    while True:
        run.reset()
        start = time.process_time()
        try:
            run.advance(times)
            return (time.process_time() - start) / (times * duration)
        except ArithmeticError:
            # With coarse steps the run may fail after several durations.
            if times == 1:
                raise
            times = (times + 1) // 2


def time_ladders(ladders, duration, rounds):
    """Time the rungs around the targets, all ladders in turn, and release the other runs."""
    chosen = []
    for rungs in ladders:
        wanted = {i for target in TARGETS for i in bracket(rungs, target) or ()}
        for i, rung in enumerate(rungs):
            if i in wanted and rung.estimate * duration < LONG:
                chosen.append(rung)
            else:
                rung.run = None
    for _ in range(rounds):
        for rung in chosen:
            # The estimate is from a cold start; later rounds use the first measured time.
            known = rung.times[0] if rung.times else rung.estimate
            rung.times.append(time_run(rung.run, duration, known))
    for rung in chosen:
        rung.run = None


def seconds_per_step(take_steps, shortest, rounds):
    """Median CPU s of a step; `take_steps(n)` takes n steps in one native loop."""
    steps = 1
    while True:
        start = time.process_time()
        take_steps(steps)
        took = time.process_time() - start
        if took >= shortest:
            break
        steps = max(2 * steps, math.ceil(1.2 * shortest / max(took, 1e-6) * steps))
    times = [took / steps]
    for _ in range(rounds - 1):
        start = time.process_time()
        take_steps(steps)
        times.append((time.process_time() - start) / steps)
    return statistics.median(times)
