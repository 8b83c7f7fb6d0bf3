# SPDX-License-Identifier: Apache-2.0
"""Runs of a scene under the inputs of a log, from one time to another, with the outputs that were measured.

A run is divided at every time at which an input changes or something was measured. Each part has equal steps of the
classical Munthe-Kaas method of order four, as few as a longest step allows. So the outputs are smooth functions of the
start and of the numbers of the scene, and differences of two runs have only the errors of rounding.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.engine import METHOD, STEP, Engine
from liegroup_core.errors import SimulationError
from liegroup_core.forces.instants import AFTER
from liegroup_core.layout import make_layout
from liegroup_core.linear.channels import Inputs, Outputs
from liegroup_core.linear.coordinates import Coordinates
from liegroup_core.linear.probe import Probe
from liegroup_core.methods.families import choose_group
from liegroup_core.reports import explain
from liegroup_core.status import NOT_FINITE, OK

NS = 1e9


@dataclass(frozen=True, eq=False)
class State:
    """State at the start of a run: of frames at the centres of mass, with unwrapped angles.

    pose, twist : (n, 12), (n, 6)
    angles      : Sample.angles
    near        : coordinates of joints with stops or friction
    """

    pose: np.ndarray
    twist: np.ndarray
    angles: np.ndarray
    near: np.ndarray


@dataclass(frozen=True, eq=False)
class Segment:
    """Part of a log that one run covers.

    start   : s
    times   : (m + 1,) s, the ends of the parts of the run; the first is the start
    inputs  : (m, k) values of the inputs of the log in each part
    rows    : for each Measured of the log (r,) its rows in this segment
    places  : for each Measured (r,) which of the times these are
    instants : Instants of the times
    """

    start: float
    times: np.ndarray
    inputs: np.ndarray
    rows: tuple
    places: tuple
    instants: tuple


def segments_of(machine, bounds, delays):
    """[Segment] of the log of a Machine between bounds (s + 1,) in s, which have measurements.

    delays : for each Measured, s
    """
    log, changes, instant_of = machine.log, _changes(machine.engine, bounds[-1]), machine.engine.instant_of
    found = []
    shifted = [np.round((each.times - delay) * NS) / NS for each, delay in zip(log.measured, delays)]
    for first, last in zip(bounds, bounds[1:]):
        rows = [np.flatnonzero((times >= first) & (times < last)) for times in shifted]
        if not any(map(len, rows)):
            continue
        own = [times[row] for times, row in zip(shifted, rows)]
        end = max(times[-1] for times in own if len(times))
        inside = [each.times[(each.times > first) & (each.times < end)] for each in log.inputs]
        inside.append(np.array([time for time in changes if first < time < end]))
        stamps = np.unique(np.round(np.concatenate([[first], *own, *inside]) * NS)).astype(int)
        times = stamps / NS
        inputs = np.array([each.over(times) for each in log.inputs]).reshape(len(log.inputs), len(times) - 1).T
        places = tuple(np.searchsorted(times, each - 0.5e-9) for each in own)
        instants = tuple(map(instant_of, stamps.tolist()))
        found.append(Segment(first, times, inputs, tuple(rows), places, instants))
    return found


class Machine:
    """Engine of a scene with the channels of a log.

    longest  : s, longest step
    in_space : whether planar mechanisms move in space, too: scenes with other numbers may not be planar
    turns    : (n, 3, 3) attitudes to which rotation vectors refer; None: those at the start of the scene
    Raises SceneError for unknown channels.
    """

    def __init__(self, scene, log, longest, in_space=False, turns=None):
        layout, self.longest = make_layout(scene), longest
        group = choose_group(METHOD, "auto")
        settings = group, "projection" if layout.drifts(group) else "none"
        options = {"space": "space"} if in_space else {}
        self.engine = Engine(scene, METHOD, STEP, *settings, quiet=True, layout=layout, **options)
        self.probe = Probe(self.engine, in_space=in_space)
        self.layout, self.log = self.engine.layout, log
        inputs = Inputs(self.probe, [each.name for each in log.inputs])
        self._wrenches, self._targets = inputs.changes(0)
        self._wanted = self.probe.wanted.copy()
        for k, name in enumerate(inputs.names):  # a target replaces that of the scene
            if name.rpartition(".")[2] in ("target", "target_velocity"):
                self._wanted[self._targets[k] != 0.0] = 0.0
        self.outputs = [Outputs(self.probe, each.channels, turns) for each in log.measured]
        self.turns = self.outputs[0].turns
        self._joints_only = [outputs.are_joints for outputs in self.outputs]

    @property
    def start(self):
        """State of the scene at its start."""
        self.engine.reset()
        return self.present()

    def placed(self, joints):
        """State with {joint: (position, velocity)}, in stops where these are beyond them; the others as they are."""
        engine = self.engine
        limits = {switch.name: switch.limits for switch in self.layout.switches if switch.limits is not None}
        for name in joints.keys() & limits.keys():
            q, v = joints[name]
            joints[name] = min(max(q, limits[name].least), limits[name].largest), v
        engine.place(joints=joints)
        return self.present()

    def present(self):
        """State of the engine, such as where the last run ended."""
        sample = self.engine.sample()
        near = np.zeros(0) if sample.switching is None else sample.switching[:, 3].copy()
        return State(*self.engine.state(), sample.angles.copy(), near)

    def effort(self, joint):
        """(n, COLUMNS) change of the external wrenches by a unit effort of a joint."""
        return Inputs(self.probe, [f"{joint}.effort"]).changes(0)[0][0]

    def at(self, state):
        """Sample of a state, from which the Probe continues."""
        self._go(state)
        sample = self.engine.sample()
        self.probe.take(sample)
        self.probe.release(stops=True)
        return sample

    def _go(self, state):
        engine = self.engine
        engine.set_state(state.pose, state.twist, 0, state.angles, state.near if len(state.near) else None)

    def beside(self, state, coordinates, change):
        """State with a change (2 m,) of its Coordinates and independent rates; the Probe is at the state."""
        if not change.any():
            return state
        m = len(coordinates.independent)
        y = sum(part * coordinates.neighbour(k, 1.0) for k, part in enumerate(change[:m])) + sum(
            part * coordinates.neighbour(k, 1.0, rate=True) for k, part in enumerate(change[m:])
        )
        _, pose, twist = self.probe.closed(y)
        return State(pose, twist, self.layout.angles(pose, state.angles), state.near)

    def coordinates(self, state):
        """Coordinates at a state, where the Probe goes."""
        self.at(state)
        return Coordinates(self.probe)

    def follow(self, other, state):
        """State of this scene with the joints' coordinates and rates of another scene's Machine at a state."""
        other.at(state)
        self.probe.follow(other.probe)
        _, pose, twist = self.probe.closed()
        return State(pose, twist, self.layout.angles(pose, state.angles), state.near)

    def run(self, segment, state, extra=None, record=None, halves=0):
        """Outputs [(r, p)] of each Measured in a Segment, from a state.

        extra  : function of the number of a part: change (n, COLUMNS) of the external wrenches, or None
        record : list that takes (pose, twist, positions and velocities (j, 2) of joints) at the times, or None
        halves : how often the steps are halved
        Raises SimulationError.
        """
        self._go(state)
        engine, instants, count = self.engine, segment.instants, len(segment.inputs)
        wanted = np.zeros(count + 1, dtype=bool)
        for places, fast in zip(segment.places, self._joints_only):
            wanted[places] |= fast
        wanted |= record is not None
        joints, order = np.empty((int(wanted.sum()), len(self.layout.coordinates.names), 2)), np.cumsum(wanted) - 1
        others = [
            (dict(zip(places.tolist(), range(len(places)))), outputs, np.empty((len(places), len(outputs))))
            for places, outputs, fast in zip(segment.places, self.outputs, self._joints_only)
            if not fast
        ]
        sizes = np.diff(segment.times)
        counts = np.maximum(1, np.ceil(sizes / self.longest - 1e-9)).astype(int) << halves
        steps = (sizes / counts).tolist()
        base, external, work = engine.inputs.external.copy(), engine.inputs.external, engine._work
        wrenches = base + np.tensordot(segment.inputs, self._wrenches, 1)
        targets = self._wanted + np.tensordot(segment.inputs, self._targets, 1)
        pose, twist, angle, write = engine._pose, engine._twist, work.angle, self.layout.coordinates.write
        try:
            for k, (instant, is_wanted) in enumerate(zip(instants, wanted.tolist())):
                if is_wanted:
                    write(pose, twist, angle, joints[order[k]])
                if record is not None:
                    record.append((pose.copy(), twist.copy(), joints[k]))
                if any(k in places for places, *_ in others):
                    self._look(k, instant, others)
                if k == count:
                    break
                external[:] = wrenches[k]
                if extra is not None:
                    external += extra(k)
                work.wanted[:] = targets[k]
                _, status = engine._integrate(instant, steps[k], int(counts[k]), instants[k + 1])
                if status != OK:
                    raise SimulationError(explain(engine, status), status & 0xFF)
            if not (np.isfinite(pose).all() and np.isfinite(joints).all()):
                raise SimulationError(explain(engine, NOT_FINITE), NOT_FINITE)
        finally:
            external[:] = base
        others = iter(others)
        return [
            outputs.of_joints(joints[order[places]]) if fast else next(others)[2]
            for places, outputs, fast in zip(segment.places, self.outputs, self._joints_only)
        ]

    def _look(self, k, instant, others):
        """Write the outputs that were measured at time k, besides those of joints."""
        sample = self._sample(instant)
        for places, outputs, rows in others:
            if k in places:
                rows[places[k]] = outputs.of(sample)

    def _sample(self, instant):
        engine = self.engine
        engine.set_inputs_from(instant)
        return engine._sample_of(instant.time, round(instant.time * NS), *engine.state(), engine._work.angle.copy())


def _changes(engine, end):
    """Times in s up to an end at which inputs of the scene change."""
    found, instant = [], engine.instant_of(0)
    while (instant := engine.change_after(instant)) is not AFTER and instant.time < end:
        found.append(instant.time)
    return found


class Apart:
    """Differences of outputs of one Measured: of angles modulo 2 pi, of attitudes as rotation vectors.

    outputs : Outputs
    """

    def __init__(self, outputs):
        self._outputs, names = outputs, list(outputs.names)
        self._quaternions = outputs.quaternions
        self._turns = [
            [names.index(f"{body}.{part}") for part in ("rx", "ry", "rz")]
            for body in dict.fromkeys(name.rpartition(".")[0] for name in names if name.endswith(".rx"))
            if {f"{body}.ry", f"{body}.rz"} <= set(names)
        ]

    def __call__(self, values, base):
        """(k, p) values minus base."""
        values = values.copy()
        for places in self._quaternions:  # a quaternion and its negative are the same rotation
            values[np.ix_(np.sum(values[:, places] * base[:, places], axis=1) < 0.0, places)] *= -1.0
        found = self._outputs.apart(values, base)
        for places in self._turns:
            known = np.isfinite(values[:, places]).all(axis=1)
            one, other = (Rotation.from_rotvec(each[known][:, places]) for each in (values, base))
            found[np.ix_(known, places)] = (other.inv() * one).as_rotvec()
        return found
