# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares: starts of all segments, delays of the clocks and numbers of the scene, from a log.

    minimise  sum over segments of | (measured - outputs) / deviation |^2  +  priors

by the method of Levenberg and Marquardt. Starts belong to one segment each. Their columns are eliminated there by an
orthogonal projection, so that the rest has as many unknowns as there are delays and numbers (variable projection). A
segment does not have to continue where the one before it ends: an error of the model does not add up along the log.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import scipy

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.threads import one_blas_thread

from .log import ENOUGH
from .machine import Apart
from .runs import CHANGE, LAG

UNSEEN = 1e-9  # relative singular value of a direction that no measurement shows
HIDDEN = 1e-6  # the same of starts: columns of what nothing shows are round-off, 1e-7 of differences
MOST_STEPS, MOST_TRIES = 40, 12
SAME = 1e-7  # relative decrease of the sum of squares in the last step
CLOSE = 0.01  # of the standard deviations: last step
AS_TOLD = 0.1  # relative difference between decreases, expected and found, up to which columns serve again
ROUND_OFF = 1e-12
MOVES = 2.0  # spread of an output by its noise, from which on it shows a motion
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-7


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a fit.

    point      : Unknowns
    residuals  : [[(r, p)]] of each segment and Measured, measured minus outputs, NaN where nothing was measured
    outputs    : [[(r, p)]]
    left       : (N,) weighted residuals without what changes of the starts explain
    columns    : (N, g) changes of the weighted outputs with the free delays, then the numbers by their scales, likewise
    bases      : [(N_s, c)] orthonormal directions of the weighted outputs that changes of each start give
    growth     : largest change of an output with a start that changes by 1 rad or the mechanism's size, by the spread
                 of the output; of outputs that show a motion
    converged  : whether the last step was small
    linear     : [((N_s, c), (N_s, g))] changes of the weighted outputs with each start, and with delays and numbers
    deviation  : [(p,)] of the weights
    """

    point: object
    residuals: list
    outputs: list
    left: np.ndarray
    columns: np.ndarray
    bases: list
    growth: float
    converged: bool
    linear: list
    deviation: list

    @property
    def covariance(self):
        """(g, g) of free delays in s, then of numbers by their scales; infinite variances where nothing shows them."""
        return covariance(self.columns)


def covariance(columns):
    """Inverse of J^T J for columns J (N, g); inf on the diagonal for directions without influence."""
    sizes = np.linalg.norm(columns, axis=0)
    seen = sizes > 0.0
    found = np.diag(np.where(seen, 0.0, np.inf))
    if not seen.any():
        return found
    _, singular, V = np.linalg.svd(columns[:, seen] / sizes[seen], full_matrices=False)
    good = singular > UNSEEN * singular[0]
    part = (V[good].T / singular[good] ** 2) @ V[good]
    part[np.diag_indices_from(part)] += np.where((np.abs(V[~good]) > 1e-3).any(axis=0), np.inf, 0.0)
    with np.errstate(invalid="ignore"):
        found[np.ix_(seen, seen)] = part / np.outer(sizes[seen], sizes[seen])
    return found


class Fit:
    """Least squares of a log.

    runs     : Runs
    deviation: [(p,)] of each Measured
    free     : (t,) whether the delay of each Measured is unknown
    limits   : (q, 2) least and largest numbers of the scene
    priors   : (q, 2) expected values and their standard deviations, inf: none
    workers  : threads; None: as many as cores
    """

    def __init__(self, runs, deviation, free, limits=None, priors=None, workers=None):
        q = len(runs.numbers)
        self.runs, self.deviation, self.free = runs, deviation, np.asarray(free, dtype=bool)
        self.workers = workers or os.cpu_count() or 1
        self._team = ThreadPoolExecutor(self.workers) if self.workers > 1 else None
        self.limits = np.tile([-np.inf, np.inf], (q, 1)) if limits is None else np.asarray(limits, dtype=float)
        self.priors = np.tile([0.0, np.inf], (q, 1)) if priors is None else np.asarray(priors, dtype=float)
        self.apart = [Apart(outputs) for outputs in runs.machine(runs.numbers.values).outputs]

    @one_blas_thread()
    def solve(self, point, same=SAME, known=None):
        """Solution from Unknowns on. Raises SimulationError if the run of the point fails.

        same  : relative decrease of the sum of squares in the last step, unless it is small against the noise
        known : Solution nearby, with the same segments and perhaps other weights; None: none
        """
        damping, columns, outputs = 0.0, self._linear_of(known), self.runs.base(point)
        for _ in range(MOST_STEPS):
            residuals = self.residuals(point, outputs)
            cost, rest = self.cost(point, residuals), [self.weighted(one) for one in residuals]
            # Columns of an earlier point serve as long as steps with them are good; the last ones are of the end.
            is_new = columns is None or [len(r) for r in rest] != [len(J_x) for J_x, _ in columns]
            if is_new:
                columns = [(J_x, J_g) for _, J_x, J_g in self._linear(point, outputs, residuals)]
            parts = [(r, *each) for r, each in zip(rest, columns)]
            for _ in range(MOST_TRIES if is_new else 1):
                other, trial, lower, share, is_small = self._tried(point, parts, damping)
                is_better = lower <= cost * (1.0 + ROUND_OFF)
                if is_better or is_small:
                    break
                damping = max(10.0 * damping, FIRST_DAMPING)
            ends = not is_better or is_small or cost - lower <= same * cost
            if is_better:
                point, outputs, damping = other, trial, 0.0 if damping < LEAST_DAMPING else 0.1 * damping
            is_as_told = abs(cost - lower - share * cost) <= AS_TOLD * share * cost
            if ends and (is_new or is_small or is_as_told):
                return self._solution(point, outputs, columns, bool(np.isfinite(lower)))
            if not is_as_told:
                columns = None
        return self._solution(point, outputs, None, False)

    def _linear_of(self, known):
        """Columns of a Solution with the present weights."""
        if known is None:
            return None
        found = []
        for one, pair in zip(known.residuals, known.linear):
            factors = [np.tile(old / new, len(part)) for old, new, part in zip(known.deviation, self.deviation, one)]
            found.append(tuple(np.concatenate(factors)[:, None] * J for J in pair))
        return found

    def _tried(self, point, parts, damping):
        """(Unknowns, outputs, cost, inf: none, expected share of its decrease, whether it is small) after a step."""
        changes, step, share, is_small = self._step(point, parts, damping)
        try:
            other = self._moved(point, changes, step)
            outputs = self.runs.base(other)
            return other, outputs, self.cost(other, self.residuals(other, outputs)), share, is_small
        except (SimulationError, SceneError):
            return point, None, np.inf, share, is_small

    def refine(self, solution):
        """Estimate the noise again, from the residuals of a Solution, in which there is less motion.

        Residuals of a few values are small by chance: these keep the first estimate.
        """
        for t, each in enumerate(self._log):
            own = each.noise_of([parts[t] for parts in solution.residuals])
            is_less = (own < self.deviation[t]) & (np.isfinite(each.values).sum(axis=0) > ENOUGH)
            self.deviation[t] = np.where(is_less, own, self.deviation[t])

    def columns(self, point):
        """[(N_s, c)] changes of the weighted outputs with starts, delays and numbers, for each segment."""
        outputs = self.runs.base(point)
        parts = self._linear(point, outputs, self.residuals(point, outputs))
        return [np.hstack(columns) for _, *columns in parts]

    def at(self, point):
        """Solution at Unknowns, without a step."""
        return self._solution(point, self.runs.base(point), None, True)

    def bases(self, point):
        """[(N_s, c)] orthonormal directions of the weighted outputs that changes of each start give."""
        outputs = self.runs.base(point)
        parts = self._linear(point, outputs, self.residuals(point, outputs), starts_only=True)
        return [_range(J_x) for _, J_x, _ in parts]

    def left(self, point, bases):
        """(N,) weighted residuals of Unknowns without their parts in bases. Raises SimulationError."""
        residuals = self.residuals(point, self.runs.base(point))
        return np.concatenate([without(U, self.weighted(one)) for U, one in zip(bases, residuals)])

    def _solution(self, point, outputs, columns, converged):
        """Solution at Unknowns, with columns [(J_x, J_g)] of one nearby, or None."""
        residuals = self.residuals(point, outputs)
        rest = [self.weighted(one) for one in residuals]
        if columns is None or [len(r) for r in rest] != [len(J_x) for J_x, _ in columns]:
            columns = [(J_x, J_g) for _, J_x, J_g in self._linear(point, outputs, residuals)]
        left, others, bases, growth = [], [], [], 0.0
        parts = [
            np.divide(sigma, each.spread, out=np.zeros_like(sigma), where=each.spread > MOVES * sigma)
            for sigma, each in zip(self.deviation, self._log)
        ]
        for r, one, (J_x, J_g) in zip(rest, residuals, columns):
            size = np.concatenate([np.tile(part, len(values)) for part, values in zip(parts, one)])
            growth = max(growth, np.abs(size[:, None] * J_x).max(initial=0.0))
            U = _range(J_x)
            left.append(without(U, r))
            others.append(without(U, J_g))
            bases.append(U)
        return Solution(
            point,
            residuals,
            outputs,
            np.concatenate(left),
            np.vstack(others),
            bases,
            growth,
            converged,
            columns,
            list(self.deviation),
        )

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
        rows = [np.nan_to_num(part / sigma).ravel() for part, sigma in zip(parts, self.deviation)]
        return np.concatenate(rows)

    def cost(self, point, residuals):
        """Mean square of the weighted residuals, with the priors; inf if delays move all measurements away."""
        total = sum(float(np.sum(self.weighted(parts) ** 2)) for parts in residuals)
        count = sum(int(np.isfinite(part).sum()) for parts in residuals for part in parts)
        return (total + float(np.sum(self._prior(point) ** 2))) / count if count else np.inf

    def _prior(self, point):
        """(q,) deviations of the numbers from their priors."""
        return (self.priors[:, 0] - point.values) / self.priors[:, 1]

    def beside(self, outputs, other, residuals):
        """[(N_s,)] changes of the weighted outputs between two runs; 0 where nothing was measured, or did not run."""
        found = []
        for base, values, rest in zip(outputs, other, residuals):
            parts = zip(self.apart, base, base if values is None else values, rest)
            changes = [np.where(np.isfinite(r), apart(b, a), 0.0) for apart, a, b, r in parts]
            found.append(self.weighted(changes))
        return found

    def tasks(self, function, items):
        """Results of function(item) in the order of the items, in all threads: compiled runs let others run."""
        if self._team is None:
            return [function(item) for item in items]
        return list(self._team.map(function, items))

    def _linear(self, point, outputs, residuals, starts_only=False):
        """For each segment weighted residuals (N_s,), columns of its start (N_s, c), and of delays and numbers."""
        runs = self.runs
        scales = [scales for scales, *_ in runs.starts(point)]
        most = max(map(len, scales))
        count = 0 if starts_only else len(runs.numbers)
        items = [("start", k) for k in range(most)] + [("number", k) for k in range(count)]
        found = [
            [factor * part for part in self.beside(outputs, other, residuals)]
            for factor, other in self.tasks(Change(runs, point), items)
        ]
        clocks = np.zeros(0, dtype=int) if starts_only else np.flatnonzero(self.free)
        late = self.late(point, outputs, residuals, clocks)
        parts = []
        for s, one in enumerate(residuals):
            r = self.weighted(one)
            J = np.array([column[s] for column in found]).reshape(len(found), len(r)).T
            parts.append((r, J[:, : len(scales[s])], np.hstack([late[s], J[:, most:]])))
        return parts

    def late(self, point, outputs, residuals, clocks):
        """[(N_s, d)] changes of the weighted outputs with the delays of some clocks (d,), per s.

        Starts are late by the mean of the delays. So a delay d of one of T clocks makes its measurements d earlier, and
        all starts d / T, with respect to which all inputs are later.
        """
        if not len(clocks):
            return [np.zeros((len(self.weighted(one)), 0)) for one in residuals]
        everything = self.tasks(Change(self.runs, point), [("time", 0), ("time", 1)])
        rates, alike = (
            [factor * part for part in self.beside(outputs, other, residuals)] for factor, other in everything
        )
        part, found = 1.0 / len(self.deviation), []
        for rate, shift, one in zip(rates, alike, residuals):
            owner = np.repeat(np.arange(len(one)), [rest.size for rest in one])
            found.append(np.array([part * (rate - shift) - rate * (owner == t) for t in clocks]).T)
        return found

    def _step(self, point, parts, damping):
        """Step from Unknowns.

        Changes [(c,)] of the starts by their scales, (g,) of delays and numbers, by which share the sum of squares
        would decrease if outputs were linear, and whether all changes are small.
        """
        q = len(self.runs.numbers)
        g = parts[0][2].shape[1]
        eliminated, rows, right = [], [], []
        for r, J_x, J_g in parts:
            sizes = np.linalg.norm(J_x, axis=0)
            more = np.sqrt(damping) * np.diag(np.maximum(sizes, 1e-300)) if damping else np.zeros((0, len(sizes)))
            A = np.vstack([J_x, more])
            U, singular, V = np.linalg.svd(A, full_matrices=False)
            good = singular > HIDDEN * singular[:1].max(initial=0.0)
            U, singular, V = U[:, good], singular[good], V[good]
            U = U[: len(r)]
            eliminated.append((U, singular, V))
            rows.append(without(U, J_g))
            right.append(without(U, r))
        step = np.zeros(g)
        if g:
            J, r = np.vstack(rows), np.concatenate(right)
            sizes = np.linalg.norm(J, axis=0)
            scales = self.runs.numbers.scales
            prior = np.zeros((q, g))
            prior[:, g - q :] = np.diag(scales / self.priors[:, 1])
            J = np.vstack([J, prior, np.sqrt(damping) * np.diag(sizes)])
            r = np.concatenate([r, self._prior(point), np.zeros(g)])
            low, high = np.full(g, -np.inf), np.full(g, np.inf)
            low[g - q :], high[g - q :] = ((limit - point.values) / scales for limit in self.limits.T)
            sizes = np.linalg.norm(J, axis=0)
            seen = sizes > UNSEEN * sizes.max(initial=0.0)
            R = np.linalg.qr(np.column_stack([J[:, seen] / sizes[seen], r]), mode="r")
            A, b = R[:, :-1], R[:, -1]
            found = np.linalg.lstsq(A, b, rcond=UNSEEN)[0]
            limits = low[seen] * sizes[seen], high[seen] * sizes[seen]
            if (found < limits[0]).any() or (found > limits[1]).any():
                found = scipy.optimize.lsq_linear(A, b, limits, method="bvls").x
            step[seen] = found / sizes[seen]
        changes, small, expected = [], True, 0.0
        spread = np.sqrt(sum(float(r @ r) for r in right) / max(sum(map(len, right)), 1))
        for (r, _, J_g), (U, singular, V) in zip(parts, eliminated):
            rest = r - J_g @ step
            part = U.T @ rest
            rest -= U @ part
            expected += float(rest @ rest)
            small = small and bool(np.abs(part).max(initial=0.0) < CLOSE * spread)
            changes.append(V.T @ (part / singular))
        if g:
            small = small and bool((np.abs(step) * np.linalg.norm(np.vstack(rows), axis=0) < CLOSE * spread).all())
        at_end = self._prior(replace(point, values=point.values + step[g - q :] * self.runs.numbers.scales))
        total = sum(float(r @ r) for r, *_ in parts) + float(np.sum(self._prior(point) ** 2))
        share = 1.0 - (expected + float(np.sum(at_end**2))) / total if total else 0.0
        return changes, step, share, small

    def _moved(self, point, changes, step):
        """Unknowns after a step."""
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


def without(U, x):
    """Vectors or columns x without their parts in the range of U, whose columns are orthonormal."""
    return x - U @ (U.T @ x)


def _range(J):
    """Orthonormal basis of the range of J (N, c)."""
    if not J.shape[1]:
        return J
    U, singular, _ = np.linalg.svd(J, full_matrices=False)
    return U[:, singular > HIDDEN * singular.max(initial=0.0)]
