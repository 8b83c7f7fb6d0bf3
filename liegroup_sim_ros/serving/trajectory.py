# SPDX-License-Identifier: Apache-2.0
"""Trajectories of joints: interpolation, and the commands to their servos.

Between two points the interpolation is that of ros2_control's joint_trajectory_controller:

    both have positions only              linear
    and velocities                        cubic
    and velocities and accelerations      quintic

The first segment begins with positions and velocities of the joints when the trajectory starts. After
the last point its positions are held. Motions of driven joints are twice continuously differentiable,
see liegroup_core/joints/motion.py.
"""

import copy
import logging
import math

from liegroup_core.joints.motion import COLUMNS, uniform

log = logging.getLogger("liegroup_core")

# Attributes that form the state of a Follower: trajectories, start time and progress.
STATE = ("_active", "_waiting", "_start", "_sent", "_ends")


class Waypoints:
    """Points through which joints move together.

    joints   : names in the scene
    points   : [messages.commands.Point], their times increase
    stamp_ns : simulated time at which it starts; 0: at once
    """

    def __init__(self, joints, points, stamp_ns=0):
        self.joints, self.stamp_ns = joints, stamp_ns
        self._times = [1e-9 * point.time_ns for point in points]
        # [(position, velocity or None, acceleration or None)] of each joint
        self._points = [
            [
                (
                    point.position[j],
                    point.velocity[j] if point.velocity else None,
                    point.acceleration[j] if point.acceleration else None,
                )
                for point in points
            ]
            for j in range(len(joints))
        ]
        self._segment = 0

    @property
    def seconds(self):
        """Time from the start to the last point, s."""
        return self._times[-1]

    def points_of(self, joint):
        """(times, positions, velocities or None, accelerations or None) of a joint, s after the start."""
        points = self._points[self.joints.index(joint)]
        positions, velocities, accelerations = map(list, zip(*points))
        if None in velocities:
            return self._times, positions, None, None
        if None in accelerations:
            return self._times, positions, velocities, None
        return self._times, positions, velocities, [*accelerations[:-1], 0.0]  # it comes to rest

    def check_servo(self, joint, limits, state=None):
        """Raise BeyondLimits for targets of a joint's servo beyond its CommandLimits.

        state : (position, velocity) from which it starts; None: check from the first point on
        """
        times, points = self._times, self._points[self.joints.index(joint)]
        _, positions, velocities, _ = self.points_of(joint)
        if state is None:
            state = positions[0], 0.0
        else:
            times, points = [0.0, *times], [(*state, None), *points]
        rows = [
            (time, *coefficients(*ends, after - time), 0.0, 0.0, 0.0, 0.0)[:COLUMNS]
            for time, after, ends in zip(times, times[1:], zip(points, points[1:]))
            if after > time
        ]
        rows.append(uniform(times[-1], positions[-1], 0.0))
        limits.check_motion(rows, positions, velocities, state)

    def begin(self, states):
        """Start from [(position, velocity)] of the joints."""
        self._times.insert(0, 0.0)
        for points, state in zip(self._points, states):
            points.insert(0, (*state, None))

    def at(self, time):
        """[(position, velocity)] of the joints at increasing times in s since the start."""
        while self._segment < len(self._times) - 1 and time >= self._times[self._segment + 1]:
            self._segment += 1
        k = self._segment
        if k == len(self._times) - 1:
            return [(points[-1][0], 0.0) for points in self._points]
        length, since = self._times[k + 1] - self._times[k], time - self._times[k]
        return [between(points[k], points[k + 1], length, since) for points in self._points]


def coefficients(first, last, length):
    """Coefficients, lowest first, of the polynomial between the positions of two points `length` s apart.

    first, last : (position, velocity or None, acceleration or None)
    """
    (p, v, a), (q, w, b) = first, last
    way = q - p
    if v is None or w is None:
        return p, way / length
    if a is None or b is None:
        return (p, v, (3.0 * way - (2.0 * v + w) * length) / length**2, (-2.0 * way + (v + w) * length) / length**3)
    return (
        p,
        v,
        0.5 * a,
        (20.0 * way - (12.0 * v + 8.0 * w) * length - (3.0 * a - b) * length**2) / (2.0 * length**3),
        (-30.0 * way + (16.0 * v + 14.0 * w) * length + (3.0 * a - 2.0 * b) * length**2) / (2.0 * length**4),
        (12.0 * way - 6.0 * (v + w) * length + (b - a) * length**2) / (2.0 * length**5),
    )


