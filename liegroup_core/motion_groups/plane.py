# SPDX-License-Identifier: Apache-2.0
"""SE(2): a link turns about z and moves along x and y."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.coefficients import turn_coefficients

from .about_z import turned_by

NAME = "SE(2)"
JOINTS = {
    "planar": "the frames share the x-y plane; the child translates and rotates in it (plate on a plate)"
}
COMPONENTS = PLANE_COMPONENTS = (2, 3, 4)


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi)."""
    psi = screws[at, 0]
    sinc, versinc = turn_coefficients(psi * psi)
    c, s = 1.0 - psi * psi * versinc, psi * sinc
    c0, s0 = coordinates[row, 0], coordinates[row, 1]
    # dexp_psi of the translation, in the axes of the start
    x, y = screws[at + 1, 0], screws[at + 2, 0]
    q = psi * versinc
    x, y = sinc * x - q * y, sinc * y + q * x
    x0, y0 = coordinates[row, 2], coordinates[row, 3]
    out[row, 2], out[row, 3] = x0 + (c0 * x - s0 * y), y0 + (s0 * x + c0 * y)
    out[row, 0], out[row, 1] = c0 * c - s0 * s, s0 * c + c0 * s
    return psi * psi


@kernel
def move_coordinates(link, coordinates, row, psi, at, out):
    """X displaced by `move`: rotation and shift are independent of each other."""
    c, s, x, y = coordinates[row, 0], coordinates[row, 1], psi[at + 1, 0], psi[at + 2, 0]
    out[row, 2] = coordinates[row, 2] + (c * x - s * y)
    out[row, 3] = coordinates[row, 3] + (s * x + c * y)
    out[row, 0], out[row, 1] = turned_by(psi[at, 0], c, s)


@kernel
def slope(link, first, b, u, rates, row, slopes, at):
    """dexp^-1_{-Psi} qdot in place of Psi."""
    xi, ex, ey = slopes[at, 0], slopes[at + 1, 0], slopes[at + 2, 0]
    w, vx, vy = rates[row, 0], rates[row, 1], rates[row, 2]
    gx, gy = ey * w - xi * vy, xi * vx - ex * w
    slopes[at, 0] = w
    slopes[at + 1, 0] = vx + first * gx - b * xi * gy
    slopes[at + 2, 0] = vy + first * gy + b * xi * gx
