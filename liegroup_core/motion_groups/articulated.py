# SPDX-License-Identifier: Apache-2.0
"""Inertia of an articulated body: momentum = (A w + B v, B^T w + C v), in link axes.

As a tuple of 21 numbers: A (6, symmetric), B (9, row by row), C (6, symmetric).
"""

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import add3, axpy3, cross3, dot3, matvec3, scale3


@kernel
def load_inertia(array, row):
    """Read an inertia: (A (6), B (9), C (6)) as one tuple."""
    return (
        array[row, 0],
        array[row, 1],
        array[row, 2],
        array[row, 3],
        array[row, 4],
        array[row, 5],
        array[row, 6],
        array[row, 7],
        array[row, 8],
        array[row, 9],
        array[row, 10],
        array[row, 11],
        array[row, 12],
        array[row, 13],
        array[row, 14],
        array[row, 15],
        array[row, 16],
        array[row, 17],
        array[row, 18],
        array[row, 19],
        array[row, 20],
    )


@kernel
def times(m, w, v):
    """I V: angular and linear momentum of an inertia (21)."""
    return (
        (
            m[0] * w[0] + m[1] * w[1] + m[2] * w[2] + m[6] * v[0] + m[7] * v[1] + m[8] * v[2],
            m[1] * w[0] + m[3] * w[1] + m[4] * w[2] + m[9] * v[0] + m[10] * v[1] + m[11] * v[2],
            m[2] * w[0] + m[4] * w[1] + m[5] * w[2] + m[12] * v[0] + m[13] * v[1] + m[14] * v[2],
        ),
        (
            m[6] * w[0] + m[9] * w[1] + m[12] * w[2] + m[15] * v[0] + m[16] * v[1] + m[17] * v[2],
            m[7] * w[0] + m[10] * w[1] + m[13] * w[2] + m[16] * v[0] + m[18] * v[1] + m[19] * v[2],
            m[8] * w[0] + m[11] * w[1] + m[14] * w[2] + m[17] * v[0] + m[19] * v[1] + m[20] * v[2],
        ),
    )


@kernel
def add_inertia(m, rot, p, out, row):
    """Add X^T I X to row `row` of `out`; rot, p: pose of the link in its parent."""
    r0, r1, r2 = (rot[0], rot[1], rot[2]), (rot[3], rot[4], rot[5]), (rot[6], rot[7], rot[8])
    # A R^T by columns, then R A R^T.
    a0 = symmetric_times(m[0], m[1], m[2], m[3], m[4], m[5], r0)
    a1 = symmetric_times(m[0], m[1], m[2], m[3], m[4], m[5], r1)
    a2 = symmetric_times(m[0], m[1], m[2], m[3], m[4], m[5], r2)
    A = (dot3(r0, a0), dot3(r0, a1), dot3(r0, a2), dot3(r1, a1), dot3(r1, a2), dot3(r2, a2))
    B = (m[6], m[7], m[8], m[9], m[10], m[11], m[12], m[13], m[14])
    t0, t1, t2 = matvec3(B, r0), matvec3(B, r1), matvec3(B, r2)
    b0 = (dot3(r0, t0), dot3(r0, t1), dot3(r0, t2))
    b1 = (dot3(r1, t0), dot3(r1, t1), dot3(r1, t2))
    b2 = (dot3(r2, t0), dot3(r2, t1), dot3(r2, t2))
    _add_shifted(A, b0, b1, b2, _turned_mass(m, r0, r1, r2), p, out, row)


@kernel
def add_hinge_inertia(m, rot, p, out, row):
    """`add_inertia` without rotation about z: A and B have two rows."""
    r0, r1, r2 = (rot[0], rot[1], rot[2]), (rot[3], rot[4], rot[5]), (rot[6], rot[7], rot[8])
    x, y = (rot[0], rot[3], rot[6]), (rot[1], rot[4], rot[7])
    s, t = axpy3(m[0], x, scale3(m[1], y)), axpy3(m[1], x, scale3(m[3], y))
    A = (
        s[0] * x[0] + t[0] * y[0],
        s[0] * x[1] + t[0] * y[1],
        s[0] * x[2] + t[0] * y[2],
        s[1] * x[1] + t[1] * y[1],
        s[1] * x[2] + t[1] * y[2],
        s[2] * x[2] + t[2] * y[2],
    )
    s, t = matvec3(rot, (m[6], m[7], m[8])), matvec3(rot, (m[9], m[10], m[11]))
    b0 = axpy3(x[0], s, scale3(y[0], t))
    b1 = axpy3(x[1], s, scale3(y[1], t))
    b2 = axpy3(x[2], s, scale3(y[2], t))
    _add_shifted(A, b0, b1, b2, _turned_mass(m, r0, r1, r2), p, out, row)


@kernel
def _turned_block(xx, xy, yy, c, s):
    """Block (xx, xy, yy) of a symmetric matrix, turned in its plane.

    A small moment next to a large one keeps its digits: both mix only as far as the angle requires.
    """
    g = s * (xx - yy) + 2.0 * c * xy
    return xx - s * g, c * g - xy, yy + s * g


