# SPDX-License-Identifier: Apache-2.0
"""Runs of all segments of a log, with changed starts, numbers or forces; each one is a task for a worker."""

import threading
from dataclasses import dataclass

import numpy as np

from liegroup_core.errors import SceneError, SimulationError
from liegroup_core.forces.contact import stiffest
from liegroup_core.linear.numbers import Numbers

from .machine import Machine, directions, moved, segments_of

# Of starts, in rad and sizes of the mechanism and per s, and of numbers, relative. Runs repeat to round-off: of
# differences it is 1e-7. Where outputs change by G of their spread per unit change, curvature adds 1e-8 G.
CHANGE = 1e-8
# s, change of times: whole ns, as instants are. Starts explain nearly all that a delay changes where motions part, so
# that the curvature of that, times LAG, must be below what is left.
LAG = 1e-8
LONGEST = 0.01  # s, first longest step; it is halved until the errors are a small part of the noise
# Of the time T in which a contact acts: one that begins within a step h changes the speed by (h / T)^2 / 8 too much.
OF_CONTACT = 1.0 / 16.0
_own = threading.local()  # machines of each thread


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Unknowns of a fit.

    bounds : (s, 2) s, of the segments
    delays : (t,) s, of each Measured
    values : (q,) numbers of the scene
    states : [MachineState] at the start of each segment, of the scene with these numbers
    halves : how often the longest steps are halved
    calm   : (times in s, how often steps are doubled from then on), see pace.py; None: nowhere
    """

    bounds: np.ndarray
    delays: np.ndarray
    values: np.ndarray
    states: tuple
    halves: int = 0
    calm: tuple | None = None


def longest_step(scene):
    """Longest step in s of runs of a Scene, to begin with."""
    return min(LONGEST, OF_CONTACT * stiffest(scene.forces)[0])


class Varied:
    """Numbers of a scene, and factors of inputs of a log, which are 1 before.

    names : as `liegroup_sim sweep --vary` takes them, and of inputs
    paths, values, scales : as of Numbers
    """

    def __init__(self, scene, log, names):
        inputs, names = [each.name for each in log.inputs], list(names)
        self._own = np.array([name not in inputs for name in names], dtype=bool)
        self._numbers = Numbers(scene, [name for name in names if name not in inputs])
        self._places = [inputs.index(name) for name in names if name in inputs]
        self._count, paths = len(inputs), iter(self._numbers.paths)
        self.paths = tuple(next(paths) if own else f"scale of {name}" for own, name in zip(self._own, names))
        self.values, self.scales = np.ones((2, len(names)))
        self.values[self._own], self.scales[self._own] = self._numbers.values, self._numbers.scales

    def __len__(self):
        return len(self.paths)

    def scene_at(self, values):
        """Scene with other values (q,). Raises SceneError."""
        return self._numbers.scene_at(np.asarray(values)[self._own])

    def factors(self, values):
        """(k,) factors of the inputs."""
        found = np.ones(self._count)
        found[self._places] = np.asarray(values)[~self._own]
        return found


class Runs:
    """Runs of a scene over a log, as a function of Unknowns and a change.

    scene : Scene
    log   : Log
    names : of numbers that vary, see Varied
    longest : s, longest step
    tell  : function of a text, how far the work is; None: nothing is told
    """

    def __init__(self, scene, log, names=(), longest=2e-3, tell=None):
        self.tell = tell or (lambda text: None)
        self.scene, self.log, self.names, self.longest = scene, log, tuple(names), longest
        # Without numbers, starts would make up for them in long segments.
        self.has_contacts = bool(names) and any(force.type == "contact" for force in scene.forces)
        self.has_hits = longest_step(scene) < LONGEST  # bodies are hit within one step of others
        self.numbers = Varied(scene, log, self.names)
        self._own, self._in_space, self._turns = threading.local(), False, None
        self._segments = self._starts = None, None
        self._turns = self.machine(self.numbers.values).turns
        self._in_space = not all(self._is_alike(k) for k in range(len(self.numbers)))
        for k in range(len(self.numbers)):
            if self._in_space and not self._is_alike(k):
                raise self._refusal(k)

    def _refusal(self, k):
        return SceneError(f"{self.numbers.paths[k]} changes the structure of the mechanism: it cannot be identified")

    def _is_alike(self, k):
        """Whether the scene with number k changed has the same structure as it is."""
        machine, (_, other) = self.machine(self.numbers.values), self._beside(self.numbers.values, k)
        return other.probe.has_structure_of(machine.probe)

    def machine(self, values):
        """Machine of this thread with numbers (q,) of the scene. Raises SceneError."""
        key = self._in_space, tuple(np.asarray(values, dtype=float).tolist())
        known = vars(self._own).setdefault("machines", {})
        if key not in known:
            while len(known) > 2 * len(self.names) + 8:
                del known[next(iter(known))]
            scene = self.scene if np.array_equal(values, self.numbers.values) else self.numbers.scene_at(values)
            factors = self.numbers.factors(values)
            known[key] = Machine(scene, self.log, self.longest, self._in_space, self._turns, factors)
        return known[key]

    def use(self, log):
        """Go on, in this thread, with another log that has the same channels."""
        self.log, self._segments, self._starts = log, (None, None), (None, None)
        for each in vars(self._own).get("machines", {}).values():
            each.use(log)

    def segments(self, point):
        """[Segment] of Unknowns."""
        key = tuple(part.tobytes() for part in (point.bounds, point.delays, *(point.calm or ())))
        known, found = self._segments  # of another thread, perhaps
        if known != key:
            found = segments_of(self.machine(point.values), point.bounds, point.delays)
            found = [each.calmed(*(point.calm or ((), None))) for each in found]
            self._segments = key, found
        return found

    def base(self, point):
        """[[(r, p)]] outputs of each segment and Measured, and gaps (z,) to the next start. Raises SimulationError."""
        return self.along(self.machine(point.values), self.segments(point), point.states, point.halves)

    @staticmethod
    def along(machine, segments, states, halves, nexts=None, extras=None):
        """As `base`, of other segments or states.

        nexts  : states to which gaps are; None: `states`
        extras : changes of the wrenches in each segment, as `Machine.run` takes them; None: none
        """
        found, nexts = [], states if nexts is None else nexts
        for k, (segment, state) in enumerate(zip(segments, states)):
            if state is None:
                found.append(None)
                continue
            try:
                one = machine.run(segment, state, None if extras is None else extras[k], halves)
            except SimulationError as error:
                raise SimulationError(f"the run from {segment.start:.9g} s on: {error}", error.status) from None
            if segment.end >= 0:
                after = machine.timed(nexts[k + 1], segments[k + 1].start)
                one[-1] -= machine.place(after.pose, after.twist, after.angles)
            found.append(one)
        return found

    def across(self, point):
        """[(c, z)] of segments: the changes of a start by its scales that change its `place` nearest to z."""
        machine, found = self.machine(point.values), []
        for _, state, _, beside, _ in self.starts(point):
            base = machine.place(state.pose, state.twist, state.angles)
            ways = np.array([(machine.place(each.pose, each.twist, each.angles) - base) / CHANGE for each in beside])
            found.append(np.linalg.pinv(ways.T) if len(ways) else np.zeros((0, len(base))))
        return found

    def starts(self, point):
        """[(scales (c,), MachineState, ways, [MachineState] CHANGE of its scale away on each way, shown)] of segments.

        shown : (c,) whether a change on each way can show, see `Machine.shown`
        """
        known, found = self._starts
        if known is not point:
            machine, found = self.machine(point.values), []
            for segment, state in zip(self.segments(point), point.states):
                state = machine.timed(state, segment.start)
                shown = machine.shown(segment, state)
                machine.at(state)
                scales, ways, numbers = directions(machine.probe)
                beside = [machine.beside(state, ways, change) for change in CHANGE * np.diag(scales)]
                found.append((scales, state, ways, beside, shown[numbers]))
            self._starts = point, found
        return found

    def beside_start(self, point, k):
        """As `base`, with coordinate or rate k of each start changed by CHANGE times its scale; None: nothing shows it.

        Gaps are to the starts as they are.
        """
        states = [beside[k] if k < len(beside) and shown[k] else None for *_, beside, shown in self.starts(point)]
        return self.along(self.machine(point.values), self.segments(point), states, point.halves, point.states)

    def beside_times(self, point, start):
        """As `base`, with everything measured LAG later, and with the starts LAG `start` later."""
        machine = self.machine(point.values)
        segments = [moved(machine, segment, LAG * start, LAG) for segment in self.segments(point)]
        return self.along(machine, segments, point.states, point.halves)

    def beside_number(self, point, k):
        """As `base`, with number k changed by CHANGE times its scale."""
        machine, (way, other) = self.machine(point.values), self._beside(point.values, k)
        if not other.probe.has_structure_of(machine.probe):
            raise self._refusal(k)
        states = [other.follow(machine, state) for state in point.states]
        return way, self.along(other, self.segments(point), states, point.halves)

    def with_number(self, point, path, change):
        """As `base`, with a number of the scene, by its path, changed. Raises SceneError, SimulationError."""
        machine = self.machine(point.values)
        numbers = Numbers(machine.layout.scene, [path])
        scene, factors = numbers.scene_at(numbers.values + change), self.numbers.factors(point.values)
        other = Machine(scene, self.log, self.longest, self._in_space, self._turns, factors)
        states = [other.follow(machine, state) for state in point.states]
        return self.along(other, self.segments(point), states, point.halves)

    def _beside(self, values, k):
        """(1 or -1, Machine) with number k changed by CHANGE times its scale; it may be at the edge of its range."""
        for way in (1.0, -1.0):
            other = np.array(values, dtype=float)
            other[k] += way * CHANGE * self.numbers.scales[k]
            try:
                return way, self.machine(other)
            except SceneError:
                if way < 0.0:
                    raise
        return None

    def followed(self, point, values):
        """States of the starts with other numbers of the scene."""
        machine, other = self.machine(point.values), self.machine(values)
        return tuple(other.follow(machine, state) for state in point.states)

    def moved(self, point, changes):
        """States of the starts with changes [(c,)] along their ways."""
        machine, found = self.machine(point.values), []
        for (_, state, ways, *_), change in zip(self.starts(point), changes):
            machine.at(state)
            found.append(machine.beside(state, ways, change))
        return tuple(found)
