# SPDX-License-Identifier: Apache-2.0
"""One freedom leaves an articulated body, a wrench, an acceleration; see formulations/relative/trees.py.

A freedom f is a direction s of a twist. For most it is a component k, 0 to 5: three rotations, three
translations. Where k is a constant, nothing of the choice is left in the machine code.
"""

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import axpy3, dot3, load3


@kernel
def component(k, torque, force):
    """Component k of a wrench or of a twist."""
    if k < 3:
        return torque[0] if k == 0 else torque[1] if k == 1 else torque[2]
    return force[0] if k == 3 else force[1] if k == 4 else force[2]


@kernel
def without_component(k, a):
    """A vector without its component k; all of it if k is none of 0, 1, 2."""
    return 0.0 if k == 0 else a[0], 0.0 if k == 1 else a[1], 0.0 if k == 2 else a[2]


@kernel
def with_component(k, value, a):
    """A vector with a value added to its component k; unchanged if k is none of 0, 1, 2."""
    return (
        a[0] + value if k == 0 else a[0],
        a[1] + value if k == 1 else a[1],
        a[2] + value if k == 2 else a[2],
    )


@kernel
def column(m, k):
    """Column k of an inertia: I s of component k."""
    if k == 0:
        return m[0], m[1], m[2], m[6], m[7], m[8]
    if k == 1:
        return m[1], m[3], m[4], m[9], m[10], m[11]
    if k == 2:
        return m[2], m[4], m[5], m[12], m[13], m[14]
    if k == 3:
        return m[6], m[9], m[12], m[15], m[16], m[17]
    if k == 4:
        return m[7], m[10], m[13], m[16], m[18], m[19]
    return m[8], m[11], m[14], m[17], m[19], m[20]


@kernel
def _cleared(m, k):
    """An inertia whose row and column k are exactly zero."""
    return (
        0.0 if k == 0 else m[0],
        0.0 if k == 0 or k == 1 else m[1],
        0.0 if k == 0 or k == 2 else m[2],
        0.0 if k == 1 else m[3],
        0.0 if k == 1 or k == 2 else m[4],
        0.0 if k == 2 else m[5],
        0.0 if k == 0 or k == 3 else m[6],
        0.0 if k == 0 or k == 4 else m[7],
        0.0 if k == 0 or k == 5 else m[8],
        0.0 if k == 1 or k == 3 else m[9],
        0.0 if k == 1 or k == 4 else m[10],
        0.0 if k == 1 or k == 5 else m[11],
        0.0 if k == 2 or k == 3 else m[12],
        0.0 if k == 2 or k == 4 else m[13],
        0.0 if k == 2 or k == 5 else m[14],
        0.0 if k == 3 else m[15],
        0.0 if k == 3 or k == 4 else m[16],
        0.0 if k == 3 or k == 5 else m[17],
        0.0 if k == 4 else m[18],
        0.0 if k == 4 or k == 5 else m[19],
        0.0 if k == 5 else m[20],
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
def store_freedom(work, f, U, inverse, u):
    """Store a freedom: U, 1 / D and u."""
    for c in range(6):
        work.freedoms[f, c] = U[c]
    work.freedoms[f, 6] = inverse
    work.freedoms[f, 7] = u


@kernel
def is_held(work, f):
    """Whether freedom f is held: then it has no U and no 1 / D, and stays in the inertia."""
    if work.held[f] == 0.0:
        return False
    store_freedom(work, f, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    return True


@kernel
def eliminate_direction(work, f, U, D, u, m, torque, force):
    """Store a freedom and return inertia and bias force without it.

    A freedom without inertia does not accelerate.
    """
    inverse = 1.0 / D if D > 0.0 else 0.0
    store_freedom(work, f, U, inverse, u)
    share = u * inverse
    return (
        _reduced(m, U, inverse),
        axpy3(share, (U[0], U[1], U[2]), torque),
        axpy3(share, (U[3], U[4], U[5]), force),
    )


@kernel
def eliminate_component(work, f, k, may_be_held, m, torque, force):
    """Eliminate component k of the twist: freedom f. The row of I becomes exactly zero."""
    if may_be_held and is_held(work, f):
        return m, torque, force
    U = column(m, k)
    D = component(k, (U[0], U[1], U[2]), (U[3], U[4], U[5]))
    u = -component(k, torque, force)
    m, torque, force = eliminate_direction(work, f, U, D, u, m, torque, force)
    return _cleared(m, k), without_component(k, torque), without_component(k - 3, force)


@kernel
def accelerate_direction(work, f, w, v):
    """Acceleration of freedom f, from the acceleration (w, v) of its link without it."""
    U = work.freedoms
    rate = U[f, 6] * (U[f, 7] - (dot3(load3(U, f, 0), w) + dot3(load3(U, f, 3), v)))
    work.acceleration[f, 0] = rate
    return rate


@kernel
def accelerate_component(work, f, k, w, v):
    """Add the acceleration of freedom f, component k, to the acceleration (w, v) of its link."""
    rate = accelerate_direction(work, f, w, v)
    return with_component(k, rate, w), with_component(k - 3, rate, v)


@kernel
def leave_direction(work, f, y, place, torque, force):
    """Wrench less U y / D of freedom f, whose component y goes to a place of work.response."""
    work.response[place] = y
    share = -y * work.freedoms[f, 6]
    return (
        axpy3(share, load3(work.freedoms, f, 0), torque),
        axpy3(share, load3(work.freedoms, f, 3), force),
    )


@kernel
def leave_component(work, f, k, may_be_held, place, torque, force):
    """Wrench of a row without freedom f, component k; see `leave_direction`."""
    y = component(k, torque, force)
    torque, force = leave_direction(work, f, y, place, torque, force)
    if may_be_held and work.held[f] != 0.0:
        return torque, force
    return without_component(k, torque), without_component(k - 3, force)
