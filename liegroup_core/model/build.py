# SPDX-License-Identifier: Apache-2.0
"""Scene -> Model: names become indices, frames become Jacobian rows, the solve gets its structure."""
import numpy as np

from ..dynamics.constraints import assemble
from ..dynamics.saddle_point import factorise
from ..scene.consistency import resolve_frames
from .arrays import BODY, JOINT, SPRING_DAMPER, VERTEX, WORLD, Model, make_work
from .linkage import child_rows
from .redundancy import kept_rows
from .sparsity import block_layout, elimination_order

# A pivot this small against its row's own S_rr belongs to a singular pose: the sine of the angle by
# which the row misses those it depends on is then below 1e-5. Nearer, the drift of a loop, 1e-9
# say, would be divided by that sine. A ratio of neighbouring masses of 1e8 makes good pivots of 1e-8.
SMALLEST_PIVOT = 1e-10

# From here on a step of refinement costs less than the digits that are lost without it.
LARGE_MASS_RATIO = 1e3


def initial_state(scene):
    """Pose (n, 12) and twist (n, 6) of all bodies at the start of a scene."""
    pose = np.array([np.concatenate([body.rotation.ravel(), body.position])
                     for body in scene.bodies]).reshape(-1, 12)
    twist = np.array([body.twist for body in scene.bodies], dtype=float).reshape(-1, 6)
    return pose, twist


def build_model(scene):
    """Model of a scene, and for each of its joints (scene joint, kept rows (k,)).

    scene : consistent, its body frames at the centres of mass (scene.centres)
    Rows that depend on others for good are left out, and a joint without any is no joint.
    raises SceneError for a linkage at a pose that it cannot leave
    """
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": WORLD}
    frames = resolve_frames(scene)
    jacobians = [child_rows(joint, child_frame)
                 for joint, (_, child_frame) in zip(scene.joints, frames)]
    keep = kept_rows(scene, frames, jacobians)
    elements = [(j, np.flatnonzero(mask)) for j, mask in enumerate(keep) if mask.any()]
    jacobians = [jacobians[j][rows] for j, rows in elements]
    ends = [(index[scene.joints[j].parent], index[scene.joints[j].child]) for j, _ in elements]
    n, m = len(scene.bodies), len(ends)
    rows = [len(jacobian) for jacobian in jacobians]

    # Vertices: bodies 0..n-1, then joints.
    sizes = [6] * n + rows
    neighbours = [set() for _ in sizes]
    for j, pair in enumerate(ends):
        for body in pair:
            if body != WORLD:
                neighbours[body].add(n + j)
                neighbours[n + j].add(body)
    order, below = elimination_order(sizes, neighbours, n)
    position = {v: p for p, v in enumerate(order)}
    sizes = np.array([sizes[v] for v in order], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    place, size, ranges, columns, updates = block_layout(sizes, below)
    vertices = np.array([(order[p] - n if order[p] >= n else -1, sizes[p], starts[p], *ranges[p])
                         for p in range(n + m)], dtype=VERTEX)

    bodies = np.array([(body.mass, 1.0 / body.mass, body.inertia_matrix.ravel(),
                        np.linalg.inv(body.inertia_matrix).ravel(), starts[position[i]])
                       for i, body in enumerate(scene.bodies)], dtype=BODY)
    joints = np.zeros(m, dtype=JOINT)
    child_jacobian = np.zeros((m, 36))
    for j, (parent, child) in enumerate(ends):
        joints[j] = (parent, child, rows[j], starts[position[n + j]],
                     *_block(place, position, n + j, child),
                     *_block(place, position, n + j, parent))
        child_jacobian[j, :6 * rows[j]] = jacobians[j].ravel()

    model = Model(
        gravity=np.array([scene.gravity], dtype=float), bodies=bodies,
        springs=_springs(scene, index), joints=joints, child_jacobian=child_jacobian,
        vertices=vertices, columns=columns, updates=updates,
        pivot_floor=_pivot_floor(scene, bodies, joints, jacobians, int(sizes.sum())),
        constant=_constant_part(scene, place, position, bodies, joints, jacobians, size),
        is_constant=all(parent == WORLD for parent, _ in ends),
        refinements=_refinements(bodies, ends))
    if model.is_constant:
        work = make_work(model, 1)
        assemble(model, work, *initial_state(scene))
        factorise(model, model.constant, 0.0)
    return model, elements


def _block(place, position, joint, body):
    """Place of the block of a joint and a body in K, and 1 if it holds the rows as columns."""
    if body == WORLD:
        return -1, 0
    turned = position[body] > position[joint]
    return place[max(position[joint], position[body]), min(position[joint], position[body])], turned


def _constant_part(scene, place, position, bodies, joints, jacobians, size):
    """M and the children's rows in the flat array of K; the rest zero."""
    constant = np.zeros(size)
    for i, body in enumerate(scene.bodies):
        block = np.zeros((6, 6))
        block[:3, :3] = body.inertia_matrix
        block[3:, 3:] = body.mass * np.eye(3)
        at = place[position[i], position[i]]
        constant[at:at + 36] = block.ravel()
    for joint, jacobian in zip(joints, jacobians):
        at = joint["child_place"]
        block = jacobian.T if joint["child_turned"] else jacobian
        constant[at:at + block.size] = block.ravel()
    return constant


def _pivot_floor(scene, bodies, joints, jacobians, count):
    """Smallest good pivot of every scalar of K: none for bodies, a fraction of S_rr for rows.

    S = J M^-1 J^T is what a row's pivot would be without any other row. Both ends of a joint count
    about the same here, so its child's part stands for all of it.
    """
    floor = np.zeros(count)
    for joint, jacobian in zip(joints, jacobians):
        body = bodies[joint["child"]]
        moved = np.hstack([jacobian[:, :3] @ body["inverse_inertia"].reshape(3, 3),
                           jacobian[:, 3:] * body["inverse_mass"]])
        floor[joint["start"]:joint["start"] + len(jacobian)] = (
            SMALLEST_PIVOT * (jacobian * moved).sum(axis=1))
    return floor


def _springs(scene, index):
    """The scene's spring-dampers as rows of SPRING_DAMPER."""
    rows = [(index[s.parent], index[s.child], s.parent_point, s.child_point,
             s.stiffness, s.damping, s.rest_length)
            for s in scene.forces if s.type == "spring_damper"]
    return np.array(rows, dtype=SPRING_DAMPER)


def _refinements(bodies, ends):
    """Steps of iterative refinement: one for joined bodies of very different mass, else none."""
    ratios = [1.0] + [bodies[a]["mass"] / bodies[b]["mass"] for a, b in ends if a != WORLD]
    return int(max(max(ratio, 1.0 / ratio) for ratio in ratios) > LARGE_MASS_RATIO)
