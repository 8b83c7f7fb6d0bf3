# SPDX-License-Identifier: Apache-2.0
"""Identification of numbers of a scene from logs, with intervals and what cannot be known."""

from dataclasses import dataclass, replace

import numpy as np

from .comparison import Comparison, covariance_of, fitted, in_short_steps, is_in_reach, judged, tied
from .contradictions import channel_fits
from .fit import Fit
from .log import ENOUGH
from .starts import alone, first_states

ROUNDS = 20  # of fits, with the noise of the residuals of the one before
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
    def is_robust(self):
        """Whether deviations are those of correlated residuals, as residuals are not white."""
        return not self.comparison.is_white

    @property
    def is_in_reach(self):
        """Whether the search ended near to the noise; else the numbers are the nearest ones that it found."""
        return is_in_reach(self.comparison.fit, self.comparison.solution)

    @property
    def intervals(self):
        """(q, 2) of 95 %."""
        half = self.comparison.half_width * self.deviations
        return np.stack([self.values - half, self.values + half], axis=1)


def identify(scene, log, names, limits=None, priors=None, held_out=0.0, workers=None, tell=None):
    """Identification of numbers of a scene.

    names    : as `liegroup_sim sweep --vary` takes them
    limits   : (q, 2) least and largest values; None: none
    priors   : (q, 2) expected values and standard deviations, inf: none
    held_out : share of the segments, at the end, that only validate
    tell     : function of a text, how far the work is; None: nothing is told
    Raises SceneError, ParameterError, SimulationError.
    """
    fit, near, solution, left = fitted(scene, log, names, workers, limits, priors, held_out, tell)
    given, weighted = [np.isfinite(each.deviation) for each in log.measured], fit
    for _ in range(ROUNDS):
        point = in_short_steps(weighted, solution.point, solution.outputs)
        solution = weighted.solve(point, known=solution, slack=solution.slack)
        noise = _noise(weighted, solution, given)
        if max(np.abs(new / old - 1.0).max(initial=0.0) for new, old in zip(noise, weighted.deviation)) < 0.02:
            break
        weighted = Fit(fit.runs, noise, fit.free, fit.limits, fit.priors, workers)
    d, numbers = int(fit.free.sum()), fit.runs.numbers
    # Weights are those of the residuals. A model is judged by the noise that a smooth motion leaves, if enough values
    # show that.
    for t, each in enumerate(fit.runs.log.measured):
        few = np.isfinite(each.values).sum(axis=0) < ENOUGH + 3
        fit.deviation[t] = np.where(few, weighted.deviation[t], fit.deviation[t])
    comparison = judged(
        fit, near, fit.solution(solution.point, solution.outputs, fit.linear_of(solution), solution.slack)
    )
    columns = np.vstack([solution.chain.columns, fit.known])
    covariance = covariance_of(weighted, solution, columns, comparison.is_white)[d:, d:]
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
        _unknown(columns, d, solution.point.values / numbers.scales, numbers.paths),
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
        found.append(np.where(known, sigma, np.maximum(sigma * np.array(own), fit.least[t])))
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
        other = alone(fit.runs, values, fit.deviation, fit.workers)
        states = first_states(other.runs, bounds, point.delays)
        start = replace(point, bounds=bounds, states=states, values=other.runs.numbers.values)
        solution = tied(other, other.solve(start))
        found.append(float(np.sqrt(solution.chain.left @ solution.chain.left / max(solution.count, 1))))
    return tuple(found)
