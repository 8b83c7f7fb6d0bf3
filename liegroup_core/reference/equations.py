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

A coupling is the difference q_1 - p(q_2) of two such coordinates, minus its value at the start;
p(q) = ratio q + a_2 q^2 + a_3 q^3 + a_4 q^4.
A driven joint is one coordinate minus its motion, whose q(t), rate and acceleration are given.
theta is the angle of a screw. Its rate is integrated with the motion, so that it is unwrapped. Each
equation g = 0 is given with its first and second time derivatives.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import subroutine

GROUND = -1  # body index of the world
STATE = 13  # numbers per body: quaternion, position, velocity, angular velocity
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
    body: np.ndarray  # (k, 2) parent, child; GROUND = -1
    point: np.ndarray  # (k, 2, 3) m, in the frames of parent and child
    axis: np.ndarray  # (k, 2, 3) e in the parent's axes, f in the child's
    normal: np.ndarray  # (k, 3) z of the parent's joint frame in its axes
    length: np.ndarray  # (k,) m, of a DISTANCE; the offset of a LEVEL; the radius of a WHEEL or BALL
    pitch: np.ndarray  # (k,) m/rad
    turn: np.ndarray  # (k,) index of the angle theta, or -1
    coupled: np.ndarray  # (c,) first of the two rows of each coupling, at the end
    ratio: np.ndarray  # (c,)
    curve: np.ndarray  # (c, 3) a_2, a_3, a_4
    offset: np.ndarray  # (c,) q_1 - p(q_2)
    driven: np.ndarray  # (c,) number of a driven joint, whose ratio is 0; -1: a coupling
    given: np.ndarray  # (3, d) coordinate, rate, acceleration of driven joints: input of an evaluation


@subroutine
def rotate(q, x):
    """Vector x rotated by the quaternion q (w, x, y, z) of any norm except zero."""
    u = q[1:4]
    t = 2.0 * np.cross(u, x) / np.dot(q, q)
    return x + q[0] * t + np.cross(u, t)


@subroutine
def rotate_back(q, x):
    """Vector x rotated by the inverse of q."""
    u = -q[1:4]
    t = 2.0 * np.cross(u, x) / np.dot(q, q)
    return x + q[0] * t + np.cross(u, t)


@subroutine
def direction(state, body, fixed):
    """World components (3, 3) of a body-fixed direction and its first two time derivatives.

    The second derivative excludes the terms with omegadot.
    """
    out = np.zeros((3, 3))
    if body == GROUND:
        out[0] = fixed
        return out
    q = state[body, 0:4]
    omega = state[body, 10:13]
    rate = np.cross(omega, fixed)
    out[0] = rotate(q, fixed)
    out[1] = rotate(q, rate)
    out[2] = rotate(q, np.cross(omega, rate))
    return out


@subroutine
def point(state, body, fixed):
    """Position, velocity and acceleration (3, 3) of a body-fixed point, world axes.

    The acceleration excludes the terms with rddot and omegadot.
    """
    out = direction(state, body, fixed)
    if body != GROUND:
        out[0] += state[body, 4:7]
        out[1] += state[body, 7:10]
    return out


@subroutine
def turning(state, parent, child):
    """Angular velocity of the child relative to the parent, world axes, rad/s."""
    out = np.zeros(3)
    if child != GROUND:
        out += rotate(state[child, 0:4], state[child, 10:13])
    if parent != GROUND:
        out -= rotate(state[parent, 0:4], state[parent, 10:13])
    return out


@subroutine
def _add_translation(row, state, body, offset, axis):
    """Add to a row the acceleration along a world vector of a point of a body.

    offset : (3,) m, of the point in the body frame
    """
    if body != GROUND:
        row[6 * body : 6 * body + 3] += axis
        # axis . (R (omegadot x p)) = omegadot . (p x R^T axis)
        row[6 * body + 3 : 6 * body + 6] += np.cross(offset, rotate_back(state[body, 0:4], axis))


@subroutine
def _add_rotation(row, state, body, axis):
    """Add to a row the angular acceleration of a body about a world vector."""
    if body != GROUND:
        row[6 * body + 3 : 6 * body + 6] += rotate_back(state[body, 0:4], axis)


@subroutine
def _contact(equations, r, state):
    """Contact point of a WHEEL or BALL, the point of an EDGE: position and velocity (2, 3), world axes."""
    parent, child = equations.body[r]
    out = point(state, child, equations.point[r, 1])[:2].copy()
    if equations.kind[r] == EDGE:
        return out
    down = -direction(state, parent, equations.normal[r])[:2]
    if equations.kind[r] == WHEEL:
        a = direction(state, child, equations.axis[r, 1])
        along, rate = np.dot(a[0], down[0]), np.dot(a[1], down[0]) + np.dot(a[0], down[1])
        across = down[0] - along * a[0]
        moving = down[1] - rate * a[0] - along * a[1]
        length = np.sqrt(np.dot(across, across))
        down[0] = across / length
        down[1] = (moving - np.dot(down[0], moving) * down[0]) / length
    out += equations.length[r] * down
    return out


