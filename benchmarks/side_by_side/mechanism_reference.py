# SPDX-License-Identifier: Apache-2.0
"""Exact attitudes at the end of any problem in space: articulated bodies, SciPy's DOP853.

It shares no code with the tested codes. Coordinates are those of joints, with quaternions for balls and
free bodies; everything else is in world axes. Loops are constraints on the accelerations of their points.
A long chain needs articulated bodies: with the mass matrix, 100 hinges lose half of all digits.
"""

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from .problems import BALL, CYLINDRICAL, FREE, GROUND, HINGE, SLIDE, UNIVERSAL

TURN, SHIFT, ROUND, LOOSE = range(4)  # links: about an axis, along one, about a point, free
TOLERANCES = (1e-12, 1e-13)  # of DOP853, by fineness
# Numbers of coordinates and speeds of each.
COORDINATES, SPEEDS = np.array([1, 1, 4, 7]), np.array([1, 1, 3, 6])
# Joints with two degrees of freedom are two links, the first one massless: (kind, index of its axis).
LINKS = {
    HINGE: [(TURN, 0)],
    SLIDE: [(SHIFT, 0)],
    UNIVERSAL: [(TURN, 0), (TURN, 1)],
    CYLINDRICAL: [(TURN, 0), (SHIFT, 0)],
    BALL: [(ROUND, 0)],
    FREE: [(LOOSE, 0)],
}


class _Links:
    """Arrays of the links of a problem; vectors are in world axes at the start, as are all frames.

    kind, parent, at_q, at_v : (k,); origin: (k, 3) m, from the parent's origin; axis: (k, 3)
    mass, centre, inertia    : (k,), (k, 3) from the origin, (k, 3, 3) about the centre
    loops, anchors           : (m, 2) links, (m, 2, 3) points from their origins
    """

    def __init__(self, problem):
        rows, self.body, speeds = [], [], []
        place = {GROUND: np.zeros(3)}
        link_of = {GROUND: -1}
        for i, (body, joint) in enumerate(zip(problem.bodies, problem.tree)):
            parts = LINKS[joint.kind]
            for count, (kind, which) in enumerate(parts):
                last = count == len(parts) - 1
                parent = link_of[joint.parent] if count == 0 else len(rows) - 1
                rows.append(
                    (
                        kind,
                        parent,
                        joint.point - place[joint.parent] if count == 0 else np.zeros(3),
                        (joint.axis, joint.second)[which],
                        body.mass if last else 0.0,
                        body.position - joint.point if last else np.zeros(3),
                        body.inertia if last else np.zeros((3, 3)),
                    )
                )
            place[i], link_of[i] = joint.point, len(rows) - 1
            self.body.append(len(rows) - 1)
            speeds += list(problem.rates(i))
        kind, parent, origin, axis, mass, centre, inertia = zip(*rows)
        kind = np.array(kind)
        self.first = np.concatenate(
            [
                {ROUND: [1.0, 0, 0, 0], LOOSE: [*start, 1.0, 0, 0, 0]}.get(k, [0.0])
                for k, start in zip(kind.tolist(), origin)
            ]
        )
        at_q = np.concatenate([[0], np.cumsum(COORDINATES[kind])])
        at_v = np.concatenate([[0], np.cumsum(SPEEDS[kind])])
        self.speeds = np.array(speeds)
        self.coordinates = int(at_q[-1])
        ends = [(loop.parent, loop.child) for loop in problem.loops]
        self.arrays = (
            kind,
            np.array(parent),
            at_q[:-1],
            at_v[:-1],
            np.array(origin),
            np.array(axis),
            np.array(mass),
            np.array(centre),
            np.array(inertia),
            np.array([[link_of[end] for end in pair] for pair in ends], dtype=int).reshape(-1, 2),
            np.array(
                [[l.point - place[end] for end in pair] for l, pair in zip(problem.loops, ends)], dtype=float
            ).reshape(-1, 2, 3),
            np.array(problem.gravity),
        )


