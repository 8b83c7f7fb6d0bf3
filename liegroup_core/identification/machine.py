# SPDX-License-Identifier: Apache-2.0
"""Runs of a scene under the inputs of a log, from one time to another, with the outputs that were measured.

A run is divided at every time at which an input changes or something was measured. Each part has equal steps of the
classical Munthe-Kaas method of order four, as few as a longest step allows, and ends where a law jumps. Halved steps
end where contacts slip and stick, too: over that, errors are large, and sawteeth of the numbers. So the outputs are
smooth functions of the start and of the numbers of the scene, and differences of two runs have only the errors of
rounding.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.engine import METHOD, Engine
from liegroup_core.errors import LieGroupSimError, SceneError, SimulationError
from liegroup_core.forces.acting import Acting
from liegroup_core.joints.motion import COLUMNS, at, row_at, uniform
from liegroup_core.layout import make_layout
from liegroup_core.linear.channels import InputChannels, OutputChannels
from liegroup_core.linear.coordinates import Coordinates, scales_of
from liegroup_core.linear.probe import Probe
from liegroup_core.methods.families import choose_group
from liegroup_core.observables.sample import Sample
from liegroup_core.reports import reason
from liegroup_core.status import EVENT, NOT_FINITE, OK

from .log import MOTION

NS = 1e9
PRESCRIBED = {"driven": True, "motion": None, "limits": None, "friction": None}  # keys of a driven joint
# Laws.compared of kinks over which all steps go on: bends of laws that are no contacts, and of bristles, which are
# faster than steps while they slide.
LEAPS = 0, -2
STEP = 1e-9  # s, of the engine: states at all times are at a step; parts of runs have steps of their own
SHIFT = 1000.0  # s by which the engine is later than the log: delays move starts to before its first message


@dataclass(frozen=True, eq=False)
class MachineState:
    """State at the start of a run: of frames at the centres of mass, with unwrapped angles.

    pose, twist : (n, 12), (n, 6)
    angles      : Sample.angles
    near        : coordinates of joints with stops or friction
    time        : s, at which driven joints are where they are
    """

    pose: np.ndarray
    twist: np.ndarray
    angles: np.ndarray
    near: np.ndarray
    time: float = 0.0


@dataclass(frozen=True, eq=False)
class Segment:
    """Part of a log that one run covers.

    start   : s
    times   : (m + 1,) s, the ends of the parts of the run; the first is the start
    inputs  : (m, k) values of the inputs of the log in each part
    rows    : for each Measured of the log (r,) its rows in this segment
    places  : for each Measured (r,) which of the times these are
    end      : which of the times is the start of the next segment, to which the run goes on; -1: none
    calm     : (m,) how often steps that are halved at all are doubled in each part; None: not
    """

    start: float
    times: np.ndarray
    inputs: np.ndarray
    rows: tuple
    places: tuple
    end: int = -1
    calm: np.ndarray | None = None

    @property
    def seen(self):
        """Numbers of the times at which something was measured."""
        return np.unique(np.concatenate(self.places))

    def calmed(self, starts, calm):
        """The same with `calm` (k,) as it is from times `starts` (k,) on; before them, and with None, it has none."""
        if calm is None or not len(calm):
            return self
        rows = np.searchsorted(starts, 0.5 * (self.times[1:] + self.times[:-1])) - 1
        return replace(self, calm=np.where(rows < 0, 0, calm[rows]))


def segments_of(machine, bounds, delays):
    """[Segment] of the log of a Machine between bounds (s, 2) in s.

    Bounds are late, too, by the mean of the delays. So a start belongs to the same measurements whatever the delay, and
    delays change only when the inputs act, and times of clocks against each other.

    delays : for each Measured, s
    """
    log, found = machine.log, []
    shifted = [np.round((each.times - delay) * NS) / NS for each, delay in zip(log.measured, delays)]
    bounds = np.round((bounds - np.mean(delays)) * NS) / NS
    if bounds.min() < -SHIFT:
        raise SceneError(f"the delays make the log begin at {bounds.min():.6g} s: at least {-SHIFT:g} s are possible")
    changes = machine.changes(bounds.max())
    for (first, last), (after, _) in zip(bounds, [*bounds[1:], (np.inf, 0.0)]):
        rows = tuple(np.flatnonzero((times >= first) & (times < last)) for times in shifted)
        own = [times[row] for times, row in zip(shifted, rows)]
        found.append(_segment(machine, first, rows, own, changes, [last] if after == last else []))
    return found


def up_to(machine, start, end):
    """Segment without measurements between times in s."""
    start, end = (round(time * NS) / NS for time in (start, end))
    return _segment(machine, start, (), [], machine.changes(end), [end])


def _segment(machine, first, rows, own, changes, more=()):
    """Segment from a time on, with rows that were measured at times [(r,)]; changes (k,) s of inputs of the scene.

    more : s, further times
    """
    end = max([first, *(times[-1] for times in (*own, more) if len(times))])
    inside = [each.times[(each.times > first) & (each.times < end)] for each in machine.log.inputs]
    inside.append(changes[(changes > first) & (changes < end)])
    stamps = np.unique(np.round(np.concatenate([[first], more, *own, *inside]) * NS)).astype(int)
    times = stamps / NS
    inputs = np.array([each.over(times) for each in machine.log.inputs])
    inputs = inputs.reshape(len(machine.log.inputs), len(times) - 1).T
    places = tuple(np.searchsorted(times, each - 0.5e-9) for each in own)
    end = int(np.searchsorted(times, more[0] - 0.5e-9)) if len(more) else -1
    return Segment(first, times, inputs, rows, places, end)


def moved(machine, segment, start, lag):
    """Segment that starts `start` s later, as the next one does, and in which everything was measured `lag` s later."""
    own = [segment.times[places] + lag for places in segment.places]
    ends = [segment.times[segment.end] + start] if segment.end >= 0 else []
    found = _segment(machine, segment.start + start, segment.rows, own, machine.changes(segment.times[-1] + lag), ends)
    return found.calmed(segment.times[:-1], segment.calm)


class _Locating(Engine):
    """Engine whose steps end where a law jumps, or bends."""

    LOCATES = True


class Machine:
    """Engine of a scene with the channels of a log.

    longest  : s, longest step
    in_space : whether planar mechanisms move in space, too: scenes with other numbers may not be planar
    turns    : (n, 3, 3) attitudes to which rotation vectors refer; None: those at the start of the scene
    factors  : (k,) of the inputs of the log
    Raises SceneError for unknown channels.
    """

    def __init__(self, scene, log, longest, in_space=False, turns=None, factors=1.0):
        self._factors = factors
        layout, self.longest = _driven(scene, log.drives), longest
        group = choose_group(METHOD, "auto")
        settings = group, "projection" if layout.drifts(group) else "none"
        options = {"space": "space"} if in_space else {}
        self.engine = _Locating(layout.scene, METHOD, STEP, *settings, quiet=True, layout=layout, **options)
        self.probe = Probe(self.engine, in_space=in_space)
        self.layout, self.log = self.engine.layout, log
        self._late = self.layout.model.forces.laws.late  # the time of laws is that of the log
        self._late[0] = SHIFT
        inputs = InputChannels(self.probe, [each.name for each in log.inputs])
        self._wrenches, self._shifts = inputs.changes(0)
        self.efforts, self._units = inputs.efforts, {}
        self._targets = self.probe.acting.targets.copy()
        self._kept = np.ones_like(self._targets)
        for k, name in enumerate(inputs.names):  # a target replaces that of the scene
            if name.rpartition(".")[2] in ("target", "target_velocity"):
                self._targets[self._shifts[k] != 0.0] = 0.0
                self._kept[self._shifts[k] != 0.0] = 0.0
        self.outputs = [OutputChannels(self.probe, each.channels, turns) for each in log.measured]
        self.turns, self._rubbing = self.outputs[0].turns, _friction(scene, log)
        self.use(log)
        limited = [switch for switch in self.layout.switches if switch.limits is not None]
        self._limits = {each.name: (each.limits.least, each.limits.largest) for each in limited}
        names = self.layout.coordinates.names
        self._rigid = [each.name for each in limited if each.limits.stiffness is None and each.name in names]
        seen, freedoms = {name for each in log.measured for name in each.channels}, self.probe.layout.freedoms
        own = [
            [f for f, each in enumerate(freedoms) if each.name.startswith(f"{force.name}.") and each.name not in seen]
            for force in scene.forces
            if force.type == "contact"
        ]
        self._of_contacts = [numbers for numbers in own if numbers]

    def use(self, log):
        """Go on with another log that has the same channels."""
        self.log, self._changes = log, (0.0, np.zeros(0))
        self._times = np.array([time for time, _ in log.acting])
        self._given = [np.array(parts) for parts in zip(*(acting for _, acting in log.acting))]

    def changes(self, end):
        """Times in s up to an end at which inputs of the scene change."""
        if end > self._changes[0]:
            own = _changes(self.engine, 2.0 * end + SHIFT) - SHIFT
            self._changes = 2.0 * end, np.unique(np.concatenate([own, self._times]))
        return self._changes[1][self._changes[1] < end]

    @property
    def start(self):
        """State of the scene at its start."""
        self.engine.reset()
        return replace(self.present(), time=math.nan)

    def placed(self, joints):
        """State with {joint: (position, velocity)}, in stops where these are beyond them; the others as they are."""
        self.engine.place(joints={name: self._between_stops(name, *pair) for name, pair in joints.items()})
        return self.present()

    def _between_stops(self, name, q, v):
        """Position and velocity of a joint; in its stop, without a velocity into it, if it is beyond."""
        if name not in self._limits:
            return q, v
        least, largest = self._limits[name]
        return min(max(q, least), largest), max(v, 0.0) if q < least else min(v, 0.0) if q > largest else v

    def _go_between_stops(self):
        """Move joints of the engine that are beyond rigid stops into them: measured starts have noise."""
        if not self._rigid:
            return
        joints = self.engine.sample().joint_coordinates
        found = {name: self._between_stops(name, *joints[name]) for name in self._rigid}
        beyond = {name: pair for name, pair in found.items() if pair[0] != joints[name][0]}
        if beyond:
            self.engine.place(joints=beyond)

    def present(self):
        """State of the engine, such as where the last run ended."""
        sample = self.engine.sample()
        near = np.zeros(0) if sample.switching is None else sample.switching[:, 3].copy()
        time = round((self.engine.time - SHIFT) * NS) / NS
        return MachineState(*self.engine.state(), sample.angles.copy(), near, time)

    def timed(self, state, time):
        """State at another time in s: driven joints are where they are then, the others as they are, if they can."""
        if state.time == time or not self.layout.motions:
            return replace(state, time=time)
        wanted = {
            joint: at(row, time + SHIFT)[:2]
            for joint, row in zip(self.layout.motions, self._motions(np.array([time + SHIFT]))[0])
        }
        if math.isnan(state.time):  # the start of the scene may be far away
            self._go(replace(state, time=0.0))
            try:
                self.engine.place(joints=wanted)
            except ValueError as error:
                raise SceneError(f"the driven joints cannot be where they were at {time:.9g} s: {error}") from None
            return replace(self.present(), time=time)
        before, y = self.at(state).joint_coordinates, np.zeros((self.probe.freedoms, 2))
        for k, freedom in enumerate(self.layout.freedoms):
            if freedom.name in wanted:
                y[k] = freedom.sign * np.subtract(wanted[freedom.name], before[freedom.name])
        self.probe.go_to_time(time + SHIFT)
        _, pose, twist = self.probe.closed(y)
        return replace(state, pose=pose, twist=twist, angles=self.layout.angles(pose, state.angles), time=time)

    def effort(self, joint):
        """(n, COLUMNS) change of the external wrenches by a unit effort of a joint."""
        if joint not in self._units:
            self._units[joint] = InputChannels(self.probe, [f"{joint}.effort"]).changes(0)[0][0]
        return self._units[joint]

    def at(self, state):
        """Sample of a state, from which the Probe continues."""
        sample = self.seen(state)
        self.probe.take(sample)
        self.probe.release(stops=True)
        return sample

    def seen(self, state):
        """Sample of a state; the Probe stays where it is."""
        self._go(state)
        return self.engine.sample()

    def instant(self, time):
        """Instant of the engine at a time of the log in s."""
        return self.engine.instant_of(round((time + SHIFT) * NS))

    def _go(self, state):
        engine = self.engine
        instant = engine.instant_inside(round((state.time + SHIFT) * NS), 0)
        engine._start_at(state.pose.copy(), state.twist.copy(), instant, state.angles)
        if len(state.near):
            engine._switching.expect(state.near)

    def shown(self, segment, state):
        """(f,) whether a start of each freedom can show in a Segment; only states of contacts cannot.

        The work, and bristles of points that do not press, accelerate no body. Bristles of a contact that slides are
        those of its motion before the next measurement, whatever they were.
        """
        f, found = self.probe.freedoms, np.ones(self.probe.freedoms, dtype=bool)
        later = segment.times[segment.seen[segment.seen > 0][:1]]
        if not self._of_contacts or not len(later):
            return found
        self.at(state)
        own = np.concatenate(self._of_contacts)
        bodies, still = np.setdiff1d(np.arange(f), own), np.zeros((f, 2))
        still[own, 1] = -self.probe.closed()[0][own]
        rest = self.probe.slopes(still)[0][f:]
        for of_one in self._of_contacts:
            slides = np.abs(rest[of_one]).max() * (later[0] - segment.start) > 1.0
            for k in of_one:
                way = still.copy()
                way[k, 1] += 1.0
                found[k] = not slides and (self.probe.slopes(way)[0][f:][bodies] != rest[bodies]).any()
        return found

    def beside(self, state, ways, change):
        """State with a change (c,) along its ways; the Probe is at the state."""
        if not change.any():
            return state
        rates, pose, twist = self.probe.closed(np.tensordot(change, ways, 1))
        angles = self.probe.with_states(self.layout.angles(pose, state.angles), rates)
        return replace(state, pose=pose, twist=twist, angles=angles)

    def follow(self, other, state):
        """State of this scene with the joints' coordinates and rates of another scene's Machine at a state."""
        other.at(state)
        self.probe.follow(other.probe)
        _, pose, twist = self.probe.closed()
        return replace(state, pose=pose, twist=twist, angles=self.layout.angles(pose, state.angles))

    def run(self, segment, state, extra=None, halves=0):
        """Outputs [(r, p)] of each Measured in a Segment, from a state, then `place` (z,) of its end, (0,) without one.

        extra  : (m, n, COLUMNS) change of the external wrenches in each part, or None
        halves : how often the steps are halved; with 0, they go on over slip and stick
        Raises SimulationError.
        """
        seen = segment.seen if segment.end < 0 else np.union1d(segment.seen, [segment.end])
        path = self.path(segment, state, seen, extra, halves)
        found = []
        for places, outputs in zip(segment.places, self.outputs):
            rows = np.searchsorted(seen, places)
            found.append(outputs.of_states(path, rows))
        for t, k, joint, law in self._rubbing:
            rate = path.joints[np.searchsorted(seen, segment.places[t]), self.layout.coordinates.names.index(joint), 1]
            found[t][:, k] += law.against(rate)
        k = np.searchsorted(seen, segment.end)
        found.append(self.place(path.poses[k], path.twists[k], path.angles[k]) if segment.end >= 0 else np.zeros(0))
        return found

    def place(self, pose, twist, angles):
        """(z,) poses (n, 12), twists (n, 6), with lengths by the mechanism's size, and states of laws.

        For differences of states. angles : (k,) as Sample.angles, which states of laws end
        """
        size, of_laws = self.layout.size, len(angles) - len(self.layout.model.forces.laws.states)
        scaled = pose / ([1.0] * 9 + [size] * 3), twist / ([1.0] * 3 + [size] * 3), angles[of_laws:]
        return np.concatenate([each.ravel() for each in scaled])

    def path(self, segment, state, seen, extra=None, halves=0):
        """Path at chosen times of a Segment, from a state; seen : their numbers. Others as of `run`."""
        if self.engine._switching is not None:
            self.engine._switching.leaps = LEAPS if halves else (*LEAPS, -1)
        self._go(self.timed(state, segment.start))
        self._go_between_stops()
        segment = replace(segment, inputs=segment.inputs * self._factors)
        engine, work, count = self.engine, self.engine._work, len(segment.inputs)
        middles = SHIFT + segment.times[:-1] + 0.5 * np.diff(segment.times)
        wrenches, targets = self._acting(middles)
        wrenches = wrenches + np.tensordot(segment.inputs, self._wrenches, 1)
        if extra is not None:
            wrenches += extra
        targets = targets + np.tensordot(segment.inputs, self._shifts, 1)
        longest = self.longest * 2.0 ** (segment.calm if halves and segment.calm is not None else 0)
        counts = np.maximum(1, np.ceil(np.diff(segment.times) / longest - 1e-9)).astype(int) << halves
        places = np.full(count + 1, -1)
        places[seen] = np.arange(len(seen))
        n, k = len(engine._pose), len(seen)
        path = Path(self, segment, seen, wrenches, targets)
        path.poses, path.twists = np.empty((k, n, 12)), np.empty((k, n, 6))
        path.modes, path.angles = np.empty((k, len(self.layout.switches), 5)), np.empty((k, len(work.angle)))
        status = self._along(segment, counts, places, path)
        engine.steps = self.instant(segment.times[-1]).step
        if status == OK and not np.isfinite(path.poses).all():
            status = NOT_FINITE
        if status != OK:
            hint = "; check the positions of driven joints" if self.log.drives else ""
            raise SimulationError(f"{reason(engine, status)}{hint}", status & 0xFF)
        return path

    def _acting(self, times):
        """External wrenches and targets without inputs of the log, with a first axis of times (m,) in s, or without."""
        if self._given:
            rows = self._rows(times)
            return self._given[0][rows], self._given[1][rows] * self._kept
        return self._of_scene(times), self._targets

    def _rows(self, times):
        """(m,) rows of what is given by the log at times (m,) in s; before the first one, it acts, too."""
        return np.maximum(np.searchsorted(self._times, times - SHIFT, side="right") - 1, 0)

    def _motions(self, times):
        """(m, d, 7) motions of the driven joints at times (m,) in s."""
        if not self._given or self.log.drives:
            return self.layout.motions_along(times)
        return self._given[2][self._rows(times)] + SHIFT * (np.arange(COLUMNS) == 0)

    def _of_scene(self, times):
        """External wrenches of the scene, (m, n, COLUMNS) at times (m,) in s, or (n, COLUMNS) if there are none."""
        if not any(force.type == "applied_wrench" for force in self.layout.scene.forces):
            return self.engine.inputs.acting.external
        found = [self.layout.wrenches_at(time) for time in times.tolist()]
        return np.reshape(found, (len(times), *self.engine.inputs.acting.external.shape))

    def _along(self, segment, counts, places, path):
        """Run through the parts of a Segment, compiled from one change of stops or friction to the next; a status."""
        engine, work, times = self.engine, self.engine._work, segment.times
        n, m, s, d = len(engine._pose), len(counts), len(work.targets), len(work.motions)
        late = self._motions(SHIFT + times[:-1] + 0.5 * np.diff(times))
        motions = late.reshape(-1, COLUMNS).copy()
        motions[:, 0] -= SHIFT  # compiled parts have the times of the log, which are more exact
        wrenches, targets = path.wrenches.reshape(m * n, path.wrenches.shape[2]), path.targets.reshape(-1, 2)
        kept = path.poses.reshape(-1, 12), path.twists.reshape(-1, 6), path.modes.reshape(-1, 5)
        state = engine._pose, engine._twist, engine.inputs.acting.external
        k = 0
        while k < m:
            last, status = self._last_alike(segment, k, path), EVENT
            if last > k:
                parts = times[k : last + 1], counts[k:last], places[k : last + 1]
                given = wrenches[k * n : last * n], targets[k * s : last * s], motions[k * d : last * d]
                self._late[0] = 0.0
                done, status = engine._integrator.passage(*parts, *given, *state, kept, path.angles)
                self._late[0] = SHIFT
                k += done
            if status == EVENT:
                self._keep(segment, k, places[k], path)
                size = float((times[k + 1] - times[k]) / counts[k])
                state[2][:], work.targets[:], work.motions[:] = path.wrenches[k], path.targets[k], late[k]
                begin, end = self.instant(times[k]), self.instant(times[k + 1])
                _, status = engine._integrate(begin, size, int(counts[k]), end)
                k += 1
            if status != OK:
                return status
        self._keep(segment, m, places[m], path)
        return OK

    def _last_alike(self, segment, k, path):
        """Number of the part up to which the compiled passage may go from part k on, at most; k: not at all."""
        engine, work, last = self.engine, self.engine._work, len(path.wrenches)
        switching = engine._switching
        if switching is None or switching.are_known and not switching.any_at_rest:
            return last
        external = engine.inputs.acting.external
        external[:], work.targets[:] = path.wrenches[k], path.targets[k]
        if len(work.motions) or not switching.is_settled(external):
            return k
        return min(last, int(path.changes[np.searchsorted(path.changes, k, side="right")]))

    def _keep(self, segment, k, place, path):
        """Write the present state, at time k, to its row of a Path; -1: none."""
        if place < 0:
            return
        engine = self.engine
        path.poses[place], path.twists[place] = engine.state()
        path.angles[place] = engine._work.angle
        if engine._switching is not None:
            path.modes[place] = engine._modes_now()


class Path:
    """States of a run at chosen times of a Segment, and the inputs of its parts.

    poses, twists, angles : (k, n, 12), (k, n, 6) at the centres of mass, and (k, a) as Sample.angles
    wrenches, targets : (m, n, COLUMNS), (m, s, 2) of each part
    modes  : (k, s, 5) as Sample.switching
    """

    def __init__(self, machine, segment, seen, wrenches, targets):
        self._machine, self._segment, self._seen = machine, segment, seen
        self.wrenches, self.targets = wrenches, targets

    @cached_property
    def changes(self):
        """Numbers of the parts whose inputs are not those of the part before, and that of the end."""
        inputs = np.hstack([each.reshape(len(each), -1) for each in (self.wrenches, self.targets)])
        return np.append(np.flatnonzero((np.diff(inputs, axis=0) != 0.0).any(axis=1)) + 1, len(inputs))

    @cached_property
    def bodies(self):
        """(k, n, 12) poses and (k, n, 6) twists of the bodies."""
        return self._machine.layout.offsets.to_bodies(self.poses, self.twists)

    @cached_property
    def joints(self):
        """(k, j, 2) positions and velocities of the joints with one coordinate."""
        return self._machine.layout.coordinates.along(self.poses, self.twists, self.angles)

    def sample(self, k):
        """Sample of state k, with the inputs of the part that ends there."""
        machine, place = self._machine, self._seen[k]
        engine, instant, part = machine.engine, machine.instant(self._segment.times[place]), max(place - 1, 0)
        found = Sample(
            machine.layout,
            instant.time,
            round(instant.time * NS),
            0,
            self.poses[k].copy(),
            self.twists[k].copy(),
            self.angles[k].copy(),
        )
        if len(self.wrenches):
            motions = machine._motions(np.array([instant.time]))[0]
            found.acting = Acting(self.wrenches[part], self.targets[part], motions)
            found.joint_efforts = machine.efforts(self._segment.inputs[part])
        if engine._switching is not None:
            found.switching = self.modes[k]
        return found


def state_at(machine, start, state, end, halves=0):
    """State at a time in s to which a run from a state at `start` leads; None if it fails."""
    try:
        machine.path(up_to(machine, start, end), state, np.zeros(0, dtype=int), halves=halves)
    except LieGroupSimError:
        return None
    return machine.present()


def directions(probe):
    """(scales (c,), (c, f, 2), freedoms (c,)) of the independent coordinates and rates of a Probe.

    Scales: 1 rad, or the mechanism's size, and per s.
    """
    coordinates, scales = Coordinates(probe), scales_of(probe.layout)
    found = [coordinates.neighbour(k, 1.0) for k in range(len(coordinates.independent))]
    found += [coordinates.neighbour(k, 1.0, rate=True) for k in range(len(coordinates.moving))]
    numbers = np.concatenate([coordinates.independent, coordinates.moving])
    return scales[numbers], np.reshape(found, (len(found), probe.freedoms, 2)), numbers


def floating(layout):
    """Names of the bodies of a Layout that move freely in space."""
    freedoms = {freedom.name for freedom in layout.freedoms}
    return [body for body in layout.body_names if f"{body}.rx" in freedoms]


def _driven(scene, drives):
    """Layout of a scene, SHIFT later, whose joints move along the positions of [Given]. Raises SceneError."""
    timed = [force for force in scene.forces if getattr(force, "start", 0.0) or getattr(force, "end", None)]
    if timed:
        scene = scene.remade(forces=[_later(force) if force in timed else force for force in scene.forces])
    if not drives:
        layout = make_layout(scene)
        return layout.with_motions({name: _shifted(rows) for name, rows in layout.motions.items()})
    given = {each.name.removesuffix(MOTION): each for each in drives}
    if missing := given.keys() - {joint.name for joint in scene.joints if "driven" in type(joint).model_fields}:
        name = min(missing)
        raise SceneError(f"{name}{MOTION}: the scene has no joint {name} that can be driven")
    joints = [joint.remade(**PRESCRIBED) if joint.name in given else joint for joint in scene.joints]
    layout = make_layout(scene.remade(joints=joints))
    turning = {name for name, unit in layout.coordinates.units.items() if unit == "rad"}
    # Kept by the log, for all scenes with other numbers.
    own = {name: (each.unwrapped if name in turning else each).motion for name, each in given.items()}
    return layout.with_motions({name: _shifted(rows) for name, rows in (layout.motions | own).items()})


def _later(force):
    """Force that begins and ends SHIFT later; one that acts from the start on acts before, too."""
    start, end = force.start, force.end
    return force.remade(start=start and start + SHIFT, end=None if end is None else end + SHIFT)


def _shifted(rows):
    """(m, 7) motion SHIFT later; before its first row it rests where it is at the start of the log."""
    (present,), later = row_at(rows, np.zeros(1)), rows.copy()
    later[:, 0] += SHIFT
    return np.vstack([uniform(0.0, at(present, 0.0)[0], 0.0), later])


def _friction(scene, log):
    """[(number of the Measured, of its output, joint, Friction)] of measured efforts of joints that a log drives.

    Raises SceneError for friction by load.
    """
    joints, driven = (
        {joint.name: joint for joint in scene.joints},
        {each.name.removesuffix(MOTION) for each in log.drives},
    )
    found = []
    for t, each in enumerate(log.measured):
        for k, name in enumerate(each.channels):
            joint, _, part = name.rpartition(".")
            if part != "effort" or joint not in driven or joints[joint].friction is None:
                continue
            found.append((t, k, joint, law_of_driven(joints[joint])))
    return found


def law_of_driven(joint):
    """Friction that is a part of the effort of a driven joint. Raises SceneError for friction by load."""
    if max(joint.friction.by_load) > 0.0:
        raise SceneError(f"{joint.name}.effort: friction by load has no part in that of a driven joint: remove mu")
    return joint.friction


def _changes(engine, end):
    """Times in s up to an end at which inputs of the scene change."""
    found = [time for start, over, _ in engine.layout.commands for time in (start, over)]
    return np.unique([time for time in found if 0.0 < time < end])


class Apart:
    """Differences of outputs of one Measured: of angles modulo 2 pi, of attitudes as rotation vectors.

    outputs : OutputChannels
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
