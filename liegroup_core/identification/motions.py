# SPDX-License-Identifier: Apache-2.0
"""Motions of a comparison: the machine as it was measured, and the fitted model at the same times."""

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.observables.sample import Sample

from .machine import directions
from .starts import PARTS

PLACES, TURNS = ("x", "y", "z"), ("rx", "ry", "rz")


def motions(found, most=2000):
    """Yield (time in s, Sample of the machine, Sample of the fitted model) along the log of a Comparison.

    most : number of times, about

    The machine is the model, moved by the residuals: in least squares to where joints were measured, with closed loops;
    then bodies whose pose was measured. What was not measured is as in the model.
    """
    runs, point, measured = found.fit.runs, found.solution.point, found.fit.runs.log.measured
    machine, segments = runs.machine(point.values), runs.segments(point)
    own = {freedom.name: (f, freedom.sign) for f, freedom in enumerate(machine.layout.freedoms) if freedom.is_of_joint}
    count = sum(len(segment.seen) for segment in segments)
    every = -(-count // most)
    for segment, state, residuals in zip(segments, point.states, found.solution.residuals):
        seen = segment.seen[::every]
        path = machine.path(segment, state, seen, halves=point.halves)
        for k, place in enumerate(seen.tolist()):
            model, values = path.sample(k), {}
            for each, places, rest, sigma in zip(measured, segment.places, residuals, found.fit.deviation):
                (row,) = np.flatnonzero(places == place)[:1].tolist() or [None]
                if row is not None:
                    values |= {
                        name.rpartition(".")[::2]: pair
                        for name, *pair in zip(each.channels, rest[row].tolist(), sigma.tolist())
                        if np.isfinite(pair[0])
                    }
            yield segment.times[place], _measured(machine, model, values, own), model


def _measured(machine, model, values, own):
    """Sample of the machine.

    values : {(name, part): (measured minus the model, deviation of the noise)};  own : {joint: (freedom, sign)}
    """
    probe, layout = machine.probe, machine.layout
    probe.take(model)
    probe.release(stops=True)
    joints = [(*each, pair) for each, pair in values.items() if each[0] in own and each[1] in PARTS]
    rows = [(*own[name], PARTS.index(part), *pair) for name, part, pair in joints]
    (_, ways, _), y = directions(probe), np.zeros((probe.freedoms, 2))
    if len(ways) and rows:
        A = np.array([[sign * way[f, part] / sigma for way in ways] for f, sign, part, _, sigma in rows])
        off = np.array([value / sigma for *_, value, sigma in rows])
        y = np.tensordot(np.linalg.lstsq(A, off, rcond=None)[0], ways, 1)
    _, pose, twist = probe.closed(y)
    pose, twist = layout.offsets.to_bodies(pose, twist)
    pose = pose.copy()
    for i, body in enumerate(layout.body_names):
        if all((body, part) in values for part in PLACES + TURNS):
            change = Rotation.from_rotvec([values[body, part][0] for part in TURNS]).as_matrix()
            pose[i, :9] = (model.pose[i, :9].reshape(3, 3) @ change).ravel()
            pose[i, 9:] = model.pose[i, 9:] + [values[body, part][0] for part in PLACES]
    given = layout.offsets.to_centres(pose, twist)
    return Sample(layout, model.time, model.time_ns, 0, *given, model.angles.copy())
