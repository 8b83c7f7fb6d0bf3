# SPDX-License-Identifier: Apache-2.0
"""Collocation of high order for the reference integration: Radau IIA with STAGES stages, order 2 STAGES - 1.

A step finds the polynomial that satisfies the equations at the nodes. Its coefficients decay, and the last one
is the estimate of the error inside the step; at the end of the step the error is smaller by many orders. The
polynomial is also the motion between the ends of steps.

All comparisons of laws keep their sides in a step, so that its equations are smooth, and the step ends where the first
of their heights a - b changes its sign, if that has an effect. A step whose equations have no solution with these
sides, or which slides along a = b, lets them change freely. Then a force that changes its law before the first node
shows in the derivative at the start, which is no node. One that changes it, and back, between two nodes shows nowhere:
so the derivative is compared where comparisons change, and between, too.

Stages are found by iteration, or by Newton's method where the step is long against the fastest decay or vibration:
Hairer and Wanner, Solving Ordinary Differential Equations II, sections IV.5 and IV.8.
"""

import numpy as np
from numpy.polynomial import legendre

from .sliding import FREE, Surfaces

STAGES = 12
EPS = np.finfo(float).eps
ITERATIONS, NEWTON_ITERATIONS = 40, 15
SLOW = 0.5  # ratio of two corrections, above which the iteration converges too slowly
NEAR = 1e-12  # of a step, to its end
CLOSE = 1e-12  # a correction that no longer decreases must be smaller
KEEP = 1.25  # Newton's method keeps the step, and so its matrices, unless the step may grow by more
AGE = 20  # steps with the same Jacobian
MOST_ATTEMPTS = 100  # of one step
MET = 1e-9  # of the largest height in a step
SHORTER = 0.05  # least part of a step that is taken again up to a change that no node has seen


def _tableau():
    """(nodes on [0, 1], matrix a, coefficients of the values at 0 and at the nodes)."""
    last = np.zeros(STAGES + 1)
    last[-2:] = -1.0, 1.0
    x = np.sort(legendre.legroots(last).real)
    x -= legendre.legval(x, last) / legendre.legval(x, legendre.legder(last))
    x[-1] = 1.0
    integrals = np.array([legendre.legint(row, lbnd=-1) for row in np.eye(STAGES)])
    a = 0.5 * legendre.legval(x, integrals.T).T @ np.linalg.inv(legendre.legvander(x, STAGES - 1))
    return 0.5 * (x + 1.0), a, np.linalg.inv(legendre.legvander(np.r_[-1.0, x], STAGES))


NODES, MATRIX, COEFFICIENTS = _tableau()
GAPS = np.diff(NODES, prepend=0.0)  # part of the step up to each node
# Derivative of the polynomial at 0, times the part of the step before the first node.
_START = NODES[0] * np.array([(-1.0) ** (k + 1) * k * (k + 1) for k in range(STAGES + 1)])
_VALUES, _VECTORS = np.linalg.eig(MATRIX)
_UPPER = _VALUES.imag >= 0.0
_INTO = np.linalg.inv(_VECTORS)[_UPPER]
_OUT = _VECTORS[:, _UPPER] * np.where(_VALUES[_UPPER].imag > 0.0, 2.0, 1.0)
_VALUES = _VALUES[_UPPER]