@kernel
def _turned_pair(x, y, c, s):
    """Components of a vector, turned in their plane."""
    return c * x - s * y, s * x + c * y


@kernel
def add_aligned_hinge_inertia(m, rot, p, out, row):
    """`add_hinge_inertia` for rot = Rx Rz: two rotations in a plane, one after the other."""
    # About z.
    c, s = rot[0], -rot[1]
    a, b, d = _turned_block(m[0], m[1], m[3], c, s)
    xx, xy, yy = _turned_block(m[15], m[16], m[18], c, s)
    xz, yz = _turned_pair(m[17], m[19], c, s)
    difference, total = m[6] - m[10], m[7] + m[9]
    g, k = s * (s * difference + c * total), s * (c * difference - s * total)
    u, w = _turned_pair(m[8], m[11], c, s)
    b0, b1 = (m[6] - g, m[7] + k, u), (m[9] + k, m[10] + g, w)
    # About x.
    c, s = rot[8], -rot[5]
    C = _turned_pair(xy, xz, c, s)
    C = (xx, C[0], C[1], *_turned_block(yy, yz, m[20], c, s))
    t = c * d
    A = (a, c * b, s * b, c * t, s * t, s * s * d)
    q, u = _turned_pair(b0[1], b0[2], c, s)
    t, w = _turned_pair(b1[1], b1[2], c, s)
    b1, b2 = (c * b1[0], c * t, c * w), (s * b1[0], s * t, s * w)
    _add_shifted(A, (b0[0], q, u), b1, b2, C, p, out, row)


@kernel
def _turned_mass(m, r0, r1, r2):
    """R C R^T of an inertia as (xx, xy, xz, yy, yz, zz); r0, r1, r2: rows of R."""
    c0, c1, c2 = mass_times(m, r0), mass_times(m, r1), mass_times(m, r2)
    return dot3(r0, c0), dot3(r0, c1), dot3(r0, c2), dot3(r1, c1), dot3(r1, c2), dot3(r2, c2)


@kernel
def _moved_mass(C, p):
    """Rows of [p] C."""
    x, y, z = p
    return (
        (y * C[2] - z * C[1], y * C[4] - z * C[3], y * C[5] - z * C[4]),
        (z * C[0] - x * C[2], z * C[1] - x * C[4], z * C[2] - x * C[5]),
        (x * C[1] - y * C[0], x * C[3] - y * C[1], x * C[4] - y * C[2]),
    )


@kernel
def _add_linear(d0, d1, d2, C, out, row):
    """Add B, with rows d0, d1, d2, and C to row `row` of `out`."""
    for k in range(3):
        out[row, 6 + k] += d0[k]
        out[row, 9 + k] += d1[k]
        out[row, 12 + k] += d2[k]
    out[row, 15] += C[0]
    out[row, 16] += C[1]
    out[row, 17] += C[2]
    out[row, 18] += C[3]
    out[row, 19] += C[4]
    out[row, 20] += C[5]


@kernel
def _add_shifted(A, b0, b1, b2, C, p, out, row):
    """Add an inertia at p, in axes of the parent, to row `row` of `out`; b0, b1, b2: rows of B."""
    # B' = B1 + [p] C, A' = A1 - B' [p] + [p] B1^T.
    d0, d1, d2 = _moved_mass(C, p)
    d0, d1, d2 = add3(b0, d0), add3(b1, d1), add3(b2, d2)
    e0, e1, e2 = cross3(d0, p), cross3(d1, p), cross3(d2, p)
    f0, f1, f2 = cross3(b0, p), cross3(b1, p), cross3(b2, p)
    out[row, 0] += A[0] - e0[0] - f0[0]
    out[row, 1] += A[1] - e0[1] - f1[0]
    out[row, 2] += A[2] - e0[2] - f2[0]
    out[row, 3] += A[3] - e1[1] - f1[1]
    out[row, 4] += A[4] - e1[2] - f2[1]
    out[row, 5] += A[5] - e2[2] - f2[2]
    _add_linear(d0, d1, d2, C, out, row)


@kernel
def add_mass(m, rot, p, out, row):
    """`add_inertia` if only C is not zero."""
    r0, r1, r2 = (rot[0], rot[1], rot[2]), (rot[3], rot[4], rot[5]), (rot[6], rot[7], rot[8])
    C = _turned_mass(m, r0, r1, r2)
    d0, d1, d2 = _moved_mass(C, p)
    e0, e1, e2 = cross3(d0, p), cross3(d1, p), cross3(d2, p)
    out[row, 0] -= e0[0]
    out[row, 1] -= e0[1]
    out[row, 2] -= e0[2]
    out[row, 3] -= e1[1]
    out[row, 4] -= e1[2]
    out[row, 5] -= e2[2]
    _add_linear(d0, d1, d2, C, out, row)


@kernel
def mass_times(m, a):
    """C a of an inertia (21)."""
    return symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], a)


@kernel
def symmetric_times(xx, xy, xz, yy, yz, zz, a):
    """Product of a symmetric matrix and a vector."""
    return (xx * a[0] + xy * a[1] + xz * a[2], xy * a[0] + yy * a[1] + yz * a[2], xz * a[0] + yz * a[1] + zz * a[2])
