# SPDX-License-Identifier: Apache-2.0
"""Schedule of commands: external wrenches, efforts of joints, targets of servos, motions of driven joints.

A source applies at most one wrench to a body. A later wrench of the same source replaces the earlier one at its
start; a zero wrench ends it. Wrenches of different sources add. A wrench is constant in body axes or in world axes
from its start to its end. A step in which a wrench starts or ends is split there.

A body has at most one pull (external.py): a later one replaces it, whatever its source.

The effort of a joint is one command with constant wrenches on both bodies (joint_effort.py). A source applies at
most one effort to a joint, by the same rules.

Target position and velocity of a servo are a command with a start and an end as well. A later command replaces it;
without a command the servo has the values of the scene. The motion of a driven joint is a command that holds until
the next one. A new motion also replaces later waiting ones.

Wrenches and prescribed motions of the scene are commands, too. They add to others or are replaced by them, but users
do not see or clear them, and they act from the end of a step on, before the next one begins.
"""

import bisect
from functools import partial, reduce
from operator import add, attrgetter
from typing import NamedTuple

import numpy as np

from liegroup_core.joints.motion import FROM_SCENE

from .commands import EFFORT, LOADS, MOTION, Command
from .external import PULL_VALUES
from .instants import AFTER, BEFORE, NEVER, Instant

# Totals: wrenches on a body in its axes, in world axes, and levers (external.py); of servos and of driven joints.
BODY, IN_WORLD, LEVERS, PULLED, SERVO, DRIVE = "body", "world", "levers", "pull", "servo", "drive"


class ScheduledCommand(NamedTuple):
    """A command in a schedule."""

    start: Instant
    end: Instant
    number: int  # order of arrival, negative: of the scene; of two commands with the same start, the later one holds
    key: tuple  # a later command with the same key replaces this one
    parts: tuple  # ((axes, number of the body, servo or driven joint, values), ...)
    command: Command

    @property
    def ends_at_once(self):
        """True for a zero wrench or effort, which ends the current one."""
        return self.command.kind in LOADS and not any(self.command.values)

    @property
    def changes(self):
        """[(number, axes)] of the totals on which it acts."""
        return [(number, axes) for axes, number, _ in self.parts]

    @property
    def of_scene(self):
        """Whether it is a command of the scene."""
        return self.number < 0


def _by_start(entry):
    return entry.start, entry.number


_start = attrgetter("start")