class CollocationSteps:
    """Steps of an integration from (time, state), one by one.

    function(times (p,), states (p, N), out (p, N), sides (p, c)) : writes the time derivatives, returns heights (p, c)
    scales(state, slope) : (N,) sizes that errors are relative to
    count                : of the surfaces c, see sliding.py

    sides, heights : (s, c) at the nodes of the last step
    """

    def __init__(self, function, scales, time, state, tolerance, count=0, halves=False):
        self.function, self.scales, self._tolerance = function, scales, tolerance
        self.surfaces = Surfaces(count, NODES, MATRIX)
        self.time, self.state, self.step, self.wanted = time, state, 0.0, None
        self._carry = np.zeros_like(state)  # round-off of the sum of all increments
        self._polynomial = self._jacobian = self._inverse = None
        self._inverse_step, self._age, self._is_new, self._passed = 0.0, 0, True, np.full(count, FREE)
        self._halves, self._is_half = halves, False

    def at(self, times):
        """States (k, N) at times within the last step."""
        x = 2.0 * (np.asarray(times) - self._begin) / self.step - 1.0
        return (
            self._before + legendre.legval(x, self._polynomial).T
        )  # no product of matrices: bits depend on their size

    def restart(self):
        """Forget the previous step, because the equations change."""
        self._inverse, self._is_new = None, True

    def advance(self, end):
        """Take one step, to `end` at most; returns whether it has succeeded."""
        if self._is_new:
            self._set_start()
        scale = self.scales(self.state, self._slope)
        self.surfaces.begin(self.function, self.time, self.state, scale)
        aim, turned = None, set(np.flatnonzero(self._passed != FREE))
        kept = self.surfaces.kept(self._heights, self._passed)
        if turned and kept is not None:
            kept = self._set_start(kept)
        if self.wanted is None:
            change = np.abs(self._slope / scale).max()
            # Runs with different tolerances take different steps from the start: else they would have the same errors.
            self.wanted = (
                (1e4 * self._tolerance) ** (1.0 / (STAGES + 1)) / max(change, 0.1) if np.isfinite(change) else 0.1
            )
        left, is_near = end - self.time, False
        step = self.wanted if self.wanted < left else left
        if step < left < 2.0 * step:
            step = 0.5 * left
        for _ in range(MOST_ATTEMPTS):
            if not step > self._shortest:
                return False
            increments, slope, is_slow = self._stages(step, scale, self.surfaces.sides if kept is None else kept)
            if increments is None:
                if kept is not None and not is_slow:
                    kept = self._set_start()
                elif is_slow and self._inverse is None and self._set_jacobian(scale, kept) * step > 1.0:
                    self._set_inverse(step)
                elif is_slow and self._inverse is not None and self._age > 0:
                    self._set_jacobian(scale, kept)
                    self._set_inverse(step)
                else:
                    step *= 0.4
                    self._inverse = None
                continue
            polynomial = COEFFICIENTS[:, 1:] @ increments
            start = _START @ polynomial - NODES[0] * step * self._slope
            if self._is_new and self.surfaces.slides.any():  # its shares at the start are a guess
                start[:] = 0.0
            error = max(np.abs(polynomial[-1] / scale).max(), np.abs(start / scale).max())
            factor = 0.9 * (self._tolerance / max(error, 1e-30)) ** (1.0 / (STAGES + 1))
            if error > self._tolerance:
                step *= max(min(factor, 0.8), 0.2)
                continue
            if kept is not None:
                part, numbers = self.surfaces.first_change(kept, self._heights, self.heights)
                if part < 1.0 - NEAR:
                    same = self._slope_of_any_side(step, scale, increments)
                    if same is None and part * step > self._shortest:
                        step, aim = part * step, None
                        if self._halves and not self._is_half:
                            step, self._is_half, is_near = 0.5 * step, True, True
                        else:
                            aim = step, numbers
                        continue
                    if same is None:
                        kept = self._turned(kept, numbers, turned)
                        continue
                    slope, kept = same, None
            is_aimed = kept is not None and aim is not None and step == aim[0]
            part = self.surfaces.part(self.sides, self.heights)
            if kept is None:
                part = min(part, self._seen(step, scale, polynomial))
            if part < 1.0:
                step *= part
                continue
            self._passed, self._is_half = np.full(len(self._passed), FREE), is_near
            if is_aimed and self._has_met(aim[1]):
                self._passed[aim[1]] = 1.0 - kept[aim[1]]
                self.heights[-1, aim[1]] = (0.5 - self._passed[aim[1]]) * EPS
            self._accept(step, increments[-1], polynomial, end)
            self._slope, self._heights = slope, self.heights[-1].copy()
            factor = min(factor, 2.0)
            if self._inverse is not None:
                self._age += 1
                if self._age > AGE:
                    if self._set_jacobian(scale, kept) * step * factor < 1.0:
                        self._inverse = None
                    else:
                        self._inverse_step = 0.0
                factor = factor if factor > KEEP else 1.0
            keeps = (step == left or is_aimed or is_near) and step < self.wanted
            self.wanted = max(self.wanted if keeps else 0.0, step * factor)
            return True
        return False

    def _set_start(self, kept=None):
        """Set the slope and the heights at the start of a step with the sides (c,) that it keeps; returns `kept`."""
        self._slope = np.empty_like(self.state)
        sides = self.surfaces.sides if kept is None else kept
        self._heights = self.function(np.array([self.time]), self.state[None], self._slope[None], sides[None])[0]
        return None if kept is None else self.surfaces.kept(self._heights, kept)

    def _turned(self, kept, numbers, turned):
        """Sides of a step whose height changes at its start: the other ones, once each; else they decide freely."""
        if not turned.isdisjoint(numbers):
            return self._set_start()
        turned.update(numbers)
        kept = kept.copy()
        kept[numbers] = 1.0 - kept[numbers]
        return self._set_start(kept)

    def _has_met(self, numbers):
        """Whether heights are zero at the end of a step up to where a longer one, which may be rough, had them zero."""
        heights = np.vstack([self._heights, self.heights])[:, numbers]
        return (np.abs(heights[-1]) <= np.maximum(MET * np.abs(heights).max(axis=0), self.surfaces.least)).all()

    @property
    def _shortest(self):
        """Size that a step must exceed, s."""
        return 4.0 * EPS * abs(self.time)

    def _slope_of_any_side(self, step, scale, increments):
        """Derivative at the end of a step if the sides that it keeps have no effect; else None."""
        slopes = np.empty_like(increments)
        heights = self.function(self.time + NODES * step, self.state + (self._carry + increments), slopes)
        away = np.abs((step * (MATRIX @ slopes) - increments) / scale).max()
        if not away <= self._tolerance or (np.isnan(heights) != np.isnan(self._heights)).any():
            return None
        self.heights = heights
        return slopes[-1].copy()

    def _seen(self, step, scale, polynomial):
        """Part of a step up to which the nodes have seen all changes of comparisons that matter; 1: all of it."""
        changes = self.surfaces.changes(self.heights)
        if not len(changes):
            return 1.0
        points, width = np.repeat(changes, 2)[:-1], np.zeros(2 * len(changes) - 1)
        points[1::2], width[1::2] = 0.5 * (changes[1:] + changes[:-1]), np.diff(changes)
        x, slopes = 2.0 * points - 1.0, np.empty((len(points), len(scale)))
        states = np.ascontiguousarray(self.state + legendre.legval(x, polynomial).T)
        heights = self.function(self.time + points * step, states, slopes, self.surfaces.sides_at(x, self.sides))
        after = np.searchsorted(NODES, points).clip(1)
        dips = (np.sign(self.heights[after - 1]) * np.sign(self.heights[after]) > 0.0) & (
            self.heights[after] * heights < 0.0
        )
        width = np.where(dips.any(axis=1), GAPS[after], width)
        away = step * slopes - 2.0 * legendre.legval(x, legendre.legder(polynomial)).T
        unseen = np.flatnonzero(np.abs(away / scale).max(axis=1) * width > self._tolerance)
        part = max(SHORTER, points[unseen[0]]) if len(unseen) else 1.0
        return part if part * step > self._shortest else 1.0

    def _accept(self, step, increment, polynomial, end):
        self._before, self._begin, self._polynomial, self.step = self.state, self.time, polynomial, step
        increment = increment + self._carry
        self.state = self.state + increment
        self._carry = increment - (self.state - self._before)
        self.time, self._is_new = end if step >= end - self.time else self.time + step, False

    def _stages(self, step, scale, sides):
        """(increments (s, N) at the nodes or None, derivative at the end, whether the iteration was slow)."""
        if self._inverse is not None and self._inverse_step != step:
            if self._fastest * step > 1.0:
                self._set_inverse(step)
            else:
                self._inverse = None
        if self._is_new or step > 2.0 * self.step:
            found = np.zeros((STAGES, len(scale)))
        else:
            ahead = legendre.legvander(1.0 + 2.0 * NODES * step / self.step, STAGES)
            found = ahead @ self._polynomial - self._polynomial.sum(axis=0)
        times, slopes = self.time + NODES * step, np.empty_like(found)
        before, slow, self.sides = np.inf, 0, np.tile(sides, (STAGES, 1))
        for k in range(ITERATIONS if self._inverse is None else NEWTON_ITERATIONS):
            self.heights = self.function(times, self.state + (self._carry + found), slopes, self.sides)
            self.surfaces.correct(self.sides, slopes, self.heights, step)
            change = step * (MATRIX @ slopes) - found
            if self._inverse is not None:
                change = (_OUT @ (self._inverse @ (_INTO @ change)[..., None])[..., 0]).real
            found += change
            size = np.abs(change / scale).max()
            if not np.isfinite(size):
                return None, None, False
            if size <= EPS or (size >= SLOW * before and size <= CLOSE):
                return found, slopes[-1].copy(), False
            slow = slow + 1 if size > SLOW * before else 0
            if slow == 3 or size > 1e3 * before:
                return None, None, True
            before = size
        return None, None, True

    def _set_jacobian(self, scale, kept):
        """Set the Jacobian at the present state by differences; returns its spectral radius, 1/s."""
        n = len(self.state)
        moved, slopes = np.tile(self.state, (n + 1, 1)), np.empty((n + 1, n))
        change = np.sqrt(EPS) * scale
        moved[np.arange(n), np.arange(n)] += change
        sides = np.tile(self.surfaces.sides if kept is None else kept, (n + 1, 1))
        self.function(np.full(n + 1, self.time), moved, slopes, sides)
        self._jacobian, self._age = ((slopes[:n] - slopes[n]) / change[:, None]).T, 0
        is_finite = np.isfinite(self._jacobian).all()
        self._fastest = np.abs(np.linalg.eigvals(self._jacobian)).max() if is_finite else 0.0
        return self._fastest

    def _set_inverse(self, step):
        self._inverse = np.linalg.inv(np.eye(len(self.state)) - step * _VALUES[:, None, None] * self._jacobian)
        self._inverse_step = step
