# SPDX-License-Identifier: Apache-2.0
"""Comparison of a log with a scene: what noise, errors of the integration, and the model account for."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.linear.coordinates import Coordinates

from .contradictions import Effect, Effects, Missing, channel_fits
from .fit import ORDER, Fit, Solution, covariance
from .horizon import Horizon, horizons
from .machine import state_at
from .pace import paced
from .runs import Runs, Unknowns, longest_step
from .scales import no_direction, scale
from .starts import LEAST, ROUGHLY, alone, first_states, has_others, shortest, starts_of
from .whiteness import Whiteness

LEVEL = 0.95  # of intervals
WRONG = 0.01  # probability that residuals of a right model are not found white
SLACKS = 1.0, 1e-2, 1e-5  # of ties, one after the other
# As of Fit.rough, one after the other: exact outputs make a narrow curved valley, which a search that begins with their
# noise follows in small steps.
SHARPER = 1e-2, 1e-3, 1e-4, 1e-5, 0.0
FAR = 0.1  # mean square from which on deviations show how to go on
FEW_SEGMENTS = 4  # of each recording, which show how long segments may be
LINEAR = 0.01  # of the spread of an output: largest rms that is not noise, for effects to be linear
# By the mean square in reach: a run along the log that is linear about free segments leaves more than that only if none
# is in reach. Of one in reach, effects are linear: at most it is as far again from the linear one, squared.
NOT_LINEAR = 4.0
# Three standard deviations of mean square minus estimated variance of n residuals that are white noise, by the variance
# and sqrt(n): those of the mean square, sqrt(2), and of third differences, 3.1, which are correlated with it.
BY_CHANCE = 3.0 * 2.7
# Largest growth G of differences in a segment. Columns have a relative error of 1e-8 G, see CHANGE, and starts explain
# all but 1/G of what delays and numbers change: of what is left, the error is 1e-8 G^2, here 1e-2.
PARTED = 1e3
LOST = 1e4  # growth in one run from which on that error is as large as what is left: such a run cannot be fitted
FIRST_PART = 1.0 / 64.0  # of a recording: the growth of one run is measured there first
PART = 0.1  # of the noise: largest error of the integration
MOST_HALVES = 8
ORDER_ONE = 2.0 * (1.0 - 2.0**-ORDER)  # factor of an error that steps of half the size only halve
RANGE, LAGS = 1.0, 41  # s, delays up to this are tried first; their number
APART = 2.0 * RANGE / (LAGS - 1)
# Delays up to Log.reach are tried at the same distance, then finer, if none before leaves noise.
CANDIDATES, FINER = 10, 11
NOISY = 4.0  # mean square that is nearly noise: a wrong model does not lead to a delay far away
NEAR = 100.0  # mean square: residuals of ten deviations are no question of single clocks, and show no delay
CLEARLY = 0.25  # of the mean square without a delay
# Of the median of the mean squares: what half a distance of the delays leaves of motions four of them long, squared.
HIT = 1.0 / 16.0
FEW, EARLY = 1.0, 8  # s of the log in which they are tried, at least, and parts of it
KEPT = 0.5  # share of the measurements of a clock that stay
PROBING = 0.1  # as ROUGHLY, of a run that may be too long for the model: what comes near goes there by more
REFINED, MOST_REFINED = 0.1, 3  # change of the noise that is small, and repetitions
STRANGE = 10.0  # standard deviations: rms from which on another unit may explain it


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
    p_white  : probability of correlations as large, of any output or all together, if residuals are white noise; and
               without those below the errors of the integration
    is_explained : whether effects explain what is more than noise
    """

    fit: Fit
    solution: Solution
    channels: list
    effects: list[Effect]
    alone: list[Effect]
    missing: list[Missing]
    numerics: list
    horizons: list[Horizon]
    p_white: tuple[float, float]
    is_explained: bool = True

    @property
    def worst(self):
        """ChannelFit with the largest residuals by its noise."""
        return max(self.channels, key=lambda channel: channel.chi / channel.limit)

    @property
    def agrees(self):
        """Whether one run along the log leaves white noise, predictions keep their band, and no effect is clear."""
        is_near = self.horizon is None or self.horizon.differs_from == np.inf
        return self.is_noise and is_near and not self.effects and not self.without

    @property
    def without(self):
        """Names of angles that are as random as directions: they show nothing."""
        return no_direction(self.fit)

    @property
    def is_noise(self):
        """Whether one run along each recording leaves noise, which that of inputs colours if it is known."""
        log = self.fit.runs.log
        is_coloured = any(each.noise is not None for each in (*log.inputs, *log.drives))
        is_small = self.solution.converged and self.worst.chi <= self.worst.limit
        return bool(is_small and (is_coloured or self.p_white[1] > 0.5 * WRONG))

    @cached_property
    def is_white(self):
        """Whether residuals of one run along each recording are white, by tests at WRONG for all together."""
        return self.p_white[0] > 0.5 * WRONG

    @property
    def horizon(self):
        """Horizon of the output that differs first, or is predicted for the shortest part of its time; None: none."""

        def order(each):
            return each.differs_from, each.within_noise / each.ahead[-1]

        return min(self.horizons, key=order, default=None)

    @property
    def delays(self):
        """{topic: (s, standard deviation)} of the clocks.

        The deviation is 0 where the delay was given, inf where the log does not show it: beyond `Log.reach`, where the
        delay is at its border, or where the model is far off.
        """
        found, k = {}, 0
        variances = np.diag(covariance_of(self.fit, self.solution, self.solution.chain.columns, self.is_white))
        chi, log = max(1.0, self.reduced), self.fit.runs.log
        border = log.reach - 0.5 * APART
        for each, delay, free in zip(log.measured, self.solution.point.delays, self.fit.free):
            is_known = abs(delay) <= border and chi <= NEAR
            deviation = 0.0 if not free else np.sqrt(variances[k]) if is_known else np.inf
            found[each.name] = float(delay - each.moved), float(deviation if deviation < log.reach else np.inf)
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
        """[SegmentStart] of the recordings."""
        return starts_of(self.fit, self.solution, max(1.0, self.reduced))

    @cached_property
    def reduced(self):
        """Sum of the squares of the weighted residuals by the degrees of freedom."""
        return self.solution.reduced

    @property
    def half_width(self):
        """Half of a 95 % interval by the standard deviation: of Student's distribution if noise is estimated."""
        if all(np.isfinite(each.deviation).all() for each in self.fit.runs.log.measured):
            return float(scipy.special.ndtri(0.5 + 0.5 * LEVEL))
        return float(scipy.special.stdtrit(self.solution.freedom, 0.5 + 0.5 * LEVEL))

    @property
    def verdict(self):
        """What the model predicts, and what the largest contradiction is."""
        worst, solution, horizon = self.worst, self.solution, self.horizon
        text = "" if horizon is None else f"The model {horizon.text}. "
        if self.agrees:
            return f"{text}The measurements agree with it: what is left is noise."
        text += "" if solution.converged else "No single run along the log was found. "
        if worst.chi > worst.limit:
            text += f"{worst.name} is {worst.chi:.3g} times its noise off (rms {worst.rms:.3g})."
        else:
            text += f"{worst.name} is as near as its noise (rms {worst.rms:.3g}), but what is left is not noise."
        if self.without:
            text += f" {self.without[0]} is as random as directions: check its unit."
        if not self.effects:
            return text + " No listed effect explains it."
        first = self.effects[0]
        if not self.is_explained:
            text += " Something that no listed effect explains acts; nearest:"
        share = f"{100.0 * first.share:.3g} % of the sum of squares"
        text += f" {first.text[0].upper()}{first.text[1:]}, {_sized(first)}, would explain {share}"
        others = [each for each in self.alone if each.text != first.text and each.share > 0.9 * first.share]
        if others:
            text += f"; so would {others[0].text}, {_sized(others[0])}, for {100.0 * others[0].share:.3g} %"
        more = self.effects[1:]
        return text + (f"; after it {', '.join(f'{each.text} ({_sized(each)})' for each in more)}." if more else ".")


