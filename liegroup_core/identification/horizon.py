# SPDX-License-Identifier: Apache-2.0
"""How far ahead a fitted model predicts: the error of runs that go on to the end of the log, without its measurements.

Runs begin at starts all over the log, which the segments of the fit there have found. The difference between the
measurements and a run, a time after its start, has three parts besides the error of the model: the noise; what the
uncertainty of the start, of the numbers and of the clocks explains, linear about the run; and the error of the
integration. A model whose runs are off by more is wrong, also where each short segment for itself agrees with it.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from liegroup_core.errors import SimulationError
from liegroup_core.threads import one_blas_thread

from .fit import HIDDEN

STARTS = 12  # of runs, at most, of which each recording has one
FIRST = 5  # measurements after which the first interval ends
RATIO = 1.25  # of successive times ahead
LEVEL = 0.01  # probability of the verdict "differs" for a right model
NOISY = 1.5  # noise is not larger than an error that serves by less
TENTH = 0.1  # of the spread of an output: the size of an error that still serves
ORDER = 4


@dataclass(frozen=True, eq=False)
class Horizon:
    """Errors of the predictions of one output.

    name, topic, unit : of the output
    noise     : standard deviation
    ahead     : (h,) s after the start: ends of intervals, of which the last one is the longest run
    error     : (h,) rms of measured minus predicted in each interval, with the noise
    explained : (h,) rms of what the uncertainty of starts, numbers and clocks explains; inf: not linear any more
    numerical : (h,) rms of the estimated error of the integration
    starts, counts : (h,) number of runs, and of measurements
    useful    : an error that still serves, a tenth of the spread of the output, rounded
    run       : of the longest run (r,) times in s, measured, predicted, and standard deviations of what is explained
    """

    name: str
    topic: str
    unit: str
    noise: float
    ahead: np.ndarray
    error: np.ndarray
    explained: np.ndarray
    numerical: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    useful: float
    run: tuple

    def within(self, size):
        """Time in s up to which the rms of the predictions is at most `size`, or (h,) sizes; 0: never."""
        beyond = np.flatnonzero(self.error > size)
        return float(self.ahead[-1] if not len(beyond) else self.ahead[beyond[0] - 1] if beyond[0] else 0.0)

    @property
    def within_noise(self):
        """Time in s up to which the model's own error is at most the noise, whose squares add, but for chance."""
        by_chance = scipy.stats.chi2.isf(LEVEL / max(len(self.ahead), 1), self.counts) / self.counts
        return self.within(self.noise * np.sqrt(2.0 * by_chance))

    @property
    def expected(self):
        """(h,) rms that the noise, the uncertainties and the integration explain."""
        return np.sqrt(self.noise**2 + self.explained**2 + self.numerical**2)

    @property
    def differs_from(self):
        """First time in s after which predictions are off by more than is explained; inf: they are not.

        What starts explain is one number of each run: so the mean of the squares counts as that of as many numbers as
        there are runs.
        """
        with np.errstate(invalid="ignore"):
            squares = self.starts * (self.error / self.expected) ** 2
        chance = scipy.stats.chi2.sf(np.nan_to_num(squares), np.maximum(self.starts, 1))
        off = np.flatnonzero(chance < LEVEL / max(len(self.ahead), 1))
        return float(self.ahead[off[0]]) if len(off) else np.inf

    @property
    def text(self):
        """For how long the model predicts the output, without a full stop."""
        noise, useful, last = self.within_noise, self.within(self.useful), self.ahead[-1]
        if noise == last:
            return f"predicts {self.name} within its noise for all of {last:.3g} s"
        found = f"predicts {self.name} within its noise for {noise:.2g} s"
        if self.useful > NOISY * self.noise:
            found += f", within {self.useful:g} {self.unit} for {useful:.2g} s"
        k = int(self.error.argmax())
        most = f"it is off by up to {self.error[k]:.2g} {self.unit}, after {self.ahead[k]:.2g} s"
        return f"{found}; {most}, where {self.expected[k]:.2g} {self.unit} is explained"


@one_blas_thread()
def horizons(fit, solution):
    """[Horizon] of the outputs of a Solution; none where no run goes on."""
    owners = _starts(fit, solution)
    if not owners:
        return []
    point, runs = _long(fit, solution.point, owners), fit.runs
    kinds = [outputs.units for outputs in runs.machine(point.values).outputs]
    outputs = runs.base(point)
    residuals = fit.residuals(point, outputs)
    explained = _explained(fit, solution, point, outputs, residuals, owners)
    finer = runs.base(replace(point, halves=point.halves + 1))
    found = []
    for t, each in enumerate(runs.log.measured):
        times = [s.times[s.places[t]] - s.start for s in runs.segments(point)]
        # Errors of the steps, from those of half the size.
        numeric = [fit.apart[t](a[t], b[t]) * 2**ORDER / (2**ORDER - 1) for a, b in zip(outputs, finer)]
        last = max((at[-1] for at in times if len(at)), default=0.0)
        first = FIRST * float(np.median(np.diff(each.times))) if len(each.times) > 1 else last
        count = int(np.log(max(last / max(first, 1e-9), 1.0)) / np.log(RATIO))
        ends = last * RATIO ** -np.arange(count, -1.0, -1.0)
        for p, name in enumerate(each.channels):
            longest = max(range(len(times)), key=lambda k: times[k][-1] if len(times[k]) else 0.0)
            run = _run(runs.segments(point)[longest], each, t, p, *(of[longest] for of in (outputs, explained)))
            parts = [[part[t][:, p] for part in of] for of in (residuals, explained)]
            parts.append([part[:, p] for part in numeric])
            sigma = float(fit.deviation[t][p])
            rows = _rows(ends, times, *parts)
            useful = _rounded(TENTH * float(each.spread[p]))
            found.append(Horizon(name, each.name, kinds[t][p], sigma, *rows.T, useful, run))
    return [each for each in found if len(each.ahead)]