@njit(cache=True)
def _cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True)
def _shift(r):
    """Matrix (6, 6) that moves a wrench (moment, force) to a point at -r (3,)."""
    out = np.eye(6)
    out[0, 4], out[0, 5], out[1, 5] = -r[2], r[1], -r[0]
    out[1, 3], out[2, 3], out[2, 4] = r[2], -r[1], r[0]
    return out


@njit(cache=True)
def _turn(axis, angle):
    """Rotation matrix about a unit axis."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + s * k + (1.0 - c) * (k @ k)


@njit(cache=True)
def _of_quaternion(q):
    """Rotation matrix of a quaternion (w, x, y, z) of any length."""
    w, x, y, z = q / np.sqrt(np.dot(q, q))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@njit(cache=True)
def _place(kind, parent, at_q, origin, axis, q):
    """Poses of the links: rotations (k, 3, 3) and origins (k, 3) in the world."""
    n = len(kind)
    rot, at = np.empty((n, 3, 3)), np.empty((n, 3))
    for i in range(n):
        p, c = parent[i], at_q[i]
        base = rot[p] if p >= 0 else np.eye(3)
        at[i] = (at[p] if p >= 0 else np.zeros(3)) + base @ origin[i]
        rot[i] = base
        if kind[i] == TURN:
            rot[i] = base @ _turn(axis[i], q[c])
        elif kind[i] == SHIFT:
            at[i] += base @ axis[i] * q[c]
        elif kind[i] == ROUND:
            rot[i] = _of_quaternion(q[c : c + 4])
        else:
            at[i] = q[c : c + 3]
            rot[i] = _of_quaternion(q[c + 3 : c + 7])
    return rot, at


@njit(cache=True)
def _directions(kind, axis):
    """Motion (6, speeds) of a link per speed: angular, then linear at its origin; world axes."""
    if kind == ROUND:
        return np.eye(6)[:, :3].copy()
    if kind == LOOSE:
        return np.concatenate((np.eye(6)[:, 3:], np.eye(6)[:, :3]), axis=1)
    out = np.zeros((6, 1))
    out[3 * (kind == SHIFT) : 3 + 3 * (kind == SHIFT), 0] = axis
    return out


@njit(cache=True)
def slope(kind, parent, at_q, at_v, origin, axis, mass, centre, inertia, loops, anchors, gravity, q, v):
    """Rates of the coordinates q and of the speeds v.

    One sweep solves all right-hand sides: column 0 has the true wrenches, each other column a unit force in
    one row of a loop.
    """
    n, sides = len(kind), 1 + 3 * len(loops)
    rot, at = _place(kind, parent, at_q, origin, axis, q)
    # Angular velocities, and parts of the accelerations without v'. Row -1 is the ground.
    omega, gain, along = np.zeros((n + 1, 3)), np.zeros((n, 6)), np.zeros((n, 3))
    moves, reach = np.zeros((n, 6, 6)), np.zeros((n, 6, 6))
    wrench = np.zeros((n, 6, sides))
    dq, dv = np.zeros(len(q)), np.zeros((len(v), sides))
    for i in range(n):
        p, c, s = parent[i], at_q[i], at_v[i]
        loose = kind[i] == LOOSE
        arm = at[i] - at[p] if p >= 0 else at[i]
        moves[i] = _shift(arm)
        w = omega[p]
        along[i] = rot[p] @ axis[i] if p >= 0 else axis[i]
        omega[i] = w
        gain[i, 3:] = _cross(w, _cross(w, arm))
        if kind[i] == TURN:
            omega[i] = w + along[i] * v[s]
            gain[i, :3] = _cross(w, along[i]) * v[s]
            dq[c] = v[s]
        elif kind[i] == SHIFT:
            gain[i, 3:] += 2.0 * _cross(w, along[i]) * v[s]
            dq[c] = v[s]
        else:
            if loose:
                omega[i] = v[s + 3 : s + 6]
                dq[c : c + 3] = v[s : s + 3]
                gain[i] = 0.0
                c += 3
            else:
                omega[i] = w + v[s : s + 3]
            dq[c] = -0.5 * np.dot(omega[i], q[c + 1 : c + 4])
            dq[c + 1 : c + 4] = 0.5 * (q[c] * omega[i] + _cross(omega[i], q[c + 1 : c + 4]))
        r, w = rot[i] @ centre[i], omega[i]
        own = rot[i] @ inertia[i] @ rot[i].T
        to_origin = _shift(r)
        reach[i, :3, :3], reach[i, 3:, 3:] = own, mass[i] * np.eye(3)
        reach[i] = to_origin @ reach[i] @ to_origin.T
        pull = mass[i] * (_cross(w, _cross(w, r)) - gravity)
        wrench[i, :3, 0] = _cross(w, own @ w) + _cross(r, pull)
        wrench[i, 3:, 0] = pull
    for l in range(len(loops)):
        for end in range(2):
            i = loops[l, end]
            if i >= 0:
                pushes = _shift(rot[i] @ anchors[l, end])[:, 3:]
                wrench[i, :, 1 + 3 * l : 4 + 3 * l] += (1.0 - 2.0 * end) * pushes
    # Inwards: articulated inertia and bias wrenches of each link about its origin.
    for i in range(n - 1, -1, -1):
        p, first, s = parent[i], at_v[i], _directions(kind[i], along[i])
        pushed = reach[i] @ s
        weight = s.T @ pushed
        for side in range(sides):
            known = wrench[i, :, side] + (reach[i] @ gain[i] if side == 0 else np.zeros(6))
            dv[first : first + s.shape[1], side] = np.linalg.solve(weight, -(s.T @ known))
            if p >= 0:
                known = known + pushed @ dv[first : first + s.shape[1], side].copy()
                wrench[p, :, side] += moves[i] @ known
        if p >= 0:
            rest = reach[i] - pushed @ np.linalg.solve(weight, pushed.T.copy())
            reach[p] += moves[i] @ rest @ moves[i].T
    # Outwards: accelerations.
    motion = np.zeros((n + 1, 6, sides))
    for i in range(n):
        p, first, s = parent[i], at_v[i], _directions(kind[i], along[i])
        carried = np.zeros((6, sides))
        if kind[i] != LOOSE:
            carried = moves[i].T @ motion[p]
            pushed = s.T @ reach[i]
            dv[first : first + s.shape[1]] -= np.linalg.solve(pushed @ s, pushed @ carried)
        motion[i] = carried + s @ dv[first : first + s.shape[1]]
        motion[i, :, 0] += gain[i]
    rows = np.zeros((sides - 1, sides))
    for l in range(len(loops)):
        for end in range(2):
            i = loops[l, end]
            if i >= 0:
                row, r, w = 3 * l, rot[i] @ anchors[l, end], omega[i]
                part = (_shift(r)[:, 3:].T.copy()) @ motion[i]
                part[:, 0] += _cross(w, _cross(w, r))
                rows[row : row + 3] += (2.0 * end - 1.0) * part
    if sides == 1:
        return dq, dv[:, 0].copy()
    # Least squares, because planar loops have redundant rows.
    forces = np.linalg.lstsq(rows[:, 1:].copy(), -rows[:, 0].copy(), 1e-10)[0]
    return dq, dv[:, 0] + dv[:, 1:].copy() @ forces


def end_attitudes(problem, fineness):
    """(n, 3, 3) attitudes at the end of a problem whose loops are balls."""
    links = _Links(problem)
    if any(loop.kind != BALL for loop in problem.loops):
        raise ValueError("the reference closes loops by balls only")
    size = links.coordinates

    def both(_, state):
        return np.concatenate(slope(*links.arrays, state[:size], state[size:]))

    state = solve_ivp(
        both,
        (0.0, problem.duration),
        np.concatenate([links.first, links.speeds]),
        method="DOP853",
        rtol=TOLERANCES[fineness],
        atol=TOLERANCES[fineness],
    ).y[:, -1]
    kind, parent, at_q, _, origin, axis = links.arrays[:6]
    return _place(kind, parent, at_q, origin, axis, state[:size])[0][links.body]
