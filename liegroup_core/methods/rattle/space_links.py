# SPDX-License-Identifier: Apache-2.0
"""Momenta and displacements of links in space, for a RATTLE step; halves.py has the equations.

A link moves in a substep by D = C^-1 C+, in the axes of its start. With the pose C_ba of the joint
at the start, and the displacement X of the joint,
    D_b = C_ba^-1 D_a C_ba X
The rotation of D is a unit quaternion (c, q). Its vector part q and the translation are computed as products of
small numbers, so velocities D / h keep all digits. A difference of poses would lose them.
"""

import math

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.coefficients import dexpinv_coefficients, sum_series, turn_coefficients
from liegroup_core.lie.so3 import so3_dexpinv_of
from liegroup_core.lie.vec3 import (
    add3,
    axpy3,
    cross3,
    dot3,
    load3,
    load9,
    matmul3,
    matvec3,
    scale3,
    store3,
    store9,
    sub3,
    tmatvec3,
    vector3,
)
from liegroup_core.motion_groups import table
from liegroup_core.motion_groups.articulated import symmetric_times
from liegroup_core.status import LARGEST_ROTATION

# (2k)! / (4^k k!^2 (2k+1)): arcsin s / s in powers of s^2
ARCSIN_SERIES = (
    1.0,
    0.16666666666666666,
    0.075,
    0.044642857142857144,
    0.030381944444444444,
    0.022372159090909092,
    0.017352764423076924,
    0.01396484375,
    0.011551800896139705,
    0.009761609529194078,
    0.008390335809616815,
    0.0073125258735988454,
)
# s^2 from which on the angle is halved first: twelve terms are exact to 1e-18 below it.
ARCSIN_BELOW = 0.0625


@kernel
def _angle_over_sine(c, square):
    """t / sin(t/2) for c = cos(t/2) and square = sin^2(t/2); t < 2 pi."""
    factor = 2.0
    while square >= ARCSIN_BELOW:
        # sin^2(t/4), without cancellation for both signs of c
        square = square / (2.0 * (1.0 + c)) if c > 0.0 else 0.5 * (1.0 - c)
        c = math.sqrt(0.5 * (1.0 + c))
        factor /= c
    return factor * sum_series(ARCSIN_SERIES, square)


@kernel
def _shifted(c, q, p):
    """(R - 1) p for the rotation R of a unit quaternion (c, q)."""
    return scale3(2.0, cross3(q, axpy3(c, p, cross3(q, p))))


@kernel
def _turned_back(c, q, p):
    """R^T p."""
    return sub3(p, scale3(2.0, cross3(q, sub3(scale3(c, p), cross3(q, p)))))


@kernel
def _half_turn(x):
    """Unit quaternion of a rotation vector, and its angle."""
    square = dot3(x, x)
    sinc, versinc = turn_coefficients(0.25 * square)
    return 1.0 - 0.25 * square * versinc, scale3(0.5 * sinc, x), math.sqrt(square)


@subroutine
def displace_links(model, work, memory, h):
    """Displacements of all links for memory.psi, M V', and its difference from the impulse.

    Writes memory.moves and half, and M V' - memory.impulse to work.force; the largest squared
    rotation of a link to memory.turned. Uses work.relative of the start.
    returns the largest sum of the angles that compose the rotation of a link, rad; if it is NaN or not below
    LARGEST_ROTATION, results are incomplete
    """
    moves, half = memory.moves, memory.half
    largest = turned = 0.0
    for b in range(len(model.links)):
        link = model.links[b]
        a = link["parent"]
        x, t = table.column_twist(link, memory.psi, link["freedom"])
        c, q, angle = _half_turn(x)
        if a != WORLD:
            rot, p = load9(work.relative, b, 0), load3(work.relative, b, 9)
            ca, qa, ta = moves[a, 0], load3(moves, a, 1), load3(moves, a, 4)
            ta = tmatvec3(rot, add3(ta, _shifted(ca, qa, p)))
            qa = tmatvec3(rot, qa)
            t = add3(ta, add3(t, _shifted(ca, qa, t)))
            c, q = (ca * c - dot3(qa, q), add3(axpy3(ca, q, scale3(c, qa)), cross3(qa, q)))
            angle += moves[a, 7]
        if not angle < LARGEST_ROTATION:
            return angle
        moves[b, 0] = c
        store3(q, moves, b, 1)
        store3(t, moves, b, 4)
        moves[b, 7] = angle
        largest = max(largest, angle)
        square = dot3(q, q)
        x = scale3(_angle_over_sine(c, square), q)
        rotation = dot3(x, x)
        turned = max(turned, rotation)
        centre = load3(memory.centre, b, 0)
        I = memory.central
        y = symmetric_times(I[b, 0], I[b, 1], I[b, 2], I[b, 3], I[b, 4], I[b, 5], x)
        factor, _ = dexpinv_coefficients(rotation)
        y = scale3(1.0 / h, so3_dexpinv_of(-0.5, factor, x, y))
        linear = scale3(link["mass"] / h, add3(t, _shifted(c, q, centre)))
        store3(y, half, b, 0)
        store3(linear, half, b, 3)
        y = add3(y, cross3(centre, linear))
        store3(sub3(y, load3(memory.impulse, b, 0)), work.force, b, 0)
        store3(sub3(linear, load3(memory.impulse, b, 3)), work.force, b, 3)
    memory.turned[0] = turned
    return largest


@kernel
def place_ends(model, work, memory):
    """Write the poses in the world of the links of cut joints after memory.moves to memory.world."""
    for e in range(len(model.elements)):
        for b in (model.elements[e]["parent"], model.elements[e]["child"]):
            if b != WORLD:
                c, q, t = (memory.moves[b, 0], load3(memory.moves, b, 1), load3(memory.moves, b, 4))
                x, y, z = q
                turn = (
                    1.0 - 2.0 * (y * y + z * z),
                    2.0 * (x * y - c * z),
                    2.0 * (x * z + c * y),
                    2.0 * (x * y + c * z),
                    1.0 - 2.0 * (x * x + z * z),
                    2.0 * (y * z - c * x),
                    2.0 * (x * z - c * y),
                    2.0 * (y * z + c * x),
                    1.0 - 2.0 * (x * x + y * y),
                )
                rot = load9(work.world, b, 0)
                store9(matmul3(rot, turn), memory.world, b, 0)
                store3(add3(load3(work.world, b, 9), matvec3(rot, t)), memory.world, b, 9)


@kernel
def weigh(model, work, memory):
    """Write the acceleration of gravity in link axes to memory.weight, weights to memory.load."""
    g = load3(model.space.gravity, 0, 0)
    for b in range(len(model.links)):
        link = model.links[b]
        a = link["parent"]
        above = g if a == WORLD else load3(memory.weight, a, 0)
        own = tmatvec3(load9(work.relative, b, 0), above)
        store3(own, memory.weight, b, 0)
        store3(cross3(vector3(link["moment"]), own), memory.load, b, 0)
        store3(scale3(link["mass"], own), memory.load, b, 3)


@kernel
def transport(model, work, memory):
    """Write M V'+ of all links, about the origin and in the axes of the end, to memory.impulse."""
    for b in range(len(model.links)):
        c, q = memory.moves[b, 0], load3(memory.moves, b, 1)
        angular = _turned_back(c, q, load3(memory.half, b, 0))
        linear = _turned_back(c, q, load3(memory.half, b, 3))
        angular = add3(angular, cross3(load3(memory.centre, b, 0), linear))
        store3(angular, memory.impulse, b, 0)
        store3(linear, memory.impulse, b, 3)
