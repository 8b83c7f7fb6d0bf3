# SPDX-License-Identifier: Apache-2.0
"""Accelerations of a scene with 50 digits, from the definitions of its joints and forces.

The dense saddle-point system of the Newton-Euler equations

    | M  J^T | | Vdot   |   | Q               |
    | J   0  | | lambda | = | -(d^2 g/dt^2)_0 |

is assembled and solved in decimal numbers. Its parts share nothing with the kernels of the engine:

    J, right-hand side   first and second derivatives of the constraint functions g of naive.py, by
                         truncated Taylor series (jets.py); index 0: at Vdot = 0. A coupling has
                         the difference of two coordinates, a driven joint its coordinate and the
                         acceleration at the start of its motion
    forces               virtual work, f dq/dX for a law f(q, qdot) of a coordinate q of two bodies,
                         whose derivatives are Jets as well

Data are the double-precision numbers of the scene: poses, twists, masses, inertias, frames, points
and constants of forces. Rotation matrices are made orthogonal; frames and a length that the scene
omits are resolved as in the engine.
"""

import re
from decimal import Decimal
from typing import NamedTuple

import naive
import numpy as np
import scipy
from jets import AXES, NONE, TWISTS, Jet, decimals, precise

from liegroup_core.scene.consistency import resolve_frames

ROUND_OFF = Decimal(2) ** -53
# A solution whose residual is a larger part of its terms is refused: 25 digits are then unused.
SOLVED = Decimal(10) ** -25
# Pivots of unit rows, at poses that satisfy the joints to 1e-14: below DEPENDENT rows are redundant.
# Between the two the pose is nearly singular.
DEPENDENT, INDEPENDENT = 1e-10, 1e-5


class NearlySingular(ValueError):
    """The joints hardly determine the accelerations."""


class Reader:
    """Numbers of a scene as decimals: exact, or each changed by one unit of round-off.

    rng : None: exact. Otherwise a number x becomes x (1 +- u), u = 2^-53, and a component of a
          vector or of a rotation matrix changes by u times the largest component: the axes that
          a vector is written in are arbitrary, and every rotation rounds it like that
    """

    def __init__(self, rng=None):
        self._rng = rng

    def _change(self, shape):
        if self._rng is None:
            return decimals(np.zeros(shape))
        return ROUND_OFF * decimals(self._rng.choice((-1.0, 1.0), size=shape))

    def number(self, value):
        return Decimal(float(value)) * (1 + self._change(1)[0])

    def vector(self, value):
        value = decimals(value)
        return value + abs(value).max() * self._change(3)

    def rotation(self, matrix):
        R = decimals(matrix) + self._change((3, 3))
        for _ in range(3):  # Newton's method: errors of 1e-15, 1e-30, 1e-60
            R = R @ (3 * AXES - R.T @ R) / 2
        return R

    def inertia(self, matrix):
        change = self._change((3, 3))
        return decimals(matrix) * (1 + (np.triu(change) + np.triu(change, 1).T))


class Moving(NamedTuple):
    """A body: its centre of mass c in its frame, and all else at it and in its axes."""

    c: np.ndarray
    mass: Decimal
    inertia: np.ndarray  # (3, 3)
    R: np.ndarray  # (3, 3) to world axes
    r: np.ndarray  # (3,) m, world
    w: np.ndarray
    v: np.ndarray


def _moving(body, read):
    c, R = read.vector(body.com), read.rotation(body.rotation)
    w = read.vector(body.angular_velocity)
    v = read.vector(body.linear_velocity) + np.cross(w, c)
    r = read.vector(body.position) + R @ c
    return Moving(c, read.number(body.mass), read.inertia(body.inertia_matrix), R, r, w, v)


def _jets(values, slopes, curvatures):
    """Array of Jets from arrays (m,), (13, m) and (m,)."""
    return np.array([Jet(*parts) for parts in zip(values, slopes.T, curvatures)], dtype=object)


def _direction(body, along, end):
    """World components (3,), as Jets, of a direction (3,) fixed in a body or (None) the world.

    end : 0: its twists are the first six, 1: the others
    """
    if body is None:
        return np.array([Jet(x) for x in along], dtype=object)
    slopes = np.tile(NONE, (3, 1)).T
    slopes[6 * end : 6 * end + 3] = np.cross(AXES, along) @ body.R.T
    turning = np.cross(body.w, along)
    slopes[TWISTS] = body.R @ turning
    return _jets(body.R @ along, slopes, body.R @ np.cross(body.w, turning))