def _sized(effect):
    return f"{effect.value:.3g} {effect.unit}".strip().removesuffix(" 1")


def compare(scene, log, workers=None, tell=None):
    """Comparison of a Log with a Scene.

    workers : threads; None: as many as cores
    tell    : function of a text, how far the work is; None: nothing is told
    Raises SceneError for unknown channels, SimulationError if the scene cannot be simulated from the measured start.
    """
    fit, near, solution, _ = fitted(scene, log, (), workers, tell=tell)
    return judged(fit, near, solution)


def fitted(scene, log, names=(), workers=None, limits=None, priors=None, held_out=0.0, tell=None):
    """(Fit, near Solution, tied Solution, bounds of the segments left out).

    One run along the log with the numbers of the scene shows whether these are near. Segments, each with a start of its
    own, are as long as the model is near to the measurements in them. Then starts are tied, with less and less slack:
    the end of each segment is the start of the next, as in one run along the log.

    names, limits, priors : of numbers that vary, see Fit
    held_out : share of the segments, at the end, that are left out
    tell : as of `compare`
    """
    fit, point = begin(scene, log, names, workers, limits, priors, tell)
    # Events of contacts are in the way of a long run that is not near, as they are walls for the numbers.
    whole = _whole(fit, point) if names and not fit.runs.has_hits else None
    if whole is not None and is_in_reach(fit, whole):
        point = whole.point
    length, few = _length(fit, point)
    point = few.point
    bounds = _divided(log.usable.spans, length)
    while True:
        kept = max(1, len(bounds) - round(held_out * len(bounds)))
        near = refined(fit, _solved(fit, _in_turn(fit, continued(fit, bounds[:kept], point)), ROUGHLY))
        point = near.point
        if _is_near(fit, near) or length <= shortest(fit.runs.log):
            found = tied(fit, near, whole)
            if found.cost < near.cost:  # free starts can only be nearer than tied ones: these went astray
                near = fit.solve(continued(fit, near.point.bounds, found.point), ROUGHLY)
            return fit, near, found, bounds[kept:]
        (first, last), length = bounds.T, 0.5 * length
        bounds = np.stack([first, 0.5 * (first + last), 0.5 * (first + last), last], axis=1).reshape(-1, 2)


