# SPDX-License-Identifier: Apache-2.0
"""Schedule of commands: external wrenches, efforts of joints, targets of servos, motions of driven joints.

A source applies at most one wrench to a body. A later wrench of the same source replaces the earlier one at its
start; a zero wrench ends it. Wrenches of different sources add. A wrench is constant in body axes or in world axes
from its start to its end. A step in which a wrench starts or ends is split there.

The effort of a joint is one command with constant wrenches on both bodies (joint_effort.py). A source applies at
most one effort to a joint, by the same rules.

Target position and velocity of a servo are a command with a start and an end as well. A later command replaces it;
without a command the servo has the values of the scene. The motion of a driven joint is a command that holds until
the next one. A new motion also replaces later waiting ones.
"""

import bisect
from functools import reduce
from operator import add
from typing import NamedTuple

import numpy as np

from liegroup_core.joints.motion import FROM_SCENE

from .commands import EFFORT, MOTION, WRENCH, Command
from .instants import AFTER, BEFORE, NEVER, Instant

# Totals: wrenches on a body in its axes, in world axes, and levers (external.py); of servos and of driven joints.
BODY, IN_WORLD, LEVERS, SERVO, DRIVE = "body", "world", "levers", "servo", "drive"


class ScheduledCommand(NamedTuple):
    """A command in a schedule."""

    start: Instant
    end: Instant
    number: int  # order of arrival; of two commands with the same start, the later one holds
    key: tuple  # a later command with the same key replaces this one
    parts: tuple  # ((axes, number of the body, servo or driven joint, values), ...)
    command: Command

    @property
    def ends_at_once(self):
        """True for a zero wrench or effort, which ends the current one."""
        return self.command.kind in (WRENCH, EFFORT) and not any(self.command.values)

    @property
    def changes(self):
        """{(number, axes)} of the totals on which it acts."""
        return {(number, axes) for axes, number, _ in self.parts}


def _by_start(entry):
    return entry.start, entry.number


