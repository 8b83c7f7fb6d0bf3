# SPDX-License-Identifier: Apache-2.0
"""Constant wrench on a body, in body or world axes, between a start and an end time.

A row acts over a whole integration step or not at all: steps are split where a wrench starts or
ends (timetable.py).
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from liegroup_core.compiling import kernel
from liegroup_core.errors import SceneError
from liegroup_core.fields.values import NotNegative, Positive, Text, Vector3
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, tmatvec3, vector3

from .described import Force

ROW = np.dtype(
    [
        ("body", "i8"),
        ("world_axes", "i8"),  # 1: world axes, 0: body axes
        ("torque", "f8", (3,)),
        ("force", "f8", (3,)),  # N m, N
        ("point", "f8", (3,)),  # m, in the frame of the body
        ("start", "f8"),
        ("end", "f8"),  # s; end may be infinite
    ],
    align=True,
)


class ConstantWrench(Force):
    """Constant torque and force on a body, between a start and an end time."""

    type: Literal["applied_wrench"] = Field("applied_wrench", description="applied_wrench")
    body: Text = Field(description="name of a body")
    torque: Vector3 = Field((0.0, 0.0, 0.0), description="torque in N m")
    force: Vector3 = Field((0.0, 0.0, 0.0), description="force in N")
    point: Vector3 = Field((0.0, 0.0, 0.0), description="point of application in m, in the body frame")
    axes: Literal["body", "world"] = Field(
        "body", description="axes in which torque and force are constant: body or world"
    )
    start: NotNegative = Field(0.0, description="start time in s, not negative")
    end: Positive | None = Field(None, description="end time in s, after start; default: no end")

    @model_validator(mode="after")
    def _check(self):
        if self.end is not None and self.end <= self.start:
            raise SceneError(
                f"end {self.end:g} must be later than start {self.start:g}: give a later end or omit it", place=("end",)
            )
        return self


def make_row(wrench, index, ends):
    """Record of a ConstantWrench; arguments as in kinds.make_forces."""
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
    """Power of the rows that act, W."""
    total = 0.0
    for e in range(len(rows)):
        if acting[e]:
            body = rows[e]["body"]
            torque, force = _in_body(rows[e], pose)
            total += dot3(torque, load3(twist, body, 0)) + dot3(force, load3(twist, body, 3))
    return total


@kernel
def add_change(rows, acting, pose, moves, wrench_out):
    """Add the changes of the wrenches in world axes along displacements, see changes.py."""
    for e in range(len(rows)):
        row = rows[e]
        if acting[e] and row["world_axes"] == 1:
            body = row["body"]
            rot, turn = load9(pose, body, 0), load3(moves, body, 0)
            torque = cross3(tmatvec3(rot, vector3(row["torque"])), turn)
            force = cross3(tmatvec3(rot, vector3(row["force"])), turn)
            torque = add3(torque, cross3(vector3(row["point"]), force))
            for c in range(3):
                wrench_out[body, c] += torque[c]
                wrench_out[body, 3 + c] += force[c]
