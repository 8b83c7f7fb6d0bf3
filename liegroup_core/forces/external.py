# SPDX-License-Identifier: Apache-2.0
"""External wrenches of one instant: a part in body axes and a part in world axes for every body.

Both act at the origin of the body frame. The part in world axes keeps its direction in the world
while the body rotates, also between the stages of a step.

Columns of the array (n, COLUMNS) that the integrators receive:
    0..5    torque N m, force N in body axes, about the centre of mass
    6..11   torque N m, force N in world axes, about the origin of the body frame
    12..14  centre of mass in the body frame, m
    15      1 if any of 6..11 is not zero
"""

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import add3, cross3, load3, load9, sub3, tmatvec3

COLUMNS = 16


def no_wrenches(offsets):
    """Array (n, COLUMNS) without a wrench; offsets: Offsets of the scene."""
    external = np.zeros((len(offsets.com), COLUMNS))
    external[:, 12:15] = offsets.com
    return external


def set_wrench(external, body, wrench, axes):
    """Set the part in "body" or "world" axes of the wrench (6,) on body number `body`."""
    if axes == "world":
        external[body, 6:12] = wrench
        external[body, 15] = np.any(wrench)
    else:
        external[body, :6] = wrench
        if external[body, 12:15].any():  # otherwise the numbers pass unchanged
            external[body, :3] -= np.cross(external[body, 12:15], external[body, 3:6])


@kernel
def external_wrench(external, pose, i):
    """Torque about the centre of mass and force on body i at its pose; body axes."""
    torque, force = load3(external, i, 0), load3(external, i, 3)
    if external[i, 15] != 0.0:
        rot = load9(pose, i, 0)
        turned = tmatvec3(rot, load3(external, i, 9))
        moment = sub3(tmatvec3(rot, load3(external, i, 6)), cross3(load3(external, i, 12), turned))
        torque, force = add3(torque, moment), add3(force, turned)
    return torque, force
