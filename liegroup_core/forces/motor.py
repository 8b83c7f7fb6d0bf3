# SPDX-License-Identifier: Apache-2.0
"""Motor about the z axis of a joint: torque tau - |tau| thetadot / limit, or tau without a limit.

This is the characteristic of a DC motor at constant voltage: tau at rest, zero at the rate limit in
the direction of tau. It holds at every rate: above the limit the motor brakes, and for rates opposite to
tau the torque exceeds tau. The torque is smooth, so that methods keep their order.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import Number, Positive

from . import turn
from .turn import TurnForce

ROW = np.dtype(
    turn.FIELDS
    + [
        ("torque", "f8"),
        ("slope", "f8"),  # N m at rest, N m s/rad
    ],
    align=True,
)


class Motor(TurnForce):
    """Motor about the z axis of a joint."""

    type: Literal["motor"] = Field("motor", description="motor")
    torque: Number = Field(description="stall torque on the child in N m")
    rate_limit: Positive | None = Field(
        None,
        description="no-load speed in rad/s, greater than 0, at which the torque has fallen linearly to "
        "zero; default: constant torque",
    )


def make_row(motor, index, ends):
    """Record of a Motor; arguments as in kinds.make_forces."""
    slope = 0.0 if motor.rate_limit is None else abs(motor.torque) / motor.rate_limit
    return *turn.fields(*ends[motor.joint]), motor.torque, slope


@kernel
def effort(row, pose, twist, n):
    """Torque on the child, N m; n: see turn.axis."""
    return row["torque"] - row["slope"] * turn.rate(row, pose, twist, n)


@kernel
def add_wrench(rows, pose, twist, wrench_out):
    """Add the torques of all rows."""
    for e in range(len(rows)):
        n = turn.axis(rows[e], pose)
        turn.apply(rows[e], pose, n, effort(rows[e], pose, twist, n), wrench_out)


@kernel
def power(rows, pose, twist):
    """Power sum torque * thetadot of the motors, W."""
    total = 0.0
    for e in range(len(rows)):
        row = rows[e]
        rate = turn.rate(row, pose, twist, turn.axis(row, pose))
        total += (row["torque"] - row["slope"] * rate) * rate
    return total


@kernel
def add_change(rows, pose, twist, moves, rates, wrench_out):
    """Add the changes of the torques along displacements, see changes.py."""
    for e in range(len(rows)):
        row = rows[e]
        n = turn.axis(row, pose)
        torque = effort(row, pose, twist, n)
        turn.add_change(row, pose, twist, moves, rates, n, torque, 0.0, row["slope"], 0.0, wrench_out)
