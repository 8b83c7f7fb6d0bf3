# SPDX-License-Identifier: Apache-2.0
"""Starts of segments: guesses, from polynomials through the nearest measurements, and what a fit knows of them."""

from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import LieGroupSimError, SceneError
from liegroup_core.linear.channels import OutputChannels
from liegroup_core.linear.coordinates import Coordinates, scales_of
from liegroup_core.observables.quantities import PLACES, POSITION, RATES, ROTATION, TWIST

from .chain import SHOWN
from .fit import HIDDEN
from .machine import Apart, directions, floating, up_to
from .runs import CHANGE as STEP

PARTS = ("position", "velocity")
NEIGHBOURS = {1: 9, 2: 5}  # measurements to which a polynomial is fitted: positions alone, and with velocities
DEGREE = 3
CHANGE = 1e-7  # of starts, by their scales: first guesses need few digits
MOST_STEPS, MOST_HALVES = 30, 6  # of Gauss and Newton, and of each step
SMALL, NO_WAY = 1e-6, 1e-6  # last step, by the scales; relative singular value of what nothing shows


def first_states(runs, bounds, delays=None, values=None):
    """[MachineState] at the start of each segment between bounds (s, 2) in s.

    Independent joints that were measured are put to where polynomials through the nearest measurements are, then all
    of the mechanism in least squares if bodies or sensors were measured. What was not measured is where the run of the
    segment before ends, or at the start of the scene.

    values : (q,) numbers of the scene; None: its own
    Raises SceneError if the mechanism cannot be put there.
    """
    log = runs.log
    machine = runs.machine(runs.numbers.values if values is None else values)
    delays = np.zeros(len(log.measured)) if delays is None else delays
    state, states, seen = machine.start, [], _seen(machine, log)
    for k, (start, end) in enumerate(bounds - np.mean(delays)):
        for guess in (_measured, _put, _as_before):
            states[k:] = [guess(machine, log, seen, state, start, delays)]
            found = state_at(machine, start, states[k], end)
            if found is not None:
                break
        state = states[k] if found is None else found
    return tuple(states)


def state_at(machine, start, state, end, halves=0):
    """State at a time in s to which a run from a state at `start` leads; None if it fails."""
    try:
        machine.path(up_to(machine, start, end), state, np.zeros(0, dtype=int), halves=halves)
    except LieGroupSimError:
        return None
    return machine.present()


def _measured(machine, log, seen, state, time, delays):
    """State in which all that was measured is where it was at a time."""
    return _nearest(machine, seen, _put(machine, log, seen, state, time, delays), time, delays)


def _as_before(machine, log, seen, state, time, delays):
    """State where the run before ends."""
    return machine.timed(state, time)


def _put(machine, log, _, state, time, delays):
    """State in which measured independent joints are where they were at a time."""
    found, state = {}, machine.timed(state, time)
    for each, delay in zip(log.measured, delays):
        for joint in dict.fromkeys(name.rpartition(".")[0] for name in each.channels if name.endswith(".position")):
            found.setdefault(joint, _guess(each, joint, time + delay))
    machine.at(state)
    try:
        coordinates = Coordinates(machine.probe, preferred=[name for name in found if name in _names(machine)])
    except SceneError:
        return state
    wanted = {name: found[name] for name in coordinates.names if found.get(name) is not None}
    if not wanted:
        return state
    return machine.placed(wanted)


def _names(machine):
    return [freedom.name for freedom in machine.layout.freedoms]


def _guess(measured, joint, time):
    """(position, velocity) of a joint at a time, or None: of the polynomial through the nearest measurements."""
    channels, noise = list(measured.channels), measured.noise
    rows = {part: channels.index(f"{joint}.{part}") for part in PARTS if f"{joint}.{part}" in channels}
    q = measured.values[:, rows["position"]]
    known = np.flatnonzero(np.isfinite(q))
    near = known[np.argsort(np.abs(measured.times[known] - time), kind="stable")[: NEIGHBOURS[len(rows)]]]
    near.sort()
    if not len(near):
        return None
    x, degree = measured.times[near] - _within(measured.times[near], time), min(DEGREE, len(near) - 1)
    powers, sigma = np.vander(x, degree + 1, increasing=True), noise[rows["position"]]
    left, right = [powers / sigma], [np.unwrap(q[near]) / sigma]
    if "velocity" in rows:
        v, sigma = measured.values[near, rows["velocity"]], noise[rows["velocity"]]
        slopes, usable = np.arange(degree + 1) * np.roll(powers, 1, axis=1), np.isfinite(v)
        left.append(slopes[usable] / sigma)
        right.append(v[usable] / sigma)
    fitted = np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0]
    return float(fitted[0]), float(fitted[1]) if degree else 0.0


