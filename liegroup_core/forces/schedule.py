# SPDX-License-Identifier: Apache-2.0
"""Schedule of external wrenches and of commands to joints: source, body, start and end.

A source applies at most one wrench to a body. A later wrench of the same source replaces the earlier
one at its start; a zero wrench ends it. Wrenches of different sources add. A wrench is constant in
body axes or in world axes from its start to its end. A step in which a wrench starts or ends is
split there, and the list of changes reproduces a run exactly.

The effort of a joint is one command with constant wrenches on both bodies (joint_effort.py). A
source applies at most one effort to a joint, by the same rules.

Target position and velocity of a servo are a command with a start and an end as well. A later command
from any source replaces it; without a command the servo has the values of the scene. The motion of a
driven joint is a command that holds until the next one. A new motion also replaces later waiting ones.
"""

import bisect
import copy
from fractions import Fraction
from functools import reduce
from operator import add
from typing import NamedTuple

import numpy as np

from liegroup_core.joints.motion import FROM_SCENE

from .external import AXES, parts_of_wrench
from .instants import AFTER, BEFORE, NEVER, NS, ROUNDING, Instant

# Used as axes if a number is the index of a servo or of a driven joint.
SERVO, DRIVE = "servo", "drive"


def _start(change):
    """Time in s of a change: an exact Fraction if it is at a whole ns, else a float."""
    time, time_ns = change.time, change.time_ns
    return Fraction(time_ns, NS) if abs(time_ns / NS - time) <= ROUNDING * time else time


class AppliedWrench(NamedTuple):
    """Total external wrench on a body, in body axes, in world axes or as a pair, from a time on.

    time    : s
    time_ns : the same in ns
    body    : name of the body
    wrench  : (6,) torque N m, force N; about the origin of the body frame
    axes    : "body" or "world"; "world_x", "world_y" or "world_z": a force in world axes at the
              point 1 m along this axis of the body frame, and its opposite at the origin
    """

    time: float
    time_ns: int
    body: str
    wrench: tuple
    axes: str

    def repeat(self, simulation):
        """Apply it to another simulation of the same scene, from its time on."""
        simulation.apply_wrench(self.body, self.wrench, _start(self), source=self.axes, axes=self.axes)


class AppliedTarget(NamedTuple):
    """Target position and velocity of the servo of a joint, from a time on.

    time     : s
    time_ns  : the same in ns
    joint    : name of the joint
    position : rad or m
    velocity : rad/s or m/s
    """

    time: float
    time_ns: int
    joint: str
    position: float
    velocity: float

    def repeat(self, simulation):
        """Command it to another simulation of the same scene, from its time on."""
        simulation.set_servo_target(self.joint, self.position, self.velocity, _start(self))


class AppliedMotion(NamedTuple):
    """Prescribed motion of a driven joint, from a time on.

    time    : s
    time_ns : the same in ns
    joint   : name of the joint
    motion  : (7,) origin in s and six coefficients, see joints/motion.py
    """

    time: float
    time_ns: int
    joint: str
    motion: tuple

    def repeat(self, simulation):
        """Command it to another simulation of the same scene, from its time on."""
        simulation.prescribe(self.joint, self.motion, _start(self))


class _Command(NamedTuple):
    start: Instant
    end: Instant
    number: int  # order of arrival; of two commands with the same start, the later one holds
    key: tuple  # (source, joint or "", body); a later command with the same key replaces this one
    parts: tuple  # ((axes, number, values), ...); see `WrenchSchedule.waiting`
    effort: float  # of the joint, N m or N

    @property
    def changes(self):
        """{(body, axes)} on which the command acts."""
        return {(number, axes) for axes, number, _ in self.parts}

    @property
    def is_zero(self):
        """True for a zero wrench or effort, which ends the current one."""
        return not any(axes not in AXES or any(values) for axes, _, values in self.parts)


