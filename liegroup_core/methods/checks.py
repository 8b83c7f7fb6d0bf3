# SPDX-License-Identifier: Apache-2.0
"""Checks of all integrators on a state, and the norm of an error estimate."""

import math

from liegroup_core.compiling import kernel
from liegroup_core.forces.kinds import too_fast
from liegroup_core.lie.vec3 import dot3, load3
from liegroup_core.status import LARGEST_ROTATION, NOT_FINITE, OK, ROTATION_TOO_LARGE, TURNS_NOT_COUNTED


@kernel
def error_norm_square(xi, eta, dw, dv, start, end, i, rtol, atol, length):
    """Square of the norm of an error estimate of a body, see munthe_kaas/error_control.py.

    xi, eta, dw, dv : estimated errors of rotation, translation, angular and linear velocity
    start, end      : twists (n, 6) at both ends of the step; row i is that of the body
    length          : m, factor of atol for positions
    """
    w0, w1 = load3(start, i, 0), load3(end, i, 0)
    v0, v1 = load3(start, i, 3), load3(end, i, 3)
    tol_w = atol + rtol * math.sqrt(max(dot3(w0, w0), dot3(w1, w1)))
    tol_m = atol * length
    tol_v = tol_m + rtol * math.sqrt(max(dot3(v0, v0), dot3(v1, v1)))
    return (
        dot3(xi, xi) / (atol * atol)
        + dot3(eta, eta) / (tol_m * tol_m)
        + dot3(dw, dw) / (tol_w * tol_w)
        + dot3(dv, dv) / (tol_v * tol_v)
    )


@kernel
def rotation_status(squared):
    """Status of a step in which a body rotates; squared: squared rotation angle, rad^2."""
    if squared < LARGEST_ROTATION * LARGEST_ROTATION:
        return OK
    if squared < math.inf:
        return ROTATION_TOO_LARGE
    return NOT_FINITE


@kernel
def is_finite(pose, twist):
    """True if pose (n, 12) and twist (n, 6) are finite: neither NaN nor infinity."""
    total = 0.0
    for i in range(len(pose)):
        # One sum per row, so that the rows do not wait for each other.
        row = 0.0
        for c in range(12):
            row += abs(pose[i, c])
        for c in range(6):
            row += abs(twist[i, c])
        total += row
    return total < math.inf


@kernel
def end_status(forces, h, pose, twist):
    """Status of the end of a step of size h: OK, NOT_FINITE, or TURNS_NOT_COUNTED + (spring << 8).

    forces : Forces; the angle of a torsional spring cannot be unwrapped if it turns too fast
    """
    if not is_finite(pose, twist):
        return NOT_FINITE
    fast = too_fast(forces, h, pose, twist)
    return OK if fast < 0 else TURNS_NOT_COUNTED + (fast << 8)
