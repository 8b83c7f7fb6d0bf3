# SPDX-License-Identifier: Apache-2.0
"""Motor along the z axis of a joint: force f - |f| sdot / limit, or f without a limit.

Same characteristic as in motor.py, with force and speed instead of torque and rate.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import Number, Positive

from . import slide
from .slide import SlideForce

ROW = np.dtype(
    slide.FIELDS
    + [
        ("force", "f8"),
        ("slope", "f8"),  # N at rest, N s/m
    ],
    align=True,
)


class LinearMotor(SlideForce):
    """Motor along the z axis of a joint."""

    type: Literal["linear_motor"] = Field("linear_motor", description="linear_motor")
    force: Number = Field(description="stall force on the child in N")
    speed_limit: Positive | None = Field(
        None,
        description="no-load speed in m/s, greater than 0, at which the force has fallen linearly to zero; "
        "default: constant force",
    )


def make_row(motor, index, ends):
    """Record of a LinearMotor; arguments as in kinds.make_forces."""
    slope = 0.0 if motor.speed_limit is None else abs(motor.force) / motor.speed_limit
    return *slide.fields(*ends[motor.joint]), motor.force, slope


@kernel
def effort(row, pose, twist):
    """Force on the child, N."""
    return row["force"] - row["slope"] * slide.rate(row, pose, twist)


@kernel
def add_wrench(rows, pose, twist, wrench_out):
    """Add the wrenches of all rows."""
    for e in range(len(rows)):
        slide.apply(rows[e], pose, effort(rows[e], pose, twist), wrench_out)


@kernel
def power(rows, pose, twist):
    """Power sum force * sdot of the motors, W."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        rate = slide.rate(row, pose, twist)
        total += (row["force"] - row["slope"] * rate) * rate
    return total


@kernel
def add_change(rows, pose, twist, moves, rates, wrench_out):
    """Add the changes of the wrenches along displacements, see changes.py."""
    for e in range(len(rows)):
        row = rows[e]
        slide.add_change(row, pose, twist, moves, rates, effort(row, pose, twist), 0.0, row["slope"], 0.0, wrench_out)