def _point(body, place, end):
    """World position (3,), as Jets, of a point (3,) of a body's frame or (None) the world."""
    if body is None:
        return np.array([Jet(x) for x in place], dtype=object)
    place = place - body.c
    slopes = np.tile(NONE, (3, 1)).T
    slopes[6 * end : 6 * end + 3] = np.cross(AXES, place) @ body.R.T
    slopes[6 * end + 3 : 6 * end + 6] = body.R.T
    speed = np.cross(body.w, place) + body.v
    slopes[TWISTS] = body.R @ speed
    return _jets(body.r + body.R @ place, slopes, body.R @ np.cross(body.w, speed))


def _frame(body, frame, end, read):
    """Pose (4, 4) in the world, as Jets, of a frame (4, 4) of a body."""
    rotation, place = read.rotation(frame[:3, :3]), read.vector(frame[:3, 3])
    pose = np.full((4, 4), Jet(Decimal(0)), dtype=object)
    pose[:3, :3] = np.transpose([_direction(body, axis, end) for axis in rotation.T])
    pose[:3, 3] = _point(body, place, end)
    return pose


def _joint_coordinate(joint_frames, turns):
    """Angle about z or shift along z of a joint as a Jet."""
    parent, child = joint_frames
    if not turns:
        return parent[:3, 2] @ (child[:3, 3] - parent[:3, 3])
    (x, y, _), (u, v, _) = parent[:3, :3].T, child[:3, :3].T
    return np.arctan2(y @ u - x @ v, x @ u + y @ v)


def _coordinate(force, joint_frames, bodies, read):
    """Coordinate of a force between two bodies as a Jet: length, angle about z, or shift along z."""
    if force.type == "spring_damper":
        parent, child = (
            _point(bodies[name], read.vector(place), end)
            for end, (name, place) in enumerate(((force.parent, force.parent_point), (force.child, force.child_point)))
        )
        return np.sqrt((child - parent) @ (child - parent))
    return _joint_coordinate(joint_frames, force.type not in ("linear_motor", "linear_spring_damper", "linear_servo"))


def _law(force, q, read):
    """Force or torque in the direction of growing q."""
    if force.type in ("motor", "linear_motor"):
        about = force.type == "motor"
        full = read.number(force.torque if about else force.force)
        limit = force.rate_limit if about else force.speed_limit
        return full if limit is None else full - abs(full) * q.rate / read.number(limit)
    if force.type in ("servo", "linear_servo"):
        limit = read.number(force.effort_limit)
        wanted = read.number(force.position) - q.value, read.number(force.velocity) - q.rate
        effort = read.number(force.stiffness) * wanted[0] + read.number(force.damping) * wanted[1]
        return max(-limit, min(limit, effort))
    rest = {
        "spring_damper": "rest_length",
        "torsional_spring_damper": "rest_angle",
        "linear_spring_damper": "rest_position",
    }[force.type]
    stretch = q.value - read.number(getattr(force, rest))
    return -read.number(force.stiffness) * stretch - read.number(force.damping) * q.rate


def _size(vector):
    return (vector @ vector).sqrt()


def _push(body, torque, force, point, axes, read):
    """Wrench (6,) about the centre of mass of a torque and a force at a point of the body's frame."""
    torque, force = read.vector(torque), read.vector(force)
    if axes == "world":
        torque, force = body.R.T @ torque, body.R.T @ force
    return np.concatenate([torque + np.cross(read.vector(point) - body.c, force), force])


def _of_law(law, frames, joints, bodies, read):
    """[(body, wrench (6,) about its centre of mass)] of a Law without functions that decimals lack."""
    values = {name: read.number(value) for name, value in law.parameters.items()}
    for name, each in law.inputs.items():
        owner, _, part = each.quantity.rpartition(".")
        if owner in joints:
            q = _joint_coordinate(frames[owner], joints[owner].type != "prismatic")
            values[name] = q.value if part == "position" else q.rate
            continue
        body, place = bodies[owner], read.vector(each.point or np.zeros(3))
        at = place - body.c
        kinds = {"w": body.w, "v": body.v + np.cross(body.w, at), "": body.r + body.R @ at}
        values[name] = kinds[part[:-1]]["xyz".index(part[-1])]

    def formula(text):
        exact = re.sub(r"\d+\.\d+", lambda found: f"Decimal({found[0]})", text)
        return Decimal(eval(exact, {"Decimal": Decimal}, values))

    for name, text in law.signals.items():
        values[name] = formula(text)
    for each in law.outputs:
        if each.body is None:
            q = _joint_coordinate(frames[each.joint], joints[each.joint].type != "prismatic")
            for end, name in enumerate((joints[each.joint].parent, joints[each.joint].child)):
                if name != "world":
                    yield name, formula(each.effort) * q.slopes[6 * end : 6 * end + 6]
        else:
            torque, force = (np.array([formula(text) for text in three]) for three in (each.torque, each.force))
            body = bodies[each.body]
            if each.axes == "world":
                torque, force = body.R.T @ torque, body.R.T @ force
            yield each.body, np.concatenate([torque + np.cross(read.vector(each.point) - body.c, force), force])


