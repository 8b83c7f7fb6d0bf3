# SPDX-License-Identifier: Apache-2.0
"""Rotation group SO(3): exp, log, right-translated dexp and its inverse, quaternions.

Kernels on tuples: xi rotation vector (3), rad; R rotation matrix (9, row by row); quaternion
(x, y, z, w). dexp is right-translated, Rdot R^T = hat(dexp_xi xidot), so the body-fixed angular
velocity is omega = dexp_{-xi} xidot, and xidot = dexpinv_{-xi} omega.

Non-finite arguments raise no exception: exp, dexp and dexpinv return non-finite values.
"""

import math

from liegroup_core.compiling import kernel

from .coefficients import dexpinv_coefficients, exp_coefficients
from .vec3 import cross3, dot3, matmul3


@kernel
def so3_exp(xi):
    """Rotation matrix of a rotation vector (Rodrigues): I + sin t/t xi^ + (1-cos t)/t^2 xi^ xi^.

    Error of an entry: 6 + 1.5 t units of 2^-53. This bound and those below:
    test/contract/test_lie_groups.py.
    Source: (6.6).
    """
    s, c, _ = exp_coefficients(dot3(xi, xi))
    x, y, z = xi
    return (
        1.0 - c * (y * y + z * z),
        c * x * y - s * z,
        c * x * z + s * y,
        c * x * y + s * z,
        1.0 - c * (x * x + z * z),
        c * y * z - s * x,
        c * x * z - s * y,
        c * y * z + s * x,
        1.0 - c * (x * x + y * y),
    )


@kernel
def so3_to_quaternion(R):
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix, by Shepperd's method.

    For every R the largest component is half the square root of a number >= 1; the other components
    are divided by it. At a rotation by pi (w = 0) the sign of the axis is undefined.
    """
    trace = R[0] + R[4] + R[8]
    if trace >= R[0] and trace >= R[4] and trace >= R[8]:
        root = math.sqrt(1.0 + trace)
        f = 0.5 / root
        q = (f * (R[7] - R[5]), f * (R[2] - R[6]), f * (R[3] - R[1]), 0.5 * root)
    elif R[0] >= R[4] and R[0] >= R[8]:
        root = math.sqrt(1.0 + R[0] - R[4] - R[8])
        f = 0.5 / root
        q = (0.5 * root, f * (R[1] + R[3]), f * (R[2] + R[6]), f * (R[7] - R[5]))
    elif R[4] >= R[8]:
        root = math.sqrt(1.0 + R[4] - R[0] - R[8])
        f = 0.5 / root
        q = (f * (R[1] + R[3]), 0.5 * root, f * (R[5] + R[7]), f * (R[2] - R[6]))
    else:
        root = math.sqrt(1.0 + R[8] - R[0] - R[4])
        f = 0.5 / root
        q = (f * (R[2] + R[6]), f * (R[5] + R[7]), 0.5 * root, f * (R[3] - R[1]))
    if q[3] < 0.0:
        return (-q[0], -q[1], -q[2], -q[3])
    return q


@kernel
def so3_from_quaternion(q):
    """Rotation matrix of a quaternion (x, y, z, w), divided by its norm. q = 0 gives NaN."""
    x, y, z, w = q
    n = x * x + y * y + z * z + w * w
    s = 2.0 / n if n > 0.0 else math.nan
    return (
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )


@kernel
def so3_log(R):
    """Rotation vector of a rotation matrix, |xi| <= pi: the inverse of exp.

    The quaternion and atan2 lose no digits near 0 and pi; trace and arccos would lose half of them
    at both ends. At a rotation by pi the sign of the axis is undefined.
    Error: 10 units of 2^-53 of t, after the error of exp, down to t = 1e-300.
    """
    x, y, z, w = so3_to_quaternion(R)
    n = math.sqrt(x * x + y * y + z * z)
    # If the squares underflow, n = 0 and the limit is exact. An inaccurate n cancels: atan2(n, w) / n.
    f = 2.0 * math.atan2(n, w) / n if n > 0.0 else 2.0 / w
    return (f * x, f * y, f * z)


@kernel
def so3_dexp(xi, w):
    """Right-translated differential of exp, dexp_xi applied to w.

    w + (1-cos t)/t^2 xi x w + (t-sin t)/t^3 xi x (xi x w).
    Error of an entry of the matrix: 5e-16, for t <= 2 pi.
    Source: (6.10).
    """
    _, c, d = exp_coefficients(dot3(xi, xi))
    a = cross3(xi, w)
    aa = cross3(xi, a)
    return (w[0] + c * a[0] + d * aa[0], w[1] + c * a[1] + d * aa[1], w[2] + c * a[2] + d * aa[2])


@kernel
def so3_dexpinv(xi, w):
    """Inverse of dexp_xi applied to w, |xi| < 2 pi: w - 1/2 xi x w + b xi x (xi x w).

    Grows like 1 / (2 pi - t) near a rotation by 2 pi, where dexp_xi is singular.
    Error of an entry of the matrix: 5e-16 for t <= pi; beyond pi, multiplied by
    (pi / (2 pi - t))^3.
    """
    b, _ = dexpinv_coefficients(dot3(xi, xi))
    return so3_dexpinv_of(0.5, b, xi, w)


@kernel
def so3_dexpinv_of(first, b, xi, w):
    """w - first xi x w + b xi x (xi x w), see `dexpinv_coefficients`."""
    a = cross3(xi, w)
    aa = cross3(xi, a)
    return (w[0] - first * a[0] + b * aa[0], w[1] - first * a[1] + b * aa[1], w[2] - first * a[2] + b * aa[2])


@kernel
def so3_nearest(rot):
    """One Newton iteration for the nearest rotation, R (3 I - R^T R) / 2.

    Round-off makes products of rotations drift from SO(3). The iteration converges quadratically,
    so that one iteration is enough.
    """
    x, y, z = (rot[0], rot[3], rot[6]), (rot[1], rot[4], rot[7]), (rot[2], rot[5], rot[8])
    xy, xz, yz = -0.5 * dot3(x, y), -0.5 * dot3(x, z), -0.5 * dot3(y, z)
    defect = (1.5 - 0.5 * dot3(x, x), xy, xz, xy, 1.5 - 0.5 * dot3(y, y), yz, xz, yz, 1.5 - 0.5 * dot3(z, z))
    return matmul3(rot, defect)
