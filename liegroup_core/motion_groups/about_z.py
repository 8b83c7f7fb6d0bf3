# SPDX-License-Identifier: Apache-2.0
"""Coordinates (cos, sin, x, y, z) of the groups that rotate about z only, and translate."""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.coefficients import turn_coefficients
from liegroup_core.lie.vec3 import add3, load3, matrix3, matvec3, vector3


@kernel
def turned(m, c, s):
    """m Rz for a rotation about z with cosine c and sine s."""
    return (
        c * m[0] + s * m[1],
        c * m[1] - s * m[0],
        m[2],
        c * m[3] + s * m[4],
        c * m[4] - s * m[3],
        m[5],
        c * m[6] + s * m[7],
        c * m[7] - s * m[6],
        m[8],
    )


@kernel
def nearest_turn(c, s):
    """Cosine and sine of an angle, from multiples of them.

    R00 + R11 and R10 - R01 are multiples for the rotation about z nearest to R. If R turns z upside down, no
    angle is nearest; the joint does not allow such a pose.
    """
    length = math.sqrt(c * c + s * s)
    return (c / length, s / length) if length > 0.0 else (1.0, 0.0)


@kernel
def turn_of(rot):
    """Cosine and sine of the rotation about z nearest to a rotation."""
    return nearest_turn(rot[0] + rot[4], rot[3] - rot[1])


@kernel
def turned_by(angle, c, s):
    """Cosine and sine of the sum of `angle` and the angle with cosine c and sine s."""
    sinc, versinc = turn_coefficients(angle * angle)
    less, sine = -angle * angle * versinc, angle * sinc
    return c + (less * c - sine * s), s + (less * s + sine * c)


@kernel
def relative_rotation(link, coordinates, row):
    """Rotation of T X."""
    return turned(matrix3(link["rotation"]), coordinates[row, 0], coordinates[row, 1])


@kernel
def relative_point(link, coordinates, row):
    """Position of T X."""
    shift = matvec3(matrix3(link["rotation"]), load3(coordinates, row, 2))
    return add3(vector3(link["point"]), shift)


@kernel
def turn(link, coordinates, row, screws, at, out):
    """Write the rotation of X exp(Psi), by the first number of Psi; returns its squared angle, rad^2."""
    psi = screws[at, 0]
    sinc, versinc = turn_coefficients(psi * psi)
    c, s = 1.0 - psi * psi * versinc, psi * sinc
    c0, s0 = coordinates[row, 0], coordinates[row, 1]
    out[row, 0], out[row, 1] = c0 * c - s0 * s, s0 * c + c0 * s
    return psi * psi


@kernel
def normalise(link, coordinates, row):
    """Remove the round-off by which products of rotations leave SO(2)."""
    c, s = coordinates[row, 0], coordinates[row, 1]
    scale = 1.5 - 0.5 * (c * c + s * s)
    coordinates[row, 0], coordinates[row, 1] = scale * c, scale * s


@kernel
def store_place(c, s, x, y, z, coordinates, row):
    """Write coordinates."""
    coordinates[row, 0], coordinates[row, 1] = c, s
    coordinates[row, 2], coordinates[row, 3], coordinates[row, 4] = x, y, z
