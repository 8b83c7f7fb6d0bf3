# SPDX-License-Identifier: Apache-2.0
"""SO(3): a link turns about the origin of its frame. Coordinates: the rotation, row by row."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.so3 import so3_dexpinv_of, so3_exp, so3_nearest
from liegroup_core.lie.vec3 import ZERO3, add3, dot3, load3, load9, matmul3, matrix3, store3, store9

from .articulated import add_mass, mass_times

NAME = "SO(3)"
JOINTS = {"spherical": "the frames share their origin; the child rotates freely about it (ball joint)"}
COMPONENTS, ORDER = (0, 1, 2), (2, 0, 1)


@kernel
def relative_rotation(link, coordinates, row):
    """Rotation of T X."""
    return matmul3(matrix3(link["rotation"]), load9(coordinates, row, 0))


@kernel
def project_pose(link, rot, p, coordinates, row):
    """X nearest to a relative pose."""
    store9(so3_nearest(rot), coordinates, row, 0)
    store3(ZERO3, coordinates, row, 9)


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi)."""
    xi = (screws[at, 0], screws[at + 1, 0], screws[at + 2, 0])
    store9(matmul3(load9(coordinates, row, 0), so3_exp(xi)), out, row, 0)
    return dot3(xi, xi)


@kernel
def normalise(link, coordinates, row):
    """Remove the round-off by which products of rotations leave SO(3)."""
    store9(so3_nearest(load9(coordinates, row, 0)), coordinates, row, 0)


@kernel
def slope(link, first, b, u, rates, row, slopes, at):
    """Replace Psi by dexp^-1_{-Psi} qdot."""
    psi = (-slopes[at, 0], -slopes[at + 1, 0], -slopes[at + 2, 0])
    w = so3_dexpinv_of(first, b, psi, load3(rates, row, 0))
    for c in range(3):
        slopes[at + c, 0] = w[c]


@kernel
def hand_on(link, work, b, m, torque, force):
    """Add the rest, only a mass matrix, to the parent."""
    force = add3(force, mass_times(m, load3(work.drift, b, 3)))
    rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
    add_mass(m, rot, p, work.inertia, link["parent"])
    return True, torque, force