class Schedule:
    """Commands that act, and those that start later.

    targets : (k, 2) target position and velocity of each servo without a command
    drives : number of driven joints
    total  : {axes: rows} sums of what acts: "body", "world" (n, 6), "levers" (n, 9), "servo" (k, 2), and "drive"
             (d, 7), commanded motions or FROM_SCENE
    """

    def __init__(self, body_count, targets=np.zeros((0, 2)), drives=0):
        self._idle = {BODY: np.zeros((body_count, 6)), IN_WORLD: np.zeros((body_count, 6))}
        self._idle |= {LEVERS: np.zeros((body_count, 9)), SERVO: targets, DRIVE: np.tile(FROM_SCENE, (drives, 1))}
        self.clear_all()

    def clear_all(self):
        """Discard all commands."""
        self.total = {axes: idle.copy() for axes, idle in self._idle.items()}
        self.waiting, self._acting = [], {}  # [ScheduledCommand] in the order of their starts; {key: ScheduledCommand}
        self._arrived = 0
        self._known_next = None

    def held(self):
        """Copy of all entries and totals, for `give_back`."""
        total = {axes: rows.copy() for axes, rows in self.total.items()}
        return total, list(self.waiting), dict(self._acting), self._arrived, self._known_next

    def give_back(self, held):
        """Return to what `held` gave."""
        self.total, self.waiting, self._acting, self._arrived, self._known_next = held

    def __bool__(self):
        return bool(self.waiting or self._acting)

    def __len__(self):
        """Number of commands that act or start later."""
        return len(self.waiting) + len(self._acting)

    @property
    def acting(self):
        """[ScheduledCommand] of the commands that act, in an order that does not depend on that of their arrival."""
        return [entry for _, entry in sorted(self._acting.items())]

    @property
    def sources(self):
        """Names of the sources with a command that acts or starts later."""
        return {entry.command.source for entry in (*self.waiting, *self._acting.values())}

    @property
    def efforts(self):
        """{joint: total effort} of the joints on which efforts act."""
        totals = {}
        for _, entry in sorted(self._acting.items()):
            kind, name, values, *_ = entry.command
            if kind == EFFORT:
                totals[name] = totals.get(name, 0.0) + values[0]
        return totals

    def insert(self, command, key, parts, start, end):
        """Add a command between two Instants; key, parts : see ScheduledCommand."""
        self._arrived += 1
        if command.kind == MOTION:
            self.waiting = [entry for entry in self.waiting if entry.key != key or entry.start < start]
        entry = ScheduledCommand(start, end, self._arrived, key, parts, command)
        bisect.insort(self.waiting, entry, key=_by_start)
        self._known_next = None

    def resume(self, command, key, parts, end):
        """Add a command that acts already, until an Instant: `update` reports no change."""
        self._arrived += 1
        self._acting[key] = entry = ScheduledCommand(BEFORE, end, self._arrived, key, parts, command)
        for changed in entry.changes:
            self._add_up(*changed)
        self._known_next = None

    def motion_at(self, drive, instant):
        """Commanded motion (7,) of a driven joint at an Instant, or FROM_SCENE."""
        found = self.total[DRIVE][drive]
        for entry in self.waiting:
            if entry.parts[0][:2] == (DRIVE, drive) and entry.start <= instant:
                found = entry.command.values
        return np.array(found)

    def clear(self, source, instant):
        """End all commands of a source at an Instant, and discard those that start later.

        Motions of driven joints stay, because they have no end.
        """

        def is_ended(entry):
            return entry.command.source == source and entry.command.kind != MOTION and entry.end > instant

        self.waiting = [
            entry._replace(end=instant) if is_ended(entry) else entry
            for entry in self.waiting
            if not (is_ended(entry) and entry.start >= instant)
        ]
        for key, entry in self._acting.items():
            if is_ended(entry):
                self._acting[key] = entry._replace(end=instant)
        self._known_next = None

    @property
    def next(self):
        """Instant before which `update` changes nothing."""
        if self._known_next is None:
            ends = [BEFORE if entry.ends_at_once else entry.end for entry in self._acting.values()]
            self._known_next = min([*ends, *(entry.start for entry in self.waiting[:1])], default=AFTER)
        return self._known_next

    def update(self, instant):
        """Set `total` to what acts from an Instant on. Returns the changed [(number, axes)]."""
        if instant < self.next:
            return []
        self._known_next, touched = None, set()
        while self.waiting and self.waiting[0].start <= instant:
            entry = self.waiting.pop(0)
            before = self._acting.get(entry.key)
            touched |= entry.changes | (before.changes if before else set())
            self._acting[entry.key] = entry
        for key, entry in list(self._acting.items()):
            if entry.end <= instant or entry.ends_at_once:
                touched |= entry.changes
                del self._acting[key]
        return [changed for changed in sorted(touched) if self._add_up(*changed)]

    def _add_up(self, number, axes):
        """Set a total; returns whether it has changed."""
        # Sorted by key, so that the sum of the same wrenches is always bit-identical.
        parts = [
            values
            for _, entry in sorted(self._acting.items())
            for kind, where, values in entry.parts
            if (where, kind) == (number, axes)
        ]
        # For six numbers, plain Python is several times faster than NumPy.
        total = [reduce(add, column) for column in zip(*parts)] or self._idle[axes][number].tolist()
        if total == self.total[axes][number].tolist():
            return False
        self.total[axes][number] = total
        return True

    def next_after(self, instant):
        """Instant up to which totals stay as they are at an Instant, at least."""
        if self.next > instant:
            return self.next
        entries = *self._acting.values(), *self.waiting  # one that waits may start at the Instant
        return min((each for entry in entries for each in (entry.start, entry.end) if each > instant), default=AFTER)

    def inside(self, step):
        """Instants inside a step at which a command starts or ends, in order."""
        if self.next.step > step:
            return []
        return sorted({i for i in self._instants(step) if i.step == step and i.offset})

    def next_change(self, step):
        """First later step that starts with a change of the totals, or contains one."""
        if self.next.step > step:
            return self.next.step
        return min((i.step for i in self._instants(step) if i.step > step), default=NEVER)

    def _instants(self, step):
        """Starts and ends of commands up to the end of a step, and at least one later if there is one."""
        instants = [entry.end for entry in self._acting.values()]
        for entry in self.waiting:
            instants += entry.start, entry.end
            if entry.start.step > step:
                break
        return instants
