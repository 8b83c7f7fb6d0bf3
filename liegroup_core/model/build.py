# SPDX-License-Identifier: Apache-2.0
"""Scene -> Model: names become indices, frames become Jacobian rows, the solve gets its structure."""
from collections import defaultdict

import numpy as np

from ..dynamics.block_cholesky import factorise
from ..dynamics.constraints import assemble_rows, assemble_solve
from ..errors import SceneError
from ..joints.elements import PAIR
from ..lie.groups import SE3
from ..scene.consistency import check_consistency, resolve_elements, resolve_frames
from .arrays import BODY, ELEMENT, JOINT, SPRING_DAMPER, WORLD, Model, make_work
from .sparsity import block_layout, elimination_order


def initial_state(scene):
    """Pose (n, 12) and twist (n, 6) of all bodies at the start of a scene."""
    pose = np.array([np.concatenate([body.rotation.ravel(), body.position])
                     for body in scene.bodies]).reshape(-1, 12)
    twist = np.array([body.twist for body in scene.bodies], dtype=float).reshape(-1, 6)
    return pose, twist


def build_model(scene):
    """Model of a scene, and the scene's index of each of the model's joints.

    returns (model, joint_order): joint j of the model is of scene.joints[joint_order[j]]
    raises SceneError: joints that do not close, velocities against them, rows that depend
    """
    check_consistency(scene)
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": WORLD}
    bodies = np.array([(body.mass, 1.0 / body.mass, body.inertia_matrix.ravel(),
                        np.linalg.inv(body.inertia_matrix).ravel()) for body in scene.bodies],
                      dtype=BODY)
    elements, owners, jacobians = _elements(scene, index)
    ends = [(int(element["parent"]), int(element["child"])) for element in elements]
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

    kinds = elements["kind"][order]
    place, size, ranges, columns, updates = block_layout(rows, below)
    constant, products = _products(ends, kinds, rows, place, size, child_jacobian, child_mobility)
    row_start = np.concatenate([[0], np.cumsum(rows)[:-1]]) if m else rows
    joints = np.array([(*ends[j], kinds[j], order[j], rows[j], row_start[j], *ranges[j])
                       for j in range(m)], dtype=JOINT)
    first = elements["row_start"][order]
    model = Model(
        gravity=np.array([scene.gravity], dtype=float), bodies=bodies,
        springs=_springs(scene, index), elements=elements, joints=joints,
        row_residual=np.repeat(first - row_start, rows) + np.arange(rows.sum()),
        child_jacobian=child_jacobian, child_mobility=child_mobility, products=products,
        columns=columns, updates=updates, solve_constant=constant,
        solve_is_constant=len(products) == 0)
    owners = [owners[j] for j in order]
    _factorise_once(model, scene, owners)
    return model, owners


def _elements(scene, index):
    """The joints of a scene as constraint elements.

    returns (elements, owners, jacobians): (m,) of ELEMENT, the index of the joint each belongs to,
    and its rows A Ad(F_b^-1) (k, 6)
    """
    records, owners, jacobians = [], [], []
    first = 0
    frames = resolve_frames(scene)
    for i, (joint, parts) in enumerate(zip(scene.joints, resolve_elements(scene))):
        F_a, F_b = frames[i]
        for part in parts:
            rows = len(part.forbidden)
            forbidden = np.zeros(36)
            forbidden[:6 * rows] = part.forbidden.ravel()
            records.append((
                part.kind, index[joint.parent], index[joint.child], rows, first,
                F_a[:3, :3].ravel(), F_a[:3, 3], F_b[:3, :3].ravel(), F_b[:3, 3],
                forbidden, part.turns_freely, part.pitch, part.length))
            owners.append(i)
            jacobians.append(part.forbidden @ SE3.Ad(SE3.inverse(F_b)))
            first += rows
    return np.array(records, dtype=ELEMENT), owners, jacobians


def _products(ends, kinds, rows, place, size, jacobian, mobility):
    """The constant part of S, and the products J_i G_j^T that depend on the pose.

    Two joints (or a joint and itself) are coupled once for every moving body they share; side 0
    is the child's, whose rows are constant if it is a PAIR, side 1 the parent's.
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
                if side_i == side_j == 0 and kinds[i] == kinds[j] == PAIR:
                    block = (jacobian[i].reshape(6, 6)[:rows[i]]
                             @ mobility[j].reshape(6, 6)[:rows[j]].T)
                    constant[at:at + block.size] += block.ravel()
                else:
                    products.append((at, i, side_i, j, side_j))
    return constant, np.array(sorted(products), dtype=np.int64).reshape(-1, 5)


def _springs(scene, index):
    """The scene's spring-dampers as rows of SPRING_DAMPER."""
    rows = [(index[s.parent], index[s.child], s.parent_point, s.child_point,
             s.stiffness, s.damping, s.rest_length)
            for s in scene.forces if s.type == "spring_damper"]
    return np.array(rows, dtype=SPRING_DAMPER)


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
