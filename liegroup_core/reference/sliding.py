# SPDX-License-Identifier: Apache-2.0
"""Motions of the reference integration along surfaces a = b of comparisons of laws (Filippov's solution).

The shares of both sides are unknowns at the nodes of a step, at which a - b must be what it is at the start: a
differential-algebraic equation of index 2, for which collocation of Radau IIA keeps its order (Hairer and Wanner,
section VII.4). The engine requires the rate of a - b to be zero instead.
"""

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import brentq

FREE = np.inf  # side of a comparison that its arguments decide; else the share of a < b
SAME = 1e-9  # of shares: they are less exact than the motion
NEAR, SHIFT = 1e-6, 0.1  # differences: of the time, relative to that of the motion, and of shares
ROUND_OFF = 64.0 * np.finfo(float).eps  # of heights, relative to the largest number of a state
SOON = 1e-9  # s, within which a surface is reached where no step is possible
GRID = np.linspace(0.0, 1.0, 101)  # of a step, where the first share beyond 0 and 1 is sought
TOGETHER = 1e-13  # of a step, between changes that are one
MOST_IDLE = 20  # changes of sides without a step


class Surfaces:
    """Sides of the comparisons of the continuous laws in one integration.

    sides   : (c,) FREE, or share of a < b; 0 and 1 also hold the side to which the motion has left a surface
    slides  : (c,) whether the motion slides along a = b
    heights : (c,) a - b at the present state, NaN where nothing needs it
    """

    def __init__(self, count, nodes, matrix):
        self.sides, self.slides, self.heights = np.full(count, FREE), np.zeros(count, bool), np.zeros(count)
        self._inverse, self._idle, self._leaves, self._noise = np.linalg.inv(matrix), 0, None, 0.0
        self._polynomial = np.linalg.inv(legendre.legvander(2.0 * nodes - 1.0, len(nodes) - 1))
        self._through = np.linalg.inv(legendre.legvander(np.r_[-1.0, 2.0 * nodes - 1.0], len(nodes)))
        self._grid = legendre.legvander(2.0 * GRID - 1.0, len(nodes))
        self._values = legendre.legvander(2.0 * GRID - 1.0, len(nodes) - 1)

    def _climb(self, function, time, state, scale, sides):
        """(r, N) slopes of a state, heights (r, c) and their rates, with sides (r, c)."""
        r, slopes = len(sides), np.empty((len(sides), len(state)))
        heights = function(np.full(r, time), np.tile(state, (r, 1)), slopes, sides)
        h, rest = NEAR / max(1.0, np.abs(slopes / scale).max()), np.empty_like(slopes)
        after, before = (function(np.full(r, time + s), state + s * slopes, rest, sides) for s in (h, -h))
        with np.errstate(invalid="ignore"):  # heights that a law skips
            return slopes, heights, (after - before) / (2.0 * h)

    def begin(self, function, time, state, scale):
        """Prepare steps from a state."""
        self.least = ROUND_OFF * max(1.0, np.abs(state).max())
        if not self.slides.any():
            return
        ways = SHIFT * np.eye(len(self.sides))[self.slides]
        sides = np.vstack([self.sides + ways, self.sides - ways])
        slopes, heights, rates = self._climb(function, time, state, scale, sides)
        self.heights = np.where(self.slides, heights[0], self.heights)
        self._effects, rates = ((each[: len(ways)] - each[len(ways) :]) / (2.0 * SHIFT) for each in (slopes, rates))
        self._shares = np.linalg.pinv(np.nan_to_num(rates[:, self.slides]))
        self._round_off = self.least * np.abs(self._shares).sum()

    def correct(self, sides, slopes, heights, step):
        """Newton's step for the sides (s, c) and slopes (s, N) at the nodes of a step, where the heights are (s, c)."""
        if self.slides.any():
            off = np.nan_to_num(heights[:, self.slides] - self.heights[self.slides])
            change = self._inverse @ off @ self._shares / step
            sides[:, self.slides] -= change
            slopes -= change @ self._effects
            self._noise = self._round_off / step

    def part(self, sides, heights):
        """Part of a step in which shares stay between 0 and 1, and sides that were left to are kept; 1: all of it."""
        part, self._leaves = 1.0, None
        for k in np.flatnonzero(self.slides):
            coefficients, allowed = self._polynomial @ sides[:, k], 0.5 + SAME + self._noise

            def share(u, coefficients=coefficients):
                return legendre.legval(2.0 * u - 1.0, coefficients)

            def beyond(u, share=share, allowed=allowed):
                return np.abs(share(u) - 0.5) - allowed

            first = np.flatnonzero(beyond(GRID) > 0.0)[:1]
            if len(first):
                (i,) = first
                end = brentq(beyond, GRID[i - 1], GRID[i], xtol=1e-14) if i else 0.0
                if end < part:
                    part, self._leaves = end, (k, float(share(GRID[i]) > 0.5))
        if (self._above(heights) < -2.0 * np.abs(self.heights) - self.least)[:, self._held].any():
            part = min(part, 0.25)
        return part

    def changes(self, heights):
        """Parts (p,) of a step where the side of a comparison changes, by polynomials of the heights (s, c)."""
        free = (self.sides == FREE) & (np.abs(heights).max(axis=0) > self.least)
        values = self._values @ (self._polynomial @ heights[:, free])
        i, k = np.nonzero(values[1:] * values[:-1] < 0.0)
        before, after = values[i, k], values[i + 1, k]
        return np.sort(GRID[i] + before / (before - after) * np.diff(GRID)[i])

    def kept(self, heights, before):
        """Sides (c,) a step keeps: `before` where given, else of the heights (c,) at its start; None if it slides."""
        if self.slides.any():
            return None
        free, sure = self.sides == FREE, np.abs(heights) > self.least
        found = np.where(sure, np.where(heights < 0.0, 1.0, 0.0), FREE)
        return np.where(free, np.where(before == FREE, found, before), self.sides)

    def first_change(self, kept, start, heights):
        """(part, numbers) of the first change of heights whose sides are kept; part 1: there is none.

        start, heights : (c,) at the start and (s, c) at the nodes of a step with the sides `kept` (c,)
        """
        sure = np.flatnonzero((self.sides == FREE) & (kept != FREE))
        above = np.where(kept[sure] == 1.0, -1.0, 1.0)
        coefficients = self._through @ (above * np.vstack([start[sure], heights[:, sure]]))
        beyond = self._grid @ coefficients < 0.0
        first, numbers = 1.0, []
        for i in np.flatnonzero(beyond[1:].any(axis=1))[:1]:
            for k in np.flatnonzero(beyond[i + 1]):

                def height(u, own=coefficients[:, k]):
                    return legendre.legval(2.0 * u - 1.0, own)

                part = GRID[i] if height(GRID[i]) <= 0.0 else GRID[i + 1]
                if height(GRID[i]) > 0.0 > height(part):  # not by round-off alone
                    part = brentq(height, GRID[i], part, xtol=1e-16)
                if part < first - TOGETHER:
                    numbers = []
                if part < first + TOGETHER:
                    first, numbers = min(first, part), [*numbers, int(sure[k])]
        return first, numbers

    def sides_at(self, x, sides):
        """Sides (p, c) at points x on [-1, 1] of a step with the sides (s, c) at its nodes."""
        found = np.tile(self.sides, (len(x), 1))
        if self.slides.any():
            found[:, self.slides] = legendre.legval(x, self._polynomial @ sides[:, self.slides]).T
        return found

    @property
    def _held(self):
        """(c,) whether a side holds to which the motion has left a surface."""
        return ~self.slides & (self.sides != FREE)

    def _above(self, heights):
        """Heights (..., c) that are positive on these sides."""
        return np.where(self.sides == 1.0, -heights, heights)

    def start(self, solver):
        """Find the surfaces along which the motion slides from its start."""
        slope = np.empty((1, len(solver.state)))
        self.heights = solver.function(np.array([solver.time]), solver.state[None], slope)[0]
        for k in np.flatnonzero(self.heights == 0.0):
            self._enter(k, solver)

    def after(self, solver, moves):
        """Change sides after a step, or where no step is possible; returns whether any changed."""
        sides, slides, held = self.sides.copy(), self.slides.copy(), self._held
        met = ~slides & ~held
        if moves:
            ends, heights = solver.sides[-1], solver.heights[-1]
            met &= (np.sign(heights) != np.sign(self.heights)) & ~np.isnan(heights) & ~np.isnan(self.heights)
            self.sides[held & (self._above(heights) > 2.0 * np.abs(self.heights))] = FREE
            self.sides[slides], self._idle = ends[slides], 0
            self.heights = np.where(slides, self.heights, heights)
            for k in np.flatnonzero(slides & np.isnan(heights)):
                self._leave(k, FREE)
            for k in np.flatnonzero(slides & (np.abs(self.sides - 0.5) >= 0.5 - SAME) & (self._noise < SAME)):
                self._leave(k, float(self.sides[k] > 0.5))
        elif self._leaves is not None:
            met[:] = False
            self._leave(*self._leaves)
            self._leaves = None
        else:
            met = ~slides
            self.sides[held] = FREE
        for k in np.flatnonzero(met):
            self._enter(k, solver, None if moves else SOON)
        self._idle += not moves
        turned = (self.slides != slides).any()
        if turned:
            solver.wanted = None
        return turned or not moves and self._idle <= MOST_IDLE and (self.sides != sides).any()

    def _leave(self, k, side):
        self.slides[k], self.sides[k] = False, side

    def _enter(self, k, solver, soon=None):
        """Let the motion slide along surface k, too, if both sides lead back to it, and within a time."""
        along = np.append(np.flatnonzero(self.slides), k)
        sides = np.tile(self.sides, (len(along) + 1, 1))
        sides[:, along] = np.eye(len(along) + 1, len(along), -1)
        slopes = np.empty_like(solver.state)
        solver.function(np.array([solver.time]), solver.state[None], slopes[None])
        scale = solver.scales(solver.state, slopes)
        rates = self._climb(solver.function, solver.time, solver.state, scale, sides)[2][:, along]
        matrix = (rates[1:] - rates[0]).T
        if not np.isfinite(matrix).all() or np.linalg.cond(matrix) > 1.0 / SAME:
            return
        inverse = np.linalg.inv(matrix)
        shares = -inverse @ rates[0]
        if soon is not None and not abs(self.heights[k]) <= soon * np.abs(rates[:, -1]).max():
            return
        if inverse[-1, -1] > 0.0 and 0.0 < shares[-1] < 1.0:
            self.slides[k], self.sides[along] = True, shares
