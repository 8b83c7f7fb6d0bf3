# SPDX-License-Identifier: Apache-2.0
"""Identification of numbers of a scene from logs, with intervals and what cannot be known."""

from dataclasses import dataclass, replace

import numpy as np

from .comparison import LENGTH, Comparison, fitted, judged
from .contradictions import channel_fits
from .fit import Fit
from .runs import Runs
from .starts import first_states

ROUNDS = 3  # of fits, with the noise of the residuals of the one before
UNKNOWN = 1.0  # standard deviation of a combination, relative to the numbers: above it nothing is known
NAMED = 0.1  # of the largest weight in a combination


@dataclass(frozen=True, eq=False)
class Identification:
    """Numbers of a scene from a log.

    paths     : of the q numbers
    before, values : (q,) in the scene, and found
    deviations: (q,) standard deviations, inf: nothing shows the number
    correlation : (q, q)
    unknown   : [{path: weight}] combinations of relative changes that the log does not show
    comparison: Comparison with the numbers found
    held_out  : rms of the weighted residuals of segments that were left out (before, after); None without
    scene     : Scene with the numbers found
    """

    paths: tuple
    before: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    correlation: np.ndarray
    unknown: list
    comparison: Comparison
    held_out: tuple | None
    scene: object

    @property
    def intervals(self):
        """(q, 2) of 95 %."""
        half = self.comparison.half_width * self.deviations
        return np.stack([self.values - half, self.values + half], axis=1)


def identify(scene, log, names, limits=None, priors=None, length=LENGTH, held_out=0.0, workers=None):
    """Identification of numbers of a scene.

    names    : as `liegroup_sim sweep --vary` takes them
    limits   : (q, 2) least and largest values; None: none
    priors   : (q, 2) expected values and standard deviations, inf: none
    length   : s, of the segments, each of which has a start of its own
    held_out : share of the segments, at the end, that only validate
    Raises SceneError, ParameterError, SimulationError.
    """
    fit, solution, left = fitted(scene, log, names, length, workers, limits, priors, held_out)
    solution = fit.solve(solution.point, known=solution)
    given = [np.isfinite(each.deviation) for each in log.measured]
    for _ in range(ROUNDS - 1):
        noise = _noise(fit, solution, given)
        if max(np.abs(new / old - 1.0).max(initial=0.0) for new, old in zip(noise, fit.deviation)) < 0.02:
            break
        fit = Fit(fit.runs, noise, fit.free, fit.limits, fit.priors, workers)
        solution = fit.solve(solution.point, known=solution)
    d, numbers = int(fit.free.sum()), fit.runs.numbers
    q = len(numbers)
    comparison = judged(fit, solution)
    wide = solution.columns
    prior = np.hstack([np.zeros((q, d)), np.diag(numbers.scales / fit.priors[:, 1])])
    solution = replace(solution, columns=np.vstack([wide, prior]))
    covariance = solution.covariance[d:, d:] * max(1.0, comparison.reduced)
    deviations = np.sqrt(np.diag(covariance)) * numbers.scales
    with np.errstate(invalid="ignore"):
        size = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(size, size)
    validation = _validated(fit, left, solution.point) if len(left) else None
    return Identification(
        numbers.paths,
        numbers.values,
        solution.point.values,
        deviations,
        correlation,
        _unknown(solution.columns, d, solution.point.values / numbers.scales, numbers.paths),
        comparison,
        validation,
        numbers.scene_at(solution.point.values),
    )


def _noise(fit, solution, given):
    """[(p,)] standard deviations: given ones, others as the residuals have."""
    found, channels = [], iter(channel_fits(fit, solution))
    for t, (each, sigma, known) in enumerate(zip(fit.runs.log.measured, fit.deviation, given)):
        counts = sum(np.isfinite(parts[t]).sum(axis=0) for parts in solution.residuals)
        own = [next(channels).chi if count else 1.0 for count in counts]
        found.append(np.where(known, sigma, np.maximum(sigma * np.array(own), each.least)))
    return found


def _unknown(columns, d, relative, paths):
    """[{path: weight}] combinations of relative changes of the numbers that columns do not show."""
    if not len(paths):
        return []
    late, own = columns[:, :d], columns[:, d:]
    if d:
        Q = np.linalg.qr(late)[0]
        own = own - Q @ (Q.T @ own)
    own = own * np.where(relative != 0.0, np.abs(relative), 1.0)
    _, singular, V = np.linalg.svd(own, full_matrices=False)
    found = []
    for size, row in zip(singular, V):
        if size * UNKNOWN < 1.0:
            row = row * np.sign(row[np.abs(row).argmax()])
            found.append({path: float(w) for path, w in zip(paths, row) if abs(w) > NAMED * np.abs(row).max()})
    return found


def _validated(fit, bounds, point):
    """Rms of the weighted residuals of the segments left out, with the numbers of the scene and with those found."""
    found = []
    for values in (fit.runs.numbers.values, point.values):
        runs = Runs(fit.runs.numbers.scene_at(values), fit.runs.log, (), fit.runs.longest)
        other = Fit(runs, fit.deviation, fit.free & False, None, None, fit.workers)
        states = first_states(runs, bounds, point.delays)
        start = replace(point, bounds=bounds, states=states, values=runs.numbers.values)
        solution = other.solve(start)
        count = sum(int(np.isfinite(part).sum()) for parts in solution.residuals for part in parts)
        found.append(float(np.sqrt(solution.left @ solution.left / max(count, 1))))
    return tuple(found)
