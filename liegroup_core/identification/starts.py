# SPDX-License-Identifier: Apache-2.0
"""First guesses of the starts of segments, from measured joints, and of the delays of clocks."""

import numpy as np

from liegroup_core.errors import LieGroupSimError, SceneError
from liegroup_core.linear.coordinates import Coordinates

from .machine import segments_of

PARTS = ("position", "velocity")
NEIGHBOURS = {1: 9, 2: 5}  # measurements to which a polynomial is fitted: positions alone, and with velocities
DEGREE = 3


def first_states(runs, bounds, delays=None, values=None):
    """[State] at the start of each segment between bounds (s, 2) in s.

    Independent joints that were measured are put to where polynomials through the nearest measurements are; the others
    are where the run of the segment before ends, or at the start of the scene.

    values : (q,) numbers of the scene; None: its own
    Raises SceneError if the mechanism cannot be put there.
    """
    log = runs.log
    machine = runs.machine(runs.numbers.values if values is None else values)
    delays = np.zeros(len(log.measured)) if delays is None else delays
    state, states = machine.start, []
    for pair in bounds:
        segments = segments_of(machine, pair[None], delays)
        if not segments:
            continue
        states.append(_put(machine, log, state, segments[0].start, delays))
        try:
            state = _end(machine, segments[0], states[-1])
        except LieGroupSimError:
            state = states[-1]
    return tuple(states)


def _end(machine, segment, state):
    machine.run(segment, state)
    return machine.present()


def _put(machine, log, state, time, delays):
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
    x, degree = measured.times[near] - time, min(DEGREE, len(near) - 1)
    powers, sigma = np.vander(x, degree + 1, increasing=True), noise[rows["position"]]
    left, right = [powers / sigma], [np.unwrap(q[near]) / sigma]
    if "velocity" in rows:
        v, sigma = measured.values[near, rows["velocity"]], noise[rows["velocity"]]
        slopes, usable = np.arange(degree + 1) * np.roll(powers, 1, axis=1), np.isfinite(v)
        left.append(slopes[usable] / sigma)
        right.append(v[usable] / sigma)
    fitted = np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0]
    return float(fitted[0]), float(fitted[1]) if degree else 0.0
