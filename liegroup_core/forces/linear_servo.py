# SPDX-License-Identifier: Apache-2.0
"""Servo along the z axis of a joint.

Same control law as in servo.py, with position and force instead of angle and torque.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import NotNegative, Number, Positive

from . import slide
from .servo import LAW, gains, law, limited
from .slide import SlideForce

ROW = np.dtype(slide.FIELDS + LAW, align=True)


class LinearServo(SlideForce):
    """Servo along the z axis of a joint."""

    type: Literal["linear_servo"] = Field("linear_servo", description="linear_servo")
    stiffness: NotNegative = Field(description="position gain in N/m, not negative")
    damping: NotNegative = Field(0.0, description="velocity gain in N s/m, not negative")
    effort_limit: Positive | None = Field(None, description="largest force in N, greater than 0; default: no limit")
    position: Number = Field(0.0, description="target position in m until a command")
    velocity: Number = Field(0.0, description="target velocity in m/s until a command")


def make_row(servo, index, ends):
    """Record of a LinearServo; arguments as in kinds.make_forces."""
    return *slide.fields(*ends[servo.joint]), *law(servo)


@kernel
def _effort(row, position, velocity, pose, twist):
    return limited(row, position - slide.coordinate(row, pose), velocity - slide.rate(row, pose, twist))


@kernel
def add_wrench(rows, targets, pose, twist, wrench_out):
    """Add the wrenches of all rows; targets : (k, 2) targets of all servos, the last ones are of these rows."""
    first = len(targets) - len(rows)
    for e in range(len(rows)):
        force = _effort(rows[e], targets[first + e, 0], targets[first + e, 1], pose, twist)
        slide.apply(rows[e], pose, force, wrench_out)


@kernel
def efforts(rows, targets, pose, twist, out):
    """Write forces and joint velocities to the last rows of out (k, 2)."""
    first = len(targets) - len(rows)
    for e in range(len(rows)):
        row = rows[e]
        out[first + e, 0] = _effort(row, targets[first + e, 0], targets[first + e, 1], pose, twist)
        out[first + e, 1] = slide.rate(row, pose, twist)


@kernel
def power(rows, targets, pose, twist):
    """Power sum force * sdot of the servos, W; targets as for `add_wrench`."""
    total, first = 0.0, len(targets) - len(rows)
    for e in range(len(rows)):
        force = _effort(rows[e], targets[first + e, 0], targets[first + e, 1], pose, twist)
        total += force * slide.rate(rows[e], pose, twist)
    return total


@kernel
def add_change(rows, targets, pose, twist, moves, rates, shifts, at, wrench_out):
    """Add the changes of the wrenches along displacements, see changes.py.

    shifts : changes of the targets of all servos, from row `at` on; the last ones are of these rows
    """
    first = len(targets) - len(rows)
    for e in range(len(rows)):
        row, own = rows[e], at + first + e
        force = _effort(row, targets[first + e, 0], targets[first + e, 1], pose, twist)
        k, c, given = gains(row, force, shifts[own, 0], shifts[own, 1])
        slide.add_change(row, pose, twist, moves, rates, force, k, c, given, wrench_out)