def _length(fit, point, count=FEW_SEGMENTS, least=0.0):
    """(Length in s of the longest segments in which the model is near, Solution of a few of them).

    least : s, length of interest: what is not near in the shortest ones is not in longer ones
    """
    spans, length, numbers = fit.runs.log.spans, shortest(fit.runs.log), fit.runs.numbers
    most, best = max(last - first for first, last in spans) / count, None
    # A few short segments show some numbers and delays badly: these stay near to what they are.
    known, late = np.isfinite(fit.priors[:, 1:]), np.column_stack([point.delays, np.full(len(fit.free), 0.5 * APART)])
    priors = np.where(known, fit.priors, np.column_stack([point.values, numbers.scales]))
    few = Fit(fit.runs, list(fit.deviation), fit.free, fit.limits, priors, fit.workers, late)
    while best is None or 2.0 * best <= most:
        point = continued(few, _some(spans, length, count), point)
        solution = refined(few, _solved(few, point, PROBING))
        is_near = _is_near(few, solution)
        if best is not None and not is_near:
            break
        best, found, point, length = length, solution, solution.point, 2.0 * length
        if best < least and not is_near:
            break
    return best, found


def _some(spans, length, count=FEW_SEGMENTS):
    """Bounds (s, 2) of some parts of recordings with a length in s."""
    starts = [(start, last) for first, last in spans for start in first + (last - first) * np.arange(count) / count]
    return np.array([(start, min(start + length, last + 1e-6)) for start, last in starts])


def _whole(fit, point):
    """Solution of one run along each recording, from given numbers on; None: it cannot be simulated, or is lost."""
    spans = fit.runs.log.spans
    halves = in_short_steps(fit, continued(fit, _some(spans, shortest(fit.runs.log)), point)).halves
    try:
        point, share = continued(fit, _divided(spans, np.inf), replace(point, halves=halves)), FIRST_PART
        while share < 1.0:
            first, last = point.bounds.T
            if fit.run_growth(replace(point, bounds=np.column_stack([first, first + share * (last - first)]))) > LOST:
                return None
            share *= 2.0
        found = _sharpened(fit, point, ROUGHLY)
    except SimulationError:
        return None
    return found if found.growth <= LOST else None


