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

from .chain import SHOWN
from .fit import covariance
from .starts import ROUGHLY

STARTS = 12  # of runs, at most, of which each recording has one
FIRST = 5  # measurements after which the first interval ends
RATIO = 1.25  # of successive times ahead
LEVEL = 0.01  # probability of the verdict "differs" for a right model
NOISY = 1.5  # noise is not larger than an error that serves by less
TENTH = 0.1  # of the spread of an output: the size of an error that still serves


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
    freedom   : (h,) degrees of freedom of the mean of the squares: as many as runs, but one of what numbers and clocks,
                which all runs share, explain
    useful    : an error that still serves, a tenth of the spread of the output, rounded
    level     : probability of "differs" for a right model: of several outputs a share
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
    freedom: np.ndarray
    useful: float
    run: tuple
    level: float = LEVEL

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

        What starts explain is one number of each run: so the mean of the squares counts as that of few numbers.
        """
        with np.errstate(invalid="ignore"):
            squares = self.freedom * (self.error / self.expected) ** 2
        chance = scipy.stats.chi2.sf(np.nan_to_num(squares), self.freedom)
        off = np.flatnonzero(chance < self.level / max(len(self.ahead), 1))
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
        explained = f", where {self.expected[k]:.2g} {self.unit} is explained" if self.expected[k] < np.inf else ""
        return f"{found}; {most}{explained}"  # not where predictions are far from linear


@one_blas_thread()
def horizons(fit, near, solution, ends=None, since=-np.inf):
    """[Horizon] of the outputs of a Solution; none where no run goes on.

    near  : Solution whose segments are free: runs begin at their starts, as they are with the numbers of the other one
    ends  : (h,) s, ends of the intervals of times ahead, which then count from the end of the segment that shows the
            start; None: by a ratio up to the end of the longest run, and from the start
    since : s, of the first measurement that counts
    """
    runs, shared = fit.runs, covariance(solution.chain.columns, 0.0)
    try:
        near = fit.solution_at(near, solution.point, ROUGHLY)
    except SimulationError:  # the numbers are far from those of `near`
        return []
    known, given, moved = near.chain.covariances(shared), near.chain.covariances(0.0 * shared), near.point
    finer = replace(moved, halves=moved.halves + 1)

    def run(k):
        try:
            return [fit.runs.base(_long(fit, each, [k]))[0] for each in (moved, finer)]
        except SimulationError:
            return None

    starts = _starts(fit, near, moved, given)
    found = [(k, *pair) for k, pair in zip(starts, fit.tasks(run, starts)) if pair is not None]
    if not found:
        return []
    owners, outputs, finer = zip(*found)
    point = _long(fit, moved, list(owners))
    kinds = [each.units for each in runs.machine(point.values).outputs]
    residuals = fit.residuals(point, outputs)
    segments, shown = runs.segments(point), np.zeros(len(owners))
    explained, own = (_explained(fit, near, segments, [(k, P[k]) for k in owners]) for P in (known, given))
    numerical, found = fit.errors(outputs, finer), []
    if ends is not None:
        shown = np.diff(near.point.bounds)[list(owners), 0]
    for t, each in enumerate(runs.log.measured):
        times = [s.times[s.places[t]] - s.start - length for s, length in zip(segments, shown)]
        if ends is not None:
            for rest, at, segment in zip(residuals, times, segments):
                rest[t][(at < 1e-9) | (each.times[segment.rows[t]] < since)] = np.nan
        intervals = _intervals(each, times) if ends is None else ends
        for p, name in enumerate(each.channels):
            longest = max(range(len(times)), key=lambda k: times[k][-1] if len(times[k]) else 0.0)
            run = _run(segments[longest], each, t, p, *(of[longest] for of in (outputs, explained)))
            parts = [[part[t][:, p] for part in of] for of in (residuals, explained, numerical, own)]
            sigma = float(fit.deviation[t][p])
            rows = _rows(intervals, times, sigma, *parts)
            useful = _rounded(TENTH * float(each.spread[p]))
            found.append(Horizon(name, each.name, kinds[t][p], sigma, *rows.T, useful, run))
    return [replace(each, level=LEVEL / len(found)) for each in found if len(each.ahead)]


def _intervals(measured, times):
    """(h,) s, ends of intervals of times ahead [(r,)], the last one that of the longest run."""
    last = max((at[-1] for at in times if len(at)), default=0.0)
    first = FIRST * float(np.median(np.diff(measured.times))) if len(measured.times) > 1 else last
    count = int(np.log(max(last / max(first, 1e-9), 1.0)) / np.log(RATIO))
    return last * RATIO ** -np.arange(count, -1.0, -1.0)


def _run(segment, measured, t, p, outputs, explained):
    rows = segment.rows[t]
    return measured.times[rows], measured.values[rows, p], outputs[t][:, p], explained[t][:, p]


def _rows(ends, times, sigma, *parts):
    """(h, 7) fields of a Horizon from `ahead` to `freedom`, of [(r,)] at times after the start [(r,)].

    sigma : of the noise;  parts : residuals, explained, errors of the integration, explained without what runs share
    """
    of = np.concatenate([np.full(len(at), k) for k, at in enumerate(times)])
    at, rest, explained, numeric, own = map(np.concatenate, (times, *parts))
    place = np.searchsorted(ends, at - 1e-9)
    rows = []
    for k, end in enumerate(ends):
        here = (place == k) & np.isfinite(rest)
        for run in np.unique(of[here]):
            # The time of an impact may be on the other side of one measurement.
            one = np.flatnonzero(here & (of == run))
            if len(one) > 2:
                here[one[np.abs(rest[one]).argmax()]] = False
        if here.any():
            sizes = (np.sqrt(np.mean(part[here] ** 2)) for part in (rest, explained, numeric))
            runs = [here & (of == run) for run in np.unique(of[here])]
            alone, whole = (np.array([np.mean(part[run] ** 2) for run in runs]) for part in (own, explained))
            rows.append((end, *sizes, len(runs), here.sum(), _freedom(sigma**2 + alone, sigma**2 + whole)))
    return np.array(rows).reshape(len(rows), 7)


def _freedom(own, whole):
    """Degrees of freedom of a sum of squares of numbers with own variances (k,), of whole ones: the rest is one cause.

    Satterthwaite (1946).
    """
    if not np.isfinite(whole).all():
        return 1.0
    shared = whole - own
    return whole.sum() ** 2 / (own @ own + 2.0 * (own @ shared) + shared.sum() ** 2)


def _rounded(size):
    """Nearest of 1, 2 and 5 times a power of ten."""
    if not size > 0.0:
        return 0.0
    power = 10.0 ** np.floor(np.log10(size))
    return float(f"{min((1.0, 2.0, 5.0, 10.0), key=lambda digit: abs(np.log(size / power / digit))) * power:.1g}")


def _starts(fit, near, point, given):
    """Numbers of segments from whose starts, in Unknowns, runs go on to the ends of their recordings.

    given : [(c + g, c + g)] covariances of the starts, with delays and numbers as they are
    """
    bounds, found, following = point.bounds, [], [*near.linear[1:], None]
    hidden = [
        np.flatnonzero(shown & (np.diag(P)[: len(shown)] > SHOWN))
        for (*_, shown), P in zip(fit.runs.starts(near.point), given)
    ]
    counts = np.array([len(each) for each in hidden])
    for first, last in fit.runs.log.spans:
        own = np.flatnonzero((bounds[:, 0] >= first - 1e-6) & (bounds[:, 0] < last))
        if not len(own):
            continue
        is_usable = counts[own] == counts[own].min()  # of the others no measurement shows all
        k = own[0]
        is_usable[0] |= _is_forgotten(near.linear[k], following[k], hidden[k])
        own, share = own[is_usable], max(1, STARTS // len(fit.runs.log.spans))
        found += own[np.unique(np.linspace(0, len(own) - 1, min(share, len(own))).astype(int))].tolist()
    return found


def _is_forgotten(part, following, numbers):
    """Whether some coordinates of a start, changed by their scales, change what follows its Part by less than noise."""
    if part.tie is None:
        return True
    return bool((np.mean((following.own @ part.tie.own[:, numbers]) ** 2, axis=0) < 1.0).all())


def _long(fit, point, numbers):
    """Unknowns with runs from some segments to the ends of their recordings, or of the segments in them."""
    firsts, lasts = point.bounds[numbers, 0], point.bounds[:, 1]
    spans = [next((first, last) for first, last in fit.runs.log.spans if first - 1e-6 <= at < last) for at in firsts]
    ends = [lasts[lasts <= last + 2e-6].max() for _, last in spans]
    return replace(point, bounds=np.column_stack([firsts, ends]), states=tuple(point.states[k] for k in numbers))


def _explained(fit, near, runs, owners):
    """[[(r, p)]] standard deviations of outputs by the uncertainty of starts, delays and numbers; inf: not linear.

    runs   : [Segment], along which those of a Solution lead; with other delays they have other rows next to their ends
    owners : [(number of a start, covariance of it and of what is shared)]
    """
    found, segments = [], fit.runs.segments(near.point)
    for (k, P), own in zip(owners, runs):
        variances, seen = [[] for _ in own.rows], [[] for _ in own.rows]
        while True:
            part, tie = near.linear[k], near.linear[k].tie
            J = np.hstack([part.own, part.shared])
            rows, at = np.einsum("ki,ij,kj->k", J, P, J), 0
            for parts, numbers, rest, measured in zip(variances, seen, near.residuals[k], segments[k].rows):
                parts.append(rows[at : at + rest.size].reshape(rest.shape))
                numbers.append(measured)
                at += rest.size
            if tie is None:
                break
            on = np.vstack([np.hstack([tie.own, tie.shared]), np.eye(len(P))[part.own.shape[1] :]])
            P, k = on @ P @ on.T, k + 1
        deviations, ends = [], np.inf
        for t, (parts, numbers, of, at) in enumerate(zip(variances, map(np.concatenate, seen), own.rows, own.places)):
            here = np.sqrt(np.maximum(np.vstack(parts), 0.0)) * fit.deviation[t]  # round-off may be negative
            spread = fit.runs.log.measured[t].spread
            most = np.maximum(spread, fit.deviation[t])
            known = np.vstack([np.where(here < most, here, np.inf), np.full(len(spread), np.inf)])
            known = known[np.minimum(np.searchsorted(numbers, of), max(len(numbers) - 1, 0))]
            is_far = np.isinf(known[:, spread > fit.deviation[t]]).any(axis=1)  # of what moves
            deviations.append(known)
            ends = min(ends, own.times[at][is_far].min(initial=np.inf))
        for known, at in zip(deviations, own.places):
            known[own.times[at] >= ends] = np.inf  # one part of a mechanism that goes another way takes all with it
        found.append(deviations)
    return found
