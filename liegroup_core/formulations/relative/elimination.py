# SPDX-License-Identifier: Apache-2.0
"""Freedoms leave articulated bodies, one after the other; see trees.py."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import axpy3

from .arrays import BALL, CYLINDER, HINGE, PLANE, SCREW, SLIDE


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
    """Store a freedom and return inertia and bias force without it; see trees.py.

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
def _is_held(work, f):
    """Whether freedom f is held: then it has no U and no 1 / D, and stays in the inertia."""
    if work.held[f] == 0.0:
        return False
    _store(work, f, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    return True


@kernel
def _without_turn(work, m, torque, force, f):
    """Eliminate the rotation about z: freedom f."""
    if _is_held(work, f):
        return m, torque, force
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
    if _is_held(work, f):
        return m, torque, force
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
    if _is_held(work, f):
        return m, torque, force
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
def without_freedoms(work, m, torque, force, f, group, pitch):
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
