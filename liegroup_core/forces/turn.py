# SPDX-License-Identifier: Apache-2.0
"""Rotation of a joint about its z axis: angle, rate, and a torque about it.

With R the rotation of the child's joint frame in the parent's and z_a, z_b the z axes of both,
    angle   theta = atan2(R10 - R01, R00 + R11)              twist angle of the swing-twist decomposition
    rate    thetadot = n . (omega_b - omega_a) ,   n = (z_a + z_b) / (1 + z_a . z_b)
If the z axes coincide, n is the axis. If they drift apart, theta is still defined and n is still
its gradient: a torque tau n on the child and -tau n on the parent does exactly the work tau dtheta
(test/contract/test_forces.py).

A rotation matrix gives the angle modulo 2 pi. The angle is unwrapped: it is the value nearest to that
of the last step. This is exact if the joint rotates by less than pi per step.
"""

import math
from typing import ClassVar

from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import Text
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.vec3 import add3, axpy3, cross3, dot3, load3, load9, matmul3, matrix3, scale3, sub3, tmatmul3

from .changes import angular_velocity, apply_change_of_torque, change_of_angular_velocity, stay, turning
from .described import Force
from .points import apply_torque, world_axes


class TurnForce(Force):
    """Force about the z axis of a joint."""

    joint_moves: ClassVar = "turns"
    joint: Text = Field(description="name of a joint that rotates about its z axis")


FIELDS = [
    ("parent", "i8"),
    ("child", "i8"),  # body index or WORLD
    ("parent_axes", "f8", (9,)),
    ("child_axes", "f8", (9,)),  # rotation from joint frame to body frame, of parent and child
]


def fields(parent, child, parent_frame, child_frame):
    """Values of FIELDS from body indices and joint frames (4, 4)."""
    return parent, child, parent_frame[:3, :3].ravel(), child_frame[:3, :3].ravel()


@kernel
def _frame_axes(pose, body, axes):
    """Axes of a joint frame in the world: a rotation matrix."""
    if body == WORLD:
        return axes
    return matmul3(load9(pose, body, 0), axes)


@kernel
def unwrapped(value, near):
    """The angle that differs from `value` by whole turns and is nearest to `near`, rad."""
    return value + 2.0 * math.pi * math.floor((near - value) / (2.0 * math.pi) + 0.5)


@kernel
def angle(row, pose, near):
    """Angle of the child's joint frame about z, rad: the value modulo 2 pi nearest to `near`."""
    relative = tmatmul3(
        _frame_axes(pose, row["parent"], matrix3(row["parent_axes"])),
        _frame_axes(pose, row["child"], matrix3(row["child_axes"])),
    )
    within_a_turn = math.atan2(relative[3] - relative[1], relative[0] + relative[4])
    return unwrapped(within_a_turn, near)


@kernel
def axis(row, pose):
    """Gradient n of the angle, world axes."""
    parent_axes = row["parent_axes"]
    child_axes = row["child_axes"]
    z_a = world_axes(pose, row["parent"], (parent_axes[2], parent_axes[5], parent_axes[8]))
    z_b = world_axes(pose, row["child"], (child_axes[2], child_axes[5], child_axes[8]))
    both = 1.0 + dot3(z_a, z_b)
    # The angle is undefined for opposite axes, but the joint does not allow such a pose.
    return scale3(1.0 / both if both > 0.0 else 0.0, add3(z_a, z_b))


@kernel
def rate(row, pose, twist, n):
    """Rate of the angle, rad/s; n: see `axis`."""
    turning = world_axes(pose, row["child"], load3(twist, row["child"], 0))
    if row["parent"] != WORLD:
        turning = sub3(turning, world_axes(pose, row["parent"], load3(twist, row["parent"], 0)))
    return dot3(n, turning)


@kernel
def apply(row, pose, n, torque, wrench_out):
    """Add torque * n to the child's wrench and subtract it from the parent's."""
    apply_torque(pose, row["child"], scale3(torque, n), wrench_out)
    apply_torque(pose, row["parent"], scale3(-torque, n), wrench_out)


@kernel
def add_change(row, pose, twist, moves, rates, n, torque, stiffness, damping, given, wrench_out):
    """Add the change of `apply` along displacements, see changes.py.

    stiffness, damping : minus the derivatives of the torque by angle and rate; given : its change by other causes
    """
    a, b, u, v = row["parent"], row["child"], row["parent_axes"], row["child_axes"]
    if given == 0.0 and stay(moves, rates, a, b):
        return
    z_a, z_b = world_axes(pose, a, (u[2], u[5], u[8])), world_axes(pose, b, (v[2], v[5], v[8]))
    turn_a, turn_b = turning(pose, moves, a), turning(pose, moves, b)
    d_a, d_b = cross3(turn_a, z_a), cross3(turn_b, z_b)
    both = 1.0 + dot3(z_a, z_b)
    inverse = 1.0 / both if both > 0.0 else 0.0
    dn = scale3(inverse, axpy3(-(dot3(d_a, z_b) + dot3(z_a, d_b)), n, add3(d_a, d_b)))
    speed = sub3(angular_velocity(pose, twist, b), angular_velocity(pose, twist, a))
    faster = sub3(
        change_of_angular_velocity(pose, twist, moves, rates, b),
        change_of_angular_velocity(pose, twist, moves, rates, a),
    )
    turned, rate = dot3(n, sub3(turn_b, turn_a)), dot3(dn, speed) + dot3(n, faster)
    vector, change = scale3(torque, n), given - stiffness * turned - damping * rate
    moved = axpy3(change, n, scale3(torque, dn))
    apply_change_of_torque(pose, moves, b, vector, moved, wrench_out)
    apply_change_of_torque(pose, moves, a, scale3(-1.0, vector), scale3(-1.0, moved), wrench_out)


@kernel
def count_turns(rows, pose, angles, first):
    """Unwrap the angles of rows at a pose; they are in `angles` from entry `first` on.

    Each angle must have changed by less than pi since the last call.
    """
    for e in range(len(rows)):
        angles[first + e] = angle(rows[e], pose, angles[first + e])


@kernel
def too_fast(rows, h, pose, twist):
    """First row whose joint rotates by pi or more in a time h, or -1."""
    for e in range(len(rows)):
        row = rows[e]
        if abs(h * rate(row, pose, twist, axis(row, pose))) >= math.pi:
            return e
    return -1