def _sharpened(fit, point, same):
    """Solution from Unknowns on, with smaller and smaller deviations, see SHARPER."""
    for part in SHARPER[:-1]:
        one = fit.rough(part)
        if not all(map(np.array_equal, one.deviation, fit.deviation)) and one.distance(point) > FAR:
            point = one.solve(in_short_steps(one, point), same, enough=FAR).point
    return fit.solve(in_short_steps(fit, point), same)


def _solved(fit, point, same):
    """Solution from Unknowns on; with contacts, whose outputs are steep functions of the starts, as of `_sharpened`."""
    if fit.runs.has_hits and len(fit.runs.numbers):  # else starts would make up for the numbers
        return _sharpened(fit, point, same)
    return fit.solve(in_short_steps(fit, point), same)


def _in_turn(fit, point):
    """Unknowns whose starts that are far from the measurements follow from the segments before, one after the other."""
    still, states, before = alone(fit.runs, point.values, fit.deviation, fit.workers), [], None
    for k in range(len(point.bounds)):
        one = replace(point, bounds=point.bounds[k : k + 1], states=(point.states[k],), values=np.zeros(0))
        guesses = [one] if before is None else [one, replace(one, states=(before,))]
        one = min(guesses, key=still.distance)
        if still.distance(one) > NOISY:
            one = still.solve(one, ROUGHLY).point
        states += one.states
        start, end = one.bounds[0] - np.mean(one.delays)
        before = state_at(still.runs.machine(one.values), start, states[-1], end, one.halves)
    return replace(point, states=tuple(states))


def tied(fit, found, whole=None):
    """Solution whose segments make one run of each recording, from one whose segments are free.

    Where motions forget their starts, as in contacts, starts of segments go astray; then one run is near to begin with.

    whole : Solution with which the search began: what is found is not farther from the measurements; None: none
    """
    linear, others, point = fit.solution(found.point, found.outputs, found.linear, SLACKS[-1]), [], found.point
    one, is_lost = _as_one(fit, point), fit.growth(found.residuals, found.linear, along=True) > LOST
    begins = [] if is_lost else [one]
    if whole is not None:
        begins.append(replace(whole.point, bounds=one.bounds, states=whole.point.states[: len(one.bounds)]))
    with suppress(SimulationError, SceneError):
        point = fit.stepped(linear)
        begins += [] if is_lost else [_as_one(fit, point)]
    for begin in begins:
        with suppress(SimulationError):
            others.append(fit.solve(begin, ROUGHLY, slack=SLACKS[-1]))
            if is_in_reach(fit, others[-1]):
                return others[-1]
    if linear.reduced > NOT_LINEAR * _of_reach(fit):  # no run along the log is in reach
        if not others:
            with suppress(SimulationError):
                others += _run_from(fit, point)
        if others:
            return min(others, key=lambda each: each.cost)
    for slack in SLACKS:
        found = fit.solve(found.point, ROUGHLY, found, slack)
    return min([found, *others], key=lambda each: each.cost)


def _run_from(fit, point):
    """[Solution] of the run along each recording from its first start, without a search; none if it fails."""
    states, machine, late = list(point.states), fit.runs.machine(point.values), np.mean(point.delays)
    for k, (before, after) in enumerate(zip(point.bounds[:-1], point.bounds[1:])):
        if before[1] == after[0] and states[k] is not None:
            states[k + 1] = state_at(machine, before[0] - late, states[k], after[0] - late, point.halves)
    if any(state is None for state in states):
        return []
    return [fit.solution(replace(point, states=tuple(states)), slack=SLACKS[-1], converged=False)]


def _as_one(fit, point):
    """Unknowns with one segment for each recording, from the first ones of others."""
    bounds = point.bounds
    firsts = np.flatnonzero(np.append(True, bounds[1:, 0] != bounds[:-1, 1]))
    lasts = np.append(firsts[1:], len(bounds)) - 1
    runs = np.column_stack([bounds[firsts, 0], bounds[lasts, 1]])
    return replace(point, bounds=runs, states=tuple(point.states[k] for k in firsts))


def _divided(spans, length):
    """Bounds (s, 2) of equal parts of recordings, of about a length in s."""
    found = []
    for first, last in spans:
        ends = np.linspace(first, last + 1e-6, max(1, round((last - first) / length)) + 1)
        found.append(np.column_stack([ends[:-1], ends[1:]]))
    return np.vstack(found)