def _run(segment, measured, t, p, outputs, explained):
    rows = segment.rows[t]
    return measured.times[rows], measured.values[rows, p], outputs[t][:, p], explained[t][:, p]


def _rows(ends, times, rest, explained, numeric):
    """(h, 6) fields of a Horizon from `ahead` to `counts`, from [(r,)] at times after the start [(r,)]."""
    of = np.concatenate([np.full(len(at), k) for k, at in enumerate(times)])
    at, rest, explained, numeric = map(np.concatenate, (times, rest, explained, numeric))
    place = np.searchsorted(ends, at - 1e-9)
    rows = []
    for k, end in enumerate(ends):
        here = (place == k) & np.isfinite(rest)
        if here.any():
            sizes = (np.sqrt(np.mean(part[here] ** 2)) for part in (rest, explained, numeric))
            rows.append((end, *sizes, len(np.unique(of[here])), here.sum()))
    return np.array(rows).reshape(len(rows), 6)


def _rounded(size):
    """Nearest of 1, 2 and 5 times a power of ten."""
    if not size > 0.0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(size))
    return float(f"{min((1.0, 2.0, 5.0, 10.0), key=lambda digit: abs(np.log(size / power / digit))) * power:.1g}")


def _starts(fit, solution):
    """Numbers of segments of a Solution from whose starts runs go on to the ends of their recordings."""
    bounds, found = solution.point.bounds, []
    for first, last in fit.runs.log.spans:
        own = np.flatnonzero((bounds[:, 0] >= first - 1e-6) & (bounds[:, 0] < last))
        known = np.array([_rank(solution.linear[k][0]) for k in own])
        own = own[known == known.max(initial=0)]  # of the others no measurement shows all
        share = max(1, STARTS // len(fit.runs.log.spans))
        for k in own[np.unique(np.linspace(0, len(own) - 1, min(share, len(own))).astype(int))] if len(own) else ():
            try:
                fit.runs.base(_long(fit, solution.point, [k]))
            except SimulationError:
                continue
            found.append(k)
    return found


def _long(fit, point, numbers):
    """Unknowns with runs from some segments to the ends of their recordings."""
    firsts = point.bounds[numbers, 0]
    ends = [next(last for first, last in fit.runs.log.spans if first - 1e-6 <= at < last) + 1e-6 for at in firsts]
    return replace(point, bounds=np.column_stack([firsts, ends]), states=tuple(point.states[k] for k in numbers))


def _rank(J):
    """Number of directions of a start that its segment shows."""
    singular = np.linalg.svd(J, compute_uv=False)
    return int((singular > HIDDEN * singular.max(initial=0.0)).sum())


def _explained(fit, solution, point, outputs, residuals, owners):
    """[[(r, p)]] standard deviations of outputs by the uncertainty of starts, delays and numbers; inf: not linear."""
    found, shared = [], np.nan_to_num(solution.covariance, posinf=0.0)
    for parts, (J, G), one, (_, O_x, O_g) in zip(
        outputs, (solution.linear[k] for k in owners), residuals, fit._linear(point, outputs, residuals)
    ):
        U, singular, V = np.linalg.svd(J, full_matrices=False)
        seen = np.arange(len(singular)) < _rank(J)
        own = O_x @ V[seen].T / singular[seen]
        hidden = np.linalg.norm(O_x - O_x @ V[seen].T @ V[seen], axis=1) > HIDDEN * np.linalg.norm(O_x, axis=1)
        of_shared = O_g - own @ U[:, seen].T @ G
        variances = np.sum(own**2, axis=1) + np.einsum("ki,ij,kj->k", of_shared, shared, of_shared)
        deviations, at = [], 0
        for t, rest in enumerate(one):
            size = rest.size
            here = np.sqrt(np.where(hidden, np.inf, variances))[at : at + size].reshape(rest.shape) * fit.deviation[t]
            spread = fit.runs.log.measured[t].spread
            deviations.append(np.where(here < np.maximum(spread, fit.deviation[t]), here, np.inf))
            at += size
        found.append(deviations)
    return found
