# SPDX-License-Identifier: Apache-2.0
"""Whether the residuals of a fit are white noise: a portmanteau test of their correlations from one time to the next.

Its statistic (Hosking 1980; for one output that of Ljung and Box 1978) has a chi-squared distribution for many values.
With 50 values, of which a fit explains five, one of white noise exceeds the quantile of 1e-3 in 17 of 1000 cases, with
1000 values in two. So small probabilities are those of white noise from which the unknowns of the fit are projected out
(Lin and McLeod 2006), by a normal distribution of the logarithm: within a factor of two or so, down to 2.5e-4.
"""

from functools import cached_property

import numpy as np
import scipy

from .fit import range_of
from .log import LEAST

LAGS = 20
# Probabilities by the chi-squared distribution that are computed again, and for at most so many values.
DOUBTFUL, MOST_VALUES = (1e-20, 0.05), 10_000
SAMPLES, AT_ONCE = 400, 2_000_000  # of noise; numbers in memory


class Whiteness:
    """Tests of the residuals of a Solution of a Fit."""

    def __init__(self, fit, solution):
        self._fit, self._solution = fit, solution

    def __call__(self, t, columns, errors=None):
        """Probability of correlations as large between residuals of some columns of a Measured, if these are white.

        Within runs along the log. Residuals below LEAST of the noise are round-off, as of a motion in a plane across
        it; those below the errors of the integration, or the least noise of exact values, say nothing.

        errors : [(p,)] largest errors of the integration by the noise, of each Measured; None: not known
        """
        parts = [residuals[t][:, columns] for residuals in self._solution.residuals]
        deviation = self._fit.deviation[t][columns]
        least = deviation * np.maximum(LEAST, 0.0 if errors is None else errors[t][columns])
        least = np.maximum(least, self._fit.least[t][columns])
        largest = np.nanmax(np.abs(np.concatenate(parts)), axis=0, initial=0.0)
        is_seen = largest > least
        least, columns, by = least[is_seen], np.asarray(columns)[is_seen], deviation[is_seen]
        parts = [part[:, is_seen] / least for part in parts]
        known = [np.isfinite(part).all(axis=1) for part in parts]
        ends = [e[None] for e in self._along([part[rows] for part, rows in zip(parts, known)])]
        p = len(columns)
        lags = min(LAGS, max(e.shape[1] for e in ends) // (4 * p)) if p else 0
        if not lags or not all(np.any(e != 0.0) for e in np.concatenate(ends, axis=1)[0].T):
            return 1.0
        found = _portmanteau(ends, lags)[0]
        chance = float(scipy.stats.chi2.sf(found, lags * p**2))
        if not DOUBTFUL[0] < chance < DOUBTFUL[1] or sum(e.shape[1] for e in ends) > MOST_VALUES:
            return chance
        by_noise = np.log(self._of_noise(t, columns, by / least, known, lags))
        return float(scipy.special.ndtr((by_noise.mean() - np.log(found)) / by_noise.std(ddof=1)))

    def _along(self, parts):
        """Arrays of segments, joined to those of runs along the log."""
        runs = np.split(np.arange(len(parts)), self._solution.firsts[1:])
        return [np.concatenate([parts[k] for k in run]) for run in runs]

    def _of_noise(self, t, columns, sizes, known, lags):
        """(SAMPLES,) of the statistic, of what a fit leaves of white noise of some sizes (p,).

        known : [(r,)] masks of the rows
        """
        own = []
        for k, rows in enumerate(known):
            ends = np.cumsum([rest.size for rest in self._solution.residuals[k]])[:-1]
            rest = self._solution.residuals[k][t]
            own.append(np.split(self._explained[k], ends)[t].reshape(*rest.shape, -1)[rows][:, columns])
        runs, rng, found = self._along(own), np.random.default_rng(0), []
        # What other outputs and priors add to the coordinates of the noise in the basis.
        size, ways = np.linalg.eigh(np.eye(runs[0].shape[2]) - sum(np.tensordot(U, U, ((0, 1), (0, 1))) for U in runs))
        others = ways * np.sqrt(np.maximum(size, 0.0))
        count = max(1, AT_ONCE // sum(U[:, :, 0].size for U in runs))
        for first in range(0, SAMPLES, count):
            noise = [rng.standard_normal((min(count, SAMPLES - first), *U.shape[:2])) for U in runs]
            x = rng.standard_normal((len(noise[0]), len(others))) @ others.T
            x += sum(np.tensordot(e, U, ((1, 2), (0, 1))) for e, U in zip(noise, runs))
            left = [(e - np.tensordot(x, U, (1, 2))) * sizes for e, U in zip(noise, runs)]
            found.append(_portmanteau(left, lags))
        return np.concatenate(found)

    @cached_property
    def _explained(self):
        """[(N_s, u)] rows of segments in an orthonormal basis of what all unknowns explain, with their priors."""
        linear, firsts = self._solution.linear, self._solution.firsts
        g, count = linear[0].shared.shape[1], sum(linear[k].own.shape[1] for k in firsts)
        shared, rows, at = np.eye(g, count + g, count), [], 0
        for k, part in enumerate(linear):
            if k in firsts:
                own = np.eye(part.own.shape[1], count + g, at)
                at += len(own)
            rows.append(part.own @ own + part.shared @ shared)
            own = part.tie.own @ own + part.tie.shared @ shared if part.tie else own
        J = np.vstack([*rows, self._fit.known @ shared])
        sizes = np.linalg.norm(J, axis=0)
        return np.split(range_of(J / np.where(sizes > 0.0, sizes, 1.0)), np.cumsum([len(each) for each in rows]))[:-1]


def _portmanteau(ends, lags):
    """(s,) statistics of s samples of residuals [(s, n, p)] of runs along the log, whose variance is 1 at least."""
    count, total = sum(e.shape[1] for e in ends), 0.0
    size, ways = np.linalg.eigh(sum(e.swapaxes(1, 2) @ e for e in ends))
    across = (ways / np.sqrt(np.maximum(size, count))[:, None]).swapaxes(1, 2)
    ends = [across @ e.swapaxes(1, 2) for e in ends]
    for lag in range(1, lags + 1):
        C = sum(e[:, :, lag:] @ e[:, :, :-lag].swapaxes(1, 2) for e in ends if e.shape[2] > lag)
        total = total + np.sum(C**2, axis=(1, 2)) / (count - lag)
    return count * (count + 2) * total
