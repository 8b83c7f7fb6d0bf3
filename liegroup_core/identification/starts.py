# SPDX-License-Identifier: Apache-2.0
"""First guesses of the starts of segments, from measured joints, and of the delays of clocks."""

import numpy as np

from liegroup_core.errors import LieGroupSimError, SceneError
from liegroup_core.linear.coordinates import Coordinates

from .machine import segments_of

NEIGHBOURS = 15  # measurements to which a polynomial is fitted
DEGREE = 2


def first_states(runs, bounds, delays=None, values=None):
    """[State] at the start of each segment between bounds in s.

    Independent joints that were measured are put to where polynomials through the nearest measurements are; the others
    are where the run of the segment before ends, or at the start of the scene.

    values : (q,) numbers of the scene; None: its own
    Raises SceneError if the mechanism cannot be put there.
    """
    log = runs.log
    machine = runs.machine(runs.numbers.values if values is None else values)
    delays = np.zeros(len(log.measured)) if delays is None else delays
    state, states = machine.start, []
    for first, last in zip(bounds, bounds[1:]):
        segments = segments_of(machine, np.array([first, last]), delays)
        if not segments:
            continue
        states.append(_put(machine, log, state, first, delays))
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
    found = {}
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
    """(position, velocity) of a joint at a time, or None."""
    channels = list(measured.channels)
    q = measured.values[:, channels.index(f"{joint}.position")]
    known = np.flatnonzero(np.isfinite(q))
    near = known[np.argsort(np.abs(measured.times[known] - time), kind="stable")[:NEIGHBOURS]]
    near.sort()
    if not len(near):
        return None
    x = measured.times[near] - time
    degree = min(DEGREE, len(near) - 1)
    fitted = np.polynomial.polynomial.polyfit(x, np.unwrap(q[near]), degree)
    return float(fitted[0]), float(fitted[1]) if degree else 0.0
