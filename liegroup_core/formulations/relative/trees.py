# SPDX-License-Identifier: Apache-2.0
"""Accelerations of trees in O(n): kinematics, and articulated bodies.

With the relative pose C_ba of parent a and child b, X = Ad(C_ba), twists in link axes,
    V_b = X V_a + S qdot ,   Vdot_b = X Vdot_a + [V_b, S qdot] + S qddot
From the leaves to the world every link adds the inertia and bias force of its articulated body to
its parent, one freedom s (column of S) after the other:
    U = I s ,  D = s . U ,  u = -s . p ;   I <- I - U U^T / D ,  p <- p + U u / D
    I_a += X^T I X ,   p_a += X^T (p + I [V_b, S qdot])
and from the world to the leaves, in the reverse order,
    qddot = (u - U . Vdot) / D ,   Vdot <- Vdot + s qddot
The world accelerates by -g instead of a weight on every link: Work.drift is Vdot - g.

A freedom leaves its row of I exactly zero. So a massive link gives a light parent no inertia about
the axis of their hinge, not even that of round-off; a ball joint gives its parent a mass matrix
only.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 7.3.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_ad, se3_Ad_inverse
from liegroup_core.lie.vec3 import (
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    matrix3,
    matvec3,
    scale3,
    store3,
    store9,
    sub3,
    vector3,
)

from .arrays import BALL, CYLINDER, FREE, HINGE, PLANE, SCREW, SLIDE
from .coordinates import rate_twist, relative_pose


@kernel
def move_links(model, work):
    """Relative poses, twists V and [V, S qdot] of all links at the stage; no applied wrenches."""
    first, coordinates, rates = len(model.parts), work.stage_pose, work.stage_twist
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        a = link["parent"]
        rot, p = relative_pose(link, coordinates, first + b)
        store9(rot, work.relative, b, 0)
        store3(p, work.relative, b, 9)
        sw, sv = rate_twist(link, rates, first + b)
        if a == WORLD:
            w, v = sw, sv
            store3((0.0, 0.0, 0.0), work.drift, b, 0)
            store3((0.0, 0.0, 0.0), work.drift, b, 3)
        else:
            w, v = se3_Ad_inverse(
                rot, p, load3(work.velocities, a, 0), load3(work.velocities, a, 3)
            )
            if link["group"] == HINGE:
                rate = sw[2]
                w = (w[0], w[1], w[2] + rate)
                store3((rate * w[1], -rate * w[0], 0.0), work.drift, b, 0)
                store3((rate * v[1], -rate * v[0], 0.0), work.drift, b, 3)
            else:
                w, v = add3(w, sw), add3(v, sv)
                cw, cv = se3_ad(w, v, sw, sv)
                store3(cw, work.drift, b, 0)
                store3(cv, work.drift, b, 3)
        store3(w, work.velocities, b, 0)
        store3(v, work.velocities, b, 3)
        store3((0.0, 0.0, 0.0), work.applied, b, 0)
        store3((0.0, 0.0, 0.0), work.applied, b, 3)


@kernel
def _load_inertia(array, row):
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
def _times(m, w, v):
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
def _reduced(m, U, inverse):
    """I - U U^T / D."""
    a, b, c = inverse * U[0], inverse * U[1], inverse * U[2]
    d, e, f = inverse * U[3], inverse * U[4], inverse * U[5]
    return (
        m[0] - a * U[0],
        m[1] - a * U[1],
        m[2] - a * U[2],
        m[3] - b * U[1],
        m[4] - b * U[2],
        m[5] - c * U[2],
        m[6] - a * U[3],
        m[7] - a * U[4],
        m[8] - a * U[5],
        m[9] - b * U[3],
        m[10] - b * U[4],
        m[11] - b * U[5],
        m[12] - c * U[3],
        m[13] - c * U[4],
        m[14] - c * U[5],
        m[15] - d * U[3],
        m[16] - d * U[4],
        m[17] - d * U[5],
        m[18] - e * U[4],
        m[19] - e * U[5],
        m[20] - f * U[5],
    )


@kernel
def _store(work, f, U, inverse, u):
    """Store a freedom: U, 1 / D and u."""
    for c in range(6):
        work.freedoms[f, c] = U[c]
    work.freedoms[f, 6] = inverse
    work.freedoms[f, 7] = u


@kernel
def _eliminate(work, m, torque, force, f, U, D, u):
    """Store a freedom and return inertia and bias force without it; see above.

    A freedom without inertia does not accelerate.
    """
    inverse = 1.0 / D if D > 0.0 else 0.0
    _store(work, f, U, inverse, u)
    share = u * inverse
    return (
        _reduced(m, U, inverse),
        axpy3(share, (U[0], U[1], U[2]), torque),
        axpy3(share, (U[3], U[4], U[5]), force),
    )


@kernel
def _without_turn(work, m, torque, force, f):
    """Eliminate the rotation about z: freedom f."""
    U = (m[2], m[4], m[5], m[12], m[13], m[14])
    m, torque, force = _eliminate(work, m, torque, force, f, U, U[2], -torque[2])
    m = (
        m[0],
        m[1],
        0.0,
        m[3],
        0.0,
        0.0,
        m[6],
        m[7],
        m[8],
        m[9],
        m[10],
        m[11],
        0.0,
        0.0,
        0.0,
        m[15],
        m[16],
        m[17],
        m[18],
        m[19],
        m[20],
    )
    return m, (torque[0], torque[1], 0.0), force


@kernel
def _without_tilt_x(work, m, torque, force, f):
    """Eliminate the rotation about x: freedom f."""
    U = (m[0], m[1], m[2], m[6], m[7], m[8])
    m, torque, force = _eliminate(work, m, torque, force, f, U, U[0], -torque[0])
    m = (
        0.0,
        0.0,
        0.0,
        m[3],
        m[4],
        m[5],
        0.0,
        0.0,
        0.0,
        m[9],
        m[10],
        m[11],
        m[12],
        m[13],
        m[14],
        m[15],
        m[16],
        m[17],
        m[18],
        m[19],
        m[20],
    )
    return m, (0.0, torque[1], torque[2]), force


@kernel
def _without_tilt_y(work, m, torque, force, f):
    """Eliminate the rotation about y: freedom f."""
    U = (m[1], m[3], m[4], m[9], m[10], m[11])
    m, torque, force = _eliminate(work, m, torque, force, f, U, U[1], -torque[1])
    m = (
        m[0],
        0.0,
        m[2],
        0.0,
        0.0,
        m[5],
        m[6],
        m[7],
        m[8],
        0.0,
        0.0,
        0.0,
        m[12],
        m[13],
        m[14],
        m[15],
        m[16],
        m[17],
        m[18],
        m[19],
        m[20],
    )
    return m, (torque[0], 0.0, torque[2]), force


@kernel
def _without_shift_x(work, m, torque, force, f):
    """Eliminate the translation along x: freedom f."""
    U = (m[6], m[9], m[12], m[15], m[16], m[17])
    m, torque, force = _eliminate(work, m, torque, force, f, U, U[3], -force[0])
    m = (
        m[0],
        m[1],
        m[2],
        m[3],
        m[4],
        m[5],
        0.0,
        m[7],
        m[8],
        0.0,
        m[10],
        m[11],
        0.0,
        m[13],
        m[14],
        0.0,
        0.0,
        0.0,
        m[18],
        m[19],
        m[20],
    )
    return m, torque, (0.0, force[1], force[2])


@kernel
def _without_shift_y(work, m, torque, force, f):
    """Eliminate the translation along y: freedom f."""
    U = (m[7], m[10], m[13], m[16], m[18], m[19])
    m, torque, force = _eliminate(work, m, torque, force, f, U, U[4], -force[1])
    m = (
        m[0],
        m[1],
        m[2],
        m[3],
        m[4],
        m[5],
        m[6],
        0.0,
        m[8],
        m[9],
        0.0,
        m[11],
        m[12],
        0.0,
        m[14],
        m[15],
        0.0,
        m[17],
        0.0,
        0.0,
        m[20],
    )
    return m, torque, (force[0], 0.0, force[2])


@kernel
def _without_lift(work, m, torque, force, f):
    """Eliminate the translation along z: freedom f."""
    U = (m[8], m[11], m[14], m[17], m[19], m[20])
    m, torque, force = _eliminate(work, m, torque, force, f, U, U[5], -force[2])
    m = (
        m[0],
        m[1],
        m[2],
        m[3],
        m[4],
        m[5],
        m[6],
        m[7],
        0.0,
        m[9],
        m[10],
        0.0,
        m[12],
        m[13],
        0.0,
        m[15],
        m[16],
        0.0,
        m[18],
        0.0,
        0.0,
    )
    return m, torque, (force[0], force[1], 0.0)


@kernel
def _without_screw(work, m, torque, force, f, pitch):
    """Eliminate the rotation about z with its translation."""
    U = (
        m[2] + pitch * m[8],
        m[4] + pitch * m[11],
        m[5] + pitch * m[14],
        m[12] + pitch * m[17],
        m[13] + pitch * m[19],
        m[14] + pitch * m[20],
    )
    u = -(torque[2] + pitch * force[2])
    return _eliminate(work, m, torque, force, f, U, U[2] + pitch * U[5], u)


@kernel
def _without_turns(work, m, torque, force, f):
    """Eliminate all rotations: freedoms f to f + 2."""
    m, torque, force = _without_turn(work, m, torque, force, f + 2)
    m, torque, force = _without_tilt_x(work, m, torque, force, f)
    return _without_tilt_y(work, m, torque, force, f + 1)


@kernel
def _without_shifts(work, m, force, f):
    """Eliminate all translations of a floating link: freedoms f to f + 2, the last ones."""
    xx, xy, xz, yy, yz, zz = m[15], m[16], m[17], m[18], m[19], m[20]
    _store(work, f, (0.0, 0.0, 0.0, xx, xy, xz), 1.0 / xx, -force[0])
    a, b = xy / xx, xz / xx
    yy, yz, zz = yy - a * xy, yz - a * xz, zz - b * xz
    y, z = force[1] - a * force[0], force[2] - b * force[0]
    _store(work, f + 1, (0.0, 0.0, 0.0, 0.0, yy, yz), 1.0 / yy, -y)
    c = yz / yy
    _store(work, f + 2, (0.0, 0.0, 0.0, 0.0, 0.0, zz - c * yz), 1.0 / (zz - c * yz), c * y - z)


@kernel
def _without_freedoms(work, m, torque, force, f, group, pitch):
    """Eliminate the freedoms of a link, the first of which is f."""
    if group == HINGE:
        return _without_turn(work, m, torque, force, f)
    if group == SLIDE:
        return _without_lift(work, m, torque, force, f)
    if group == SCREW:
        return _without_screw(work, m, torque, force, f, pitch)
    if group == BALL:
        return _without_turns(work, m, torque, force, f)
    if group == CYLINDER:
        m, torque, force = _without_turn(work, m, torque, force, f)
        return _without_lift(work, m, torque, force, f + 1)
    if group == PLANE:
        m, torque, force = _without_turn(work, m, torque, force, f)
        m, torque, force = _without_shift_x(work, m, torque, force, f + 1)
        return _without_shift_y(work, m, torque, force, f + 2)
    m, torque, force = _without_turns(work, m, torque, force, f)
    _without_shifts(work, m, force, f + 3)
    return m, torque, force


@kernel
def _add_inertia(m, rot, p, out, row):
    """Add X^T I X to row `row` of `out`; rot, p: pose of the link in its parent."""
    r0, r1, r2 = (rot[0], rot[1], rot[2]), (rot[3], rot[4], rot[5]), (rot[6], rot[7], rot[8])
    # A R^T by columns, then R A R^T.
    a0 = _symmetric_times(m[0], m[1], m[2], m[3], m[4], m[5], r0)
    a1 = _symmetric_times(m[0], m[1], m[2], m[3], m[4], m[5], r1)
    a2 = _symmetric_times(m[0], m[1], m[2], m[3], m[4], m[5], r2)
    A = (dot3(r0, a0), dot3(r0, a1), dot3(r0, a2), dot3(r1, a1), dot3(r1, a2), dot3(r2, a2))
    B = (m[6], m[7], m[8], m[9], m[10], m[11], m[12], m[13], m[14])
    t0, t1, t2 = matvec3(B, r0), matvec3(B, r1), matvec3(B, r2)
    b0 = (dot3(r0, t0), dot3(r0, t1), dot3(r0, t2))
    b1 = (dot3(r1, t0), dot3(r1, t1), dot3(r1, t2))
    b2 = (dot3(r2, t0), dot3(r2, t1), dot3(r2, t2))
    _add_shifted(A, b0, b1, b2, m, r0, r1, r2, p, out, row)


@kernel
def _add_hinge_inertia(m, rot, p, out, row):
    """`_add_inertia` without rotation about z: A and B have two rows."""
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
    _add_shifted(A, b0, b1, b2, m, r0, r1, r2, p, out, row)


@kernel
def _add_shifted(A, b0, b1, b2, m, r0, r1, r2, p, out, row):
    """Add an inertia at p to row `row` of `out`.

    A, b0, b1, b2 : R A R^T and the rows of R B R^T; r0, r1, r2: rows of R; C is in m
    """
    c0 = _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], r0)
    c1 = _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], r1)
    c2 = _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], r2)
    c00, c01, c02 = dot3(r0, c0), dot3(r0, c1), dot3(r0, c2)
    c11, c12, c22 = dot3(r1, c1), dot3(r1, c2), dot3(r2, c2)
    # B' = B1 + [p] C, A' = A1 - B' [p] + [p] B1^T.
    x, y, z = p
    d0 = (b0[0] + y * c02 - z * c01, b0[1] + y * c12 - z * c11, b0[2] + y * c22 - z * c12)
    d1 = (b1[0] + z * c00 - x * c02, b1[1] + z * c01 - x * c12, b1[2] + z * c02 - x * c22)
    d2 = (b2[0] + x * c01 - y * c00, b2[1] + x * c11 - y * c01, b2[2] + x * c12 - y * c02)
    e0, e1, e2 = cross3(d0, p), cross3(d1, p), cross3(d2, p)
    f0, f1, f2 = cross3(b0, p), cross3(b1, p), cross3(b2, p)
    out[row, 0] += A[0] - e0[0] - f0[0]
    out[row, 1] += A[1] - e0[1] - f1[0]
    out[row, 2] += A[2] - e0[2] - f2[0]
    out[row, 3] += A[3] - e1[1] - f1[1]
    out[row, 4] += A[4] - e1[2] - f2[1]
    out[row, 5] += A[5] - e2[2] - f2[2]
    for k in range(3):
        out[row, 6 + k] += d0[k]
        out[row, 9 + k] += d1[k]
        out[row, 12 + k] += d2[k]
    out[row, 15] += c00
    out[row, 16] += c01
    out[row, 17] += c02
    out[row, 18] += c11
    out[row, 19] += c12
    out[row, 20] += c22


@kernel
def _add_mass(m, rot, p, out, row):
    """`_add_inertia` if only C is not zero."""
    r0, r1, r2 = (rot[0], rot[1], rot[2]), (rot[3], rot[4], rot[5]), (rot[6], rot[7], rot[8])
    c0 = _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], r0)
    c1 = _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], r1)
    c2 = _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], r2)
    c00, c01, c02 = dot3(r0, c0), dot3(r0, c1), dot3(r0, c2)
    c11, c12, c22 = dot3(r1, c1), dot3(r1, c2), dot3(r2, c2)
    x, y, z = p
    d0 = (y * c02 - z * c01, y * c12 - z * c11, y * c22 - z * c12)
    d1 = (z * c00 - x * c02, z * c01 - x * c12, z * c02 - x * c22)
    d2 = (x * c01 - y * c00, x * c11 - y * c01, x * c12 - y * c02)
    e0, e1, e2 = cross3(d0, p), cross3(d1, p), cross3(d2, p)
    out[row, 0] -= e0[0]
    out[row, 1] -= e0[1]
    out[row, 2] -= e0[2]
    out[row, 3] -= e1[1]
    out[row, 4] -= e1[2]
    out[row, 5] -= e2[2]
    for k in range(3):
        out[row, 6 + k] += d0[k]
        out[row, 9 + k] += d1[k]
        out[row, 12 + k] += d2[k]
    out[row, 15] += c00
    out[row, 16] += c01
    out[row, 17] += c02
    out[row, 18] += c11
    out[row, 19] += c12
    out[row, 20] += c22


@kernel
def _symmetric_times(xx, xy, xz, yy, yz, zz, a):
    """Product of a symmetric matrix and a vector."""
    return (
        xx * a[0] + xy * a[1] + xz * a[2],
        xy * a[0] + yy * a[1] + yz * a[2],
        xz * a[0] + yz * a[1] + zz * a[2],
    )


@kernel
def add_wrench(torque, force, rot, p, out, row):
    """Add X^T W to row `row` of `out`, for a wrench W on a link at rot, p in its parent."""
    f = matvec3(rot, force)
    t = add3(matvec3(rot, torque), cross3(p, f))
    for c in range(3):
        out[row, c] += t[c]
        out[row, 3 + c] += f[c]


@kernel
def momentum(link, w, v):
    """I V of a link without its children: angular and linear momentum."""
    moment, inertia = vector3(link["moment"]), link["inertia"]
    angular = _symmetric_times(
        inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5], w
    )
    return add3(angular, cross3(moment, v)), axpy3(link["mass"], v, cross3(w, moment))


@kernel
def apply_wrenches(model, work):
    """Add the wrenches on the bodies, work.wrench, to work.applied."""
    for i in range(len(model.parts)):
        part = model.parts[i]
        if part["link"] != WORLD:
            add_wrench(
                load3(work.wrench, i, 0),
                load3(work.wrench, i, 3),
                matrix3(part["rotation"]),
                vector3(part["point"]),
                work.applied,
                part["link"],
            )


@kernel
def _start(model, work):
    """Set inertia and bias force of every link to its own."""
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        mass, inertia = link["mass"], link["inertia"]
        x, y, z = vector3(link["moment"])
        for k in range(6):
            work.inertia[b, k] = inertia[k]
        # B = [m c]: L = I w + m c x v
        work.inertia[b, 6], work.inertia[b, 7], work.inertia[b, 8] = 0.0, -z, y
        work.inertia[b, 9], work.inertia[b, 10], work.inertia[b, 11] = z, 0.0, -x
        work.inertia[b, 12], work.inertia[b, 13], work.inertia[b, 14] = -y, x, 0.0
        work.inertia[b, 15], work.inertia[b, 16], work.inertia[b, 17] = mass, 0.0, 0.0
        work.inertia[b, 18], work.inertia[b, 19], work.inertia[b, 20] = mass, 0.0, mass
        w, v = load3(work.velocities, b, 0), load3(work.velocities, b, 3)
        angular, linear = momentum(link, w, v)
        torque = add3(cross3(w, angular), cross3(v, linear))
        force = cross3(w, linear)
        store3(sub3(torque, load3(work.applied, b, 0)), work.force, b, 0)
        store3(sub3(force, load3(work.applied, b, 3)), work.force, b, 3)


@subroutine
def gather(model, work):
    """Articulated inertias and bias forces for work.applied, from the leaves to the world."""
    _start(model, work)
    for b in range(len(model.bodies) - 1, -1, -1):
        link = model.bodies[b]
        group, f, a = link["group"], link["freedom"], link["parent"]
        m = _load_inertia(work.inertia, b)
        torque, force = load3(work.force, b, 0), load3(work.force, b, 3)
        m, torque, force = _without_freedoms(work, m, torque, force, f, group, link["pitch"])
        if a == WORLD:
            continue
        rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
        w, v = load3(work.drift, b, 0), load3(work.drift, b, 3)
        if group == HINGE:
            # Neither rotation about z nor drift along it.
            torque = (
                torque[0] + (m[0] * w[0] + m[1] * w[1] + m[6] * v[0] + m[7] * v[1]),
                torque[1] + (m[1] * w[0] + m[3] * w[1] + m[9] * v[0] + m[10] * v[1]),
                torque[2],
            )
            force = (
                force[0] + (m[6] * w[0] + m[9] * w[1] + m[15] * v[0] + m[16] * v[1]),
                force[1] + (m[7] * w[0] + m[10] * w[1] + m[16] * v[0] + m[18] * v[1]),
                force[2] + (m[8] * w[0] + m[11] * w[1] + m[17] * v[0] + m[19] * v[1]),
            )
            _add_hinge_inertia(m, rot, p, work.inertia, a)
        elif group == BALL:
            force = add3(force, _symmetric_times(m[15], m[16], m[17], m[18], m[19], m[20], v))
            _add_mass(m, rot, p, work.inertia, a)
        else:
            dw, dv = _times(m, w, v)
            torque, force = add3(torque, dw), add3(force, dv)
            _add_inertia(m, rot, p, work.inertia, a)
        add_wrench(torque, force, rot, p, work.force, a)
    return 0


@kernel
def _move_on(work, f, axis, w, v):
    """Add the acceleration of freedom f, a unit direction, to the acceleration (w, v) of its link."""
    U = work.freedoms
    rate = U[f, 6] * (U[f, 7] - (dot3(load3(U, f, 0), w) + dot3(load3(U, f, 3), v)))
    work.acceleration[f, 0] = rate
    if axis < 3:
        return (
            (w[0] + rate, w[1], w[2])
            if axis == 0
            else (w[0], w[1] + rate, w[2])
            if axis == 1
            else (w[0], w[1], w[2] + rate),
            v,
        )
    return w, (
        (v[0] + rate, v[1], v[2])
        if axis == 3
        else (v[0], v[1] + rate, v[2])
        if axis == 4
        else (v[0], v[1], v[2] + rate)
    )


@kernel
def _with_freedoms(work, f, group, pitch, w, v):
    """Acceleration of a link with all its freedoms, in the reverse order of elimination."""
    if group == HINGE:
        return _move_on(work, f, 2, w, v)
    if group == SLIDE:
        return _move_on(work, f, 5, w, v)
    if group == SCREW:
        w, v = _move_on(work, f, 2, w, v)
        return w, (v[0], v[1], v[2] + pitch * work.acceleration[f, 0])
    if group == CYLINDER:
        w, v = _move_on(work, f + 1, 5, w, v)
        return _move_on(work, f, 2, w, v)
    if group == PLANE:
        w, v = _move_on(work, f + 2, 4, w, v)
        w, v = _move_on(work, f + 1, 3, w, v)
        return _move_on(work, f, 2, w, v)
    if group == FREE:
        w, v = _move_on(work, f + 5, 5, w, v)
        w, v = _move_on(work, f + 4, 4, w, v)
        w, v = _move_on(work, f + 3, 3, w, v)
    w, v = _move_on(work, f + 1, 1, w, v)
    w, v = _move_on(work, f, 0, w, v)
    return _move_on(work, f + 2, 2, w, v)


@subroutine
def _spread(model, work, gx, gy, gz, drift):
    """Accelerations of all freedoms and links, from the world to the leaves.

    gx, gy, gz : acceleration of gravity, world axes
    drift      : 1 with the terms [V, S qdot], 0 without: response to forces alone
    writes work.acceleration, and Vdot - gravity of the links to work.moved
    """
    for b in range(len(model.bodies)):
        link = model.bodies[b]
        a = link["parent"]
        rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
        if a == WORLD:
            w, v = se3_Ad_inverse(rot, p, (0.0, 0.0, 0.0), (-gx, -gy, -gz))
        else:
            w, v = se3_Ad_inverse(rot, p, load3(work.moved, a, 0), load3(work.moved, a, 3))
        if drift == 1:
            w = add3(w, load3(work.drift, b, 0))
            v = add3(v, load3(work.drift, b, 3))
        w, v = _with_freedoms(work, link["freedom"], link["group"], link["pitch"], w, v)
        store3(w, work.moved, b, 0)
        store3(v, work.moved, b, 3)
    return 0


@kernel
def spread(model, work):
    """Accelerations of all freedoms and links at the stage."""
    g = load3(model.gravity, 0, 0)
    _spread(model, work, g[0], g[1], g[2], 1)


@kernel
def spread_response(model, work):
    """The same without gravity and velocities: the response to the forces u of the freedoms."""
    _spread(model, work, 0.0, 0.0, 0.0, 0)