class Schedule:
    """Commands that act, and those that start later.

    targets : (k, 2) target position and velocity of each servo without a command
    drives : number of driven joints
    scene  : [(Instant, Instant, key, parts, Command)] starts and ends of commands of the scene
    total  : {axes: rows} sums of what acts: "body", "world" (n, 6), "levers" (n, 9), "pull" (n, 12), "servo" (k, 2),
             and "drive" (d, 7) motions
    reached : last Instant of `update`
    """

    def __init__(self, body_count, targets=np.zeros((0, 2)), drives=0, scene=()):
        self._idle = {BODY: np.zeros((body_count, 6)), IN_WORLD: np.zeros((body_count, 6))}
        self._idle |= {PULLED: np.zeros((body_count, PULL_VALUES))}
        self._idle |= {LEVERS: np.zeros((body_count, 9)), SERVO: targets, DRIVE: np.tile(FROM_SCENE, (drives, 1))}
        scene = [
            ScheduledCommand(start, end, k - len(scene), key, parts, command)
            for k, (start, end, key, parts, command) in enumerate(scene)
        ]
        self._scene = sorted(scene, key=_by_start)
        self.restart(BEFORE)

    def restart(self, instant):
        """Discard all commands, and let those of the scene act that act from an Instant on."""
        self.total = {axes: idle.copy() for axes, idle in self._idle.items()}
        passed = bisect.bisect_right(self._scene, instant, key=_start)
        self.waiting = self._scene[passed:]  # [ScheduledCommand] in the order of their starts
        found = {entry.key: entry for entry in self._scene[:passed]}
        self._acting = {key: entry for key, entry in found.items() if entry.end > instant}
        self._add_up({changed for entry in self._acting.values() for changed in entry.changes})
        self._arrived, self._known, self.reached = 0, None, instant

    def held(self):
        """Copy of all entries and totals, for `give_back`."""
        total = {axes: rows.copy() for axes, rows in self.total.items()}
        return total, list(self.waiting), dict(self._acting), self._arrived, self._known, self.reached

    def give_back(self, held):
        """Return to what `held` gave."""
        self.total, self.waiting, self._acting, self._arrived, self._known, self.reached = held

    def __bool__(self):
        return bool(self.waiting or self._acting)

    def __len__(self):
        """Number of commands that act or start later, without those of the scene."""
        return sum([entry.number >= 0 for entry in (*self.waiting, *self._acting.values())])

    @property
    def acting(self):
        """[ScheduledCommand] that act, in an order that does not depend on that of their arrival; not of the scene."""
        return [entry for _, entry in sorted(self._acting.items()) if not entry.of_scene]

    def ends_of(self, kinds):
        """Ends in ns, as they were given, of the commands of some kinds that act; not of the scene."""
        entries = self._acting.values()
        return {entry.command.end_ns for entry in entries if entry.number >= 0 and entry.command.kind in kinds}

    @property
    def later(self):
        """[ScheduledCommand] that start later, without those of the scene."""
        return [entry for entry in self.waiting if not entry.of_scene]

    @property
    def sources(self):
        """Names of the sources with a command that acts or starts later."""
        return {entry.command.source for entry in (*self.acting, *self.later)}

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
            self._discard(key, start)
        entry = ScheduledCommand(start, end, self._arrived, key, parts, command)
        if self.waiting and start < self.waiting[-1].start:
            bisect.insort(self.waiting, entry, key=_by_start)
        else:
            self.waiting.append(entry)
        if self._known:
            self._known = min(start, self._known[0]), self._known[1]

    def _discard(self, key, start):
        """Discard what waits with a key and starts at an Instant or later."""
        self.waiting = [entry for entry in self.waiting if entry.key != key or entry.start < start]
        self._known = None

    def resume(self, command, key, parts, end):
        """Add a command that acts already, until an Instant: `update` reports no change."""
        self._arrived += 1
        if command.kind == MOTION:
            self._discard(key, BEFORE)
        self._acting[key] = entry = ScheduledCommand(BEFORE, end, self._arrived, key, parts, command)
        self._add_up(entry.changes)
        self._known = None

    def motion_at(self, drive, instant):
        """Motion (7,) of a driven joint at an Instant that is not before the last `update`."""
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
            command = entry.command
            return command.source == source and command.kind != MOTION and entry.end > instant and not entry.of_scene

        self.waiting = [
            entry._replace(end=instant) if is_ended(entry) else entry
            for entry in self.waiting
            if not (is_ended(entry) and entry.start >= instant)
        ]
        for key, entry in self._acting.items():
            if is_ended(entry):
                self._acting[key] = entry._replace(end=instant)
        self._known = None

    @property
    def next(self):
        """Instant before which `update` changes nothing."""
        return (self._known or self._next_times())[0]

    @property
    def next_of_scene(self):
        """Instant before which `update` changes nothing of the scene."""
        return (self._known or self._next_times())[1]

    def _next_times(self):
        first = self.waiting[0].start if self.waiting else AFTER
        of_scene = next((entry.start for entry in self.waiting if entry.of_scene), AFTER)
        for entry in self._acting.values():
            end = entry.end
            if end < first:
                first = end
            if entry.number < 0 and end < of_scene:
                of_scene = end
            if entry.ends_at_once:
                first = BEFORE
        self._known = first, of_scene
        return self._known

    def update(self, instant):
        """Set `total` to what acts from an Instant on. Returns the changed [(number, axes)]."""
        self.reached = instant
        if instant < self.next:
            return []
        self._known, touched = None, set()
        started = bisect.bisect_right(self.waiting, instant, key=_start)
        for entry in self.waiting[:started]:
            before = self._acting.get(entry.key)
            touched.update(entry.changes, before.changes if before else ())
            self._acting[entry.key] = entry
        del self.waiting[:started]
        for key, entry in list(self._acting.items()):
            if entry.end <= instant or entry.ends_at_once:
                touched.update(entry.changes)
                del self._acting[key]
        return self._add_up(touched)

    def _add_up(self, touched):
        """Set totals [(number, axes)]; returns those that have changed, in order."""
        parts = {each: [] for each in sorted(touched)}
        # Sorted by key, so that the sum of the same wrenches is always bit-identical.
        for _, entry in sorted(self._acting.items()):
            for axes, number, values in entry.parts:
                if (number, axes) in parts:
                    parts[number, axes].append(values)
        changed = []
        for (number, axes), rows in parts.items():
            # For six numbers, plain Python is several times faster than NumPy.
            total = list(reduce(partial(map, add), rows)) if rows else self._idle[axes][number].tolist()
            if total != self.total[axes][number].tolist():
                self.total[axes][number] = total
                changed.append((number, axes))
        return changed

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
