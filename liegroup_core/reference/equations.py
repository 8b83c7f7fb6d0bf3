# SPDX-License-Identifier: Apache-2.0
"""Joints as geometric equations between directions and points, in world axes.

Every joint consists of these kinds of equations, one row each; the first three as in Haug, Computer Aided
Kinematics and Dynamics of Mechanical Systems, 1989, chapter 9 (dot-1, dot-2, distance):

    ACROSS    e . f = 0                             a direction e of the parent, f of the child
    LEVEL     e . d - pitch theta - offset = 0      d from the point of the parent to that of the child
    DISTANCE  (d . d - length^2) / (2 length) = 0
    ANGLE     theta                                 of a coupled joint, and LEVEL of a coupled slide
    WHEEL     e . u = 0                             u: velocity of the child, relative to the parent, where its rim
    BALL      e . u = 0                             is lowest, or below its centre; g: the height there if e = z
    EDGE      f . u = 0                             u: velocity of the child's point

A coupling is the difference q_1 - p(q_2) - c_3 q_3 - ... of such coordinates, minus its value at the start;
p(q) = ratio q + a_2 q^2 + a_3 q^3 + a_4 q^4.
A driven joint is one coordinate minus its motion, whose q(t), rate and acceleration are given.
theta is the angle of a screw. Its rate is integrated with the motion, so that it is unwrapped. Each
equation g = 0 is given with its first and second time derivatives. A rotor of inertia I is a row with the
compliance 1/I: its coordinate is free, and the acceleration needs the force I qddot.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import kernel, subroutine

from .vectors import add_three, cross, direction, dot, plus, point, three, turning

ACROSS, LEVEL, DISTANCE, ANGLE, WHEEL, BALL, EDGE = 0, 1, 2, 3, 4, 5, 6
X, Y, Z = 0, 1, 2  # axes of a joint frame

# The equations of each kind of joint: (ACROSS, axis of the parent's frame, axis of the child's)
# and (LEVEL, axis of the parent's frame), between the origins of the frames.
_SAME_POINT = ((LEVEL, X), (LEVEL, Y), (LEVEL, Z))
_SAME_Z = ((ACROSS, X, Z), (ACROSS, Y, Z))
_NO_TURN = ((ACROSS, X, Y),)
_ON_THE_AXIS = ((LEVEL, X), (LEVEL, Y))
JOINTS = {
    "spherical": _SAME_POINT,
    "revolute": _SAME_POINT + _SAME_Z,
    "prismatic": _ON_THE_AXIS + _SAME_Z + _NO_TURN,
    "cylindrical": _ON_THE_AXIS + _SAME_Z,
    "planar": _SAME_Z + ((LEVEL, Z),),
    "screw": _ON_THE_AXIS + _SAME_Z + ((LEVEL, Z),),
    "fixed": _SAME_POINT + _SAME_Z + _NO_TURN,
    "universal": _SAME_POINT + _NO_TURN,
    "distance": ((DISTANCE,),),
    "wheel": tuple((WHEEL, axis, Z) for axis in (X, Y, Z)),
    "ball_on_plane": tuple((BALL, axis, Z) for axis in (X, Y, Z)),
    "knife_edge": ((EDGE, X, Y),),
}


class Equations(NamedTuple):
    """Equations of all joints of a scene: k rows, t joints with an integrated angle."""

    kind: np.ndarray  # (k,) ACROSS, LEVEL, DISTANCE or ANGLE
    body: np.ndarray  # (k, s) parent, child, those of the other joints of a coupling; n: the world, or none
    point: np.ndarray  # (k, 6) m, in the frames of parent and child
    axis: np.ndarray  # (k, 6) e in the parent's axes, f in the child's
    normal: np.ndarray  # (k, 3) z of the parent's joint frame in its axes
    length: np.ndarray  # (k,) m, of a DISTANCE; the offset of a LEVEL; the radius of a WHEEL or BALL
    pitch: np.ndarray  # (k,) m/rad
    turn: np.ndarray  # (k,) index of the angle theta, or -1
    coupled: np.ndarray  # (c,) first of the rows of each coupling, one for each joint, at the end
    ratio: np.ndarray  # (c,)
    curve: np.ndarray  # (c, 3) a_2, a_3, a_4
    shares: np.ndarray  # (c, s / 2 - 2) c_3, ...; 0: no such joint
    offset: np.ndarray  # (c,) q_1 - p(q_2) - c_3 q_3 - ...
    driven: np.ndarray  # (c,) number of a driven joint, whose ratio is 0; -1: a coupling
    compliance: np.ndarray  # (k,) 1/inertia of the rotor on the coordinate of the row, 1/(kg m^2) or 1/kg; else 0


@kernel
def _pull(rows, r, slot, arm, axis, sign):
    """Add to a row the acceleration along an axis of the point of a body at an arm from its centre."""
    add_three(rows, r, 6 * slot, sign, axis)
    add_three(rows, r, 6 * slot + 3, sign, cross(arm, axis))


@kernel
def _turn(rows, r, axis, factor):
    """Add to a row a multiple of the angular acceleration of the child, relative to the parent, about an axis."""
    add_three(rows, r, 9, factor, axis)
    add_three(rows, r, 3, -factor, axis)


@kernel
def _set_rolling(equations, r, frame, rows, gap_out):
    """Row and gaps of a WHEEL, BALL or EDGE."""
    kind, a, b = equations.kind[r], equations.body[r, 0], equations.body[r, 1]
    s, s_rate, _ = point(frame, b, three(equations.point, r, 3))
    n, n_rate, _ = direction(frame, a, three(equations.normal, r, 0))
    f, f_rate, _ = direction(frame, b, three(equations.axis, r, 3))
    t, t_rate, _ = direction(frame, a, three(equations.axis, r, 0))
    if kind == EDGE:
        t, t_rate = f, f_rate
    else:  # the contact point is lowest
        down, down_rate = plus(n, -2.0, n), plus(n_rate, -2.0, n_rate)
        if kind == WHEEL:
            along, rate = dot(f, down), dot(f_rate, down) + dot(f, down_rate)
            across = plus(down, -along, f)
            moving = plus(plus(down_rate, -rate, f), -along, f_rate)
            length = np.sqrt(dot(across, across))
            down = plus(across, 1.0 / length - 1.0, across)
            down_rate = plus(moving, -dot(down, moving), down)
            down_rate = plus(down_rate, 1.0 / length - 1.0, down_rate)
        s, s_rate = plus(s, equations.length[r], down), plus(s_rate, equations.length[r], down_rate)
        at = point(frame, a, three(equations.point, r, 0))[0]
        if dot(n, t) > 0.5:
            gap_out[0, r] = dot(n, plus(s, -1.0, at))
    for slot in range(2):
        body, sign = equations.body[r, slot], 2.0 * slot - 1.0
        omega, velocity = three(frame, body, 15), three(frame, body, 12)
        arm, rate = plus(s, -1.0, three(frame, body, 9)), plus(s_rate, -1.0, velocity)
        slip = plus(velocity, 1.0, cross(omega, arm))
        gap_out[1, r] += sign * dot(t, slip)
        gap_out[2, r] += sign * (dot(t_rate, slip) + dot(t, cross(omega, rate)))
        _pull(rows, r, slot, arm, t, sign)


@kernel
def _set_row(equations, r, frame, angle, rows, gap_out):
    """Row and gaps of any other equation; the turn of a screw included."""
    kind, a, b = equations.kind[r], equations.body[r, 0], equations.body[r, 1]
    e, e_rate, e_change = direction(frame, a, three(equations.axis, r, 0))
    turn, spin = equations.turn[r], turning(frame, a, b)
    theta = angle[turn] if turn >= 0 else 0.0
    if kind == ACROSS:
        f, f_rate, f_change = direction(frame, b, three(equations.axis, r, 3))
        gap_out[0, r] = dot(e, f)
        gap_out[1, r] = dot(e_rate, f) + dot(e, f_rate)
        gap_out[2, r] = dot(e_change, f) + 2.0 * dot(e_rate, f_rate) + dot(e, f_change)
        _turn(rows, r, cross(f, e), 1.0)
    elif kind == ANGLE:
        gap_out[0, r], gap_out[1, r], gap_out[2, r] = theta, dot(e, spin), dot(e_rate, spin)
        _turn(rows, r, e, 1.0)
    else:
        start, end = point(frame, a, three(equations.point, r, 0)), point(frame, b, three(equations.point, r, 3))
        d, d_rate, d_change = plus(end[0], -1.0, start[0]), plus(end[1], -1.0, start[1]), plus(end[2], -1.0, start[2])
        length, pitch = equations.length[r], equations.pitch[r]
        if kind == DISTANCE:
            gap_out[0, r] = (dot(d, d) / length - length) / 2.0
            gap_out[1, r] = dot(d, d_rate) / length
            gap_out[2, r] = (dot(d_rate, d_rate) + dot(d, d_change)) / length
            axis = plus(d, 1.0 / length - 1.0, d)
        else:
            gap_out[0, r] = dot(e, d) - length - pitch * theta
            gap_out[1, r] = dot(e_rate, d) + dot(e, d_rate) - pitch * dot(e, spin)
            gap_out[2, r] = dot(e_change, d) + 2.0 * dot(e_rate, d_rate) + dot(e, d_change) - pitch * dot(e_rate, spin)
            axis = e
        # e of the parent turns: the force on it acts at the point of the child
        _pull(rows, r, 0, plus(end[0], -1.0, three(frame, a, 9)), axis, -1.0)
        _pull(rows, r, 1, plus(end[0], -1.0, three(frame, b, 9)), axis, 1.0)
        if kind == LEVEL:
            _turn(rows, r, e, -pitch)


@subroutine
def joint_equations(equations, frame, angle, given, rows_out, gap_out):
    """Evaluate all equations g = 0 at one state.

    frame    : (n + 1, FRAME) of vectors.place
    angle    : (t,) rad
    given    : (3, d) coordinate, rate, acceleration of the driven joints
    rows_out : (k, 6 s) A: for parent and child, and those of the other joints of a coupling, the factors of
               (rddot, omegadot) in world axes, so that gddot = A a + gap_out[2]
    gap_out  : (3, k) g, gdot, and gddot at a = 0. g is in m; for ACROSS it is the cosine, which is an
               angle in rad if small
    """
    for r in range(len(equations.kind)):
        for c in range(rows_out.shape[1]):
            rows_out[r, c] = 0.0
        for c in range(3):
            gap_out[c, r] = 0.0
        if equations.kind[r] >= WHEEL:
            _set_rolling(equations, r, frame, rows_out, gap_out)
        else:
            _set_row(equations, r, frame, angle, rows_out, gap_out)
    for c in range(len(equations.coupled)):
        first, d = equations.coupled[c], equations.driven[c]
        q, v, a = gap_out[0, first + 1], gap_out[1, first + 1], gap_out[2, first + 1]
        value, slope, bend = equations.ratio[c] * q, equations.ratio[c], 0.0
        for k in range(3):
            factor = equations.curve[c, k]
            value += factor * q ** (k + 2)
            slope += (k + 2) * factor * q ** (k + 1)
            bend += (k + 2) * (k + 1) * factor * q**k
        gap_out[0, first] -= value + equations.offset[c]
        gap_out[1, first] -= slope * v
        gap_out[2, first] -= slope * a + bend * v * v
        for k in range(12):
            rows_out[first, 12 + k] = -slope * rows_out[first + 1, k]
        for j in range(equations.shares.shape[1]):
            share, r = equations.shares[c, j], first + 2 + j
            for k in range(3 if share != 0.0 else 0):
                gap_out[k, first] -= share * gap_out[k, r]
            for k in range(12 if share != 0.0 else 0):
                rows_out[first, 24 + 12 * j + k] = -share * rows_out[r, k]
        if d >= 0:
            for k in range(3):
                gap_out[k, first] -= given[k, d]
            if equations.kind[first] == ANGLE:
                gap_out[0, first] -= 2.0 * np.pi * np.round(gap_out[0, first] / (2.0 * np.pi))