class WrenchSchedule:
    """External wrenches that act, and those that start later.

    wanted : (k, 2) target position and velocity of each servo without a command
    drives : number of driven joints
    total  : {axes: (n, 6)} sums of the wrenches that act, for each of AXES;
             "servo": (k, 2) target values; "drive": (d, 7) commanded motions, or FROM_SCENE
    """

    def __init__(self, body_count, wanted=np.zeros((0, 2)), drives=0):
        self._idle = {axes: np.zeros((body_count, 6)) for axes in AXES}
        self._idle |= {SERVO: wanted, DRIVE: np.tile(FROM_SCENE, (drives, 1))}
        self.total = {axes: idle.copy() for axes, idle in self._idle.items()}
        self._waiting = []
        self._acting = {}
        self._arrived = 0
        self._known_next = None

    def copy(self):
        """Copy of the schedule."""
        other = copy.copy(self)
        other.total = {axes: total.copy() for axes, total in self.total.items()}
        other._waiting, other._acting = self._waiting.copy(), self._acting.copy()
        return other

    def __bool__(self):
        return bool(self._waiting or self._acting)

    def __len__(self):
        """Number of wrenches that act or start later."""
        return len(self._waiting) + len(self._acting)

    @property
    def sources(self):
        """Names of the sources with a wrench that acts or starts later."""
        return {c.key[0] for c in (*self._waiting, *self._acting.values())}

    @property
    def efforts(self):
        """{joint: total effort} of the joints on which efforts act."""
        totals = {}
        for (_, joint, _), command in sorted(self._acting.items()):
            if command.effort:
                totals[joint] = totals.get(joint, 0.0) + command.effort
        return totals

    @property
    def waiting(self):
        """[(start in s, number, wrench (6,), axes)] of the commands that start later.

        number is the index of a body. With the axes "servo" it is the index of a servo, and the wrench is
        (target position, velocity). With "drive" it is that of a driven joint, and the wrench is its motion.
        """
        return [(c.start.time, number, values, axes) for c in self._waiting for axes, number, values in c.parts]

    def act(self, number, wrench, axes):
        """Restore a wrench (6,), or the target values of a servo, that act already, so `update` reports no change.

        number, axes : as in `waiting`. The axes are also the source of the wrench
        """
        self._arrived += 1
        key = (axes, "", number) if axes in AXES else ("", axes, number)
        wrench = tuple(map(float, wrench))
        parts = ((axes, number, wrench),)
        self._acting[key] = _Command(BEFORE, AFTER, self._arrived, key, parts, 0.0)
        self.total[axes][number] = wrench
        self._known_next = None

    def command(self, source, body, wrench, start, end, axes="body", point=None):
        """Apply `wrench` (6,) of `source` to body number `body` between two Instants.

        end   : None: until the wrench is replaced
        point : (3,) m, point of application of the force; None: the origin of the body frame
        """
        parts = [(axes, wrench)] if point is None else parts_of_wrench(wrench, axes, point)
        parts = [(axes, body, values) for axes, values in parts]
        self._insert((source, "", body), parts, start, end)

    def command_effort(self, source, joint, effort, unit, start, end):
        """Apply an effort of `source` to a joint between two Instants.

        unit : wrenches of a unit effort, from joint_effort.unit_wrenches
        end  : None: until the effort is replaced
        """
        parts = [("body", body, effort * wrench) for body, wrench in unit]
        self._insert((source, joint, -1), parts, start, end, effort)

    def command_servo(self, servo, position, velocity, start, end):
        """Command the target values of servo number `servo` between two Instants.

        end : None: until they are replaced
        """
        self._insert(("", SERVO, servo), [(SERVO, servo, (position, velocity))], start, end)

    def command_motion(self, drive, motion, start):
        """Command the motion (7,) of driven joint number `drive` from an Instant on."""
        key = "", DRIVE, drive
        self._waiting = [c for c in self._waiting if c.key != key or c.start < start]
        self._insert(key, [(DRIVE, drive, motion)], start, None)

    def motions_of(self, drive):
        """Commands of a driven joint that act or wait, for `resume`."""
        key = "", DRIVE, drive
        return [c for c in (*self._acting.values(), *self._waiting) if c.key == key]

    def resume(self, commands):
        """Add commands of another schedule to this one."""
        self._waiting = sorted((*self._waiting, *commands), key=lambda c: (c.start, c.number))
        self._arrived = max([self._arrived, *(c.number for c in commands)])
        self._known_next = None

    def motion_at(self, drive, instant):
        """Commanded motion (7,) of a driven joint at an Instant, or FROM_SCENE."""
        found = self.total[DRIVE][drive]
        for command in self._waiting:
            if command.key == ("", DRIVE, drive) and command.start <= instant:
                found = command.parts[0][2]
        return np.array(found)

    def _insert(self, key, parts, start, end, effort=0.0):
        self._arrived += 1
        parts = tuple((axes, number, tuple(map(float, values))) for axes, number, values in parts)
        end = AFTER if end is None else end
        bisect.insort(
            self._waiting, _Command(start, end, self._arrived, key, parts, effort), key=lambda c: (c.start, c.number)
        )
        self._known_next = None

    def clear(self, source):
        """End all wrenches of a source at the next update, also those that start later.

        Motions of driven joints stay, because they have no end.
        """
        ended = {c.key for c in (*self._waiting, *self._acting.values())}
        ended = {key for key in ended if key[0] == source and key[1] != DRIVE}
        self._waiting = [c for c in self._waiting if c.key not in ended]
        for key in ended & self._acting.keys():
            self._acting[key] = self._acting[key]._replace(end=BEFORE)
        self._known_next = None

    @property
    def _next(self):
        """Instant before which `update` changes nothing."""
        if self._known_next is None:
            ends = [BEFORE if c.is_zero else c.end for c in self._acting.values()]
            self._known_next = min([*ends, *(c.start for c in self._waiting[:1])], default=AFTER)
        return self._known_next

    def update(self, instant):
        """Set `total` to the wrenches that act from an Instant on. Returns the changed [(body, axes)]."""
        if instant < self._next:
            return []
        self._known_next, touched = None, set()
        while self._waiting and self._waiting[0].start <= instant:
            command = self._waiting.pop(0)
            before = self._acting.get(command.key)
            touched |= command.changes | (before.changes if before else set())
            self._acting[command.key] = command
        for key, command in list(self._acting.items()):
            if command.end <= instant or command.is_zero:
                touched |= command.changes
                del self._acting[key]
        # Sorted by key, so that the sum of the same wrenches is always bit-identical.
        ordered = [self._acting[key] for key in sorted(self._acting)] if touched else []
        changed = []
        for body, axes in sorted(touched):
            wrenches = [
                values
                for command in ordered
                for kind, number, values in command.parts
                if (number, kind) == (body, axes)
            ]
            # For six numbers, plain Python is several times faster than NumPy.
            total = [reduce(add, column) for column in zip(*wrenches)]
            total = total or self._idle[axes][body].tolist()
            if total != self.total[axes][body].tolist():
                self.total[axes][body] = total
                changed.append((body, axes))
        return changed

    def inside(self, step):
        """Instants inside a step at which a wrench starts or ends, in order."""
        if self._next.step > step:
            return []
        return sorted({i for i in self._instants(step) if i.step == step and i.offset})

    def next_change(self, step):
        """First later step that starts with a change of the wrenches, or contains one."""
        if self._next.step > step:
            return self._next.step
        return min((i.step for i in self._instants(step) if i.step > step), default=NEVER)

    def _instants(self, step):
        """Starts and ends of commands up to the end of a step, and at least one later if there is one."""
        instants = [c.end for c in self._acting.values()]
        for command in self._waiting:
            instants += command.start, command.end
            if command.start.step > step:
                break
        return instants
