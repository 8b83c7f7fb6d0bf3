# SPDX-License-Identifier: Apache-2.0
"""Least squares of starts of segments, which matching conditions tie, and of unknowns that all segments share.

Starts are eliminated one after the other by an orthogonal factor (square-root information filter; Bierman 1977, ch. V).
Ties are rows, of a weight so large that their slack is no part of what is found. So growing and decaying motions are
eliminated stably, and nothing is inverted that need not have an inverse.
"""

from typing import NamedTuple

import numpy as np
import scipy

# Variance of a coordinate by its scale, from which on it is not shown: an information of 1 is given, more than a tenth.
SHOWN = 0.1


class Part(NamedTuple):
    """One segment: weighted residuals (N,), and their columns with its start (N, c) and with what is shared (N, g)."""

    rest: np.ndarray
    own: np.ndarray
    shared: np.ndarray
    tie: object = None  # Tie to the start of the next segment; None: it is free


class Tie(NamedTuple):
    """Matching condition x' = own x + shared g + gap of the next start x', with weights (c',)."""

    own: np.ndarray
    shared: np.ndarray
    gap: np.ndarray
    weights: np.ndarray


class Chain:
    """Elimination of the starts of [Part].

    columns, left : (m, g), (m,) what is left of columns of shared unknowns, and of residuals: of equal products
    """

    def __init__(self, parts, damping=0.0):
        g = parts[0].shared.shape[1]
        self._blocks, ends, carried = [], [], None
        for rest, own, shared, tie in parts:
            c, n = own.shape[1], 0 if tie is None else len(tie.gap)
            given = damping * np.einsum("ij,ij->j", own, own) + (carried is None)
            rows = [np.column_stack([own, shared, rest]), np.eye(c, c + g + 1) * np.sqrt(given)[:, None]]
            rows = np.vstack(rows if carried is None else [*rows, carried])
            whole = np.zeros((n + len(rows), c + n + g + 1))
            whole[n:, :c], whole[n:, c + n :] = rows[:, :c], rows[:, c:]
            if n:  # the heavy rows first
                whole[:n, :c], whole[:n, c + n : -1] = -tie.own, -tie.shared
                whole[:n, c : c + n], whole[:n, -1] = np.eye(n), tie.gap
                whole[:n] *= tie.weights[:, None]
            R = np.linalg.qr(whole, mode="r")
            self._blocks.append((R[:c, :c], R[:c, c:-1], R[:c, -1]))
            carried = R[c:, c:] if n else None
            if not n:
                ends.append(R[c:, c:])
        R = np.linalg.qr(np.vstack(ends), mode="r")
        self.columns, self.left = R[:, :g], R[:, g]

    def starts(self, shared):
        """[(c,)] changes of the starts, with those of what is shared (g,)."""
        found, g = [], len(shared)
        for R, others, right in reversed(self._blocks):
            known = np.concatenate([found[-1], shared]) if others.shape[1] > g else shared
            found.append(scipy.linalg.solve_triangular(R, right - others @ known))
        return found[::-1]

    def covariances(self, shared):
        """[(c + g, c + g)] of each start and what is shared, whose own (g, g) is given."""
        found, g = [], len(shared)
        for R, others, _ in reversed(self._blocks):
            inverse = scipy.linalg.solve_triangular(R, np.eye(len(R)))
            known, of = found[-1] if others.shape[1] > g else shared, -inverse @ others
            cross = of @ known[:, len(known) - g :]
            found.append(np.block([[inverse @ inverse.T + of @ known @ of.T, cross], [cross.T, shared]]))
        return found[::-1]
