# SPDX-License-Identifier: Apache-2.0
"""Classical formulation of multibody dynamics: independent reference for the Lie group engine.

It shares only the Scene with the engine. It uses
    unit quaternions                          instead of rotation matrices
    velocities in world axes                  instead of body axes
    geometric equations (equations.py)        instead of subgroups of SE(3)
    integrated angles                         instead of angles of poses
    the null space of all constraint rows     instead of multipliers of independent rows

The state of one body is 13 numbers,
    quaternion (w, x, y, z)   position r   velocity v = rdot, world axes   omega, body axes
The angles of the joints that need one follow after all bodies. With the joint equations
differentiated twice, A a = b, the accelerations a = (rddot, omegadot) of all bodies are
    a = A^+ b + N y ,   (N^T M N) y = N^T (f - M A^+ b) ,   A N = 0
(Laulusa and Bauchau, J. Comput. Nonlinear Dyn. 3 (2008) 011004, section 4). A^+ and N come from
the singular value decomposition of A, independent of the masses. The smallest singular values
belong to redundant rows of closed loops. The terms -2 c gdot - c^2 g in b vanish on the exact
motion. They prevent an accumulation of round-off in g.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import subroutine

from .equations import STATE, Equations, joint_equations
from .loads import Loads, add_loads

DRIFT_DAMPING = 10.0  # 1/s, c; far below 1/step of a tight integration: it does not limit the step


class System(NamedTuple):
    """Arrays of a scene of n bodies."""

    mass: np.ndarray  # (n,) kg
    inertia: np.ndarray  # (n, 3, 3) kg m^2, about the centre of mass, body axes
    size: float  # m, characteristic length: scales rotations to displacements in A
    equations: Equations
    loads: Loads
    rotors: Equations  # (r,) coordinates of the joints with a rotor: ANGLE or LEVEL
    rotor_inertia: np.ndarray  # (r,) kg m^2 or kg


@subroutine
def scaled_equations(system, state, angle, right_out):
    """Return the unit rows (k, 6 n) of A for (rddot, size omegadot); write b (k,) to right_out."""
    n, k = len(system.mass), len(system.equations.kind)
    rows, gap = np.zeros((k, 6 * n)), np.zeros((3, k))
    joint_equations(system.equations, state, angle, rows, gap)
    for r in range(k):
        for body in range(n):
            rows[r, 6 * body + 3 : 6 * body + 6] /= system.size
        length = np.sqrt(np.dot(rows[r], rows[r]))
        scale = 1.0 / length if length > 0.0 else 0.0
        rows[r] *= scale
        right_out[r] = -scale * (gap[2, r] + 2.0 * DRIFT_DAMPING * gap[1, r] + DRIFT_DAMPING**2 * gap[0, r])
    return rows


@subroutine
def _add_rotors(system, state, mass, load):
    """Add the rotors, I qddot^2 / 2 with qddot = J a + j, to the mass matrix and load for (rddot, size omegadot)."""
    r, n = len(system.rotor_inertia), len(system.mass)
    rows, gap = np.zeros((r, 6 * n)), np.zeros((3, r))
    joint_equations(system.rotors, state, np.zeros(1), rows, gap)
    for k in range(r):
        for body in range(n):
            rows[k, 6 * body + 3 : 6 * body + 6] /= system.size
        mass += system.rotor_inertia[k] * np.outer(rows[k], rows[k])
        load -= system.rotor_inertia[k] * gap[2, k] * rows[k]


@subroutine
def _constrained_accelerations(system, rank, state, angle, force, acceleration_out):
    """Compute the accelerations (n, 6) under forces (n, 6) that satisfy the joints.

    rank : of the joint equations
    returns the smallest singular value within the rank, and the largest one beyond it
    """
    n, k = len(system.mass), len(system.equations.kind)
    b = np.zeros(k)
    rows = scaled_equations(system, state, angle, b)
    left, singular, right = np.linalg.svd(rows)
    components = np.zeros(6 * n)
    components[:rank] = (left.T @ b)[:rank] / singular[:rank]
    a = right.T @ components
    free = np.ascontiguousarray(right[rank:])  # N^T
    mass = np.zeros((6 * n, 6 * n))  # for (rddot, size omegadot)
    load = np.zeros(6 * n)
    for i in range(n):
        for c in range(3):
            mass[6 * i + c, 6 * i + c] = system.mass[i]
            load[6 * i + c] = force[i, c]
            load[6 * i + 3 + c] = force[i, 3 + c] / system.size
        mass[6 * i + 3 : 6 * i + 6, 6 * i + 3 : 6 * i + 6] = system.inertia[i] / system.size**2
    if len(system.rotor_inertia) > 0:
        _add_rotors(system, state, mass, load)
    if rank < 6 * n:
        reduced = free @ mass @ free.T
        a += free.T @ np.linalg.solve(reduced, free @ (load - mass @ a))
    for i in range(n):
        acceleration_out[i, 0:3] = a[6 * i : 6 * i + 3]
        acceleration_out[i, 3:6] = a[6 * i + 3 : 6 * i + 6] / system.size
    return singular[rank - 1], singular[rank] if rank < len(singular) else 0.0


@subroutine
def rate(system, rank, flat_state, wrench, acting, flat_out):
    """Compute the time derivative of the whole state (13 n + t,); NaN for non-finite input.

    rank   : of the joint equations
    wrench : (n, 24) external wrenches, see loads.add_loads
    acting : (p,) mask of the applied wrenches
    returns the smallest singular value of the rows within the rank, and the largest one beyond it
    """
    n = len(system.mass)
    state, angle = flat_state[: STATE * n].reshape(n, STATE), flat_state[STATE * n :]
    out = flat_out[: STATE * n].reshape(n, STATE)
    force = np.zeros((n, 6))
    add_loads(system.loads, system.mass, state, angle, wrench, acting, force, flat_out[STATE * n :])
    acceleration = np.zeros((n, 6))
    for i in range(n):
        omega = state[i, 10:13]
        force[i, 3:6] -= np.cross(omega, system.inertia[i] @ omega)
    if not (np.isfinite(flat_state).all() and np.isfinite(force).all()):
        flat_out[:] = np.nan  # LAPACK rejects non-finite numbers
        return 1.0, 0.0
    least, beyond = 1.0, 0.0
    if rank > 0:
        least, beyond = _constrained_accelerations(system, rank, state, angle, force, acceleration)
    else:
        for i in range(n):
            acceleration[i, 0:3] = force[i, 0:3] / system.mass[i]
            acceleration[i, 3:6] = np.linalg.solve(system.inertia[i], force[i, 3:6])
    for i in range(n):
        q = state[i, 0:4]
        omega = state[i, 10:13]
        out[i, 0] = -0.5 * np.dot(q[1:4], omega)
        out[i, 1:4] = 0.5 * (q[0] * omega + np.cross(q[1:4], omega))
        out[i, 4:7] = state[i, 7:10]
        out[i, 7:13] = acceleration[i]
    return least, beyond
