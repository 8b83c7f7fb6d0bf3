# SPDX-License-Identifier: Apache-2.0
"""Scene -> Model: names become indices, frames become Jacobian rows, the solve gets its structure."""
from collections import defaultdict

import numpy as np

from ..dynamics.block_cholesky import factorise
from ..dynamics.constraints import assemble_rows, assemble_solve
from ..errors import SceneError
from ..forces.kinds import make_forces
from ..joints.pairs import LOWER_PAIRS
from ..lie.groups import SE3
from ..scene.consistency import check_consistency, resolve_frames
from .arrays import BODY, JOINT, WORLD, Model, make_work
from .sparsity import block_layout, elimination_order


def initial_state(scene):
    """Pose (n, 12) and twist (n, 6) of all bodies at the start of a scene."""
    pose = np.array([np.concatenate([body.rotation.ravel(), body.position])
                     for body in scene.bodies]).reshape(-1, 12)
    twist = np.array([body.twist for body in scene.bodies], dtype=float).reshape(-1, 6)
    return pose, twist


def build_model(scene):
    """Model of a scene, and the scene's index of each of the model's joints.

    returns (model, joint_order): joint j of the model is scene.joints[joint_order[j]]
    raises SceneError: joints that do not close, velocities against them, rows that depend
    """
    check_consistency(scene)
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": WORLD}
    bodies = np.array([(body.mass, 1.0 / body.mass, body.inertia_matrix.ravel(),
                        np.linalg.inv(body.inertia_matrix).ravel()) for body in scene.bodies],
                      dtype=BODY)
    ends, jacobians = _joint_rows(scene, index)
    touching = defaultdict(set)
    for j, (parent, child) in enumerate(ends):
        for body in (parent, child):
            if body != WORLD:
                touching[body].add(j)
    neighbours = [set().union(*(touching[body] for body in pair if body != WORLD)) - {j}
                  for j, pair in enumerate(ends)]
    order, below = elimination_order(neighbours)
    ends = [ends[j] for j in order]
    jacobians = [jacobians[j] for j in order]
    rows = np.array([len(jacobian) for jacobian in jacobians], dtype=np.int64)

    m = len(order)
    child_jacobian, child_mobility = np.zeros((m, 36)), np.zeros((m, 36))
    for j, jacobian in enumerate(jacobians):
        child = ends[j][1]
        inverse_inertia = bodies[child]["inverse_inertia"].reshape(3, 3)
        moved = np.hstack([jacobian[:, :3] @ inverse_inertia,
                           jacobian[:, 3:] * bodies[child]["inverse_mass"]])
        child_jacobian[j, :jacobian.size] = jacobian.ravel()
        child_mobility[j, :moved.size] = moved.ravel()

    place, size, ranges, columns, updates = block_layout(rows, below)
    constant, products = _products(ends, rows, place, size, child_jacobian, child_mobility)
    row_start = np.concatenate([[0], np.cumsum(rows)[:-1]]) if m else rows
    joints = np.array([(*ends[j], rows[j], row_start[j], *ranges[j]) for j in range(m)],
                      dtype=JOINT)
    model = Model(
        gravity=np.array([scene.gravity], dtype=float), bodies=bodies,
        forces=_forces(scene, index), joints=joints, child_jacobian=child_jacobian,
        child_mobility=child_mobility, products=products, columns=columns, updates=updates,
        solve_constant=constant, solve_is_constant=len(products) == 0)
    _factorise_once(model, scene, order)
    return model, order


def _joint_rows(scene, index):
    """Body indices (parent, child) and rows A Ad(F_b^-1) (k, 6) of every joint of the scene."""
    ends = [(index[joint.parent], index[joint.child]) for joint in scene.joints]
    jacobians = [LOWER_PAIRS[joint.type].forbidden @ SE3.Ad(np.linalg.inv(child_frame))
                 for joint, (_, child_frame) in zip(scene.joints, resolve_frames(scene))]
    return ends, jacobians


def _products(ends, rows, place, size, jacobian, mobility):
    """The constant part of S, and the products J_i G_j^T that depend on the pose.

    Two joints (or a joint and itself) are coupled once for every moving body they share; side 0
    is the child's, whose rows are constant, side 1 the parent's.
    """
    constant, products = np.zeros(size), []
    sides = defaultdict(list)
    for j, (parent, child) in enumerate(ends):
        sides[child].append((j, 0))
        if parent != WORLD:
            sides[parent].append((j, 1))
    for incident in sides.values():
        for i, side_i in incident:
            for j, side_j in incident:
                if i < j:
                    continue
                at = place[i, j]
                if side_i == side_j == 0:
                    block = (jacobian[i].reshape(6, 6)[:rows[i]]
                             @ mobility[j].reshape(6, 6)[:rows[j]].T)
                    constant[at:at + block.size] += block.ravel()
                else:
                    products.append((at, i, side_i, j, side_j))
    return constant, np.array(sorted(products), dtype=np.int64).reshape(-1, 5)


def _forces(scene, index):
    """The scene's forces as rows of every kind."""
    ends = {joint.name: (index[joint.parent], index[joint.child], *frames)
            for joint, frames in zip(scene.joints, resolve_frames(scene))}
    return make_forces(scene.forces, index, ends)


def _factorise_once(model, scene, order):
    """Factorise S at the initial state: at once for good where no pose changes it."""
    work = make_work(model, 1)
    solve = model.solve_constant if model.solve_is_constant else work.solve
    if not model.solve_is_constant:
        pose, twist = initial_state(scene)
        assemble_rows(model, work, pose, twist, False, work.multiplier)
        assemble_solve(model, work)
    dependent = factorise(model, solve)
    if dependent >= 0:
        joint = scene.joints[order[dependent]]
        raise SceneError(
            f"joint {joint.name} constrains what other joints constrain already (its rows depend "
            "on theirs); replace it by a joint that leaves more freedom, or leave it out",
            ("joints", order[dependent]))
