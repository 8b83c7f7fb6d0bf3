# SPDX-License-Identifier: Apache-2.0
"""Classical formulation of multibody dynamics: independent reference for the Lie group engine.

It shares only the Scene with the engine. It uses
    unit quaternions                          instead of rotation matrices
    velocities in world axes                  instead of body axes
    geometric equations (equations.py)        instead of subgroups of SE(3)
    integrated angles                         instead of angles of poses
    multipliers of all joints at once         instead of a tree and its cuts

The state of one body is 13 numbers,
    quaternion (w, x, y, z)   position r   velocity v = rdot, world axes   omega, body axes
The angles of the joints that need one and the states of laws follow after all bodies. With independent joint equations
differentiated twice, A a = b, the accelerations a of all bodies and the multipliers are
    M a = f + A^T lambda ,   (A M^-1 A^T + C) lambda = b - A M^-1 f
(Haug, Computer Aided Kinematics and Dynamics of Mechanical Systems, 1989, section 11.3), solved by Cholesky
factors within the envelope and refined once. C is diagonal: the compliance of the rows of rotors. The terms
-2 c gdot - c^2 g in b vanish on the exact motion. They prevent an accumulation of round-off in g. As the rows are
independent, every state has such accelerations, so no state near the motion drifts away from it.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import kernel, subroutine

from .equations import Equations, joint_equations
from .laws import LawLoads, add_laws, set_targets, set_values
from .loads import Loads, add_loads
from .vectors import FRAME, cross, dot, place, plus, three, turned, turned_back

STATE = 13  # numbers per body
DRIFT_DAMPING = 10.0  # 1/s, c; far below 1/step of a tight integration: it does not limit the step


class System(NamedTuple):
    """Arrays of a scene of n bodies."""

    mass: np.ndarray  # (n,) kg
    inertia: np.ndarray  # (n, 9) kg m^2, about the centre of mass, body axes
    mobility: np.ndarray  # (n, 9) inverse of the inertia
    size: float  # m, characteristic length
    equations: Equations
    loads: Loads
    laws: LawLoads


class Chosen(NamedTuple):
    """Independent rows: m of the k equations, in their order."""

    row: np.ndarray  # (m,)
    first: np.ndarray  # (m,) first of these rows that shares a body with this one or with one between them
    pair: np.ndarray  # (p, 4) i, j <= i of these rows, and their slots, where both have the same body


def chosen_rows(system, rows):
    """Chosen for some rows, in increasing order."""
    on_body = {}
    for i, bodies in enumerate(system.equations.body[rows].tolist()):
        for slot, body in enumerate(bodies):
            if body < len(system.mass):
                on_body.setdefault(body, []).append((i, slot))
    pairs = [(i, j, a, b) for ends in on_body.values() for i, a in ends for j, b in ends if j <= i]
    first = np.arange(len(rows))
    for i, j, _, _ in pairs:
        first[i] = min(first[i], j)
    return Chosen(np.array(rows, dtype=int), first, np.array(pairs, dtype=int).reshape(-1, 4))


@kernel
def _product(matrix, i, x):
    """Product of the matrix (9) in row i with x."""
    return dot(three(matrix, i, 0), x), dot(three(matrix, i, 3), x), dot(three(matrix, i, 6), x)


@subroutine
def _factorise(first, matrix):
    """Replace the lower part of `matrix` (m, m) by its Cholesky factor; returns the smallest ratio of pivot and entry.

    first : (m,) columns where the rows begin. Returns 0 if it is not positive definite.
    """
    least = 1.0
    for i in range(len(first)):
        for j in range(first[i], i):
            total = matrix[i, j]
            for k in range(max(first[i], first[j]), j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / matrix[j, j]
        entry = matrix[i, i]
        pivot = entry
        for k in range(first[i], i):
            pivot -= matrix[i, k] * matrix[i, k]
        if not pivot > 0.0:
            return 0.0
        least = min(least, pivot / entry)
        matrix[i, i] = np.sqrt(pivot)
    return least


@subroutine
def _solve(first, factor, x):
    """Replace x (m,) by the solution for the factor of `_factorise`."""
    m = len(first)
    for i in range(m):
        for k in range(first[i], i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(m - 1, -1, -1):
        x[i] /= factor[i, i]
        for k in range(first[i], i):
            x[k] -= factor[i, k] * x[i]


@subroutine
def _set_matrix(system, chosen, rows, frame, moved, matrix):
    """Write moved (k, 6 s) = A M^-1, and the lower part of the matrix A M^-1 A^T + C."""
    equations, world = system.equations, len(system.mass)
    for i in range(len(chosen.row)):
        r = chosen.row[i]
        for k in range(chosen.first[i], i):
            matrix[i, k] = 0.0
        matrix[i, i] = equations.compliance[r]
        for slot in range(equations.body.shape[1]):
            body = equations.body[r, slot]
            if body == world:
                continue
            torque = turned_back(frame, body, three(rows, r, 6 * slot + 3))
            torque = turned(frame, body, _product(system.mobility, body, torque))
            for c in range(3):
                moved[r, 6 * slot + c] = rows[r, 6 * slot + c] / system.mass[body]
                moved[r, 6 * slot + 3 + c] = torque[c]
    for p in range(len(chosen.pair)):
        i, j = chosen.pair[p, 0], chosen.pair[p, 1]
        r, s, a, b = chosen.row[i], chosen.row[j], 6 * chosen.pair[p, 2], 6 * chosen.pair[p, 3]
        matrix[i, j] += dot(three(moved, r, a), three(rows, s, b))
        matrix[i, j] += dot(three(moved, r, a + 3), three(rows, s, b + 3))


@subroutine
def rates(system, chosen, times, given, states, wrench, out, sides, heights):
    """Compute the time derivatives of p states; NaN where the accelerations are not determined.

    times  : (p,) s
    given  : (p, 3, d) coordinate, rate and acceleration of the driven joints
    states : (p, 13 n + t)
    wrench : (n, LOADS) external wrenches, see loads.add_loads
    out    : (p, 13 n + t)
    sides, heights : (p, c), see formulas.evaluate
    returns the smallest ratio of a pivot of the matrix and its diagonal entry: 1 if no row is near others, 0 if
    one depends on them
    """
    n, m, k = len(system.mass), len(chosen.row), len(system.equations.kind)
    equations, turns = system.equations, STATE * n
    frame, force, a = np.zeros((n + 1, FRAME)), np.zeros((n + 1, 6)), np.zeros((n + 1, 6))
    width = 6 * equations.body.shape[1]
    rows, gap, moved = np.zeros((k, width)), np.zeros((3, k)), np.zeros((k, width))
    matrix, x = np.zeros((m, m)), np.zeros(m)
    total = np.zeros(m)
    stack, values = np.empty(system.laws.sizes[1]), np.empty(system.laws.sizes[0])
    least = 1.0
    for p in range(len(states)):
        state, angle = states[p, :turns].reshape(n, STATE), states[p, turns:]
        force[:] = 0.0
        place(state, frame)
        set_values(system.laws, times[p], state, frame, angle, stack, values, sides[p], heights[p])
        set_targets(system.laws, values, system.loads.turn_law, system.loads.slide_law)
        add_loads(system.loads, system.mass, frame, angle, wrench, force, out[p, turns:])
        add_laws(system.laws, frame, angle, values, force, out[p, turns:])
        for i in range(n):
            omega = three(state, i, 10)
            torque = turned_back(frame, i, three(force, i, 3))
            torque = plus(torque, -1.0, cross(omega, _product(system.inertia, i, omega)))
            torque = turned(frame, i, _product(system.mobility, i, torque))
            for c in range(3):
                a[i, c], a[i, 3 + c] = force[i, c] / system.mass[i], torque[c]
        if m > 0:
            joint_equations(equations, frame, angle, given[p], rows, gap)
            _set_matrix(system, chosen, rows, frame, moved, matrix)
            pivot = _factorise(chosen.first, matrix)
            least = min(least, pivot)
            total[:] = 0.0
            for _ in range(2 if pivot > 0.0 else 0):
                for i in range(m):
                    r = chosen.row[i]
                    x[i] = -gap[2, r] - equations.compliance[r] * total[i]
                    if equations.compliance[r] == 0.0:
                        x[i] -= 2.0 * DRIFT_DAMPING * gap[1, r] + DRIFT_DAMPING**2 * gap[0, r]
                    for slot in range(equations.body.shape[1]):
                        body = equations.body[r, slot]
                        for c in range(6 if body < n else 0):
                            x[i] -= rows[r, 6 * slot + c] * a[body, c]
                _solve(chosen.first, matrix, x)
                for i in range(m):
                    r = chosen.row[i]
                    total[i] += x[i]
                    for slot in range(equations.body.shape[1]):
                        body = equations.body[r, slot]
                        for c in range(6 if body < n else 0):
                            a[body, c] += moved[r, 6 * slot + c] * x[i]
            if not pivot > 0.0:
                a[:] = np.nan
        for i in range(n):
            w, x0, y, z = state[i, 0], state[i, 1], state[i, 2], state[i, 3]
            o = STATE * i
            omega = three(state, i, 10)
            spin = cross((x0, y, z), omega)
            change = turned_back(frame, i, three(a, i, 3))
            out[p, o] = -0.5 * (x0 * omega[0] + y * omega[1] + z * omega[2])
            for c in range(3):
                out[p, o + 1 + c] = 0.5 * (w * omega[c] + spin[c])
                out[p, o + 4 + c] = state[i, 7 + c]
                out[p, o + 7 + c] = a[i, c]
                out[p, o + 10 + c] = change[c]
    return least


def unit_rows(system, state, given):
    """Unit rows (k, 6 n) for (rddot, size omegadot) of all equations at a state, and their g (k,) relative to the size.

    Rows that are no equations, those of rotors and of the other joints of a coupling, are zero.
    """
    n, (k, slots), coupled = len(system.mass), system.equations.body.shape, system.equations.coupled
    frame, rows, gap = np.zeros((n + 1, FRAME)), np.zeros((k, 6 * slots)), np.zeros((3, k))
    place(state[: STATE * n].reshape(n, STATE), frame)
    joint_equations(system.equations, frame, state[STATE * n :], given, rows, gap)
    dense = np.zeros((k, n + 1, 6))
    for slot in range(slots):
        dense[np.arange(k), system.equations.body[:, slot]] += rows[:, 6 * slot : 6 * slot + 6]
    dense[..., 3:] /= system.size
    others = np.setdiff1d(np.arange(coupled.min(initial=k), k), coupled)
    dense[others] = dense[system.equations.compliance > 0.0] = 0.0
    dense = dense[:, :n].reshape(k, 6 * n)
    length = np.linalg.norm(dense, axis=1)
    scale = np.divide(1.0, length, out=np.zeros(k), where=length > 0.0)
    return scale[:, None] * dense, scale * gap[0] / system.size