def _within(times, time):
    """Time for a polynomial through measurements at times (k,): not farther beyond them than their usual distance."""
    usual = (times.max() - times.min()) / max(len(times) - 1, 1)
    return float(np.clip(time, times.min() - usual, times.max() + usual))


class _Seen:
    """Outputs of a Measured that positions determine, or positions and rates.

    number   : of the Measured
    is_rate  : whether they change with rates
    slope, slope_sigma : (p,) slope of the polynomial at its time, and standard deviations
    """

    def __init__(self, machine, number, measured, columns, is_rate):
        self.number, self.is_rate, self._measured, self._columns = number, is_rate, measured, columns
        self._outputs = OutputChannels(machine.probe, [measured.channels[k] for k in columns], machine.turns)
        self._apart = Apart(self._outputs)

    def aim(self, time):
        """Take the polynomial at a time of the clock; returns whether enough was measured."""
        values, times = self._measured.values[:, self._columns], self._measured.times
        known = np.flatnonzero(np.isfinite(values).all(axis=1))
        near = known[np.argsort(np.abs(times[known] - time), kind="stable")[: NEIGHBOURS[1]]]
        if not len(near):
            return False
        x, self._base = times[near] - _within(times[near], time), values[near[:1]]
        powers = np.vander(x, min(DEGREE, len(near) - 1) + 1, increasing=True)
        inverse = np.linalg.pinv(powers)
        found = inverse @ self._apart(values[near], np.repeat(self._base, len(near), axis=0))
        noise = self._measured.noise[self._columns]
        sizes = np.linalg.norm(inverse, axis=1)
        self._value, self._sigma = found[0], sizes[0] * noise
        self.slope, self.slope_sigma = (found[1], sizes[1] * noise) if len(found) > 1 else (0.0, np.inf)
        return True

    def at(self, sample):
        """(p,) outputs, relative to the measurement that is nearest."""
        return self._apart(self._outputs.of(sample)[None], self._base)[0]

    def off(self, found):
        """(p,) weighted differences of outputs from the polynomial."""
        return (found - self._value) / self._sigma

    def weighted(self, changes):
        """(d, p) changes of outputs by the deviation of the polynomial."""
        return changes / self._sigma


def has_others(log):
    """Whether a Log has outputs that are neither positions nor velocities of joints."""
    return any(name.rpartition(".")[2] not in PARTS for each in log.measured for name in each.channels)


def _seen(machine, log):
    """[_Seen] of a Log; none where only joints were measured, which can be put to where they were."""
    catalogue, kinds_of = machine.layout.catalogue, {PLACES: False, RATES: True}
    found, joints, kinds = [], set(), {}
    for t, each in enumerate(log.measured):
        own = [kinds_of.get(depends) for depends in catalogue.columns(each.channels).depends]
        kinds |= dict(zip(each.channels, own))
        joints |= {name for name in each.channels if name.endswith(".position")}
        for is_rate in (False, True):
            columns = [k for k, kind in enumerate(own) if kind is is_rate]
            if columns:
                found.append(_Seen(machine, t, each, columns, is_rate))
    known = joints | {name.removesuffix("position") + "velocity" for name in joints}
    return found if any(kind is not None and name not in known for name, kind in kinds.items()) else []


def _nearest(machine, seen, state, time, delays):
    """State near another one in which [_Seen] outputs are near their polynomials at a time, in least squares."""
    seen = [each for each in seen if each.aim(time + delays[each.number])]
    places, rates = ([each for each in seen if each.is_rate == is_rate] for is_rate in (False, True))
    return _with_rates(machine, places, rates, _with_places(machine, places, state) if places else state)


def _with_places(machine, places, state):
    """State with the positions that fit best, by the method of Gauss and Newton."""
    off = np.concatenate([each.off(x) for each, x in zip(places, _at(machine, places, state))])
    for _ in range(MOST_STEPS):
        machine.at(state)
        scales, ways = directions(machine.probe)
        ways = (scales[:, None, None] * ways)[ways[:, :, 0].any(axis=1)]
        step = -_solved(
            np.hstack([each.weighted(D) for each, D in zip(places, _changes(machine, places, state, ways))]), off
        )
        for _ in range(MOST_HALVES):
            other = machine.beside(state, ways, step)
            found = np.concatenate([each.off(x) for each, x in zip(places, _at(machine, places, other))])
            if found @ found < off @ off:
                break
            step *= 0.5
        else:
            break
        state, off = other, found
        if np.abs(step).max(initial=0.0) < SMALL:
            break
    return state


