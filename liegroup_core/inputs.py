# SPDX-License-Identifier: Apache-2.0
"""Inputs of an Engine that act from one time to another: wrenches, efforts, servos, motions."""

import math
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from liegroup_core.fields.arguments import check_name, floats, got, is_finite
from liegroup_core.forces.acting import Acting
from liegroup_core.forces.commands import (
    AXES,
    CLEAR,
    EFFORT,
    LOADS,
    MOTION,
    MOVE,
    PULL,
    SCENE,
    TARGET,
    WRENCH,
    Command,
    Commands,
)
from liegroup_core.forces.external import no_wrenches, parts_of_wrench, set_wrench
from liegroup_core.forces.instants import AFTER, NS
from liegroup_core.forces.kinds import servos, target_values
from liegroup_core.forces.schedule import BODY, DRIVE, IN_WORLD, LEVERS, PULLED, SERVO, Schedule
from liegroup_core.joints.limits import check_number, usable
from liegroup_core.joints.motion import at, through


class Inputs:
    """Commands to an Engine, and the totals that act.

    layout  : Layout of the scene
    grid    : StepGrid of the steps
    targets, motions : (k, 2), (d, 7) arrays of the integrator, set to the targets of servos and motions of driven
              joints that act
    engine  : Engine, or None: `show` says when the commands act
    tell    : function that takes a text about a command that came late

    acting    : Acting, with the arrays `targets` and `motions`
    schedule  : Schedule
    known_end : first Instant at which a command that acts ends, as it was given, or the scene changes anything
    changes   : number of changes of what acts or waits
    follower  : Inputs of another Engine that takes all commands, too, or None
    log       : [Command] since they were last taken; None: not logged
    """

    KEPT = ("commands",)

    def __init__(self, layout, grid, targets, motions, engine=None, tell=None):
        self._layout, self._grid, self._engine, self._tell = layout, grid, engine, tell
        self._bodies = {name: i for i, name in enumerate(layout.body_names)}
        self._drives, self._servos = tuple(layout.motions), tuple(layout.servos)
        self._units = {
            joint: [(body, tuple(unit.tolist())) for body, unit in parts]
            for joint, parts in layout.unit_efforts.items()
        }
        self._found = (None,) * 4  # the last present time, start and duration of commands, and their interval
        scene = []
        for k, (start, end, command) in enumerate(layout.commands):
            key, parts = self._effects(command)
            key = key if command.kind == MOTION else ("", SCENE, k)  # those of the scene add up
            scene.append((grid.scene_instant(start), grid.scene_instant(end), key, parts, command))
        self.schedule = Schedule(len(self._bodies), target_values(layout.model.forces), len(self._drives), scene)
        self.acting = Acting(no_wrenches(layout.offsets), targets, motions)
        self.follower, self.log, self.changes, self._shown = None, [], 0, ()
        self._take_totals()

    def clear(self, instant):
        """Discard all commands: from an Instant on, only the scene acts."""
        self.schedule.restart(instant)
        self._take_totals()

    def held(self):
        """Copy of all that acts and waits, exactly, for `give_back`: `commands` know the ends of a clear."""
        return self.schedule.held(), self.known_end, self.acting.copy()

    def give_back(self, held):
        """Return to what `held` gave."""
        self.changes += 1
        schedule, self.known_end, acting = held
        self.schedule.give_back(schedule)
        self.acting.set(acting)

    def freeze(self):
        """Let what acts have no end and discard what waits, but for the scene, until `commands` are set."""
        endless = (command._replace(end_ns=None, cleared_ns=None) for command in self.commands.acting)
        self.commands = Commands(tuple(endless))

    def show(self, acting, instant):
        """Let Commands that act at an Instant act, and the scene; without an engine."""
        if acting != self._shown or instant < self.schedule.reached:
            self.set_commands(Commands(acting), instant)
            self._shown = acting
        self.update(instant)

    def _take_totals(self):
        self.changes += 1
        total, external = self.schedule.total, no_wrenches(self._layout.offsets)
        for axes in (BODY, IN_WORLD, LEVERS, PULLED) if self.schedule else ():
            for body in np.flatnonzero(total[axes].any(axis=1)).tolist():
                set_wrench(external, body, total[axes][body], axes)
        self.acting.set((external, total[SERVO], total[DRIVE]))
        self._note_ends()
        if self.log:
            self.log = []

    def _note_ends(self):
        ends = map(self._at_mark, self.schedule.ends_of(LOADS))
        self.known_end = min([*ends, self.schedule.next_of_scene])

    @property
    def commands(self):
        """Commands that act or start later, of which a state consists."""
        return Commands(*(tuple(map(self._marked, part)) for part in (self.schedule.acting, self.schedule.later)))

    @commands.setter
    def commands(self, commands):
        self.set_commands(commands, self._engine.base)

    def set_commands(self, commands, instant):
        """Let Commands act from an Instant on, and the scene."""
        self.schedule.restart(instant)
        for command in commands.acting:
            key, parts = self._effects(command)
            self.schedule.resume(command, key, parts, self._ends(command))
        for command in commands.waiting:
            key, parts = self._effects(command)
            self.schedule.insert(command, key, parts, self._grid.marked(command.start_ns), self._ends(command))
        self._take_totals()

    def _marked(self, entry):
        """Command of a ScheduledCommand, as it was given, and the time at which it was cleared."""
        cleared = None if entry.end == self._end(entry.command) else self._grid.mark(entry.end)
        return entry.command._replace(cleared_ns=cleared)

    def _ends(self, command):
        """Instant at which a command of a state ends."""
        return self._end(command) if command.cleared_ns is None else self._grid.marked(command.cleared_ns)

    def _end(self, command):
        return self._at_mark(command.end_ns)

    def _at_mark(self, end_ns):
        return AFTER if end_ns is None else self._grid.marked(end_ns)

    def accept(self, command):
        """Take a Command without checks of limits; one that is late starts with the next step.

        Raises ValueError for an unknown body or joint.
        """
        begin, end = max(self._engine.now, self._grid.marked(command.start_ns)), self._end(command)
        self._insert(command, begin, end, *self._marks(begin, end))

    def _marks(self, begin, end):
        return self._grid.mark(begin), None if end == AFTER else self._grid.mark(end)

    def _insert(self, command, begin, end, start_ns, end_ns):
        """Take a Command from an Instant on, up to another one; with their marks."""
        self.changes += 1
        command = Command(*command[:3], start_ns, end_ns, *command[5:])
        if command.kind == CLEAR:
            self.schedule.clear(command.source, begin)
        else:
            key, parts = self._effects(command)
            self.schedule.insert(command, key, parts, begin, end)
            if command.kind == MOTION:  # it may replace motions of the scene
                self._note_ends()
        if self.follower is not None:
            self.follower.accept(command)
        if self.log is not None and command.kind in (*LOADS, CLEAR):
            self.log.append(command)

    def _effects(self, command):
        """(key, parts) of a command, see schedule.ScheduledCommand. Raises ValueError for an unknown body or joint."""
        kind, name, values, source = command.kind, command.name, command.values, command.source
        if kind == WRENCH:
            check_name(name, self._bodies, "unknown body {}")
            body = self._bodies[name]
            parts = [(axes, body, part) for axes, part in parts_of_wrench(values, command.axes, command.point)]
            key = source, "", body
        elif kind == PULL:
            check_name(name, self._bodies, "unknown body {}")
            parts = [(PULLED, self._bodies[name], (*values[:5], *(command.point or (0.0, 0.0, 0.0)), *values[5:]))]
            key = "", PULL, parts[0][1]
        elif kind == EFFORT:
            check_name(name, self._units, "joint {} is not a joint with one coordinate")
            effort = float(values[0])
            parts = [(BODY, body, tuple([effort * number for number in unit])) for body, unit in self._units[name]]
            return (source, name, -1), tuple(parts)
        elif kind == TARGET:
            parts = [(SERVO, self._servo(name), values)]
            key = "", SERVO, parts[0][1]
        else:
            parts = [(DRIVE, self._drive(name), values)]
            key = "", DRIVE, parts[0][1]
        return key, tuple((axes, number, tuple(map(float, part))) for axes, number, part in parts)

    def apply_wrench(
        self,
        body: str,
        wrench: ArrayLike,
        start: float | Fraction | None = None,
        duration: float | None = None,
        source: str = "api",
        axes: str = "body",
        point: ArrayLike | None = None,
    ) -> None:
        """Apply a wrench to a body from one time to another.

        body     : name of the body
        wrench   : (6,) torque N m, force N. Zero ends it
        start    : simulated time, s; None: the present one. A Fraction is exact: floats resolve whole ns up to 4e6 s.
                   From a past time on, it acts from the present one to the end that this start and the duration
                   state, and the first such command is logged
        duration : s; None: until it is replaced. Start and end are rounded to whole ns, as stamps of ROS
                   and of recordings are; `drain_applied` returns them
        source   : each source has one wrench per body; wrenches of different sources add
        axes     : of the components: "body", or "world". A wrench in world axes keeps its direction
                   in the world while the body rotates
        point    : (3,) m, in the body frame: the force acts there, and the point turns with the body.
                   None: the origin of the body frame
        A step in which a wrench starts or ends is split at that time, so that methods keep their
        order (test/verification/test_pushes.py).
        Raises ValueError for an unknown body, a wrong shape, or a number that is not finite or beyond 1e100.
        """
        if axes not in AXES:
            raise ValueError(f"axes must be 'body' or 'world', got {axes!r}")
        check_name(body, self._bodies, "unknown body {}")
        wrench = usable("a wrench must be six finite numbers (torque, force)", wrench, (6,))
        if point is not None:
            point = usable("a point must be three finite numbers", point, (3,))
            usable("point times force must be finite numbers", np.outer(point, wrench[3:]), (3, 3))
        _check_source(source)
        point = None if point is None else tuple(point.tolist())
        self._take(Command(WRENCH, body, tuple(wrench.tolist()), None, None, source, axes, point), start, duration)

    def pull(
        self,
        body: str,
        to: ArrayLike,
        stiffness: float,
        damping: float = 0.0,
        start: float | Fraction | None = None,
        duration: float | None = None,
        source: str = "api",
        point: ArrayLike | None = None,
        torque: ArrayLike = (0.0, 0.0, 0.0),
        turning_damping: float = 0.0,
    ) -> None:
        """Pull at a point of a body with a spring and a damper from a point in the world.

        body      : name of the body, which has one pull at most: a later one replaces it
        to        : (3,) m, world axes
        stiffness, damping : N/m, N s/m, not negative: force k (to - x) - c v. All numbers zero: end it
        point     : (3,) m, in the body frame; None: its origin
        torque, turning_damping : (3,) N m in world axes and N m s/rad: torque n - d omega in addition
        start, duration, source : as in `apply_wrench`
        The force follows the motion inside a step, in each of two runs for an estimate of the error on its own state
        (test/core/test_pulls.py). Raises ValueError for an unknown body, wrong shapes, or numbers that are not finite,
        beyond 1e100 or negative.
        """
        check_name(body, self._bodies, "unknown body {}")
        to = usable("to must be three finite numbers", to, (3,))
        torque = usable("torque must be three finite numbers", torque, (3,))
        for name, value in (("stiffness", stiffness), ("damping", damping), ("turning_damping", turning_damping)):
            check_number(f"{name} must be a finite number", value)
            if value < 0.0:
                raise ValueError(f"{name} must not be negative, got {value!r}")
        if point is not None:
            point = tuple(usable("a point must be three finite numbers", point, (3,)).tolist())
        _check_source(source)
        values = (*map(float, (stiffness, damping, *to, *torque, turning_damping)),)
        if not any((stiffness, damping, *torque, turning_damping)):
            values = (0.0,) * len(values)
        self._take(Command(PULL, body, values, None, None, source, point=point), start, duration)

    def apply_effort(
        self,
        joint: str,
        effort: float,
        start: float | Fraction | None = None,
        duration: float | None = None,
        source: str = "api",
    ) -> None:
        """Apply an effort to a joint with one coordinate, from one time to another.

        joint  : name of a revolute, screw or prismatic joint
        effort : torque about its z axis in N m, or force along it in N, on the child; the opposite
                 acts on the parent. Zero ends it
        start, duration, source : as in `apply_wrench`; each source has one effort per joint
        Raises ValueError for an unknown joint, a joint without exactly one coordinate, or a number
        that is not finite, and BeyondLimits, a ValueError, for an effort beyond that of the joint
        (joints/limits.py).
        """
        units = self._layout.unit_efforts
        check_name(joint, units, "joint {} is not a joint with one coordinate")
        check_number("an effort must be a finite number", effort)
        _check_source(source)
        self._layout.limits[joint].check_effort(effort)
        self._take(Command(EFFORT, joint, (float(effort),), None, None, source), start, duration)

    def command_servo(
        self,
        joint: str,
        position: float,
        velocity: float = 0.0,
        start: float | Fraction | None = None,
        duration: float | None = None,
    ) -> None:
        """Command the target position and velocity of the servo of a joint.

        joint    : name of a joint with a servo or linear_servo
        position : rad, which may exceed 2 pi, or m
        velocity : rad/s or m/s
        start, duration : as in `apply_wrench`; after its end the values of the scene hold
        Raises ValueError for a joint without a servo, or a number that is not finite, and BeyondLimits,
        a ValueError, for a position or velocity beyond the limits of the joint, or a position to which
        it cannot jump (joints/limits.py). A servo without stiffness has no target position.
        """
        self._servo(joint)
        for name, value in (("position", position), ("velocity", velocity)):
            check_number(f"a target {name} must be a finite number", value)
        self.check_jump(joint, position)
        self._layout.limits[joint].check_velocity(velocity)
        self.set_target(joint, position, velocity, start, duration)

    def set_target(self, joint, position, velocity, start=None, duration=None):
        """As `command_servo`, for finite values that were checked before."""
        self._servo(joint)
        self._take(Command(TARGET, joint, (float(position), float(velocity))), start, duration)

    def give(self, command, duration=None):
        """Take a Command whose numbers and limits were checked, for a duration in s; None: until it is replaced.

        After its duration a move comes to rest in as many seconds as it took to begin.
        Raises BeyondLimits, a ValueError, for a move beyond the limits of its joint.
        """
        start = None if command.start_ns is None else Fraction(command.start_ns, NS)
        if command.kind != MOVE:
            self._take(command, start, duration)
            return
        self.command_motion(command.name, *_points(command), start=start)
        if duration is not None:
            begin = self._engine.now.time if start is None else start
            self.command_motion(command.name, command.values[2:], None, [0.0], start=begin + duration)

    def check(self, command):
        """Raise BeyondLimits for a Command that cannot be followed from the present state."""
        if command.kind == EFFORT:
            self._layout.limits[command.name].check_effort(*command.values)
        elif command.kind == TARGET:
            self.check_jump(command.name, command.values[0])
        elif command.kind == MOVE:
            start = None if command.start_ns is None else Fraction(command.start_ns, NS)
            self.check_motion(command.name, *_points(command), start=start)

    def _take(self, command, start, duration):
        """Take a Command from a time in s on and for a duration in s; see `_interval`."""
        now = self._engine.now
        # The commands of one message share all three.
        if not (now is self._found[0] and start is self._found[1] and duration is self._found[2]):
            begin, end = self._interval(command.name, start, duration)
            if begin == end:
                return
            self._found = now, start, duration, (begin, end, *self._marks(begin, end))
        self._insert(command, *self._found[3])

    def _servo(self, joint):
        """Number of the servo of a joint. Raises ValueError for a joint without one, or with one that a law leads."""
        check_name(joint, self._layout.servos, "joint {} has no servo")
        if law := self._layout.leaders.get(joint):
            raise ValueError(f"the target of the servo of {joint} is an output of the law {law}")
        return self._layout.servos[joint]

    def command_motion(
        self,
        joint: str,
        times: ArrayLike,
        positions: ArrayLike | None,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
        start: float | Fraction | None = None,
    ) -> None:
        """Command the motion of a driven joint through points, and then at the last velocity.

        joint     : name of a driven joint
        times     : (m,) s after the start, positive and increasing
        positions : (m,) rad, which may exceed 2 pi, or m; None: they follow from the velocities
        velocities, accelerations : (m,), the last acceleration 0; default: see joints/motion.py
        start     : as in `apply_wrench`
        The motion begins with the position, velocity and acceleration that the joint has at the start,
        and is twice continuously differentiable. From its start on it replaces earlier commands.
        Raises ValueError for a joint that is not driven, wrong shapes or times, or NaN, and BeyondLimits,
        a ValueError, for a motion beyond the limits of the joint (joints/limits.py).
        """
        planned = self._planned(joint, times, positions, velocities, accelerations, start)
        for instant, row in planned:
            self._insert(Command(MOTION, joint, tuple(row.tolist())), instant, AFTER, *self._marks(instant, AFTER))

    def check_motion(self, joint, times, positions, velocities=None, accelerations=None, start=None):
        """Raise the errors of `command_motion` without commanding anything."""
        self._planned(joint, times, positions, velocities, accelerations, start)

    def _planned(self, joint, times, positions, velocities, accelerations, start):
        """[(Instant, motion (7,))] of a commanded motion. Raises ValueError."""
        number = self._drive(joint)
        begin, _ = self._interval(joint, start, None)
        after = np.atleast_1d(floats("times must be finite numbers", times))
        usable(f"times must be {len(after)} finite numbers", after, (len(after),))
        points = [
            part
            if part is None
            else usable(f"{name} must be {len(after)} finite numbers", np.atleast_1d(part), after.shape)
            for name, part in (("positions", positions), ("velocities", velocities), ("accelerations", accelerations))
        ]
        if not (len(after) and after[0] > 0.0 and (np.diff(after) > 0.0).all()):
            raise ValueError(f"times must be positive and increase, got {after}")
        if points[0] is None and points[1] is None:
            raise ValueError("give positions or velocities")
        if points[2] is not None and (points[1] is None or points[2][-1] != 0.0):
            raise ValueError("accelerations require velocities, and the last one must be 0")
        # A motion meets the next one at a whole ns, where the step is split.
        instants = [begin, *(self._grid.after(begin, time) for time in after.tolist())]
        if not all(before < later for before, later in zip(instants, instants[1:])):
            raise ValueError("times must be at least 1 ns apart")
        origins = [instant.time for instant in instants]
        motion = self.schedule.motion_at(number, begin)
        with np.errstate(over="ignore", invalid="ignore"):
            rows = through(at(motion, begin.time), origins, *points)
            self._layout.limits[joint].check_motion(rows, *points[:2])
        return list(zip(instants, rows))

    def check_jump(self, joint, position):
        """Raise BeyondLimits for a target position to which the servo of a joint cannot jump now."""
        number = self._servo(joint)
        if servos(self._layout.scene.forces)[number].stiffness > 0.0:
            before = float(self.acting.targets[number, 0])
            self._layout.limits[joint].check_jump(before, position)

    def _drive(self, joint):
        """Number of a driven joint. Raises ValueError for a joint that is not driven."""
        check_name(joint, self._drives, "joint {} is not driven")
        return self._drives.index(joint)

    def _interval(self, target, start, duration):
        """Instants at which a command to a body or joint starts and ends; equal: it is over. Raises ValueError."""
        for name, value in (("start", start), ("duration", duration)):
            if value is not None and not is_finite(value):
                raise ValueError(f"{name} must be finite, or None, {got(value)}")
        now = self._engine.now
        begin, end = now if start is None else self._grid.instant(_exact_or_float(start)), AFTER
        if duration is not None:
            if not duration > 0.0:
                raise ValueError(f"a duration must be positive, got {duration!r}")
            end = self._grid.after(begin, _exact_or_float(duration))
            if end <= begin:
                raise ValueError(f"a duration must be at least 1 ns, got {duration!r} s")
        if begin < now:
            what = "it is over" if end <= now else "it acts from then" + (" to its end" if end < AFTER else "")
            self._tell(f"command to {target} for t = {begin.time:.9g} s at {now.time:.9g} s: {what}")
        return max(begin, now), max(end, now)

    @property
    def commanded_motions(self) -> tuple[str, ...]:
        """Driven joints with a commanded motion, which acts or starts later."""
        commands = (entry.command for entry in (*self.schedule.acting, *self.schedule.later))
        commanded = {command.name for command in commands if command.kind == MOTION}
        return tuple(name for name in self._drives if name in commanded)

    @property
    def input_count(self) -> int:
        """Number of wrenches, and of commands of joints, that act now or start later."""
        return len(self.schedule)

    @property
    def wrench_sources(self) -> set[str]:
        """Names of the sources of wrenches and efforts that act now or start later."""
        return self.schedule.sources

    @property
    def has_wrenches(self) -> bool:
        """Whether a wrench or an effort acts that is not of the scene."""
        return any(entry.command.kind in LOADS for entry in self.schedule.acting)

    @property
    def targets_by_joint(self):
        """{joint: (position, velocity)}, targets of all servos."""
        return {joint: tuple(self.acting.targets[number].tolist()) for joint, number in self._layout.servos.items()}

    @property
    def motions_by_joint(self):
        """{joint: motion (7,)} of the driven joints with a commanded motion that acts."""
        commands = (entry.command for entry in self.schedule.acting)
        return {command.name: command.values for command in commands if command.kind == MOTION}

    def clear_wrenches(self, source: str = "api") -> None:
        """End all wrenches, pulls and efforts of a source, also those that start later."""
        if source in self.schedule.sources:
            now = self._engine.now
            self._insert(Command(CLEAR, "", (), None, None, source), now, AFTER, *self._marks(now, AFTER))

    def drain_applied(self) -> list[Command]:
        """Return the inputs since the last call: commands, and new targets and motions where they start.

        If `command.repeat(simulation)` gives them to another simulation of the same scene, the run is bit-identical
        (test/core/test_wrenches.py).
        """
        found, self.log = self.log or [], []
        return found

    def update(self, instant):
        """Set the totals that act from an Instant on."""
        if not instant < self.schedule.next:
            self.apply(instant, self.schedule.update(instant))

    def apply(self, instant, changed):
        """Let the totals [(number, axes)] of the schedule act from an Instant on."""
        self._note_ends()
        self.changes += len(changed)
        commanded = self.motions_by_joint if self._drives and changed else {}
        for number, axes in changed:
            total = self.schedule.total[axes][number]
            if axes == SERVO:
                self.acting.targets[number] = total
            elif axes == DRIVE:
                self.acting.motions[number] = total
            else:
                set_wrench(self.acting.external, number, total.tolist(), axes)
                continue
            if self.log is not None and (axes == SERVO or self._drives[number] in commanded):
                kind, names = (TARGET, self._servos) if axes == SERVO else (MOTION, self._drives)
                values = tuple(total.tolist())
                self.log.append(Command(kind, names[number], values, self._grid.mark(instant)))


def _points(move):
    """Arguments of `command_motion` for the joint of a move."""
    position, velocity, seconds = move.values
    return [seconds], None if math.isnan(position) else [position], [velocity]


def _exact_or_float(seconds):
    return seconds if type(seconds) is Fraction else float(seconds)


def _check_source(source):
    if not isinstance(source, str):
        raise ValueError(f"source must be a name, {got(source)}")
