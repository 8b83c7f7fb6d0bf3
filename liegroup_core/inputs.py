# SPDX-License-Identifier: Apache-2.0
"""Inputs of an Engine that act from one time to another: wrenches, efforts, servos, motions."""

from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from liegroup_core.fields.arguments import check_name, finite, floats, got, is_finite
from liegroup_core.forces.external import AXES, PAIRS, no_wrenches, set_wrench
from liegroup_core.forces.kinds import servos, wanted_values
from liegroup_core.forces.schedule import DRIVE, SERVO, AppliedMotion, AppliedTarget, AppliedWrench, WrenchSchedule
from liegroup_core.joints.motion import COLUMNS, at, row_at, through


class Inputs:
    """Commands of an Engine: base class that uses its `layout`, `steps`, `time`, `_grid` and `_work`."""

    def _clear_inputs(self):
        """Clear all commands: servos and driven joints follow the scene."""
        wanted = wanted_values(self.layout.model.forces)
        bodies, drives = len(self.layout.body_names), len(self.layout.motions)
        self._schedule = WrenchSchedule(bodies, wanted, drives)
        self._commanded = self._schedule.total[DRIVE].copy()
        self._work.wanted[:] = wanted
        self._external = no_wrenches(self.layout.offsets)
        self._applied = []

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
        start    : simulated time, s; None or a past time: the next step. A Fraction is exact: floats
                   resolve whole ns up to 4e6 s
        duration : s; None: until it is replaced. Start and end are rounded to whole ns, as stamps of ROS
                   and of recordings are; `drain_applied` returns them
        source   : each source has one wrench per body; wrenches of different sources add
        axes     : of the components: "body", or "world". A wrench in world axes keeps its direction
                   in the world while the body rotates. The axes of a drained AppliedWrench are valid, too
        point    : (3,) m, in the body frame: the force acts there, and the point turns with the body.
                   None: the origin of the body frame
        A step in which a wrench starts or ends is split at that time, so that methods keep their
        order (test/verification/test_pushes.py).
        Raises ValueError for an unknown body, a wrong shape, or a number that is not finite.
        """
        if axes in PAIRS and point is not None:
            raise ValueError(f"axes {axes!r} already define a point: omit point, got {point!r}")
        if axes not in AXES:
            raise ValueError(f"axes must be 'body' or 'world', got {axes!r}")
        check_name(body, self._body, "unknown body {}")
        wrench = finite("a wrench must be six finite numbers (torque, force)", wrench, (6,))
        if point is not None:
            point = finite("a point must be three finite numbers", point, (3,))
            with np.errstate(over="ignore"):
                moments = np.outer(point, wrench[3:])
            finite("point times force must be finite numbers", moments, (3, 3))
        _check_source(source)
        begin, end = self._interval(start, duration)
        self._schedule.command(source, self._body[body], wrench, begin, end, axes, point)

    def apply_effort(
        self,
        joint: str,
        effort: float,
        start: float | Fraction | None = None,
        duration: float | None = None,
        source: str = "api",
    ) -> None:
        """Apply an effort to a joint with one coordinate, from one time to another.

        joint  : name of a revolute or prismatic joint
        effort : torque about its z axis in N m, or force along it in N, on the child; the opposite
                 acts on the parent. Zero ends it
        start, duration, source : as in `apply_wrench`; each source has one effort per joint
        The total wrenches of `drain_applied` contain the efforts.
        Raises ValueError for an unknown joint, a joint without exactly one coordinate, or a number
        that is not finite, and BeyondLimits, a ValueError, for an effort beyond that of the joint
        (joints/limits.py).
        """
        units = self.layout.unit_efforts
        check_name(joint, units, "joint {} is not a joint with one coordinate")
        if not is_finite(effort):
            raise ValueError(f"an effort must be a finite number, {got(effort)}")
        _check_source(source)
        self.layout.limits[joint].check_effort(effort)
        begin, end = self._interval(start, duration)
        self._schedule.command_effort(source, joint, float(effort), units[joint], begin, end)

    def command_servo(
        self,
        joint: str,
        position: float,
        velocity: float = 0.0,
        start: float | Fraction | None = None,
        duration: float | None = None,
    ) -> None:
        """Command the wanted position and velocity of the servo of a joint.

        joint    : name of a joint with a servo or linear_servo
        position : rad, which may exceed 2 pi, or m
        velocity : rad/s or m/s
        start, duration : as in `apply_wrench`; after its end the values of the scene hold
        Raises ValueError for a joint without a servo, or a number that is not finite, and BeyondLimits,
        a ValueError, for a position or velocity beyond the limits of the joint, or a position to which
        it cannot jump (joints/limits.py). A servo without stiffness has no wanted position.
        """
        self._servo(joint)
        for name, value in (("position", position), ("velocity", velocity)):
            if not is_finite(value):
                raise ValueError(f"a wanted {name} must be a finite number, {got(value)}")
        self.check_jump(joint, position)
        self.layout.limits[joint].check_velocity(velocity)
        self.set_servo_target(joint, position, velocity, start, duration)

    def set_servo_target(
        self,
        joint: str,
        position: float,
        velocity: float,
        start: float | Fraction | None = None,
        duration: float | None = None,
    ) -> None:
        """As `command_servo`, without checks: to repeat a run with values that were checked before."""
        begin, end = self._interval(start, duration)
        self._schedule.command_servo(self._servo(joint), float(position), float(velocity), begin, end)

    def _servo(self, joint):
        """Number of the servo of a joint. Raises ValueError for a joint without one."""
        check_name(joint, self.layout.servos, "joint {} has no servo")
        return self.layout.servos[joint]

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
            self._schedule.command_motion(self._drive(joint), row, instant)

    def check_motion(self, joint, times, positions, velocities=None, accelerations=None, start=None):
        """Raise the errors of `command_motion` without commanding anything."""
        self._planned(joint, times, positions, velocities, accelerations, start)

    def _planned(self, joint, times, positions, velocities, accelerations, start):
        """[(Instant, motion (7,))] of a commanded motion. Raises ValueError."""
        number = self._drive(joint)
        begin, _ = self._interval(start, None)
        after = np.atleast_1d(floats("times must be finite numbers", times))
        finite(f"times must be {len(after)} finite numbers", after, (len(after),))
        points = [
            part
            if part is None
            else finite(f"{name} must be {len(after)} finite numbers", np.atleast_1d(part), after.shape)
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
        motion = self._schedule.motion_at(number, begin)
        if not np.isfinite(motion[0]):
            motion = row_at(self.layout.motions[joint], begin.time)
        with np.errstate(over="ignore", invalid="ignore"):
            rows = through(at(motion, begin.time), origins, *points)
            self.layout.limits[joint].check_motion(rows, *points[:2])
        return list(zip(instants, rows))

    def prescribe(self, joint: str, motion: ArrayLike, start: float | Fraction | None = None) -> None:
        """Command a motion (7,) of a driven joint without checks of limits: see AppliedMotion.

        Raises ValueError for a joint that is not driven, or an invalid motion.
        """
        row = finite(f"a motion must be {COLUMNS} finite numbers", motion, (COLUMNS,))
        begin, _ = self._interval(start, None)
        self._schedule.command_motion(self._drive(joint), row, begin)

    def check_jump(self, joint, position):
        """Raise BeyondLimits for a wanted position to which the servo of a joint cannot jump now."""
        number = self._servo(joint)
        if servos(self.scene.forces)[number].stiffness > 0.0:
            before = float(self._work.wanted[number, 0])
            self.layout.limits[joint].check_jump(before, position)

    def _drive(self, joint):
        """Number of a driven joint. Raises ValueError for a joint that is not driven."""
        names = tuple(self.layout.motions)
        check_name(joint, names, "joint {} is not driven")
        return names.index(joint)

    def _interval(self, start, duration):
        """Instants at which a command starts and ends (None: never). Raises ValueError."""
        for name, value in (("start", start), ("duration", duration)):
            if value is not None and not is_finite(value):
                raise ValueError(f"{name} must be finite, or None, {got(value)}")
        begin, end = self._grid.boundary(self.steps), None
        if start is not None:
            begin = max(begin, self._grid.instant(_exact_or_float(start)))
        if duration is not None:
            if not duration > 0.0:
                raise ValueError(f"a duration must be positive, got {duration!r}")
            end = self._grid.after(begin, _exact_or_float(duration))
            if end <= begin:
                raise ValueError(f"a duration must be at least 1 ns, got {duration!r} s")
        return begin, end

    @property
    def commanded_motions(self) -> tuple[str, ...]:
        """Driven joints with a commanded motion, which acts or starts later."""
        names = enumerate(self.layout.motions)
        return tuple(name for number, name in names if self._schedule.motions_of(number))

    @property
    def input_count(self) -> int:
        """Number of wrenches, and of commands of joints, that act now or start later."""
        return len(self._schedule)

    @property
    def wrench_sources(self):
        """Names of the sources of wrenches and efforts that act now or start later."""
        return self._schedule.sources

    def clear_wrenches(self, source: str = "api") -> None:
        """End all wrenches and efforts of a source, also those that start later."""
        self._schedule.clear(source)

    def drain_applied(self) -> list[AppliedWrench | AppliedTarget | AppliedMotion]:
        """Return the changes of total wrenches, of servos and of motions since the last call.

        There is one total in body axes, one in world axes, and three pairs of forces if forces in world
        axes act at points; see AppliedWrench. If `change.repeat(simulation)`
        applies the changes again, the run is bit-identical (test/core/test_wrenches.py).
        """
        applied, self._applied = self._applied, []
        return applied

    def acting(self):
        """[AppliedWrench, AppliedTarget or AppliedMotion] of the inputs that act from now on."""
        now = self._grid.boundary(self.steps)
        return [self._applied_at(now, *key) for key in self._acting_numbers()]

    def _acting_numbers(self):
        """[(number, axes)] of the nonzero total wrenches, all servos, and commanded motions."""
        acting = {
            (int(i), axes)
            for axes in (AXES if self._schedule else ())
            for i in np.flatnonzero(self._schedule.total[axes].any(axis=1))
        }
        commanded = np.isfinite(self._schedule.total[DRIVE][:, 0])
        acting |= {(int(i), DRIVE) for i in np.flatnonzero(commanded)}
        return sorted(acting | {(i, SERVO) for i in self.layout.servos.values()})

    def acting_now(self):
        """[[body or joint, axes, *wrench]] of the acting inputs, JSON types; see Layout.names_of_inputs."""
        names = self.layout.names_of_inputs
        return [
            [names[axes][number], axes, *self._schedule.total[axes][number].tolist()]
            for number, axes in self._acting_numbers()
        ]

    def remember_acting(self, acting):
        """Restore the acting inputs that `acting_now` returned.

        They act until replaced, by a wrench whose source is the name of its axes, or by wanted values of
        the servo. Raises ValueError, KeyError, TypeError for an invalid list.
        """
        names = self.layout.names_of_inputs
        for name, axes, *wrench in acting:
            total = self._schedule.total[axes]
            if len(wrench) != total.shape[1] or not np.isfinite(wrench).all():
                raise ValueError(f"not a wrench: {axes!r:.20}, {wrench!r:.60}")
            number = names[axes].index(name)
            self._schedule.act(number, wrench, axes)
            self._set_input(number, wrench, axes)

    def _set_input(self, number, total, axes):
        """Set a total wrench, wanted values or a motion for the next steps."""
        if axes == SERVO:
            self._work.wanted[number] = total
        elif axes == DRIVE:
            self._commanded[number] = total
        else:
            set_wrench(self._external, number, total, axes)

    def _change_wrenches(self, instant, changed):
        """Apply the total wrenches, or wanted values, of [(body, axes)] from an Instant on."""
        for body, axes in changed:
            total = self._schedule.total[axes][body]
            self._set_input(body, total, axes)
            self._applied.append(self._applied_at(instant, body, axes))

    def _applied_at(self, instant, body, axes):
        """AppliedWrench, AppliedTarget or AppliedMotion of a total at an Instant."""
        time, time_ns = instant.time, self._grid.time_ns(instant)
        total = self._schedule.total[axes][body].tolist()
        name = self.layout.names_of_inputs[axes][body]
        if axes == SERVO:
            return AppliedTarget(time, time_ns, name, *total)
        if axes == DRIVE:
            return AppliedMotion(time, time_ns, name, tuple(total))
        return AppliedWrench(time, time_ns, name, tuple(total), axes)

    def _instants_inside(self):
        """Instants inside the next step at which a wrench may start or end."""
        instants = self._timetable.inside(self.steps)
        return {*instants, *self._schedule.inside(self.steps)} if self._schedule else instants


def _exact_or_float(seconds):
    return seconds if type(seconds) is Fraction else float(seconds)


def _check_source(source):
    if not isinstance(source, str):
        raise ValueError(f"source must be a name, {got(source)}")
