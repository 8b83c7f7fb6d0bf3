# SPDX-License-Identifier: Apache-2.0
"""Motion of jointed rigid bodies in the classical formulation: referee of the Lie group engine.

Written to share nothing with the engine: unit quaternions instead of rotation matrices, world
instead of body velocities, joints as points that coincide and axes that stay aligned instead of
subgroups of SE(3), one dense solve instead of a sparse one. What both read is the Scene alone.

The state of one body is 13 numbers,
    quaternion (w, x, y, z)   position r   velocity v = rdot, world axes   omega, body axes
and the accelerations a = (rddot, omegadot) of all bodies follow from Udwadia and Kalaba,
Proc. R. Soc. Lond. A 439 (1992), 407-410:
    a = a_free + W (A W)^+ (b - A a_free),     W W^T = M^-1
where A a = b are the joint equations differentiated twice, M the mass matrix, a_free the motion
without joints and ^+ the pseudo-inverse, which also serves closed loops with redundant rows.
Two terms -2 c gdot - c^2 g, zero on the exact motion, keep round-off from piling up in g.
"""
from typing import NamedTuple

import numpy as np

from .._compile import kernel

GROUND = -1             # index of the world where a body is meant
STATE = 13              # numbers per body
JOINT_ROWS = {"spherical": 3, "revolute": 5}    # equations of each kind of joint
DRIFT_DAMPING = 10.0    # 1/s; far below 1/step of a tight integration, so it costs no step size
# Singular values below this part of the largest belong to redundant rows: those sit at 1e-16,
# the true ones of a planar four-bar at 0.1 (scaled by masses of like size).
RANK_CUTOFF = 1e-9


class System(NamedTuple):
    """A scene as arrays; n bodies, m joints, s spring-dampers."""

    gravity: np.ndarray         # (3,) m/s^2
    mass: np.ndarray            # (n,) kg
    inertia: np.ndarray         # (n, 3, 3) kg m^2, about the centre of mass, body axes
    inertia_inverse: np.ndarray     # (n, 3, 3)
    weight: np.ndarray          # (6 n, 6 n) W with W W^T = M^-1, M that of (rddot, omegadot)
    joint_body: np.ndarray      # (m, 2) parent, child; GROUND = -1
    joint_point: np.ndarray     # (m, 2, 3) m, in the frames of parent and child
    joint_axes: np.ndarray      # (m, 3, 3) rows: x and y in the parent's, z in the child's axes
    joint_rows: np.ndarray      # (m,) 3 (point) or 5 (point and axis)
    spring_body: np.ndarray     # (s, 2)
    spring_point: np.ndarray    # (s, 2, 3) m
    spring_law: np.ndarray      # (s, 3) stiffness N/m, damping N s/m, rest length m


@kernel
def rotate(q, x):
    """The vector x turned by the quaternion q (w, x, y, z) of any norm but zero."""
    u = q[1:4]
    t = 2.0 * np.cross(u, x) / np.dot(q, q)
    return x + q[0] * t + np.cross(u, t)


@kernel
def rotate_back(q, x):
    """The vector x turned by the inverse of q."""
    u = -q[1:4]
    t = 2.0 * np.cross(u, x) / np.dot(q, q)
    return x + q[0] * t + np.cross(u, t)


@kernel
def _direction(state, body, fixed):
    """A direction fixed in a body, its rate, and its second rate without omegadot; world axes."""
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


@kernel
def _point(state, body, fixed):
    """A point fixed in a body: position, velocity, acceleration without that of the body."""
    out = _direction(state, body, fixed)
    if body != GROUND:
        out[0] += state[body, 4:7]
        out[1] += state[body, 7:10]
    return out


