# SPDX-License-Identifier: Apache-2.0
"""Servo about the z axis of a joint: a drive with a target angle and a target rate.

    torque on the child  k (theta_target - theta) + c (thetadot_target - thetadot), within +- limit
The angle theta is unwrapped (turn.py). The targets come from the scene or from commands.
Commands are constant between two instants of the schedule.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Number, Positive

from . import turn
from .turn import TurnForce

LAW = [
    ("stiffness", "f8"),
    ("damping", "f8"),
    ("limit", "f8"),  # N m/rad, N m s/rad, N m; or N/m, N s/m, N
    ("position", "f8"),
    ("velocity", "f8"),  # targets without a command: rad, rad/s; or m, m/s
]
ROW = np.dtype(turn.FIELDS + LAW, align=True)


class Servo(TurnForce):
    """Servo about the z axis of a joint."""

    type: Literal["servo"] = Field("servo", description="servo")
    stiffness: NotNegative = Field(description="position gain in N m/rad, not negative")
    damping: NotNegative = Field(0.0, description="velocity gain in N m s/rad, not negative")
    effort_limit: Positive | None = Field(None, description="largest torque in N m, greater than 0; default: no limit")
    position: Number = Field(0.0, description="target angle in rad until a command; may exceed 2 pi")
    velocity: Number = Field(0.0, description="target velocity in rad/s until a command")


def law(servo):
    """Values of LAW."""
    limit = math.inf if servo.effort_limit is None else servo.effort_limit
    return servo.stiffness, servo.damping, limit, servo.position, servo.velocity


def make_row(servo, index, ends):
    """Record of a Servo; arguments as in kinds.make_forces."""
    return *turn.fields(*ends[servo.joint]), *law(servo)


@kernel
def limited(row, position_error, velocity_error):
    """Effort of a servo, within its limit."""
    effort = row["stiffness"] * position_error + row["damping"] * velocity_error
    return min(max(effort, -row["limit"]), row["limit"])


@kernel
def gains(row, effort, position, velocity):
    """Present gains of a servo, and the change of its effort with its targets; zeros at its limit."""
    if abs(effort) >= row["limit"]:
        return 0.0, 0.0, 0.0
    return row["stiffness"], row["damping"], row["stiffness"] * position + row["damping"] * velocity


@kernel
def _effort(row, near, position, velocity, pose, twist, n):
    return limited(row, position - turn.angle(row, pose, near), velocity - turn.rate(row, pose, twist, n))


@kernel
def add_wrench(rows, angle, targets, pose, twist, wrench_out):
    """Add the torques of all rows.

    angle  : all unwrapped angles after the last step, rad; the last ones are those of these rows
    targets : (k, 2) target position and velocity of all servos; the first ones are those of these rows
    """
    first = len(angle) - len(rows)
    for e in range(len(rows)):
        n = turn.axis(rows[e], pose)
        torque = _effort(rows[e], angle[first + e], targets[e, 0], targets[e, 1], pose, twist, n)
        turn.apply(rows[e], pose, n, torque, wrench_out)


@kernel
def efforts(rows, angle, targets, pose, twist, out):
    """Write torques and joint velocities to out (k, 2)."""
    first = len(angle) - len(rows)
    for e in range(len(rows)):
        n = turn.axis(rows[e], pose)
        out[e, 0] = _effort(rows[e], angle[first + e], targets[e, 0], targets[e, 1], pose, twist, n)
        out[e, 1] = turn.rate(rows[e], pose, twist, n)


@kernel
def power(rows, angle, targets, pose, twist):
    """Power sum torque * thetadot of the servos, W; arguments as for `add_wrench`."""
    total, first = 0.0, len(angle) - len(rows)
    for e in range(len(rows)):
        n = turn.axis(rows[e], pose)
        torque = _effort(rows[e], angle[first + e], targets[e, 0], targets[e, 1], pose, twist, n)
        total += torque * turn.rate(rows[e], pose, twist, n)
    return total


@kernel
def add_change(rows, angle, targets, pose, twist, moves, rates, shifts, at, wrench_out):
    """Add the changes of the torques along displacements, see changes.py.

    shifts : changes of the targets of all servos, from row `at` on
    """
    first = len(angle) - len(rows)
    for e in range(len(rows)):
        row = rows[e]
        n = turn.axis(row, pose)
        torque = _effort(row, angle[first + e], targets[e, 0], targets[e, 1], pose, twist, n)
        k, c, given = gains(row, torque, shifts[at + e, 0], shifts[at + e, 1])
        turn.add_change(row, pose, twist, moves, rates, n, torque, k, c, given, wrench_out)