def between(first, last, length, time):
    """(position, velocity) at a time in s after the first of two points; see `coefficients`."""
    position = velocity = 0.0
    for coefficient in reversed(coefficients(first, last, length)):
        velocity = velocity * time + position
        position = position * time + coefficient
    return position, velocity


class Follower:
    """Commands servos and driven joints along the latest trajectory; for the simulation thread only.

    simulation : liegroup_core.Simulation
    period     : s of simulated time, during which targets are constant: those at its middle
    stopping   : s of simulated time, in which a driven joint comes to rest
    refuse     : function, called with one line of text if a trajectory cannot be followed when it
                 starts
    """

    refuse = staticmethod(log.warning)

    def __init__(self, simulation, period, stopping):
        self._simulation, self._period, self._stopping = simulation, period, stopping
        self._driven = simulation.layout.motions.keys()
        self.clear()

    def clear(self):
        """Discard all trajectories."""
        self._active = self._waiting = None

    def snapshot(self):
        """Copy of the followed and the waiting trajectory, for `restore`."""
        return copy.deepcopy(self._state)

    def restore(self, snapshot):
        """Continue the trajectories of a snapshot; their times refer to its state."""
        self._state = copy.deepcopy(snapshot)

    @property
    def _state(self):
        return [vars(self).get(name) for name in STATE]

    @_state.setter
    def _state(self, values):
        vars(self).update(zip(STATE, values))

    def follow(self, trajectory, start):
        """Replace the present trajectory, at a time in s: now or later."""
        self._waiting = trajectory, start

    def release(self, joint, time):
        """Stop commanding a joint at a time in s, from which another command applies to it."""
        if self._active is not None and joint in self._active.joints:
            self._ends[joint] = min(time, self._ends.get(joint, math.inf))

    @property
    def is_idle(self):
        """True if there is nothing to follow."""
        return self._active is None and self._waiting is None

    def command(self, until):
        """Command the targets up to a time in s."""
        if self._waiting is not None and self._waiting[1] < until:
            trajectory, start = self._waiting
            coordinates = self._simulation.sample().joint_coordinates
            # States of driven joints are not used.
            states = [coordinates.get(joint, (0.0, 0.0)) for joint in trajectory.joints]
            if not self._can_begin(trajectory, start, states):
                self._waiting = None
                self._feed(until)
                return
            self._feed(start)
            self._stop(start, trajectory.joints)
            for joint in self._driven & set(trajectory.joints):
                self._simulation.command_motion(joint, *trajectory.points_of(joint), start)
            trajectory.begin(states)
            self._active, self._waiting = trajectory, None
            self._start, self._sent, self._ends = start, 0, {}
        self._feed(until)

    def _can_begin(self, trajectory, start, states):
        """Whether all joints can follow from their states; otherwise the trajectory is refused as a whole."""
        limits = self._simulation.layout.limits
        try:
            for joint, state in zip(trajectory.joints, states):
                if joint in self._driven:
                    self._simulation.check_motion(joint, *trajectory.points_of(joint), start)
                else:
                    trajectory.check_servo(joint, limits[joint], state)
        except ValueError as error:
            self.refuse(str(error))
            return False
        return True

    def _stop(self, time, others):
        """End the trajectory at a time in s; its joints that are not in `others` stop there."""
        if self._active is None:
            return
        for joint, (position, _) in zip(self._active.joints, self._active.at(max(0.0, time - self._start))):
            if joint in others or time >= self._ends.get(joint, math.inf):
                continue
            if joint in self._driven:
                self._simulation.command_motion(joint, [self._stopping], None, [0.0], start=time)
            else:
                self._simulation.inputs.set_target(joint, position, 0.0, time)
        self._active = None

    def _feed(self, until):
        while self._active is not None:
            since = self._sent * self._period
            if self._start + min(since, self._active.seconds) >= until:
                return
            ended = since >= self._active.seconds
            time = self._start + (self._active.seconds if ended else since)
            middle = 0.5 * (since + min(since + self._period, self._active.seconds))
            targets = self._active.at(self._active.seconds if ended else middle)
            for joint, target in zip(self._active.joints, targets):
                if joint not in self._driven and time < self._ends.get(joint, math.inf):
                    self._simulation.inputs.set_target(joint, *target, time)
            self._sent += 1
            if ended:
                self._active = None
