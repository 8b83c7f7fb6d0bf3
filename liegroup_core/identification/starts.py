# SPDX-License-Identifier: Apache-2.0
"""Starts of segments: guesses, by fits to the next measurements, and what a fit knows of them."""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.linear.channels import OutputChannels
from liegroup_core.linear.coordinates import Coordinates
from liegroup_core.observables.quantities import POSITION, ROTATION, TWIST

from .chain import SHOWN
from .fit import HIDDEN, Fit, covariance
from .machine import Apart, floating, state_at
from .runs import CHANGE as STEP
from .runs import Runs, Unknowns

PARTS = ("position", "velocity")
NEARLY = 1e-2  # of the spread of outputs, to which starts are fitted at first
LEAST = 9  # measurements in a segment: those to which a start is fitted
ROUGHLY = 1e-3  # relative decrease of the sum of squares in the last step: effects are judged by larger ones


def first_states(runs, bounds, delays=None, values=None):
    """[MachineState] at the start of each segment between bounds (s, 2) in s.

    Independent joints that were measured are put to where they were, then a run is fitted to the next measurements.
    What was not measured is where the run of the segment before ends, or at the start of the scene.

    values : (q,) numbers of the scene; None: its own
    Raises SceneError if the mechanism cannot be put there.
    """
    log = runs.log
    machine = runs.machine(runs.numbers.values if values is None else values)
    delays = np.zeros(len(log.measured)) if delays is None else delays
    state, states, length = machine.start, [], shortest(log)
    # With other numbers, exact outputs lead a start astray.
    still = alone(runs, runs.numbers.values if values is None else values).rough(NEARLY)
    still.deviation = still._firsts
    parts = (1.0 / LEAST, 1.0) if has_others(log) else (1.0,)  # one measurement shows places, more show rates
    for begin, end in bounds:
        start, before = begin - np.mean(delays), state
        state = _put(machine, log, before, start, delays)
        for part in parts:
            point = Unknowns(np.array([[begin, begin + part * length]]), delays, np.zeros(0), (state,))
            with suppress(SimulationError):
                (state,) = still.solve(point, ROUGHLY).point.states
        after = state_at(machine, start, state, end)
        if after is None:
            state = machine.timed(before, start)
            after = state_at(machine, start, state, end)
        states.append(state)
        state = state if after is None else after
    return tuple(states)


def alone(runs, values, deviation=None, workers=1):
    """Fit of the starts alone, with numbers (q,); deviation: None: of the measurements."""
    numbers, log, still = runs.numbers, runs.log, runs
    if len(numbers):
        scaled = [replace(each, values=each.values * size) for each, size in zip(log.inputs, numbers.factors(values))]
        still = Runs(numbers.scene_at(values), replace(log, inputs=tuple(scaled)), (), runs.longest, runs.tell)
    deviation = [each.noise for each in log.measured] if deviation is None else deviation
    return Fit(still, deviation, np.zeros(len(log.measured), dtype=bool), workers=workers)


def shortest(log):
    """Length in s of the shortest segments: of LEAST measurements."""
    fullest = max(log.measured, key=lambda each: len(each.times))
    return LEAST * (float(np.median(np.diff(fullest.times))) if len(fullest.times) > 1 else 1.0)


def _put(machine, log, state, time, delays):
    """State in which measured independent joints are where they were at a time."""
    found, state = {}, machine.timed(state, time)
    for each, delay in zip(log.measured, delays):
        for joint in dict.fromkeys(name.rpartition(".")[0] for name in each.channels if name.endswith(".position")):
            found.setdefault(joint, _nearest(each, joint, time + delay))
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


def _nearest(measured, joint, time):
    """(position, velocity) of a joint that were measured nearest to a time, 0: no velocity; None: no position."""
    found = []
    for name in (f"{joint}.{part}" for part in PARTS):
        if name in measured.channels:
            values = measured.values[:, measured.channels.index(name)]
            known = np.flatnonzero(np.isfinite(values))
            found += values[known[np.abs(measured.times[known] - time).argsort()[:1]]].tolist()
    return (*found, 0.0)[:2] if found else None


def has_others(log):
    """Whether a Log has outputs that are neither positions nor velocities of joints."""
    return any(name.rpartition(".")[2] not in PARTS for each in log.measured for name in each.channels)


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
    shared = covariance(solution.chain.columns, 0.0)
    unknown = ~np.isfinite(np.diag(solution.covariance))
    known, segments, starts = solution.chain.covariances(shared), runs.segments(point), runs.starts(point)
    for k in solution.firsts:
        segment, (_, state, _, beside, _), P = segments[k], starts[k], known[k]
        values, c = outputs.of(machine.seen(state)), len(beside)
        there = np.array([outputs.of(machine.seen(other)) for other in beside]).reshape(c, len(values))
        D = np.hstack([apart(there, np.tile(values, (c, 1))).T / STEP, np.zeros((len(values), len(shared)))])
        D[:, c : c + free] = (_rates(machine, outputs, apart, segment, state) / len(fit.free))[:, None]
        off = (np.abs(D[:, :c]) > HIDDEN) @ (np.diag(P)[:c] > SHOWN)
        off |= (np.abs(D[:, :c] @ P[:c, c:] + D[:, c:] @ shared)[:, unknown] > HIDDEN).any(axis=1)
        deviations = np.where(off, np.inf, np.sqrt(chi * np.maximum(np.einsum("ki,ij,kj->k", D, P, D), 0.0)))
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
