# SPDX-License-Identifier: Apache-2.0
"""SE(3): a floating link, whose parent is the world. Coordinates: rotation row by row, position."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.se3 import se3_compose, se3_dexpinv_of, se3_exp
from liegroup_core.lie.so3 import so3_exp, so3_nearest
from liegroup_core.lie.vec3 import ZERO3, add3, dot3, load3, load9, matmul3, matrix3, matvec3, store3, store9, vector3

from .ball import normalise as normalise
from .ball import relative_rotation as relative_rotation
from .elimination import WITHOUT, leave_direction, store_freedom

_without_x, _without_y, _without_z = WITHOUT[:3]

NAME = "SE(3)"
JOINTS = {}
COMPONENTS, ORDER = (0, 1, 2, 3, 4, 5), (2, 0, 1, 3, 4, 5)


@kernel
def relative_point(link, coordinates, row):
    """Position of T X."""
    shift = matvec3(matrix3(link["rotation"]), load3(coordinates, row, 9))
    return add3(vector3(link["point"]), shift)


@kernel
def project_pose(link, rot, p, coordinates, row):
    """X nearest to a relative pose."""
    store9(so3_nearest(rot), coordinates, row, 0)
    store3(p, coordinates, row, 9)


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi)."""
    xi = (screws[at, 0], screws[at + 1, 0], screws[at + 2, 0])
    eta = (screws[at + 3, 0], screws[at + 4, 0], screws[at + 5, 0])
    relative, shift = se3_exp(xi, eta)
    rot, p = se3_compose(load9(coordinates, row, 0), load3(coordinates, row, 9), relative, shift)
    store9(rot, out, row, 0)
    store3(p, out, row, 9)
    return dot3(xi, xi)


@kernel
def move_coordinates(link, coordinates, row, psi, at, out):
    """Displace X by a column: rotation and translation, independently of each other."""
    rot = load9(coordinates, row, 0)
    shift = matvec3(rot, (psi[at + 3, 0], psi[at + 4, 0], psi[at + 5, 0]))
    store3(add3(load3(coordinates, row, 9), shift), out, row, 9)
    relative = so3_exp((psi[at, 0], psi[at + 1, 0], psi[at + 2, 0]))
    store9(matmul3(rot, relative), out, row, 0)


@kernel
def slope(link, first, b, u, rates, row, slopes, at):
    """Replace Psi by dexp^-1_{-Psi} qdot."""
    xi = (-slopes[at, 0], -slopes[at + 1, 0], -slopes[at + 2, 0])
    eta = (-slopes[at + 3, 0], -slopes[at + 4, 0], -slopes[at + 5, 0])
    w, v = load3(rates, row, 0), load3(rates, row, 3)
    w, v = se3_dexpinv_of(first, b, u, xi, eta, w, v)
    for c in range(3):
        slopes[at + c, 0] = w[c]
        slopes[at + 3 + c, 0] = v[c]


@kernel
def eliminate(link, work, f, m, torque, force):
    """Eliminate all degrees of freedom from an articulated body. Nothing remains for a parent."""
    m, torque, force = _without_z(work, f + 2, m, torque, force)
    m, torque, force = _without_x(work, f, m, torque, force)
    m, torque, force = _without_y(work, f + 1, m, torque, force)
    xx, xy, xz, yy, yz, zz = m[15], m[16], m[17], m[18], m[19], m[20]
    store_freedom(work, f + 3, (0.0, 0.0, 0.0, xx, xy, xz), 1.0 / xx, -force[0])
    a, b = xy / xx, xz / xx
    yy, yz, zz = yy - a * xy, yz - a * xz, zz - b * xz
    y, z = force[1] - a * force[0], force[2] - b * force[0]
    store_freedom(work, f + 4, (0.0, 0.0, 0.0, 0.0, yy, yz), 1.0 / yy, -y)
    c = yz / yy
    zz -= c * yz
    store_freedom(work, f + 5, (0.0, 0.0, 0.0, 0.0, 0.0, zz), 1.0 / zz, c * y - z)
    return m, torque, force


@kernel
def leave(link, work, f, place, rows, torque, force):
    """Write the responses of all freedoms. Nothing remains for a parent."""
    w, v = leave_direction(work, f + 2, torque[2], place, torque, force)
    w, v = leave_direction(work, f, w[0], place + rows, (w[0], w[1], 0.0), v)
    w, v = leave_direction(work, f + 1, w[1], place + 2 * rows, (0.0, w[1], 0.0), v)
    w, v = leave_direction(work, f + 3, v[0], place + 3 * rows, ZERO3, v)
    w, v = leave_direction(work, f + 4, v[1], place + 4 * rows, ZERO3, v)
    leave_direction(work, f + 5, v[2], place + 5 * rows, ZERO3, v)
    return ZERO3, ZERO3