def _is_near(fit, solution):
    """Whether the model explains the segments, and differences are linear in them."""
    return solution.converged and excess(fit, solution) <= LINEAR and solution.growth <= PARTED


def _of_reach(fit):
    """Largest mean square of weighted residuals that is in reach."""
    total, count = 0.0, 0
    for each, sigma in zip(fit.runs.log.measured, fit.deviation):
        counts = np.isfinite(each.values).sum(axis=0)
        beyond = LINEAR * np.maximum(each.spread, each.least) / sigma
        total += counts @ (1.0 + BY_CHANCE / np.sqrt(np.maximum(counts, 1)) + beyond**2)
        count += counts.sum()
    return max(NOISY, total / count)


def is_in_reach(fit, solution):
    """Whether a search has ended near to the noise, or to the measurements."""
    return bool(solution.converged and (solution.reduced <= NOISY or excess(fit, solution) <= LINEAR))


def refined(fit, solution):
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


def continued(fit, bounds, point):
    """Unknowns of other segments; those that start in one of a point start where that is then."""
    runs, machine, late, states = fit.runs, fit.runs.machine(point.values), np.mean(point.delays), []
    for at in bounds[:, 0]:
        k = int(np.searchsorted(point.bounds[:, 0], at + 1e-9)) - 1
        first, last = point.bounds[k] if k >= 0 else (at, at)
        if at < last:
            near = point.states[k]
            states.append(
                near if at <= first + 1e-9 else state_at(machine, first - late, near, at - late, point.halves)
            )
        else:
            states.append(None)
    new = np.array([state is None for state in states])
    others = iter(first_states(runs, bounds[new], point.delays, point.values) if new.any() else ())
    states = tuple(next(others) if each is None else each for each in states)
    if point.calm is not None:  # steps are those of other parts
        point = replace(point, halves=0, calm=None)
    return replace(point, bounds=bounds, states=states)


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


def judged(fit, near, solution):
    """Comparison of a tied Solution; near: one whose segments are free, and near to the measurements."""
    fit.runs.tell("effects that the model may lack")
    finer = fit.runs.base(replace(solution.point, halves=solution.point.halves + 1))
    errors = _largest(fit, fit.errors(solution.outputs, finer))
    # Noise that is not larger than errors is no noise to find. Errors that remain are of order one, as at kinks.
    errors = [np.where(each > PART, ORDER_ONE * each, each) for each in errors]
    if any((each > PART).any() for each in errors):
        sizes = [np.hypot(1.0, each) for each in errors]
        fit.deviation = [sigma * size for sigma, size in zip(fit.deviation, sizes)]
        errors = [error / size for error, size in zip(errors, sizes)]
        near, solution = (
            fit.solution(each.point, each.outputs, fit.linear_of(each), each.slack, each.converged)
            for each in (near, solution)
        )
    if is_in_reach(fit, solution):
        judge = Effects(fit, solution, finer)
    else:
        judge = Effects(fit, fit.solution(near.point, near.outputs, near.linear, SLACKS[-1]))
    columns = [np.flatnonzero(np.isfinite(each.values).any(axis=0)) for each in fit.runs.log.measured]
    white = Whiteness(fit, solution)
    channels, p_white = channel_fits(fit, solution, white, errors), []
    plain = [white(t, [p]) for t, own in enumerate(columns) for p in own]
    for least, each in ((None, plain), (errors, [channel.p_white for channel in channels])):
        together = [white(t, own, least) for t, own in enumerate(columns) if len(own)]
        p_white.append(min(min(each) * len(each), min(together) * len(columns)))
    found = Comparison(fit, solution, channels, [], [], [], errors, horizons(fit, near, solution), tuple(p_white))
    effects, alone, missing, is_explained = judge.find(found.is_noise)
    # Angles are random, or residuals large: outputs may have another unit.
    far = None
    if found.without or found.worst.chi > STRANGE:
        far = scale(partial(_longest, Runs(fit.runs.scene, fit.runs.log, (), fit.runs.longest)), fit)
    if far is not None:  # others are linear about a wrong motion
        effects, alone, is_explained = [far], [far, *alone], True
    return replace(found, effects=effects, alone=alone, missing=missing, is_explained=is_explained)