@kernel
def _unconstrained(system, state, wrench, out):
    """Accelerations (rddot, omegadot) without joints: out (n, 6); wrench (n, 6) in body axes."""
    force = np.zeros((len(system.mass), 6))         # world force, body torque
    for i in range(len(system.mass)):
        force[i, 0:3] = system.mass[i] * system.gravity + rotate(state[i, 0:4], wrench[i, 3:6])
        force[i, 3:6] = wrench[i, 0:3]
    for s in range(len(system.spring_body)):
        parent, child = system.spring_body[s]
        start = _point(state, parent, system.spring_point[s, 0])
        end = _point(state, child, system.spring_point[s, 1])
        d = end[0] - start[0]
        length = np.sqrt(np.dot(d, d))
        stiffness, damping, rest = system.spring_law[s]
        pull = -stiffness * d
        if length > 0.0:
            unit = d / length
            pull += (stiffness * rest - damping * np.dot(unit, end[1] - start[1])) * unit
        for side in range(2):
            body = system.spring_body[s, side]
            if body != GROUND:
                acting = pull if side == 1 else -pull
                force[body, 0:3] += acting
                force[body, 3:6] += np.cross(system.spring_point[s, side],
                                             rotate_back(state[body, 0:4], acting))
    for i in range(len(system.mass)):
        omega = state[i, 10:13]
        torque = force[i, 3:6] - np.cross(omega, system.inertia[i] @ omega)
        out[i, 0:3] = force[i, 0:3] / system.mass[i]
        out[i, 3:6] = system.inertia_inverse[i] @ torque


@kernel
def joint_equations(system, state, rows_out, gap_out):
    """Joint equations g = 0 at one state.

    rows_out : (k, 6 n) A, so that gddot = A a + gap_out[2] with a = (rddot, omegadot) per body
    gap_out  : (3, k) g (m; for the axes the cosine, rad when small), gdot, gddot at a = 0
    """
    rows_out[:] = 0.0
    first = 0
    for j in range(len(system.joint_rows)):
        parent, child = system.joint_body[j]
        # The two points coincide.
        end = _point(state, child, system.joint_point[j, 1])
        start = _point(state, parent, system.joint_point[j, 0])
        for d in range(3):
            for c in range(3):
                gap_out[d, first + c] = end[d, c] - start[d, c]
        for side in range(2):
            body = system.joint_body[j, side]
            if body == GROUND:
                continue
            sign = 1.0 if side == 1 else -1.0
            for c in range(3):
                axis = np.zeros(3)
                axis[c] = sign
                rows_out[first + c, 6 * body + c] = sign
                # axis . (R (omegadot x p)) = omegadot . (p x R^T axis)
                rows_out[first + c, 6 * body + 3:6 * body + 6] = np.cross(
                    system.joint_point[j, side], rotate_back(state[body, 0:4], axis))
        # The child's z axis stays perpendicular to the parent's x and y axes.
        z = _direction(state, child, system.joint_axes[j, 2])
        for r in range(3, system.joint_rows[j]):
            e = _direction(state, parent, system.joint_axes[j, r - 3])
            gap_out[0, first + r] = np.dot(e[0], z[0])
            gap_out[1, first + r] = np.dot(e[1], z[0]) + np.dot(e[0], z[1])
            gap_out[2, first + r] = (np.dot(e[2], z[0]) + 2.0 * np.dot(e[1], z[1])
                                     + np.dot(e[0], z[2]))
            row = np.cross(z[0], e[0])
            rows_out[first + r, 6 * child + 3:6 * child + 6] = rotate_back(state[child, 0:4], row)
            if parent != GROUND:
                rows_out[first + r, 6 * parent + 3:6 * parent + 6] = rotate_back(
                    state[parent, 0:4], -row)
        first += system.joint_rows[j]


@kernel
def rate(system, flat_state, wrench, flat_out):
    """Time derivative of the whole state (13 n,) under body wrenches (n, 6)."""
    n = len(system.mass)
    state = flat_state.reshape(n, STATE)
    out = flat_out.reshape(n, STATE)
    acceleration = np.zeros((n, 6))
    _unconstrained(system, state, wrench, acceleration)
    if len(system.joint_rows) > 0:
        k = system.joint_rows.sum()
        rows, gap, missing = np.zeros((k, 6 * n)), np.zeros((3, k)), np.zeros(k)
        joint_equations(system, state, rows, gap)
        present = rows @ acceleration.reshape(6 * n)
        for r in range(k):
            missing[r] = -(present[r] + gap[2, r] + 2.0 * DRIFT_DAMPING * gap[1, r]
                           + DRIFT_DAMPING ** 2 * gap[0, r])
        smallest = np.linalg.lstsq(rows @ system.weight, missing, RANK_CUTOFF)[0]
        acceleration += (system.weight @ smallest).reshape(n, 6)
    for i in range(n):
        q = state[i, 0:4]
        omega = state[i, 10:13]
        out[i, 0] = -0.5 * np.dot(q[1:4], omega)
        out[i, 1:4] = 0.5 * (q[0] * omega + np.cross(q[1:4], omega))
        out[i, 4:7] = state[i, 7:10]
        out[i, 7:13] = acceleration[i]
