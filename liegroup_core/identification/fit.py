# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares: starts of all segments, delays of the clocks and numbers of the scene, from a log.

    minimise  sum over segments of | (measured - outputs) / deviation |^2  +  priors

by the method of Levenberg and Marquardt. Delays stay within the reach of the log (Log.reach), and where they are if a
delay as large as that changes less than noise, or what the model leaves. Starts of segments are free, or tied: then
each segment starts where the one before ends, as in one run along the log (multiple shooting, Bock 1983), whatever the
growth of differences in it. Ties are weighted rows. Starts are eliminated (chain.py), so that the rest has as many
unknowns as delays and numbers.
"""

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.threads import one_blas_thread

from .chain import Chain, Part, Tie
from .log import ENOUGH, LEAST
from .machine import NS, Apart
from .runs import CHANGE, LAG

UNSEEN = 1e-9  # relative singular value of a direction that no measurement shows
HIDDEN = 1e-6  # the same of starts: columns of what nothing shows are round-off, 1e-7 of differences
MOST_STEPS, MOST_TRIES = 40, 12
ORDER = 4  # of the method of the runs
SAME = 1e-7  # relative decrease of the sum of squares in the last step
# Of the standard deviations: last step. If outputs are linear, no combination of unknowns changes by more than this
# part of its standard deviation in a step that decreases the sum of squares by CLOSE^2 times the variance of residuals.
CLOSE = 0.01
AS_TOLD = 0.1  # relative difference between decreases, expected and found, up to which columns serve again
ROUND_OFF = 1e-12
FIXED = 1e-12  # standard deviation of what does not vary, by its scale or in s
KINDS = ("rad", "m"), ("rad/s", "m/s")  # units of outputs whose sizes are compared
EXACT = 100.0  # of the least noise by the own spread: values with less are exact ones of a simulation
FINEST = 1e-9  # rad: no encoder resolves less, with 32 bits a turn
LIGHT = 1e-6  # weight of ties of what no measurement shows: it goes on, and its gaps are no misfit
MOVES = 2.0  # spread of an output by its noise, from which on it shows a motion
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-7


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a fit.

    point      : Unknowns
    residuals  : [[(r, p)]] of each segment and Measured, measured minus outputs, NaN where nothing was measured
    outputs    : [[(r, p)]], and gaps (z,) to the next start
    chain      : Chain of the columns of the weighted outputs, with free delays, then numbers by their scales
    cost       : mean square that the fit minimises, see `Fit.cost`
    growth     : largest in a segment, see `Fit.growth`
    converged  : whether the last step was small
    linear     : [Part] without gaps
    deviation  : [(p,)] of the weights
    slack      : of ties, see `Fit.solve`
    """

    point: object
    residuals: list
    outputs: list
    chain: Chain
    cost: float
    growth: float
    converged: bool
    linear: list
    deviation: list
    slack: float | None

    @property
    def parts(self):
        """[Part] with gaps."""
        return _at(self.linear, [part.rest for part in self.linear], self.outputs, self.slack)

    @property
    def covariance(self):
        """(g, g) of free delays in s, then of numbers by their scales; infinite variances where nothing shows them."""
        return covariance(self.chain.columns)

    @property
    def freedom(self):
        """Degrees of freedom."""
        return max(self.count - self.unknowns, 1)

    @property
    def reduced(self):
        """Sum of the squares of the weighted residuals by the degrees of freedom."""
        return float(self.chain.left @ self.chain.left) / self.freedom

    @property
    def count(self):
        """Number of measurements."""
        return sum(int(np.isfinite(part).sum()) for parts in self.residuals for part in parts)

    @property
    def unknowns(self):
        """Number of unknowns: starts that are not tied, delays and numbers."""
        return sum(int(self.linear[k].own.any(axis=0).sum()) for k in self.firsts) + self.chain.columns.shape[1]

    @property
    def firsts(self):
        """Numbers of segments whose starts are not tied to the segment before: one run begins there."""
        before = [None, *(part.tie for part in self.linear[:-1])]
        return [k for k, tie in enumerate(before) if tie is None or self.slack is None]


