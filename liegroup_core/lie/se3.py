# SPDX-License-Identifier: Apache-2.0
"""Group of rigid-body motions SE(3): exp, log, right-translated dexp and its inverse, Ad and ad.

Kernels on tuples. Pose C = (R, r): R (9, row by row) body -> world, r (3) in world axes, m.
Screw X = (xi, eta), twist V = (w, v), wrench (torque, force): angular part first. dexp is
right-translated, Cdot C^-1 = dexp_X Xdot, so the body-fixed twist is V = dexp_{-X} Xdot and
Xdot = dexpinv_{-X} V. Operators are applied by cross products; no 6x6 matrix is formed.

Non-finite arguments raise no exception: exp, dexp and dexpinv return non-finite values.
"""

from liegroup_core.compiling import kernel

from .coefficients import dexp_slopes, dexpinv_coefficients, exp_coefficients
from .so3 import so3_dexp, so3_dexpinv, so3_exp, so3_log
from .vec3 import add3, cross3, dot3, matmul3, matvec3, sub3, tmatvec3, transpose3


@kernel
def se3_compose(R1, r1, R2, r2):
    """Product of two poses: (R1 R2, r1 + R1 r2)."""
    return matmul3(R1, R2), add3(r1, matvec3(R1, r2))


@kernel
def se3_inverse(R, r):
    """Inverse of a pose: (R^T, -R^T r)."""
    x, y, z = tmatvec3(R, r)
    return transpose3(R), (-x, -y, -z)


@kernel
def se3_exp(xi, eta):
    """Pose of a screw: (exp xi, dexp_xi eta).

    Error of an entry: (6 + 1.5 t) (1 + |eta|) units of 2^-53. This bound and those below:
    test/contract/test_lie_groups.py.
    Source: (6.15). The form with the pitch, (6.5), is 0/0 at xi = 0 and loses digits near it.
    """
    return so3_exp(xi), so3_dexp(xi, eta)


@kernel
def se3_log(R, r):
    """Screw (xi, eta) of a pose, |xi| <= pi: the inverse of exp."""
    xi = so3_log(R)
    return xi, so3_dexpinv(xi, r)


@kernel
def se3_Ad(R, r, w, v):
    """Ad_C V, the body-frame twist V in the frame that C maps to: (R w, r x R w + R v)."""
    Rw = matvec3(R, w)
    return Rw, add3(cross3(r, Rw), matvec3(R, v))


@kernel
def se3_Ad_inverse(R, r, w, v):
    """Ad_C^-1 V: (R^T w, R^T (v - r x w))."""
    return tmatvec3(R, w), tmatvec3(R, sub3(v, cross3(r, w)))


@kernel
def se3_wrench(R, r, torque, force):
    """Ad_C^-T of a wrench: from the frame at C = (R, r) to the reference frame of C, in its axes."""
    f = matvec3(R, force)
    return add3(matvec3(R, torque), cross3(r, f)), f


@kernel
def se3_ad(xi, eta, w, v):
    """Lie bracket ad_X V: (xi x w, eta x w + xi x v)."""
    return cross3(xi, w), add3(cross3(eta, w), cross3(xi, v))


@kernel
def se3_ad_transpose(xi, eta, torque, force):
    """ad_X^T applied to a wrench: (torque x xi + force x eta, force x xi)."""
    return add3(cross3(torque, xi), cross3(force, eta)), cross3(force, xi)


@kernel
def se3_dexp(xi, eta, w, v):
    """Right-translated differential of exp, dexp_X applied to (w, v).

    The lower left block is the derivative of dexp_xi in the direction eta: it needs `dexp_slopes`.
    Error of an entry of the matrix: 5e-16 (1 + |eta|), for t <= 2 pi.
    """
    x = dot3(xi, xi)
    _, c, d = exp_coefficients(x)
    c_slope, d_slope = dexp_slopes(x)
    pitch = dot3(xi, eta)
    p = pitch * c_slope
    q = pitch * d_slope
    a = cross3(xi, w)
    aa = cross3(xi, a)
    g = add3(cross3(eta, w), cross3(xi, v))
    gg = add3(cross3(eta, a), cross3(xi, g))
    return (
        (w[0] + c * a[0] + d * aa[0], w[1] + c * a[1] + d * aa[1], w[2] + c * a[2] + d * aa[2]),
        (
            v[0] + c * g[0] + d * gg[0] + p * a[0] + q * aa[0],
            v[1] + c * g[1] + d * gg[1] + p * a[1] + q * aa[1],
            v[2] + c * g[2] + d * gg[2] + p * a[2] + q * aa[2],
        ),
    )


@kernel
def se3_dexpinv(xi, eta, w, v):
    """Inverse of dexp_X applied to (w, v), |xi| < 2 pi.

    Lower left block: -1/2 eta^ + b (xi^ eta^ + eta^ xi^) + (xi . eta) u xi^ xi^.
    Error of an entry of the matrix: 5e-16 (1 + |eta|) for t <= pi; beyond pi, multiplied by
    (pi / (2 pi - t))^3.
    Source: (6.12), (6.13), corrected: lower right block dexp_xi^-1, gamma = (t/2) cot(t/2),
    factor (xi . eta)/t^4 of the last term.
    """
    b, u = dexpinv_coefficients(dot3(xi, xi))
    return se3_dexpinv_of(0.5, b, u, xi, eta, w, v)


@kernel
def se3_dexpinv_of(first, b, u, xi, eta, w, v):
    """Series 1 - first ad_X + b ad_X^2 + ... applied to (w, v), see `dexpinv_coefficients`.

    On SO(3) all even powers of ad are multiples of its square. On SE(3) the derivative u of the
    factor b enters too.
    """
    q = dot3(xi, eta) * u
    a = cross3(xi, w)
    aa = cross3(xi, a)
    g = add3(cross3(eta, w), cross3(xi, v))
    gg = add3(cross3(eta, a), cross3(xi, g))
    return (
        (w[0] - first * a[0] + b * aa[0], w[1] - first * a[1] + b * aa[1], w[2] - first * a[2] + b * aa[2]),
        (
            v[0] - first * g[0] + b * gg[0] + q * aa[0],
            v[1] - first * g[1] + b * gg[1] + q * aa[1],
            v[2] - first * g[2] + b * gg[2] + q * aa[2],
        ),
    )