def _longest(runs, log, least):
    """(Fit, s, Solution) of the longest run from the start of a log in which the model is near; 0 s: of none.

    runs : Runs of this thread, which go on with the log;  least : s, as of `_length`
    """
    runs.use(log.usable)
    fit, point = _begin(runs, workers=1, is_late=False)
    return fit, *_length(fit, point, 1, least)


def begin(scene, log, names=(), workers=None, limits=None, priors=None, tell=None):
    """(Fit, Unknowns to begin with, without segments); arguments as of `fitted`."""
    return _begin(runs_of(scene, log.usable, names, tell), workers, limits, priors)


def runs_of(scene, log, names=(), tell=None):
    """Runs whose steps are short enough for bodies that turn fast, anywhere in the log."""
    bounds, longest = _some(log.spans, min(shortest(log), FEW)), longest_step(scene)
    for _ in range(MOST_HALVES):
        runs = Runs(scene, log, names, longest, tell)
        machine, starts = runs.machine(runs.numbers.values), zip(bounds, first_states(runs, bounds))
        if all(state_at(machine, first, state, last) is not None for (first, last), state in starts):
            break
        longest *= 0.5
    return runs


def _begin(runs, workers=None, limits=None, priors=None, is_late=True):
    """As `begin`, with Runs. is_late: whether clocks may be."""
    log = runs.log
    free = [each.delay is None for each in log.measured]
    fit = Fit(runs, [each.noise for each in log.measured], free, limits, priors, workers)
    fit.deviation = [np.maximum(*pair) for pair in zip(fit.deviation, fit.least)]
    length, values = shortest(log), np.clip(runs.numbers.values, *fit.limits.T)
    bounds, delays = (
        _divided(log.spans, max(length, FEW / EARLY)),
        np.array([each.delay or 0.0 for each in log.measured]),
    )
    point = Unknowns(bounds[:0], delays, values, ())
    if length > FEW and fit.run_growth(continued(fit, _divided(log.spans, length)[:1], point)) > PARTED:
        raise SceneError(
            f"{LEAST} messages take {length:.3g} s, in which motions of the scene part {PARTED:g} times: check the "
            "unit of the stamps"
        )
    return fit, replace(point, delays=_rough_delays(fit, bounds, delays) if is_late else delays)


def covariance_of(fit, solution, columns, is_white):
    """(g, g) covariance of free delays and numbers, of columns (m, g) of a Solution and of what is known before.

    Without white residuals it is robust: that of correlated ones (Newey and West 1987). Residuals of exact values may
    be smaller than the least noise. But numbers make up for errors of the integration: residuals that are smaller than
    these count as if they were as large.
    """
    plain, by_errors = covariance(columns), most_error(fit) ** 2
    if is_white:
        return plain * max(by_errors if fit.is_exact and not fit.known.any() else 1.0, solution.reduced)
    finite = np.where(np.isfinite(plain), plain, 0.0)
    size = max(1.0, by_errors / max(solution.reduced, np.finfo(float).tiny))
    return np.where(np.isfinite(plain), size * finite @ _spread(fit, solution) @ finite, plain)


def _spread(fit, solution):
    """(g, g) covariance of the slopes of the sum of squares, of correlated residuals.

    Slopes of the measurements of one time are one; the width is that of Andrews (1991), of a process of order one.
    """
    still, g, found = solution.chain.starts(np.zeros(len(solution.covariance))), len(solution.covariance), []
    moved = [solution.chain.starts(row) for row in np.eye(g)]
    times = [s.places for s in fit.runs.segments(solution.point)]
    for k, part in enumerate(solution.parts):
        change = np.array([each[k] - still[k] for each in moved]).T
        slopes = (part.own @ change.reshape(len(still[k]), g) + part.shared) * part.rest[:, None]
        owner = np.concatenate([np.repeat(at, rest.shape[1]) for at, rest in zip(times[k], solution.residuals[k])])
        rows = np.zeros((owner.max(initial=-1) + 1, g))
        np.add.at(rows, owner, slopes)
        found.append(rows[np.unique(owner)])
    rows = np.vstack(found)
    rho = np.einsum("ij,ij->j", rows[1:], rows[:-1]) / np.maximum(np.einsum("ij,ij->j", rows, rows), 1e-300)
    rho = min(max(rho.max(initial=0.0), 0.0), 0.97)
    width = 1.1447 * (4.0 * rho**2 / (1.0 - rho**2) ** 2 * len(rows)) ** (1.0 / 3.0)
    total = rows.T @ rows
    for lag in range(1, min(int(width) + 1, len(rows))):
        C = rows[lag:].T @ rows[:-lag]
        total += (1.0 - lag / (width + 1.0)) * (C + C.T)
    return total