def _with_rates(machine, places, rates, state):
    """State with the rates that fit best: of rates that were measured, and slopes of places."""
    machine.at(state)
    scales, ways = directions(machine.probe)
    ways = (scales[:, None, None] * ways)[~ways[:, :, 0].any(axis=1)]
    present = machine.probe.closed()[0]
    along = np.zeros((len(ways) + 1, *ways.shape[1:]))  # displacements along the rates, and the present ones
    along[:-1, :, 0], along[-1, :, 0] = ways[:, :, 1], present
    rows, off = [np.zeros((len(ways), 0))], [np.zeros(0)]
    for each, D, x in zip(rates, _changes(machine, rates, state, ways), _at(machine, rates, state)):
        rows.append(each.weighted(D))
        off.append(each.off(x))
    size = max(1.0, float(np.abs(present / scales_of(machine.layout)).max(initial=0.0)))
    along[-1] /= size
    for each, D in zip(places, _changes(machine, places, state, along)):
        rows.append(D[:-1] / each.slope_sigma)
        off.append((size * D[-1] - each.slope) / each.slope_sigma)
    return machine.beside(state, ways, -_solved(np.hstack(rows), np.concatenate(off)))


def _at(machine, of, state):
    """[(p,)] outputs of [_Seen] at a MachineState."""
    sample = machine.seen(state)
    return [each.at(sample) for each in of]


def _changes(machine, of, state, ways):
    """[(d, p)] derivatives of outputs of [_Seen] along ways (d, f, 2) from a MachineState, where the Probe is."""
    if not of:
        return []
    there = [_at(machine, of, machine.beside(state, ways, CHANGE * row)) for row in np.eye(len(ways))]
    return [
        (np.array(values).reshape(len(ways), -1) - x) / CHANGE
        for values, x in zip(zip(*there), _at(machine, of, state))
    ]


def _solved(rows, right):
    """(d,) least squares of rows (d, N), least where nothing shows."""
    return np.linalg.lstsq(rows.T, right, rcond=NO_WAY)[0]


@dataclass(frozen=True, eq=False)
class SegmentStart:
    """Start of a run along a recording.

    time   : s, of the clock of the inputs
    names  : of outputs: joints, and bodies that float
    values, deviations : (k,) SI units, and standard deviations, inf: the log does not show it
    """

    time: float
    names: tuple
    values: np.ndarray
    deviations: np.ndarray


def starts_of(fit, solution, chi):
    """[SegmentStart] of the runs of a Solution, whose covariance is multiplied by chi.

    A start moves along the run with the mean of the delays.
    """
    runs, point = fit.runs, solution.point
    machine = runs.machine(point.values)
    outputs = OutputChannels(machine.probe, _reported(machine), machine.turns)
    apart, found, free = Apart(outputs), [], int(fit.free.sum())
    shared = np.nan_to_num(solution.covariance, posinf=0.0)
    unknown = ~np.isfinite(np.diag(solution.covariance))
    known, segments, starts = solution.chain.covariances(shared), runs.segments(point), runs.starts(point)
    for k in solution.firsts:
        segment, (_, state, _, beside), P = segments[k], starts[k], known[k]
        values, c = outputs.of(machine.seen(state)), len(beside)
        there = np.array([outputs.of(machine.seen(other)) for other in beside]).reshape(c, len(values))
        D = np.hstack([apart(there, np.tile(values, (c, 1))).T / STEP, np.zeros((len(values), len(shared)))])
        D[:, c : c + free] = (_rates(machine, outputs, apart, segment, state) / len(fit.free))[:, None]
        off = (np.abs(D[:, :c]) > HIDDEN) @ (np.diag(P)[:c] > SHOWN)
        off |= (np.abs(D[:, :c] @ P[:c, c:] + D[:, c:] @ shared)[:, unknown] > HIDDEN).any(axis=1)
        deviations = np.where(off, np.inf, np.sqrt(chi * np.einsum("ki,ij,kj->k", D, P, D)))
        found.append(SegmentStart(segment.start, tuple(outputs.names), values, deviations))
    return found


def _rates(machine, outputs, apart, segment, state):
    """(k,) rates of outputs at the start of a Segment; zero without a part that shows them."""
    if len(segment.times) < 2:
        return np.zeros(len(outputs))
    path = machine.path(segment, state, np.array([0, 1]))
    first, second = outputs.of_states(path, np.array([0, 1]))
    return apart(second[None], first[None])[0] / (segment.times[1] - segment.times[0])


def _reported(machine):
    """Names of outputs that make a state."""
    parts = (*ROTATION, *POSITION, *TWIST)
    return ["joints", *(f"{body}.{part}" for body in floating(machine.layout) for part in parts)]
