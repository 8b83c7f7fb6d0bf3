# SPDX-License-Identifier: Apache-2.0
"""Constant wrench on a body, in body or world axes, from one time to another.

Whether a row acts does not change within a step: the step is split where one starts or ends
(timetable.py).
"""

import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, tmatvec3, vector3

ROW = np.dtype(
    [
        ("body", "i8"),
        ("world_axes", "i8"),  # world_axes: 1, body axes: 0
        ("torque", "f8", (3,)),
        ("force", "f8", (3,)),  # N m, N
        ("point", "f8", (3,)),  # m, in the frame of the body
        ("start", "f8"),
        ("end", "f8"),  # s; end may be infinite
    ],
    align=True,
)


def make_row(wrench, index, ends):
    """Row of a ConstantWrench of a scene; see kinds.make_forces."""
    return (
        index[wrench.body],
        wrench.axes == "world",
        wrench.torque,
        wrench.force,
        wrench.point,
        wrench.start,
        math.inf if wrench.end is None else wrench.end,
    )


@kernel
def _in_body(row, pose):
    """Torque about the centre of mass, and force; body axes."""
    torque = vector3(row["torque"])
    force = vector3(row["force"])
    if row["world_axes"] == 1:
        rot = load9(pose, row["body"], 0)
        torque = tmatvec3(rot, torque)
        force = tmatvec3(rot, force)
    return add3(torque, cross3(vector3(row["point"]), force)), force


@kernel
def add_wrench(rows, acting, pose, wrench_out):
    """Add the wrenches of the rows that act; acting (k,) bool."""
    for e in range(len(rows)):
        if acting[e]:
            body = rows[e]["body"]
            torque, force = _in_body(rows[e], pose)
            for c in range(3):
                wrench_out[body, c] += torque[c]
                wrench_out[body, 3 + c] += force[c]


@kernel
def power(rows, acting, pose, twist):
    """Power that the rows that act put in, W."""
    total = 0.0
    for e in range(len(rows)):
        if acting[e]:
            body = rows[e]["body"]
            torque, force = _in_body(rows[e], pose)
            total += dot3(torque, load3(twist, body, 0)) + dot3(force, load3(twist, body, 3))
    return total
