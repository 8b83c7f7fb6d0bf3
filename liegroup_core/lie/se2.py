# SPDX-License-Identifier: Apache-2.0
"""Motions of a plane, SE(2), on tuples: se3.py with three numbers for a twist, as far as sweeps need it.

Pose (c, s, x, y): cosine and sine of its angle, and its position in m. Twist (omega, x, y), wrench
(torque, x, y).
"""

from liegroup_core.compiling import kernel


@kernel
def turn2(c, s, x, y):
    """R v."""
    return c * x - s * y, s * x + c * y


@kernel
def turn_back2(c, s, x, y):
    """R^T v."""
    return c * x + s * y, c * y - s * x


@kernel
def se2_compose(P, Q):
    """Product of two poses."""
    c, s, x, y = P
    dx, dy = turn2(c, s, Q[2], Q[3])
    return c * Q[0] - s * Q[1], s * Q[0] + c * Q[1], x + dx, y + dy


@kernel
def se2_inverse(P):
    """Inverse of a pose."""
    x, y = turn_back2(P[0], P[1], P[2], P[3])
    return P[0], -P[1], -x, -y


@kernel
def se2_between(P, Q):
    """P^-1 Q."""
    c, s, x, y = P
    x, y = turn_back2(c, s, Q[2] - x, Q[3] - y)
    return c * Q[0] + s * Q[1], c * Q[1] - s * Q[0], x, y


@kernel
def se2_Ad(P, V):
    """Ad_P V."""
    x, y = turn2(P[0], P[1], V[1], V[2])
    return V[0], x + V[0] * P[3], y - V[0] * P[2]


@kernel
def se2_Ad_inverse(P, V):
    """Ad_P^-1 V: a twist of the frame a in that of b, whose pose in a is P."""
    x, y = turn_back2(P[0], P[1], V[1] - V[0] * P[3], V[2] + V[0] * P[2])
    return V[0], x, y


@kernel
def se2_wrench(P, F):
    """Ad_P^-T F: a wrench on b in the frame of a."""
    x, y = turn2(P[0], P[1], F[1], F[2])
    return F[0] + (P[2] * y - P[3] * x), x, y


@kernel
def se2_turned_mass(c, s, xx, xy, yy):
    """R M R^T of a symmetric (2, 2) matrix."""
    m0, m1 = c * xx - s * xy, c * xy - s * yy
    n0, n1 = s * xx + c * xy, s * xy + c * yy
    return m0 * c - m1 * s, n0 * c - n1 * s, n0 * s + n1 * c
