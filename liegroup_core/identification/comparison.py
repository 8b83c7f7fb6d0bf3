# SPDX-License-Identifier: Apache-2.0
"""Comparison of a log with a scene: what noise, errors of the integration, and the model account for."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.linear.coordinates import Coordinates

from .contradictions import Effect, Effects, Missing, channel_fits
from .fit import Fit, Solution
from .horizon import Horizon, horizons
from .runs import Runs, Unknowns
from .starts import first_states, has_others, starts_of, state_at

LEVEL = 0.95  # of intervals
LENGTH = 2.0  # s, of a segment
PARTS = (16, 4, 1)  # of the length: segments with which fits begin, as short ones need no good start
FEW_SEGMENTS = 4  # of the longest, with which fits begin
ENOUGH = 3  # messages in a segment, on average: two positions of a joint fit any model, by its start
LEAST = 9  # measurements in a segment: as many as the first guess of a start takes
LINEAR = 0.01  # of the spread of an output: largest rms that is not noise, for effects to be linear
# Three standard deviations of mean square minus estimated variance of n residuals that are white noise, by the variance
# and sqrt(n): those of the mean square, sqrt(2), and of third differences, 3.1, which are correlated with it.
BY_CHANCE = 3.0 * 2.7
# Largest growth G of differences in a segment. Columns have a relative error of 1e-8 G, see CHANGE, and starts explain
# all but 1/G of what delays and numbers change: of what is left, the error is 1e-8 G^2, here 1e-2.
PARTED = 1e3
MUCH_PARTED = 1e5  # expected growth with which longer segments are not tried
LONGEST = 0.01  # s, first longest step; it is halved until the errors are a small part of the noise
PART = 0.1  # of the noise: largest error of the integration
MOST_HALVES = 8
RANGE, LAGS = 1.0, 41  # s, delays up to this are tried first; their number
# s, and of a recording: delays up to these are tried at the same distance, then finer, if none before leaves noise.
WIDEST, PART_OF_LOG, CANDIDATES, FINER = 30.0, 0.5, 10, 11
NOISY = 4.0  # mean square that is nearly noise: a wrong model does not lead to a delay far away
NEAR = 100.0  # mean square: residuals of ten deviations are no question of single clocks, and show no delay
CLEARLY = 0.25  # of the mean square without a delay
FEW = 1.0  # s of the log in which they are tried, at least
KEPT = 0.5  # share of the measurements of a clock that stay
ORDER = 4
MOST_RESTARTS = 5  # of fits, from where segments before end
REFINED, MOST_REFINED = 0.1, 3  # change of the noise that is small, and repetitions
ROUGHLY = 1e-3  # relative decrease of the sum of squares in the last step: effects are judged by larger ones


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of a log with a scene.

    fit, solution : Fit, Solution
    horizons : [Horizon] of the outputs, how far ahead the model predicts them
    channels : [ChannelFit]
    effects  : [Effect] that explain residuals, one after the other
    alone    : [Effect], each alone, by share
    missing  : [Missing] efforts against the motion of each joint, by share; none where the log agrees
    numerics : [(p,)] largest estimated error of the integration by the noise, of each Measured
    """

    fit: Fit
    solution: Solution
    channels: list
    effects: list[Effect]
    alone: list[Effect]
    missing: list[Missing]
    numerics: list
    horizons: list[Horizon]

    @property
    def worst(self):
        """ChannelFit with the largest residuals by its noise."""
        return max(self.channels, key=lambda channel: channel.chi / channel.limit)

    @property
    def agrees(self):
        """Whether residuals are as small as the noise, no effect explains them, and longer runs are off by no more."""
        return self._is_noise and (self.horizon is None or self.horizon.differs_from == np.inf)

    @property
    def horizon(self):
        """Horizon of the output that differs first, or is predicted for the shortest part of its time; None: none."""

        def order(each):
            return each.differs_from, each.within_noise / each.ahead[-1]

        return min(self.horizons, key=order, default=None)

    @property
    def _is_noise(self):
        return bool(self.worst.chi <= self.worst.limit) and not self.effects

    @property
    def delays(self):
        """{topic: (s, standard deviation)} of the clocks.

        The deviation is 0 where the delay was given, inf where the log does not show it: also where it is at the border
        of those that are tried, or the model is far off.
        """
        found, variances, k = {}, np.diag(self.solution.covariance), 0
        chi, log = max(1.0, self.reduced), self.fit.runs.log
        border = reach(log) - RANGE / (LAGS - 1)
        for each, delay, free in zip(log.measured, self.solution.point.delays, self.fit.free):
            is_known = abs(delay) <= border and chi <= NEAR
            deviation = 0.0 if not free else np.sqrt(variances[k] * chi) if is_known else np.inf
            found[each.name] = float(delay - each.moved), float(deviation)
            k += bool(free)
        return found

    @property
    def guessed(self):
        """Names of independent coordinates that were not measured: a fit may find wrong starts of theirs."""
        runs = self.fit.runs
        if has_others(runs.log):
            return []
        known = [name.removesuffix(".position") for each in runs.log.measured for name in each.channels]
        machine = runs.machine(self.solution.point.values)
        machine.at(self.solution.point.states[0])
        names = [freedom.name for freedom in machine.layout.freedoms]
        found = Coordinates(machine.probe, preferred=[name for name in known if name in names])
        return [name for name in found.names if name not in known and name not in machine.layout.motions]

    @cached_property
    def starts(self):
        """[SegmentStart] of the segments."""
        return starts_of(self.fit, self.solution, max(1.0, self.reduced))

    @cached_property
    def reduced(self):
        """Sum of the squares of the weighted residuals by the degrees of freedom."""
        return float(self.solution.left @ self.solution.left) / self._freedom

    @cached_property
    def _freedom(self):
        unknowns = sum(basis.shape[1] for basis in self.solution.bases) + self.solution.columns.shape[1]
        count = sum(int(np.isfinite(part).sum()) for parts in self.solution.residuals for part in parts)
        return max(count - unknowns, 1)

    @property
    def half_width(self):
        """Half of a 95 % interval by the standard deviation: of Student's distribution if noise is estimated."""
        if all(np.isfinite(each.deviation).all() for each in self.fit.runs.log.measured):
            return float(scipy.special.ndtri(0.5 + 0.5 * LEVEL))
        return float(scipy.special.stdtrit(self._freedom, 0.5 + 0.5 * LEVEL))

    @property
    def verdict(self):
        """What the model predicts, and what the largest contradiction is."""
        worst, solution, horizon = self.worst, self.solution, self.horizon
        text = "" if horizon is None else f"The model {horizon.text}. "
        if self.agrees:
            return f"{text}The measurements agree with it: what is left is noise."
        if self._is_noise:
            longest = max(segment.times[-1] - segment.start for segment in self.fit.runs.segments(solution.point))
            return f"{text}Segments of {longest:.3g} s, each with its own start, agree with it, but longer runs do not."
        text += "" if solution.converged else "The fit of the starts did not converge. "
        if worst.chi > worst.limit:
            text += f"{worst.name} is {worst.chi:.3g} times its noise off (rms {worst.rms:.3g})."
        else:
            text += f"{worst.name} is as near as its noise (rms {worst.rms:.3g}), but what is left is not noise."
        if not self.effects:
            return text + " No single effect explains it."
        first = self.effects[0]
        share = f"{100.0 * first.share:.3g} % of the sum of squares"
        text += f" {first.text[0].upper()}{first.text[1:]}, {_sized(first)}, would explain {share}"
        others = [each for each in self.alone if each.text != first.text and each.share > 0.9 * first.share]
        if others:
            text += f"; so would {others[0].text}, {_sized(others[0])}, for {100.0 * others[0].share:.3g} %"
        more = self.effects[1:]
        return text + (f"; after it {', '.join(f'{each.text} ({_sized(each)})' for each in more)}." if more else ".")