@subroutine
def _set_rolling(equations, r, state, row, gap_out):
    """Row and gaps of a WHEEL, BALL or EDGE."""
    parent, child = equations.body[r]
    s = _contact(equations, r, state)
    if equations.kind[r] == EDGE:
        t = direction(state, child, equations.axis[r, 1])
    else:
        t = direction(state, parent, equations.axis[r, 0])
    slip, change = np.zeros(3), np.zeros(3)
    for end in range(2):
        body = child if end == 0 else parent
        if body == GROUND:
            continue
        sign = 1.0 if end == 0 else -1.0
        arm, rate = s[0] - state[body, 4:7], s[1] - state[body, 7:10]
        omega = rotate(state[body, 0:4], state[body, 10:13])
        slip += sign * (state[body, 7:10] + np.cross(omega, arm))
        change += sign * np.cross(omega, rate)
        row[6 * body : 6 * body + 3] += sign * t[0]
        row[6 * body + 3 : 6 * body + 6] += sign * rotate_back(state[body, 0:4], np.cross(arm, t[0]))
    if equations.kind[r] != EDGE:
        n = direction(state, parent, equations.normal[r])[0]
        at = point(state, parent, equations.point[r, 0])[0]
        gap_out[0, r] = np.dot(n, s[0] - at) if np.dot(n, t[0]) > 0.5 else 0.0
    gap_out[1, r] = np.dot(t[0], slip)
    gap_out[2, r] = np.dot(t[1], slip) + np.dot(t[0], change)


@subroutine
def joint_equations(equations, state, angle, rows_out, gap_out):
    """Evaluate all equations g = 0 at one state.

    state    : (n, 13) quaternion, position, velocity (world), omega (body) of each body
    angle    : (t,) rad
    rows_out : (k, 6 n) A, so that gddot = A a + gap_out[2] with a = (rddot, omegadot) per body
    gap_out  : (3, k) g, gdot, and gddot at a = 0. g is in m; for ACROSS it is the cosine, which is an
               angle in rad if small
    """
    rows_out[:] = 0.0
    for r in range(len(equations.kind)):
        row = rows_out[r]
        parent, child = equations.body[r]
        e = direction(state, parent, equations.axis[r, 0])
        if equations.kind[r] == ACROSS:
            f = direction(state, child, equations.axis[r, 1])
            gap_out[0, r] = np.dot(e[0], f[0])
            gap_out[1, r] = np.dot(e[1], f[0]) + np.dot(e[0], f[1])
            gap_out[2, r] = np.dot(e[2], f[0]) + 2.0 * np.dot(e[1], f[1]) + np.dot(e[0], f[2])
            axis = np.cross(f[0], e[0])
            _add_rotation(row, state, child, axis)
            _add_rotation(row, state, parent, -axis)
            continue
        if equations.kind[r] == ANGLE:
            spin = turning(state, parent, child)
            gap_out[0, r] = angle[equations.turn[r]]
            gap_out[1, r] = np.dot(e[0], spin)
            gap_out[2, r] = np.dot(e[1], spin)
            _add_rotation(row, state, child, e[0])
            _add_rotation(row, state, parent, -e[0])
            continue
        if equations.kind[r] >= WHEEL:
            _set_rolling(equations, r, state, row, gap_out)
            continue
        d = point(state, child, equations.point[r, 1]) - point(state, parent, equations.point[r, 0])
        length = equations.length[r]
        if equations.kind[r] == DISTANCE:
            gap_out[0, r] = (np.dot(d[0], d[0]) / length - length) / 2.0
            gap_out[1, r] = np.dot(d[0], d[1]) / length
            gap_out[2, r] = (np.dot(d[1], d[1]) + np.dot(d[0], d[2])) / length
            axis = d[0] / length
        else:
            gap_out[0, r] = np.dot(e[0], d[0]) - length
            gap_out[1, r] = np.dot(e[1], d[0]) + np.dot(e[0], d[1])
            gap_out[2, r] = np.dot(e[2], d[0]) + 2.0 * np.dot(e[1], d[1]) + np.dot(e[0], d[2])
            axis = e[0]
            _add_rotation(row, state, parent, np.cross(e[0], d[0]))
        _add_translation(row, state, child, equations.point[r, 1], axis)
        _add_translation(row, state, parent, equations.point[r, 0], -axis)
        if equations.turn[r] >= 0:
            pitch, spin = equations.pitch[r], turning(state, parent, child)
            gap_out[0, r] -= pitch * angle[equations.turn[r]]
            gap_out[1, r] -= pitch * np.dot(e[0], spin)
            gap_out[2, r] -= pitch * np.dot(e[1], spin)
            _add_rotation(row, state, child, -pitch * e[0])
            _add_rotation(row, state, parent, pitch * e[0])
    for c in range(len(equations.coupled)):
        first = equations.coupled[c]
        (q, v, a), curve = gap_out[:, first + 1], equations.curve[c]
        slope, bend = equations.ratio[c], 0.0
        gap_out[0, first] -= equations.ratio[c] * q
        for k in range(3):
            gap_out[0, first] -= curve[k] * q ** (k + 2)
            slope += (k + 2) * curve[k] * q ** (k + 1)
            bend += (k + 2) * (k + 1) * curve[k] * q**k
        rows_out[first] -= slope * rows_out[first + 1]
        gap_out[1, first] -= slope * v
        gap_out[2, first] -= slope * a + bend * v * v
        gap_out[0, first] -= equations.offset[c]
        d = equations.driven[c]
        if d >= 0:
            gap_out[:, first] -= equations.given[:, d]
            if equations.kind[first] == ANGLE:
                gap_out[0, first] -= 2.0 * np.pi * np.round(gap_out[0, first] / (2.0 * np.pi))
        rows_out[first + 1] = 0.0
        gap_out[:, first + 1] = 0.0
