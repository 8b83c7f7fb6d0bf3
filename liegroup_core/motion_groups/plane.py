# SPDX-License-Identifier: Apache-2.0
"""SE(2): a link turns about z and moves along x and y."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.coefficients import turn_coefficients
from liegroup_core.lie.vec3 import ZERO3

from .about_z import normalise as plane_normalise  # noqa: F401
from .about_z import turned_by
from .elimination import inverse_of
from .in_plane import store_freedom

NAME = "SE(2)"
JOINTS = {"planar": "the frames share the x-y plane; the child translates and rotates in it (plate on a plate)"}
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
    """Displace X by a column: rotation and translation, independently of each other."""
    c, s, x, y = coordinates[row, 0], coordinates[row, 1], psi[at + 1, 0], psi[at + 2, 0]
    out[row, 2] = coordinates[row, 2] + (c * x - s * y)
    out[row, 3] = coordinates[row, 3] + (s * x + c * y)
    out[row, 0], out[row, 1] = turned_by(psi[at, 0], c, s)


@kernel
def slope(link, first, b, u, rates, row, slopes, at):
    """Replace Psi by dexp^-1_{-Psi} qdot."""
    xi, ex, ey = slopes[at, 0], slopes[at + 1, 0], slopes[at + 2, 0]
    w, vx, vy = rates[row, 0], rates[row, 1], rates[row, 2]
    gx, gy = ey * w - xi * vy, xi * vx - ex * w
    slopes[at, 0] = w
    slopes[at + 1, 0] = vx + first * gx - b * xi * gy
    slopes[at + 2, 0] = vy + first * gy + b * xi * gx


# In a planar mechanism the coordinates are those of T X: products from the right are the same.
plane_displace, plane_move_coordinates = displace, move_coordinates
plane_hand_on = "return"


@kernel
def plane_add_rates(link, S, V):
    """V and [V, S qdot] of a planar mechanism."""
    w, x, y = V[0] + S[0], V[1] + S[1], V[2] + S[2]
    return (w, x, y), (S[0] * y - w * S[2], w * S[1] - S[0] * x)


@kernel
def plane_eliminate(link, work, f, m, F):
    """Eliminate all degrees of freedom of the plane from an articulated body; stores U in its own axes."""
    ww, wx, wy, xx, xy, yy = m
    _, fx, fy = F
    inverse, u = inverse_of(ww), -F[0]
    store_freedom(work, f, (ww, wx, wy), inverse, u)
    share = inverse * wx
    xx, xy, fx = xx - share * wx, xy - share * wy, fx + share * u
    share = inverse * wy
    yy, fy = yy - share * wy, fy + share * u
    inverse, u = inverse_of(xx), -fx
    store_freedom(work, f + 1, (0.0, xx, xy), inverse, u)
    share = inverse * xy
    yy, fy = yy - share * xy, fy + share * u
    store_freedom(work, f + 2, (0.0, 0.0, yy), inverse_of(yy), -fy)
    return m, F


@kernel
def plane_accelerate(link, work, f, E, V):
    """E of a link with all degrees of freedom of the plane; V: E without them."""
    U, qddot = work.freedoms, work.acceleration
    y = U[f + 2, 6] * U[f + 2, 7]
    x = U[f + 1, 6] * (U[f + 1, 7] - U[f + 1, 2] * y)
    w = U[f, 6] * (U[f, 7] - (U[f, 1] * x + U[f, 2] * y))
    qddot[f, 0], qddot[f + 1, 0], qddot[f + 2, 0] = w - V[0], x - V[1], y - V[2]
    return w, x, y


@kernel
def plane_leave(link, work, f, row, F):
    """Remaining wrench, which is zero, and the components of the freedoms."""
    U = work.freedoms
    share = F[0] * U[f, 6]
    x, y = F[1] - share * U[f, 1], F[2] - share * U[f, 2]
    return ZERO3, F[0], x, y - x * U[f + 1, 6] * U[f + 1, 2]