class System(NamedTuple):
    """Blocks of the saddle-point system of n bodies and m rows, in decimals."""

    masses: list  # n blocks (6, 6) of M
    J: np.ndarray  # (m, 6 n)
    Q: np.ndarray  # (6 n,)
    right: np.ndarray  # (m,)
    shares: list  # of each row: {joint: (6,) its row for the twist of the joint's child}


def _system(scene, wrenches, read, states=None):
    """System of a scene at its initial state, or at states [(R, r, w, v)] of the centres of mass of its bodies."""
    names = [body.name for body in scene.bodies]
    index = {name: slice(6 * i, 6 * i + 6) for i, name in enumerate(names)}
    bodies = {body.name: _moving(body, read) for body in scene.bodies} | {"world": None}
    for name, (R, r, w, v) in zip(names, states or ()):
        bodies[name] = bodies[name]._replace(R=R, r=r, w=w, v=v)
    gravity = read.vector(scene.gravity)
    n = 6 * len(names)

    frames, rows, right, shares = {}, [], [], []
    for joint, pair in zip(scene.joints, resolve_frames(scene)):
        ends = joint.parent, joint.child
        frames[joint.name] = tuple(
            _frame(bodies[name], frame, end, read) for end, (name, frame) in enumerate(zip(ends, pair))
        )
        # The length of a rod has no influence on derivatives.
        for g in naive.joint_residual(joint, *frames[joint.name], 1.0):
            row = decimals(np.zeros(n))
            for end, name in enumerate(ends):
                if name != "world":
                    row[index[name]] = g.slopes[6 * end : 6 * end + 6]
            rows.append(row)
            right.append(-g.curvature)
            shares.append({joint.name: g.slopes[6:12]})

    joints = {joint.name: joint for joint in scene.joints}
    for coupling in scene.couplings:
        row, curvature, share = decimals(np.zeros(n)), Decimal(0), {}
        for name, factor in ((coupling.joint, Decimal(1)), (coupling.other, -read.number(coupling.ratio))):
            q = _joint_coordinate(frames[name], joints[name].type != "prismatic")
            for end, body in enumerate((joints[name].parent, joints[name].child)):
                if body != "world":
                    row[index[body]] += factor * q.slopes[6 * end : 6 * end + 6]
            curvature += factor * q.curvature
            share[name] = factor * q.slopes[6:12]
        shares.append(share)
        rows.append(row)
        right.append(-curvature)

    for joint in scene.joints:
        if not joint.driven:
            continue
        row, q = (decimals(np.zeros(n)), _joint_coordinate(frames[joint.name], joint.type != "prismatic"))
        for end, body in enumerate((joint.parent, joint.child)):
            if body != "world":
                row[index[body]] += q.slopes[6 * end : 6 * end + 6]
        shares.append({joint.name: q.slopes[6:12]})
        rows.append(row)
        right.append(read.number(joint.motion.accelerations[0]) - q.curvature)

    masses, Q = [], decimals(np.zeros(n))
    for name in names:
        body = bodies[name]
        block = decimals(np.zeros((6, 6)))
        block[:3, :3], block[3:, 3:] = body.inertia, body.mass * AXES
        masses.append(block)
        momentum = block @ np.concatenate([body.w, body.v])
        Q[index[name]] -= np.concatenate([np.cross(body.w, momentum[:3]), np.cross(body.w, momentum[3:])])
        Q[index[name]][3:] += body.mass * (body.R.T @ gravity)
    for name, wrench, axes in wrenches:
        Q[index[name]] += _push(bodies[name], wrench[:3], wrench[3:], np.zeros(3), axes, read)
    links = {joint.name: (joint.parent, joint.child) for joint in scene.joints}
    for force in scene.forces:
        if force.type == "applied_wrench":
            body = bodies[force.body]
            Q[index[force.body]] += _push(body, force.torque, force.force, force.point, force.axes, read)
        elif force.type == "law":
            for name, wrench in _of_law(force, frames, joints, bodies, read):
                Q[index[name]] += wrench
        elif force.type == "drag":
            body = bodies[force.body]
            kinds = ((body.w, force.angular, force.angular_quadratic),)
            kinds += ((body.v, force.linear, force.quadratic),)
            Q[index[force.body]] -= np.concatenate(
                [(read.number(c) + read.number(d) * _size(x)) * x for x, c, d in kinds]
            )
        else:
            joint = getattr(force, "joint", None)
            q = _coordinate(force, frames.get(joint), bodies, read)
            ends = links[joint] if joint else (force.parent, force.child)
            pull = _law(force, q, read)
            for end, name in enumerate(ends):
                if name != "world":
                    Q[index[name]] += pull * q.slopes[6 * end : 6 * end + 6]
    J = np.array(rows, dtype=object).reshape(len(rows), n)
    return System(masses, J, Q, np.array(right, dtype=object), shares)