def covariance(columns, unseen=np.inf):
    """Inverse of J^T J for columns J (N, g), whose diagonal has `unseen` more for directions without influence."""
    sizes = np.linalg.norm(columns, axis=0)
    seen = sizes > 0.0
    found = np.diag(np.where(seen, 0.0, unseen))
    if not seen.any():
        return found
    _, singular, V = np.linalg.svd(columns[:, seen] / sizes[seen], full_matrices=False)
    good = singular > UNSEEN * singular[0]
    part = (V[good].T / singular[good] ** 2) @ V[good]
    part[np.diag_indices_from(part)] += np.where((np.abs(V[~good]) > 1e-3).any(axis=0), unseen, 0.0)
    with np.errstate(invalid="ignore"):
        found[np.ix_(seen, seen)] = part / np.outer(sizes[seen], sizes[seen])
    return found


_thread = threading.local()


def _begin_worker():
    """Note that this thread works for a Fit."""
    _thread.works = True


class Fit:
    """Least squares of a log.

    runs     : Runs
    deviation: [(p,)] of each Measured
    free     : (t,) whether the delay of each Measured is unknown
    limits   : (q, 2) least and largest numbers of the scene
    priors   : (q, 2) expected values and their standard deviations, inf: none
    late     : (t, 2) s, the same of delays; None: nothing is known
    workers  : threads; None: as many as cores
    """

    def __init__(self, runs, deviation, free, limits=None, priors=None, workers=None, late=None):
        q = len(runs.numbers)
        self.runs, self.deviation, self.free = runs, deviation, np.asarray(free, dtype=bool)
        self.workers = workers or os.cpu_count() or 1
        self._firsts = ()  # deviations of the first measurements of segments; (): as of the others
        self._team = ThreadPoolExecutor(self.workers, initializer=_begin_worker) if self.workers > 1 else None
        self.limits = np.tile([-np.inf, np.inf], (q, 1)) if limits is None else np.asarray(limits, dtype=float)
        self.priors = np.tile([0.0, np.inf], (q, 1)) if priors is None else np.asarray(priors, dtype=float)
        self._late = late = np.tile([0.0, np.inf], (len(self.free), 1)) if late is None else late
        self._expected = np.vstack([late[self.free], self.priors])
        self._sizes = np.concatenate([np.ones(self.free.sum()), runs.numbers.scales])
        self.apart = [Apart(outputs) for outputs in runs.machine(runs.numbers.values).outputs]

    def rough(self, part):
        """The same Fit with deviations that are at least a part of the spread of the outputs.

        Of angles and places of one clock, and of their rates, that of the one that moves most. A body that slides
        hardly turns or sinks: that begins and ends with jerks, whose times would be walls for the numbers. But starts
        would sink deep into contacts: first measurements of segments have the geometric mean of this and of their own.
        """
        most, first = (
            [np.maximum(s, part * size) for s, size in zip(self.deviation, of)] for of in self._sizes_of_outputs
        )
        found = Fit(self.runs, most, self.free, self.limits, self.priors, self.workers, self._late)
        found._firsts = first
        return found

    @cached_property
    def least(self):
        """[(p,)] least standard deviations that noise may have; of exact values by what moves most, as of `rough`.

        Of what hardly moves FINEST rad and of the mechanism's size, and per s; those of a simulation are its errors.
        """
        found, machine = [], self.runs.machine(self.runs.numbers.values)
        for each, most, outputs in zip(self._log, self._sizes_of_outputs[0], machine.outputs):
            finest = FINEST * np.nan_to_num(_scales(outputs, machine.layout.size, KINDS[0] + KINDS[1]))
            is_exact = (each.spread == 0.0) | (each.noise <= np.maximum(EXACT * each.least, finest))
            least = np.where(is_exact, np.maximum(np.maximum(each.least, LEAST * most), finest), each.least)
            found.append(np.where(np.isfinite(each.deviation), 0.0, np.maximum(least, each.error)))
        return found

    @property
    def is_exact(self):
        """Whether all noise is the least one: values of a simulation."""
        return all((sigma <= least).all() for sigma, least in zip(self.deviation, self.least))

    @cached_property
    def _sizes_of_outputs(self):
        """[(p,)] as `rough` takes them, largest ones and of the first measurements."""
        machine, found = self.runs.machine(self.runs.numbers.values), []
        for each, outputs in zip(self._log, machine.outputs):
            most, mean = each.spread.copy(), each.spread.copy()
            for angle, length in KINDS:
                scales = _scales(outputs, machine.layout.size, (angle, length))
                moves = np.isfinite(scales) & (each.spread > MOVES * each.noise)
                if moves.any():
                    relative = (each.spread / scales)[moves]
                    own = np.where(moves, each.spread, scales * relative.min())
                    most = np.where(np.isfinite(scales), scales * relative.max(), most)
                    mean = np.where(np.isfinite(scales), np.sqrt(own * most), mean)
            found.append((most, mean))
        return list(zip(*found))

    @one_blas_thread()
    def solve(self, point, same=SAME, known=None, slack=None, enough=0.0):
        """Solution from Unknowns on. Raises SimulationError if the run of the point fails.

        same  : relative decrease of the sum of squares in the last step, unless it is small against the noise
        known : Solution nearby, with the same segments and perhaps other weights; None: none
        slack : of ties, by what one segment for itself shows of its start; None: starts are free
        enough : cost at which the search ends
        """
        damping, columns, outputs, failed = 0.0, self.linear_of(known), self.runs.base(point), None
        for k in range(MOST_STEPS):
            self._tell(point, slack, k + 1)
            rest = [self.weighted(one) for one in self.residuals(point, outputs)]
            # Columns of an earlier point serve as long as steps with them are good; the last ones are of the end.
            is_new = not self._serve(columns, point, rest)
            if is_new:
                columns = self._linear(point, outputs)
            parts = _at(columns, rest, outputs, slack)
            cost = self.cost(point, parts)
            for _ in range(MOST_TRIES if is_new else 1):
                other, trial, lower, share, whole, is_small = self._tried(point, columns, parts, damping, slack)
                if cost < lower < np.inf and slack is not None:  # ties bend: a second step closes their gaps
                    rest = [self.weighted(one) for one in self.residuals(other, trial)]
                    if self._serve(columns, other, rest):
                        again = _at(columns, rest, trial, slack)
                        other, trial, lower, *_ = self._tried(other, columns, again, damping, slack)
                is_better = lower <= cost * (1.0 + ROUND_OFF)
                if is_better or is_small:
                    break
                failed, damping = damping, max(10.0 * damping, FIRST_DAMPING)
            less, is_last = 0.0 if damping < LEAST_DAMPING else 0.1 * damping, cost - lower <= same * cost
            if is_better and is_last and damping > 0.0 and whole > same and (failed is None or less > failed):
                is_last = False  # the damping makes the step small: with less it goes on
            elif not is_last:
                failed = None
            ends = not is_better or is_small or is_last or lower <= enough
            if is_better:
                point, outputs, damping = other, trial, less
            is_as_told = abs(cost - lower - share * cost) <= AS_TOLD * share * cost
            if ends and (is_new or is_small or is_as_told or lower <= enough):
                return self.solution(point, outputs, columns, slack, bool(np.isfinite(lower)))
            if not is_as_told:
                columns = None
        return self.solution(point, outputs, None, slack, False)

    def _tell(self, point, slack, k):
        first, last = point.bounds[:, 0].min(), point.bounds[:, 1].max()
        of = "starts" if not len(point.values) and not self.free.any() else "numbers" if len(point.values) else "delays"
        parts = f"{len(point.bounds)} {'tied' if slack is not None else 'free'} segment{'s' * (len(point.bounds) > 1)}"
        self.runs.tell(f"{of} from {parts} of {first:.3g} to {last:.3g} s, iteration {k}")

    def solution_at(self, near, other, same):
        """Solution near one whose segments are free, with delays and numbers of other Unknowns; same: as of `solve`."""
        step = self.apart_from(near.point, other)
        changes = [a - b for a, b in zip(near.chain.starts(step), near.chain.starts(0.0 * step))]
        point = replace(self.moved(near.point, changes, step), delays=other.delays, values=other.values)
        fixed = np.column_stack([other.values, FIXED * self.runs.numbers.scales])
        late = np.column_stack([other.delays, np.full(len(self.free), FIXED)])
        one = Fit(self.runs, self.deviation, self.free, self.limits, fixed, self.workers, late)
        return one.solve(point, same, near)

    def stepped(self, solution):
        """Unknowns after a step from a Solution that is not damped. Raises SimulationError, SceneError."""
        changes, step, *_ = self._step(solution.point, solution.parts, 0.0)
        return self.moved(solution.point, changes, step)

    def linear_of(self, known):
        """Columns of a Solution with the present weights."""
        if known is None:
            return None
        found = []
        for one, part in zip(known.residuals, known.linear):
            factors = [np.tile(old / new, len(each)) for old, new, each in zip(known.deviation, self.deviation, one)]
            rows = np.concatenate(factors)[:, None]
            found.append(part._replace(own=rows * part.own, shared=rows * part.shared))
        return found

    def _tried(self, point, columns, parts, damping, slack):
        """(Unknowns, outputs, cost, inf: none) after a step, and its shares as of `_step`."""
        changes, step, *shares = self._step(point, parts, damping)
        try:
            other = self.moved(point, changes, step)
            outputs = self.runs.base(other)
            rest = [self.weighted(one) for one in self.residuals(other, outputs)]
            return other, outputs, self.cost(other, _at(columns, rest, outputs, slack)), *shares
        except (SimulationError, SceneError):
            return point, None, np.inf, *shares

    def refine(self, solution):
        """Estimate the noise again, from the residuals of a Solution, in which there is less motion.

        Residuals of a few values are small by chance: these keep the first estimate.
        """
        for t, each in enumerate(self._log):
            own = np.maximum(each.noise_of([parts[t] for parts in solution.residuals]), self.least[t])
            is_less = (own < self.deviation[t]) & (np.isfinite(each.values).sum(axis=0) > ENOUGH)
            self.deviation[t] = np.where(is_less, own, self.deviation[t])

    def bases(self, point):
        """[(N_s, c)] orthonormal directions of the weighted outputs that changes of each start give."""
        return [range_of(part.own) for part in self._linear(point, self.runs.base(point), starts_only=True)]

    def left(self, point, bases):
        """(N,) weighted residuals of Unknowns without their parts in bases. Raises SimulationError."""
        residuals = self.residuals(point, self.runs.base(point))
        return np.concatenate([without(U, self.weighted(one)) for U, one in zip(bases, residuals)])

    def solution(self, point, outputs=None, columns=None, slack=None, converged=True):
        """Solution at Unknowns, without a step; outputs, columns [Part]: of it, or of one nearby, None: not known."""
        outputs = self.runs.base(point) if outputs is None else outputs
        residuals = self.residuals(point, outputs)
        rest = [self.weighted(one) for one in residuals]
        if not self._serve(columns, point, rest):
            columns = self._linear(point, outputs)
        growth = self.growth(residuals, columns)
        columns = [part._replace(rest=r) for part, r in zip(columns, rest)]
        parts = _at(columns, rest, outputs, slack)
        chain, cost = Chain(parts), self.cost(point, parts)
        return Solution(point, residuals, outputs, chain, cost, growth, converged, columns, list(self.deviation), slack)

    def growth(self, residuals, columns, along=False):
        """Largest change of an output with a start that changes by 1 rad or the mechanism's size, by its spread.

        Of outputs that show a motion. With contacts at least by what the output changes at first: a body that hardly
        turns has small spreads, which are no measure of how motions part.
        along : of starts of whole recordings, through the ties; else of each segment
        """
        found, before, least = 0.0, None, self._first_changes(residuals, columns)
        sizes = [
            np.where(each.spread > MOVES * s, s / np.maximum(np.maximum(each.spread, first), s), 0.0)
            for s, each, first in zip(self.deviation, self._log, least)
        ]
        for one, part in zip(residuals, columns):
            size = np.concatenate([np.tile(of, len(values)) for of, values in zip(sizes, one)])
            own = part.own if before is None else part.own @ before
            found = max(found, np.abs(size[:, None] * own).max(initial=0.0))
            if along:
                before = part.tie and (part.tie.own if before is None else part.tie.own @ before)
        return found

    def _first_changes(self, residuals, columns):
        """[(p,)] largest changes of the first outputs of segments with their starts, as of `growth`."""
        found = [np.zeros_like(sigma) for sigma in self.deviation]
        for one, part in zip(residuals, columns) if self.runs.has_contacts else ():
            at = 0
            for t, rest in enumerate(one):
                if len(rest):
                    first = np.abs(part.own[at : at + rest.shape[1]]).max(axis=1, initial=0.0)
                    found[t] = np.maximum(found[t], first * self.deviation[t])
                at += rest.size
        return found

    def run_growth(self, point):
        """Growth of segments from Unknowns. Raises SimulationError."""
        outputs = self.runs.base(point)
        return self.growth(self.residuals(point, outputs), self._linear(point, outputs, starts_only=True))

    def residuals(self, point, outputs):
        """[[(r, p)]] measured minus outputs."""
        return [self.differences(*each) for each in zip(self.runs.segments(point), outputs)]

    def differences(self, segment, outputs):
        """[(r, p)] measured minus outputs of a Segment."""
        parts = zip(self.apart, self._log, segment.rows, outputs)
        return [apart(each.values[rows], values) for apart, each, rows, values in parts]

    @property
    def _log(self):
        return self.runs.log.measured

    def weighted(self, parts):
        """(N_s,) residuals of one segment, or differences of outputs, by their deviations; 0 for NaN."""
        rows = [np.nan_to_num(part / sigma) for part, sigma in zip(parts, self.deviation)]
        for row, sigma, first in zip(rows, self.deviation, self._firsts):
            row[:1] *= sigma / first
        return np.concatenate([row.ravel() for row in rows])

    def cost(self, point, parts):
        """Sum of the squares of the weighted residuals, of the gaps, and of priors, by the count of the former.

        inf if delays move all measurements away.
        """
        total = sum(_square(part) for part in parts) + float(np.sum(self._prior(point) ** 2))
        count = sum(len(part.rest) for part in parts)
        return total / count if count else np.inf

    def errors(self, outputs, finer):
        """[[(r, p)]] estimated errors of outputs, from those with steps of half the size."""
        size = 2**ORDER / (2**ORDER - 1)
        return [[size * apart(*pair) for apart, *pair in zip(self.apart, *both)] for both in zip(outputs, finer)]

    def distance(self, point):
        """Mean square of the weighted residuals of Unknowns; inf if a run fails."""
        try:
            rest = np.concatenate([self.weighted(one) for one in self.residuals(point, self.runs.base(point))])
        except SimulationError:
            return np.inf
        return float(rest @ rest) / max(len(rest), 1)

    def _prior(self, point):
        """(g,) deviations of free delays and numbers from their priors."""
        present = np.concatenate([point.delays[self.free], point.values])
        return (self._expected[:, 0] - present) / self._expected[:, 1]

    @property
    def known(self):
        """(g, g) columns of the priors with free delays in s and numbers by their scales."""
        return np.diag(self._sizes / self._expected[:, 1])

    def beside(self, outputs, other, residuals):
        """[(N_s + z,)] changes of weighted outputs and gaps between two runs; 0 where nothing was measured or ran."""
        found = []
        for base, values, rest in zip(outputs, other, residuals):
            values = base if values is None else values
            parts = zip(self.apart, base, values, rest)
            changes = [np.where(np.isfinite(r), apart(b, a), 0.0) for apart, a, b, r in parts]
            found.append(np.concatenate([self.weighted(changes), values[-1] - base[-1]]))
        return found

    def tasks(self, function, items):
        """Results of function(item) in the order of the items, in all threads: compiled runs let others run."""
        if self._team is None or getattr(_thread, "works", False):  # a task that waited for others would block them
            return [function(item) for item in items]
        return list(self._team.map(function, items))

    def _serve(self, columns, point, rest):
        """Whether columns [Part], or None, are of as many measurements and start coordinates as Unknowns have.

        Delays move some measurements to other segments, and starts with a taut cable have fewer coordinates.
        rest : [(N_s,)] weighted residuals of the Unknowns
        """
        if columns is None:
            return False
        sizes = zip(columns, rest, self.runs.starts(point))
        return all(part.own.shape == (len(r), len(scales)) for part, r, (scales, *_) in sizes)

    def _linear(self, point, outputs, starts_only=False):
        """[Part] of segments: columns with starts, delays and numbers; gaps of their ties are linear maps of z."""
        runs, residuals = self.runs, self.residuals(point, outputs)
        count = 0 if starts_only else len(runs.numbers)
        most = max(len(scales) for scales, *_ in runs.starts(point))
        items = [("start", k) for k in range(most)] + [("number", k) for k in range(count)]
        found = [
            [factor * part for part in self.beside(outputs, other, residuals)]
            for factor, other in self.tasks(Change(runs, point), items)
        ]
        clocks = np.zeros(0, dtype=int) if starts_only else np.flatnonzero(self.free)
        late = self.late(point, outputs, residuals, clocks)
        rests, sizes = [self.weighted(one) for one in residuals], [len(of[-1]) for of in outputs]
        across, columns = runs.across(point), []
        for s, (r, z, D) in enumerate(zip(rests, sizes, across)):
            own = np.reshape([column[s] for column in found[: len(D)]], (len(D), len(r) + z)).T
            numbers = np.reshape([column[s] for column in found[most:]], (count, len(r) + z)).T
            columns.append((own, np.hstack([late[s], numbers])))
        seen = [
            np.where(shown, 1.0 + np.linalg.norm(J[: len(r)], axis=0), LIGHT)
            for r, (J, _), (*_, shown) in zip(rests, columns, runs.starts(point))
        ]
        parts = []
        for s, (r, z, (J, G)) in enumerate(zip(rests, sizes, columns)):
            n, D = len(r), across[s + 1] if z else None
            parts.append(Part(r, J[:n], G[:n], Tie(D @ J[n:], D @ G[n:], D, seen[s + 1]) if z else None))
        return parts

    def late(self, point, outputs, residuals, clocks):
        """[(N_s + z, d)] changes of the weighted outputs and gaps with the delays of some clocks (d,), per s.

        Starts are late by the mean of the delays. So a delay d of one of T clocks makes its measurements d earlier, and
        all starts d / T, with respect to which all inputs are later.
        """
        if not len(clocks):
            return [np.zeros((len(self.weighted(one)) + len(of[-1]), 0)) for one, of in zip(residuals, outputs)]
        everything = self.tasks(Change(self.runs, point), [("time", 0), ("time", 1)])
        rates, alike = (
            [factor * part for part in self.beside(outputs, other, residuals)] for factor, other in everything
        )
        part, found = 1.0 / len(self.deviation), []
        for rate, shift, one in zip(rates, alike, residuals):
            sizes = [rest.size for rest in one]
            owner = np.repeat([*range(len(one)), -1], [*sizes, len(rate) - sum(sizes)])
            found.append(np.array([part * (rate - shift) - rate * (owner == t) for t in clocks]).T)
        return found

    def _step(self, point, parts, damping):
        """Step from Unknowns.

        Changes [(c,)] of the starts by their scales, (g,) of delays and numbers, by which share the sum of squares
        would decrease if outputs were linear, that of a step without damping, and whether this is small, see CLOSE.
        """
        q, chain = len(self.runs.numbers), Chain(parts, damping)
        g = chain.columns.shape[1]
        step, count = np.zeros(g), max(sum(len(part.rest) for part in parts), 1)
        variance = max(chain.left @ chain.left / count, LEAST**2)
        if g:
            scales = self.runs.numbers.scales
            J = np.vstack(
                [chain.columns, self.known, np.sqrt(damping) * np.diag(np.linalg.norm(chain.columns, axis=0))]
            )
            r = np.concatenate([chain.left, self._prior(point), np.zeros(g)])
            low, high = np.full(g, -np.inf), np.full(g, np.inf)
            low[g - q :], high[g - q :] = ((limit - point.values) / scales for limit in self.limits.T)
            reach, delays = self.runs.log.reach, point.delays[self.free]
            low[: g - q], high[: g - q] = np.minimum(-reach - delays, 0.0), np.maximum(reach - delays, 0.0)
            sizes = np.linalg.norm(J, axis=0)
            seen = sizes > UNSEEN * sizes.max(initial=0.0)
            seen[: g - q] &= sizes[: g - q] * reach > np.sqrt(variance)
            A = J[:, seen] / sizes[seen]
            found = np.linalg.lstsq(A, r, rcond=UNSEEN)[0]
            limits = low[seen] * sizes[seen], high[seen] * sizes[seen]
            if (found < limits[0]).any() or (found > limits[1]).any():
                found = scipy.optimize.lsq_linear(A, r, limits, method="bvls").x
            step[seen] = found / sizes[seen]
            # Times are whole ns, of starts with the mean of the delays: ties would show a rest.
            whole = len(self.free) / NS
            step[: g - q] = whole * np.round(step[: g - q] / whole)
        changes = chain.starts(step)
        ahead = [changes[s + 1] if part.tie else None for s, part in enumerate(parts)]
        expected = sum(_square(part, change, step, after) for part, change, after in zip(parts, changes, ahead))
        at_end = self._prior(point) - self.known @ step
        total = sum(map(_square, parts)) + float(np.sum(self._prior(point) ** 2))
        share = 1.0 - (expected + float(np.sum(at_end**2))) / total if total else 0.0
        if damping:
            return changes, step, share, *self._step(point, parts, 0.0)[3:]
        return changes, step, share, share, bool(share * total <= len(parts) * CLOSE**2 * variance)

    def apart_from(self, point, other):
        """(g,) step of delays and numbers from Unknowns to others."""
        numbers = (other.values - point.values) / self.runs.numbers.scales
        return np.concatenate([(other.delays - point.delays)[self.free], numbers])

    def moved(self, point, changes, step):
        """Unknowns after changes [(c,)] of the starts by their scales, and of delays and numbers (g,)."""
        runs = self.runs
        scaled = [change * scales for (scales, *_), change in zip(runs.starts(point), changes)]
        q, free = len(runs.numbers), np.flatnonzero(self.free)
        delays = point.delays.copy()
        delays[free] += step[: len(free)]
        values = np.clip(point.values + step[len(step) - q :] * runs.numbers.scales, *self.limits.T)
        moved = replace(point, states=runs.moved(point, scaled))
        return replace(moved, delays=delays, values=values, states=runs.followed(moved, values))


