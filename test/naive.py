# SPDX-License-Identifier: Apache-2.0
"""Simple dense implementations of kernels for comparison; they share nothing with the engine."""

import numpy as np
from scipy.linalg import expm


def hat(w):
    """Cross-product matrix of w (3,)."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def displaced(matrix, twist):
    """Pose (4, 4) moved along a body twist (6,): C expm(hat V)."""
    generator = np.zeros((4, 4))
    generator[:3, :3] = hat(twist[:3])
    generator[:3, 3] = twist[3:]
    return matrix @ expm(generator)


def matrices(pose):
    """Poses (n, 4, 4) of rows (n, 12) of R, row by row, and r."""
    found = np.tile(np.eye(4), (len(pose), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = pose[:, :9].reshape(-1, 3, 3), pose[:, 9:]
    return found


def flat(found):
    """The inverse of `matrices`."""
    return np.concatenate([found[:, :3, :3].reshape(-1, 9), found[:, :3, 3]], axis=1)


def joint_residual(joint, parent, child, length):
    """Residual of a joint, from products of the axes of its frames and the vector between them.

    parent, child : (4, 4) poses of the joint frames in the world
    length        : m, of a distance joint
    returns (rows,), zero if the joint is satisfied; the rows differ from the engine's but have the
    same span
    """
    (x, y, z), (u, v, w) = parent[:3, :3].T, child[:3, :3].T
    d = child[:3, 3] - parent[:3, 3]
    together, aligned = [*d], [x @ w, y @ w]
    if joint.type == "screw":
        turn = np.arctan2(y @ u - x @ v, x @ u + y @ v)
        turns = np.round((z @ d / joint.pitch - turn) / (2 * np.pi))
        return np.array([*aligned, x @ d, y @ d, z @ d - joint.pitch * (turn + 2 * np.pi * turns)])
    return np.array(
        {
            "spherical": together,
            "revolute": together + aligned,
            "prismatic": [*aligned, x @ v, x @ d, y @ d],
            "cylindrical": [*aligned, x @ d, y @ d],
            "planar": [*aligned, z @ d],
            "fixed": [*together, *aligned, x @ v],
            "universal": [*together, x @ v],
            "distance": [np.sqrt(d @ d) - length],
        }[joint.type]
    )


def _joints(scene, frames):
    """[(joint, frames of its ends, length)]; a length that is not given is the initial distance."""
    starts = {body.name: body.pose for body in scene.bodies} | {"world": np.eye(4)}
    for joint, (parent, child) in zip(scene.joints, frames):
        apart = (starts[joint.parent] @ parent)[:3, 3] - (starts[joint.child] @ child)[:3, 3]
        yield joint, parent, child, getattr(joint, "length", None) or np.linalg.norm(apart)


def residual(scene, frames, matrices):
    """Residuals of all joints, one below the other; matrices {body: (4, 4)}."""
    matrices = {**matrices, "world": np.eye(4)}
    parts = [np.zeros(0)]
    for joint, parent, child, length in _joints(scene, frames):
        parts.append(joint_residual(joint, matrices[joint.parent] @ parent, matrices[joint.child] @ child, length))
    return np.concatenate(parts)


def jacobian(scene, frames, matrices, step=1e-6):
    """d residual / d (body twists) by central differences, (rows, 6 n)."""
    nudges = step * np.concatenate([np.eye(6), -np.eye(6)])
    moved = {name: [displaced(matrix, nudge) for nudge in nudges] for name, matrix in matrices.items()}
    matrices, rows = {**matrices, "world": np.eye(4)}, [np.zeros((0, 6 * len(moved)))]
    for joint, parent, child, length in _joints(scene, frames):
        block = {}
        for name in (joint.parent, joint.child):
            ends = [{**matrices, name: matrix} for matrix in moved.get(name, [])]
            found = [joint_residual(joint, at[joint.parent] @ parent, at[joint.child] @ child, length) for at in ends]
            block[name] = (np.array(found[:6]) - np.array(found[6:])).T / (2 * step)
        empty = np.zeros((len(max(block.values(), key=len)), 6))
        rows.append(np.hstack([block.get(name, empty) for name in moved]))
    return np.concatenate(rows)


def applied_wrenches(scene, matrices, twists):
    """{body: (6,)} of gravity and spring-dampers in body axes, from the definitions."""
    wrenches = {}
    for body in scene.bodies:
        R = matrices[body.name][:3, :3]
        wrenches[body.name] = np.concatenate([np.zeros(3), body.mass * R.T @ np.array(scene.gravity)])
    for spring in scene.forces:
        ends = []
        for name, point in ((spring.parent, spring.parent_point), (spring.child, spring.child_point)):
            matrix = matrices.get(name, np.eye(4))
            twist = twists.get(name, np.zeros(6))
            point = np.array(point)
            ends.append(
                (
                    name,
                    point,
                    matrix[:3, :3] @ point + matrix[:3, 3],
                    matrix[:3, :3] @ (twist[3:] + np.cross(twist[:3], point)),
                )
            )
        d, ddot = ends[1][2] - ends[0][2], ends[1][3] - ends[0][3]
        length = np.linalg.norm(d)
        tension = spring.stiffness * (length - spring.rest_length) + spring.damping * (d @ ddot) / length
        for sign, (name, point, _, _) in zip((1.0, -1.0), ends):
            if name in wrenches:
                force = sign * tension * matrices[name][:3, :3].T @ d / length
                wrenches[name] += np.concatenate([np.cross(point, force), force])
    return wrenches


def accelerations(scene, frames, matrices, twists, jacobian_rate):
    """{body: (6,)} Vdot from the dense saddle-point system (6.22).

    jacobian_rate : (rows,) of Jdot V
    """
    names = list(matrices)
    n = len(names)
    wrenches = applied_wrenches(scene, matrices, twists)
    mass, right = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    for i, body in enumerate(scene.bodies):
        at = slice(6 * i, 6 * i + 6)
        inertia, w, v = body.inertia_matrix, twists[body.name][:3], twists[body.name][3:]
        mass[at, at][:3, :3] = inertia
        mass[at, at][3:, 3:] = body.mass * np.eye(3)
        gyroscopic = np.concatenate([-np.cross(w, inertia @ w), -body.mass * np.cross(w, v)])
        right[at] = wrenches[body.name] + gyroscopic
    J = jacobian(scene, frames, matrices)
    system = np.block([[mass, J.T], [J, np.zeros((len(J), len(J)))]])
    solution = np.linalg.solve(system, np.concatenate([right, -jacobian_rate]))
    return {name: solution[6 * i : 6 * i + 6] for i, name in enumerate(names)}
