# SPDX-License-Identifier: Apache-2.0
"""Trajectories of joints: decoding and validation of whole JointTrajectory messages before they start.

Names are those of ~/joint_states; every joint must be driven, or have a servo with a stiffness. A trajectory
starts at its stamp if that is in the future, with a zero stamp now.
"""

import math

from liegroup_sim_ros.messages.commands import decode_trajectory
from liegroup_sim_ros.numbers import counted

from .counted_input import bounded
from .joint_input import OF_JOINTS, JointInput
from .trajectory import Waypoints

REASONS = (
    *OF_JOINTS,
    "no_points",
    "wrong_times",
    "moving_at_end",
    "jump_too_large",
    "beyond_limits",
    "effort",
    "stamp_too_old",
    "stamp_too_far",
    "damaged",
)
QUANTITIES = ("positions", "velocities", "accelerations")


class TrajectoryInput(JointInput):
    """Decoder and counter of trajectories for the joints of a scene; arguments as in JointInput."""

    def __init__(self, layout, present=None):
        super().__init__("joint trajectory", "joint_trajectories", REASONS, layout, present)

    def read(self, payload, now_ns, stamped=True, jumps=None, may_be_empty=False):
        """Waypoints of a serialized JointTrajectory, or None of an empty one that may be so. Raises Refusal.

        now_ns  : current stamp
        stamped : False: the time stamp is ignored
        jumps   : Jumps, or None for no limit
        """
        stamp_ns, names, points = self.decoded(decode_trajectory, payload, self.most_names)
        if may_be_empty and not (names or points):
            return None
        self.check_names(names)
        for name in names:
            if not (self.servos.get(name, False) or name in self.driven):
                self.no_servo(name, "has no servo with a stiffness and is not driven")
        if not (names and points):
            self.refuse("no_points", lambda: "it has no joints or no points")
        for k, point in enumerate(points):
            self._check_point(k, point, len(names))
        times = [point.time_ns for point in points]
        if times[0] < 0 or any(b <= a for a, b in zip(times, times[1:])):
            self.refuse(
                "wrong_times", lambda: "time_from_start must not be negative, and must increase from point to point"
            )
        if any(points[-1].velocity):
            self.refuse("moving_at_end", lambda: "the velocities of its last point must be zero")
        if times[0] == 0 and not self.driven.isdisjoint(names):
            self.refuse("wrong_times", lambda: "the first point of a driven joint must be later than time_from_start 0")
        if jumps is not None:
            self._check_jumps(names, points, jumps)
        if not stamped:
            stamp_ns = 0
        if stamp_ns and stamp_ns + times[-1] < now_ns:
            self.refuse(
                "stamp_too_old",
                lambda: (
                    f"it ends at {(stamp_ns + times[-1]) * 1e-9:.9g} s, before the simulated time "
                    f"{now_ns * 1e-9:.9g} s; use a zero stamp, or simulated time (use_sim_time)"
                ),
            )
        self.refuse_far_stamp(stamp_ns, now_ns, names[0])
        trajectory = Waypoints([self.joints[name] for name in names], points, stamp_ns)
        for k, name in enumerate(names):
            self.refuse_beyond_limits(self._check_limits, trajectory, k, name)
        self.accepted += 1
        return trajectory

    def _check_limits(self, trajectory, k, name):
        """Raise BeyondLimits for a motion of joint number k of a trajectory beyond its limits."""
        joint = trajectory.joints[k]
        times, positions, *rates = trajectory.points_of(joint)
        if name not in self.driven:
            # The simulation thread checks the first segment when it starts, from the state at that time.
            trajectory.check_servo(joint, self.limits[joint])
        if self._present is None:
            return
        if name in self.driven:
            self._present.check_motion(joint, trajectory.stamp_ns, times, positions, *rates)
        elif times[0] == 0.0:
            self._present.check_jump(joint, positions[0])

    def _check_point(self, k, point, count):
        if any(point.effort):
            self.refuse("effort", lambda: f"point {k} has efforts: leave them empty")
        for kind, values in zip(QUANTITIES, point):
            if len(values) != count and (values or kind == "positions"):
                self.refuse(
                    "wrong_length",
                    lambda: (
                        f"{kind} in point {k}: {counted(len(values), 'number')} for "
                        f"{counted(count, 'joint')}; give one per joint" + ("" if kind == "positions" else ", or none")
                    ),
                )
            if not bounded(values):
                self.refuse("not_finite", lambda: f"{kind} of point {k} are not finite or too large")

    def _check_jumps(self, names, points, jumps):
        """Refuse a segment that moves a joint by more than the limit in a period, on average."""
        before = [jumps.positions.get(self.joints[name], math.nan) for name in names]
        since = 0
        for point in points:
            most = jumps.most * max(1.0, 1e-9 * (point.time_ns - since) / jumps.period)
            for name, first, last in zip(names, before, point.position):
                self.refuse_jump(name, first, last, most)
            before, since = point.position, point.time_ns