class Change:
    """(factor, outputs of a run with one change), as a function of (kind, number): the derivative is their product.

    kind : "start", "number", or "time" of what was measured, and with 1 of the starts, too
    """

    def __init__(self, runs, point):
        self._runs, self._point = runs, point

    def __call__(self, item):
        kind, k = item
        if kind == "start":
            return 1.0 / CHANGE, self._runs.beside_start(self._point, k)
        if kind == "time":
            return 1.0 / LAG, self._runs.beside_times(self._point, k)
        way, found = self._runs.beside_number(self._point, k)
        return way / CHANGE, found


def _scales(outputs, size, units):
    """(p,) 1 rad, or the size of a mechanism, and per s, of outputs with some units; NaN of others."""
    known = {"rad": 1.0, "m": size}
    return np.array([known[unit.removesuffix("/s")] if unit in units else np.nan for unit in outputs.units])


def _at(columns, rest, outputs, slack):
    """[Part] of columns [Part] with weighted residuals [(N_s,)] and the gaps of outputs; slack: as of `Fit.solve`."""
    found = []
    for part, r, of in zip(columns, rest, outputs):
        tie = part.tie if slack is not None else None
        if tie:
            tie = tie._replace(gap=tie.gap @ of[-1], weights=tie.weights / slack)
        found.append(part._replace(rest=r, tie=tie))
    return found


def _square(part, change=None, step=None, after=None):
    """Sum of the squares of a Part after changes of its start, of what is shared, and of the next start; None: none."""
    rest, gap = part.rest, part.tie.gap if part.tie else 0.0
    if change is not None:
        rest = rest - part.own @ change - part.shared @ step
        gap = gap + part.tie.own @ change + part.tie.shared @ step - after if part.tie else 0.0
    weighted = part.tie.weights * gap if part.tie else np.zeros(0)
    return float(rest @ rest + weighted @ weighted)


def without(U, x):
    """Vectors or columns x without their parts in the range of U, whose columns are orthonormal."""
    return x - U @ (U.T @ x)


def range_of(J):
    """Orthonormal basis of the range of J (N, c)."""
    if not J.shape[1]:
        return J
    U, singular, _ = np.linalg.svd(J, full_matrices=False)
    return U[:, singular > HIDDEN * singular.max(initial=0.0)]