def most_error(fit):
    """Largest error of the integration by the noise; of contacts it falls slowly, and least noise is not all noise."""
    return 1.0 if fit.runs.has_hits and fit.is_exact else PART


def in_short_steps(fit, point, outputs=None):
    """Unknowns with steps whose errors are a small part of the noise, or of residuals of a model that is not near.

    Where steps of half the size do not even halve the errors, motions part: shorter ones do not help.

    outputs : of the point, None: not known
    """
    before, has_contacts = np.inf, fit.runs.has_contacts and fit.runs.has_hits
    is_new, is_old = has_contacts and point.calm is None, has_contacts and point.calm is not None
    outputs = fit.runs.base(point) if outputs is None else outputs
    while point.halves < MOST_HALVES:
        rest = np.concatenate([fit.weighted(one) for one in fit.residuals(point, outputs)])
        most = most_error(fit) * max(1.0, float(np.sqrt(rest @ rest / max(len(rest), 1))))
        if is_new:
            point, is_new = paced(fit, point, most, MOST_HALVES), False
            outputs = fit.runs.base(point)
        shorter = replace(point, halves=point.halves + 1)
        finer = fit.runs.base(shorter)
        error = max(part.max(initial=0.0) for part in _largest(fit, fit.errors(outputs, finer)))
        if error <= most or error > 0.5 * before:
            break
        if is_old:  # events are elsewhere now
            is_new, is_old = True, False
        else:
            point, outputs, before = shorter, finer, error
    return point


def _largest(fit, errors):
    """[(p,)] largest errors [[(r, p)]] of outputs by the noise, of each Measured."""
    parts = ([each[t] for each in errors] for t in range(len(fit.deviation)))
    return [np.abs(np.concatenate(part)).max(axis=0, initial=0.0) / s for part, s in zip(parts, fit.deviation)]


def _rough_delays(fit, bounds, delays):
    """Delays with the smallest residuals on a grid: a common one of all free clocks, then each alone.

    What has the same stamps throughout was stamped together: it begins with one delay.
    """
    runs, all_times = fit.runs, [each.times for each in fit.runs.log.measured]
    together = np.array([next(k for k, own in enumerate(all_times) if np.array_equal(own, at)) for at in all_times])
    free = np.flatnonzero(fit.free & fit.free[together])
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
        return sorted(fit.tasks(lambda lag: (cost(of, lag), lag), lags))

    def best(of):
        most = runs.log.reach
        first = lowest(of, min(RANGE, most) * np.linspace(-1.0, 1.0, LAGS))
        found, lag = first[0]
        if found > max(NOISY, HIT * first[LAGS // 2][0]) and most > RANGE and (runs.log.inputs or runs.log.drives):
            near = [lag for _, lag in lowest(of, np.arange(-most, most, APART))[:CANDIDATES]]
            other, finer = lowest(of, np.add.outer(near, APART * np.linspace(-0.5, 0.5, FINER)).ravel())[0]
            found, lag = min((found, lag), (other, finer)) if other < NOISY else (found, lag)
        # Starts absorb a common delay where little acts: without a clear minimum stamps are right.
        clear = found < CLEARLY * cost(of, 0.0)
        return delays + np.where(np.isin(np.arange(len(delays)), of) & clear, lag, 0.0)

    if cost(free, 0.0) <= 1.0:  # what is left is noise
        return delays
    delays = best(free)
    if len(free) > 1 and cost(free, 0.0) > NEAR:
        for first in np.unique(together[free]):
            delays = best(free[together[free] == first])
    return delays