def _sized(effect):
    return f"{effect.value:.3g} {effect.unit}".strip().removesuffix(" 1")


def compare(scene, log, length=LENGTH, workers=None):
    """Comparison of a Log with a Scene.

    length  : s, of the longest segments, each of which starts anew; shorter ones where the model is far off
    workers : threads; None: as many as cores
    Raises SceneError for unknown channels, SimulationError if the scene cannot be simulated from the measured start.
    """
    fit, solution, _ = fitted(scene, log, (), length, workers)
    return judged(fit, solution)


def fitted(scene, log, names=(), length=LENGTH, workers=None, limits=None, priors=None, held_out=0.0):
    """(Fit, Solution, bounds of the segments left out) with the longest segments in which the model is near.

    A fit of a few of the longest segments finds the length and nearly the numbers; one of all segments continues.

    names, limits, priors : of numbers that vary, see Fit
    held_out : share of the segments, at the end, that are left out
    """
    fit, bounds = begin(scene, log, names, length, workers, limits, priors)
    kept = max(1, len(bounds[-1]) - round(held_out * len(bounds[-1])))
    few = np.unique(np.linspace(0, kept - 1, FEW_SEGMENTS).astype(int))
    found, level = _nested(fit, [_divided(each, few, len(bounds[-1])) for each in bounds])
    if len(few) < kept:
        parts = [_divided(each, np.arange(kept), len(bounds[-1])) for each in bounds[: level + 1]]
        whole = _solved(fit, continued(fit, parts[-1], found))
        found, level = (_refined(fit, whole), level) if _is_near(fit, whole) else _nested(fit, parts, found)
    return fit, found, bounds[level][kept * len(bounds[level]) // len(bounds[-1]) :]


def _divided(bounds, chosen, count):
    """Bounds of the parts of some of `count` longest segments, from those of all parts."""
    return bounds.reshape(count, -1, 2)[chosen].reshape(-1, 2)


def _nested(fit, bounds, found=None):
    """(Solution, number of its bounds) with the longest segments in which the model is near, from growing ones.

    found : Solution to continue with; None: from the log and the scene
    """
    best, growths = None, []
    for each in bounds:
        if len(growths) > 1 and _next_growth(*growths[-2:]) > MUCH_PARTED:
            break
        solution = _solved(fit, first_point(fit, each) if found is None else continued(fit, each, found))
        if best is not None and not _is_near(fit, solution):
            break
        best = found = _refined(fit, solution)
        growths.append(solution.growth)
    return best, len(growths) - 1


def _solved(fit, point):
    """Solution from Unknowns, none of whose segments would be nearer if it went on from the end of the one before."""
    solution = fit.solve(point, ROUGHLY)
    for _ in range(MOST_RESTARTS):
        point = _gone_on(fit, solution)
        if point is solution.point:
            break
        solution = fit.solve(point, ROUGHLY)
    return solution


def _gone_on(fit, solution):
    """Unknowns in which segments start where the ones before end, if they are nearer to the measurements then."""
    runs, point = fit.runs, solution.point
    machine, segments, states = runs.machine(point.values), runs.segments(point), list(point.states)
    for s in range(1, len(segments)):
        segment, rest = segments[s], solution.residuals[s]
        state = state_at(machine, segments[s - 1], states[s - 1], segment.start, point.halves)
        if state is None:
            continue
        try:
            outputs = machine.run(segment, state, halves=point.halves)
        except SimulationError:
            continue
        others = fit.differences(segment, outputs)
        if np.linalg.norm(fit.weighted(others)) < np.linalg.norm(fit.weighted(rest)):
            states[s] = state
    same = all(one is other for one, other in zip(states, point.states))
    return point if same else replace(point, states=tuple(states))


def _is_near(fit, solution):
    """Whether the model explains the segments, and differences are linear in them."""
    return solution.converged and excess(fit, solution) <= LINEAR and solution.growth <= PARTED


def _next_growth(before, last):
    """Growth of differences in segments four times as long, if it is exponential in time, from those of two lengths."""
    return last * (last / before) ** 4 if before > 0.0 else last


def _refined(fit, solution):
    """Solution with the noise that is in the residuals, and steps that are short enough for it."""
    for _ in range(MOST_REFINED):
        before, point = list(fit.deviation), solution.point
        fit.refine(solution)
        point = in_short_steps(fit, point, solution.outputs)
        same = all(np.allclose(*pair, rtol=REFINED, atol=0.0) for pair in zip(fit.deviation, before))
        if same and point is solution.point:
            break
        solution = fit.solve(point, ROUGHLY, solution)
    return solution


def continued(fit, bounds, solution):
    """Unknowns of other segments; those that start with one of a Solution start as that does."""
    given, runs = solution.point, fit.runs
    known = {segment.start: state for segment, state in zip(runs.segments(given), given.states)}
    point = replace(given, bounds=bounds)
    starts = [segment.start for segment in runs.segments(point)]
    if known.keys() >= set(starts):
        return replace(point, states=tuple(known[start] for start in starts))
    states = first_states(runs, bounds, given.delays, given.values)
    return replace(point, states=tuple(map(known.get, starts, states)))


def excess(fit, solution):
    """Largest rms of residuals beyond the noise and what it is by chance, by the spread of the output."""
    found = 0.0
    for t, (each, sigma) in enumerate(zip(fit.runs.log.measured, fit.deviation)):
        rest = np.concatenate([part[t] for part in solution.residuals])
        counts = np.maximum(np.isfinite(rest).sum(axis=0), 1)
        noise = sigma**2 * (1.0 + BY_CHANCE / np.sqrt(counts))
        beyond = np.sqrt(np.maximum(np.nansum(rest**2, axis=0) / counts - noise, 0.0))
        found = max(found, (beyond / np.maximum(each.spread, each.least)).max(initial=0.0))
    return found


def judged(fit, solution):
    """Comparison of a Solution."""
    judge = Effects(fit, solution)
    effects, alone = judge.find()
    errors = numerics(fit, solution.point, solution.outputs)
    ahead = horizons(fit, solution)
    found = Comparison(fit, solution, channel_fits(fit, solution), effects, alone, [], errors, ahead)
    return found if found.agrees else replace(found, missing=judge.missing())


def begin(scene, log, names=(), length=LENGTH, workers=None, limits=None, priors=None):
    """(Fit, [bounds of segments of growing length]); arguments as of `fitted`."""
    if not (np.isfinite(length) and length > 0.0):
        raise SceneError(f"the length of segments must be a positive number of seconds, got {length}")
    log = log.usable
    runs = Runs(scene, log, names, LONGEST)
    free = [each.delay is None for each in log.measured]
    fit = Fit(runs, [each.noise for each in log.measured], free, limits, priors, workers)
    fullest = max(log.measured, key=lambda each: len(each.times))
    most = len(fullest.times)
    counts = [max(1, round((last - first) / length)) for first, last in log.spans]
    finest = [np.linspace(first, last + 1e-6, PARTS[0] * count + 1) for count, (first, last) in zip(counts, log.spans)]
    longest = np.searchsorted(np.concatenate([each[:: PARTS[0]] for each in finest]), fullest.times, "right")
    if (each := most / len(np.unique(longest))) < ENOUGH:
        usual = float(np.median(np.diff(fullest.times))) if most > 1 else 0.0
        raise SceneError(
            f"{fullest.name}: segments of {length:g} s have {each:.3g} of the {most} messages each, too few to judge "
            f"a model: check the unit of the stamps, {usual:.2g} s apart, or use segments of {LEAST * usual:.2g} s"
        )
    found = []
    for part in PARTS:
        if part == 1 or part * sum(counts) * LEAST <= most:
            ends = [times[:: PARTS[0] // part] for times in finest]
            found.append(np.vstack([np.column_stack([each[:-1], each[1:]]) for each in ends]))
    return fit, found


def first_point(fit, bounds):
    """Unknowns to begin with; steps are short enough for the noise."""
    runs = fit.runs
    delays = _rough_delays(fit, bounds, np.array([each.delay or 0.0 for each in runs.log.measured]))
    values = np.clip(runs.numbers.values, *fit.limits.T)
    return in_short_steps(fit, Unknowns(bounds, delays, values, first_states(runs, bounds, delays, values)))


def in_short_steps(fit, point, outputs=None):
    """Unknowns with steps whose errors are a small part of the noise; outputs: of the point, None: not known."""
    while point.halves < MOST_HALVES and max(part.max(initial=0.0) for part in numerics(fit, point, outputs)) > PART:
        point, outputs = replace(point, halves=point.halves + 1), None
    return point


def numerics(fit, point, outputs=None):
    """[(p,)] largest estimated error of the integration by the noise, from steps of half the size."""
    outputs = fit.runs.base(point) if outputs is None else outputs
    finer = fit.runs.base(replace(point, halves=point.halves + 1))
    found = []
    for t, (apart, sigma) in enumerate(zip(fit.apart, fit.deviation)):
        off = [np.abs(apart(a[t], b[t])) for a, b in zip(outputs, finer)]
        error = np.concatenate(off).max(axis=0, initial=0.0) * 2**ORDER / (2**ORDER - 1)
        found.append(error / sigma)
    return found


def reach(log):
    """Largest delay in s of a Log that is tried."""
    return min(WIDEST, PART_OF_LOG * min(last - first for first, last in log.spans))


def _rough_delays(fit, bounds, delays):
    """Delays with the smallest residuals on a grid: a common one of all free clocks, then each alone."""
    runs, free = fit.runs, np.flatnonzero(fit.free)
    if not len(free):
        return delays
    first = np.searchsorted(bounds[:-1, 1], max(each.times[0] for each in runs.log.measured), side="right")
    few = bounds[first : first + 1 + int(FEW / (bounds[0, 1] - bounds[0, 0]))]
    # Of all clocks alike: starts, and nearly what their changes do, belong to measurements.
    common = Unknowns(few, delays, runs.numbers.values, first_states(runs, few, delays))
    bases = fit.bases(common)

    def seen(of, trial):
        """Number of measurements of some clocks in the segments."""
        return sum(len(s.rows[t]) for s in runs.segments(replace(common, delays=trial)) for t in of)

    def cost(of, lag):
        """Mean square of what the best starts leave of the same measurements; inf if a lag moves most of them away."""
        trial = delays + np.where(np.isin(np.arange(len(delays)), of), lag, 0.0)
        alike = len(of) == len(delays)
        try:
            if not alike and seen(of, trial) < KEPT * seen(of, delays):
                return np.inf
            point = replace(common, delays=trial, states=common.states if alike else first_states(runs, few, trial))
            left = fit.left(point, bases if alike else fit.bases(point))
        except SimulationError:
            return np.inf
        return float(left @ left) / max(np.count_nonzero(left), 1)

    def lowest(of, lags):
        return sorted((cost(of, lag), lag) for lag in lags)

    def best(of):
        most = reach(runs.log)
        found, lag = lowest(of, min(RANGE, most) * np.linspace(-1.0, 1.0, LAGS))[0]
        if found > NOISY and most > RANGE and (runs.log.inputs or runs.log.drives):
            apart = 2.0 * RANGE / (LAGS - 1)
            near = [lag for _, lag in lowest(of, np.arange(-most, most, apart))[:CANDIDATES]]
            other, finer = lowest(of, np.add.outer(near, apart * np.linspace(-0.5, 0.5, FINER)).ravel())[0]
            found, lag = min((found, lag), (other, finer)) if other < NOISY else (found, lag)
        # Starts absorb a common delay where little acts: without a clear minimum stamps are right.
        clear = found < CLEARLY * cost(of, 0.0)
        return delays + np.where(np.isin(np.arange(len(delays)), of) & clear, lag, 0.0)

    if cost(free, 0.0) <= 1.0:  # what is left is noise
        return delays
    delays = best(free)
    if len(free) > 1 and cost(free, 0.0) > NEAR:
        for t in free:
            delays = best(np.array([t]))
    return delays
