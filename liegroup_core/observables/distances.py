# SPDX-License-Identifier: Apache-2.0
"""Distances between two states of a mechanism."""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import cross3, load3, load9, matvec3, sub3, tmatmul3


@kernel
def _norm(v):
    """Norm of a vector without underflow or overflow of its squares."""
    size = max(abs(v[0]), abs(v[1]), abs(v[2]))
    if not 0.0 < size < math.inf:
        return size
    x, y, z = v[0] / size, v[1] / size, v[2] / size
    return size * math.sqrt(x * x + y * y + z * z)


@kernel
def distances(com, pose, twist, other_pose, other_twist, out):
    """Write distances between the body frames of two states to out (n, 4): m, rad, m/s, rad/s; twists in body axes.

    com : (n, 3) m, centres of mass in the body frames; the states are those of frames at these points
    returns the largest distance in m and in rad
    """
    position = angle = 0.0
    for i in range(len(pose)):
        c, mine, other = load3(com, i, 0), load9(pose, i, 0), load9(other_pose, i, 0)
        d = sub3(load3(pose, i, 9), load3(other_pose, i, 9))
        d = sub3(d, sub3(matvec3(mine, c), matvec3(other, c)))
        r = tmatmul3(mine, other)
        sine = 0.5 * (r[7] - r[5]), 0.5 * (r[2] - r[6]), 0.5 * (r[3] - r[1])
        w = sub3(load3(twist, i, 0), load3(other_twist, i, 0))
        v = sub3(load3(twist, i, 3), load3(other_twist, i, 3))
        v = sub3(v, cross3(w, c))
        out[i, 0], out[i, 2], out[i, 3] = _norm(d), _norm(v), _norm(w)
        out[i, 1] = math.atan2(_norm(sine), 0.5 * (r[0] + r[4] + r[8] - 1.0))
        position, angle = max(position, out[i, 0]), max(angle, out[i, 1])
    return position, angle