def _independent_rows(J):
    """Indices of independent rows of a Jacobian (m, 6 n), in decimals; best conditioned first.

    Raises NearlySingular.
    """
    if not len(J):
        return np.zeros(0, dtype=int)
    unit = J.astype(float)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    _, triangle, order = scipy.linalg.qr(unit.T, mode="economic", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    if ((pivots > DEPENDENT) & (pivots < INDEPENDENT)).any():
        raise NearlySingular(f"pivots {pivots}")
    return np.sort(order[: int((pivots >= INDEPENDENT).sum())])


def _solved(system, keep):
    """Vdot (6 n,) and lambda of a System with the rows `keep`, in decimals.

    Gaussian elimination of the dense matrix, zeros skipped. No pivoting is needed: M is positive
    definite and what is left of the other diagonal block is negative definite. The residual
    is the proof.
    """
    n, size = len(system.Q), len(system.Q) + len(keep)
    K = decimals(np.zeros((size, size)))
    for i, block in enumerate(system.masses):
        K[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = block
    K[n:, :n], K[:n, n:] = system.J[keep], system.J[keep].T
    right = np.concatenate([system.Q, system.right[keep]])
    left, x = K.copy(), right.copy()
    for k in range(size):
        below = k + 1 + np.flatnonzero(left[k + 1 :, k])
        across = k + 1 + np.flatnonzero(left[k, k + 1 :])
        factor = left[below, k] / left[k, k]
        left[np.ix_(below, across)] -= np.outer(factor, left[k, across])
        x[below] -= factor * x[k]
    for k in reversed(range(size)):
        across = k + 1 + np.flatnonzero(left[k, k + 1 :])
        if len(across):
            x[k] -= left[k, across] @ x[across]
        x[k] /= left[k, k]
    terms = abs(K) @ abs(x) + abs(right)
    # Rows of a mechanism at rest contain round-off of the last digits only, hence the floor.
    if not (abs(K @ x - right) <= SOLVED * (terms + terms.max() / 10**12)).all():
        raise ArithmeticError("the system was not solved to 25 digits")
    return x


def _squared_condition(system, keep):
    """Condition of J M^-1 J^T with a unit diagonal, for the rows `keep`; 1 without rows."""
    if not len(keep):
        return 1.0
    blocks = np.split(system.J[keep].astype(float), len(system.masses), axis=1)
    rows = np.hstack(
        [
            np.linalg.solve(np.linalg.cholesky(mass.astype(float)), block.T).T
            for mass, block in zip(system.masses, blocks)
        ]
    )
    sizes = np.linalg.svd(rows / np.linalg.norm(rows, axis=1, keepdims=True), compute_uv=False)
    return (sizes[0] / sizes[-1]) ** 2


class Exact(NamedTuple):
    """Accelerations of n bodies, and how well they can be computed."""

    acceleration: np.ndarray  # (n, 6) of Decimal: angular, linear; body axes, centre of mass
    change: np.ndarray  # (n, 6) largest change by random round-off of the data, see Reader
    free: np.ndarray  # (n, 6) M^-1 Q: accelerations without joints
    squared_condition: float  # of J M^-1 J^T
    redundant: int  # number of redundant rows


@precise
def accelerations(scene, wrenches=(), samples=3):
    """Exact accelerations of a scene at its initial state.

    wrenches : [(body, (6,) torque and force about the origin of the body's frame, "body" or
               "world")]
    samples  : number of random changes of all data
    Raises NearlySingular.
    """
    n = len(scene.bodies)
    system = _system(scene, wrenches, Reader())
    keep = _independent_rows(system.J)
    found = _solved(system, keep)[: 6 * n]
    changes = [
        _solved(_system(scene, wrenches, Reader(np.random.default_rng(k))), keep)[: 6 * n] - found
        for k in range(samples)
    ]
    Q = system.Q.astype(float).reshape(n, 6)
    return Exact(
        acceleration=found.reshape(n, 6),
        change=np.abs(np.array(changes).astype(float)).max(axis=0).reshape(n, 6),
        free=np.array([np.linalg.solve(m.astype(float), q) for m, q in zip(system.masses, Q)]),
        squared_condition=_squared_condition(system, keep),
        redundant=len(system.J) - len(keep),
    )


@precise
def states_of(pose, twist):
    """[(R, r, w, v)] in decimals of poses (n, 12) and twists (n, 6) of centres of mass."""
    read = Reader()
    return [(read.rotation(C[:9].reshape(3, 3)), *map(decimals, (C[9:], V[:3], V[3:]))) for C, V in zip(pose, twist)]


@precise
def accelerations_at(scene, states, rounding=None):
    """Function of [(R, r, w, v)] in decimals: accelerations (n, 6) in decimals, with the rows independent at `states`.

    R, r, w, v : of the centres of mass, as of Moving
    rounding   : seed of random changes of all data, see Reader; None: exact
    Raises NearlySingular.
    """
    keep = _independent_rows(_system(scene, (), Reader(), states).J)

    @precise
    def found(states):
        rng = None if rounding is None else np.random.default_rng(rounding)
        system = _system(scene, (), Reader(rng), states)
        return _solved(system, keep)[: len(system.Q)].reshape(-1, 6)

    return found


@precise
def errors(exact, found):
    """Errors (n, 6), as floats, of accelerations (n, 6) in double precision."""
    return np.abs((decimals(found) - exact.acceleration).astype(float))


@precise
def solved_with(scene, wrenches, J, right):
    """Accelerations (n, 6), in decimals, with other rows in place of those of naive.py.

    J (m, 6 n), right (m,) : independent rows and their right-hand side, in double precision
    """
    system = _system(scene, wrenches, Reader())._replace(J=decimals(J), right=decimals(right))
    return _solved(system, np.arange(len(J)))[: len(system.Q)].reshape(-1, 6)


@precise
def reactions(scene, wrenches=()):
    """{joint: ((6,) wrench on the child, (6,) mask of the components that are undetermined)}, floats.

    Torque, force about the origin and in the axes of the child's joint frame; couplings act through
    their joints. Rows that depend on others transmit nothing. A component is undetermined where the
    null space of J^T changes it, of unit rows, by more than 1e-8: poses close to 1e-14.
    Raises NearlySingular.
    """
    system = _system(scene, wrenches, Reader())
    keep = _independent_rows(system.J)
    multipliers = _solved(system, keep)[len(system.Q) :]
    J = system.J.astype(float)
    sizes = np.linalg.norm(J, axis=1)
    null = np.linalg.svd(J / sizes[:, None])[0][:, len(keep) :] / sizes[:, None]
    bodies = {body.name: body for body in scene.bodies}
    found = {}
    for joint, (_, frame) in zip(scene.joints, resolve_frames(scene)):
        rotation = Reader().rotation(frame[:3, :3])
        place = decimals(frame[:3, 3]) - decimals(bodies[joint.child].com)

        def in_frame(wrench):
            torque = wrench[:3] - np.cross(place, wrench[3:])
            return np.concatenate([rotation.T @ torque, rotation.T @ wrench[3:]])

        own, changes = decimals(np.zeros(6)), np.zeros((6, null.shape[1]))
        for r, share in enumerate(system.shares):
            if joint.name in share:
                row = in_frame(share[joint.name])
                changes += np.outer(row.astype(float), null[r])
                if r in keep:
                    own -= multipliers[np.searchsorted(keep, r)] * row
        found[joint.name] = own.astype(float), np.abs(changes).max(axis=1, initial=0.0) > 1e-8
    return found
