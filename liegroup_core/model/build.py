# SPDX-License-Identifier: Apache-2.0
"""Build a Model from a scene: indices for names, Jacobian rows, structure of the solve."""

import numpy as np

from liegroup_core.forces.kinds import make_forces
from liegroup_core.joints.elements import ELEMENT, PAIR, WORLD
from liegroup_core.joints.motion import COLUMNS
from liegroup_core.lie.groups import SE3
from liegroup_core.scene.consistency import driven_joints, resolve_elements, resolve_frames
from liegroup_core.scene.massless import invertible_inertia

from .arrays import BODY, Model
from .redundancy import kept_rows, loop_joints
from .sparsity import cheapest_structure

# A pivot smaller than this part of its row's own S_rr indicates a singular pose: the sine of the
# angle between the row and the span of the others is below 1e-5. Closer to the singularity the
# drift of a loop, about 1e-9, would be divided by that sine. A ratio of neighbouring masses of 1e8
# gives regular pivots of 1e-8.
SMALLEST_PIVOT = 1e-10

# Ratio of neighbouring masses or inertias from which iterative refinement is used.
LARGE_RATIO = 1e3
# Ratios of a body's moments of inertia from which one, two and three refinements are used. If joint
# rows mix its principal rotations, twelve rods lose 1e-12 times the ratio (measured); four rods
# without such rows a thousandth of it. Each refinement about squares the relative error.
SLENDER, ALIGNED = (1e2, 1e6, 1e8), 1e-4


def initial_state(scene):
    """Pose (n, 12) and twist (n, 6) of all bodies at the start of a scene."""
    pose = np.array(
        [np.concatenate([body.rotation.ravel(), body.position]) for body in scene.bodies]
    ).reshape(-1, 12)
    twist = np.array([body.twist for body in scene.bodies], dtype=float).reshape(-1, 6)
    return pose, twist


def build_model(scene):
    """Model of a scene, with the names of its parts as in layout.Layout.

    scene : consistent, body frames at the centres of mass (scene.centres)
    returns (model, frames, owners, row_names, kept): frames of every joint; of each element its
    scene joint, the names of its rows, and the rows that are solved for. Redundant rows are
    eliminated; an element without remaining rows is not in `joints`.
    Raises SceneError for a linkage in a pose that it cannot leave.
    """
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": WORLD}
    frames = resolve_frames(scene)
    parts = resolve_elements(scene)
    elements, owners = _elements(scene, index, frames, parts)
    keep = np.concatenate([np.zeros(0, dtype=bool), *kept_rows(scene, frames, parts)])
    kept = [
        tuple(np.flatnonzero(keep[first : first + rows]).tolist())
        for first, rows in zip(elements["row_start"], elements["rows"])
    ]
    solved = [e for e, rows in enumerate(kept) if rows]
    ends = [(int(elements[e]["parent"]), int(elements[e]["child"])) for e in solved]
    n = len(scene.bodies)
    rows = [len(kept[e]) for e in solved]
    jacobians = [_constant_rows(elements[e])[list(kept[e])] for e in solved]

    loops = set(loop_joints([(joint.parent, joint.child) for joint in scene.joints]))
    inertias = [_solved_inertia(i, body, elements) for i, body in enumerate(scene.bodies)]
    bodies = np.array(
        [
            (
                body.mass,
                1.0 / body.mass,
                body.inertia_matrix.ravel(),
                np.linalg.inv(inertia).ravel(),
            )
            for body, inertia in zip(scene.bodies, inertias)
        ],
        dtype=BODY,
    )
    few = refinements(bodies, np.trace(inertias, axis1=1, axis2=2), ends, elements)
    structure = cheapest_structure(n, rows, ends, elements["kind"][solved] != PAIR, few == 0)
    joints = structure.joints()
    joints["element"] = solved
    joints["kind"] = elements["kind"][solved]
    model = Model(
        gravity=np.array([scene.gravity], dtype=float),
        bodies=bodies,
        forces=_forces(scene, index, frames),
        motions=np.zeros((len(driven_joints(scene)), COLUMNS)),  # set before every step
        elements=elements,
        joints=joints,
        row_residual=np.array(
            [elements[e]["row_start"] + r for e in solved for r in kept[e]], dtype=np.int64
        ),
        child_jacobian=np.concatenate([np.zeros((0, 6)), *jacobians]),
        ground_projector=_ground_projector(bodies, joints, jacobians),
        pivot_floor=_pivot_floor(
            bodies,
            elements,
            joints,
            jacobians,
            structure.unknowns,
            [j for j, e in enumerate(solved) if owners[e] in loops],
        ),
        refinements=few,
        **structure.arrays(list(map(_mass_matrix, scene.bodies, inertias)), jacobians),
    )
    names = tuple(part.names for elements in parts for part in elements)
    return model, tuple(frames), owners, names, tuple(kept)


def _elements(scene, index, frames, parts):
    """(records of ELEMENT, index of the scene joint of each) of all joints."""
    records, owners = [], []
    first = 0
    for i, (joint, (F_a, F_b), elements) in enumerate(zip(scene.joints, frames, parts)):
        for part in elements:
            records.append(part.record(index[joint.parent], index[joint.child], first, F_a, F_b))
            owners.append(i)
            first += len(part.names)
    return np.array(records, dtype=ELEMENT), tuple(owners)


def _constant_rows(element):
    """Rows A Ad(F_b^-1) (k, 6) of a PAIR; zeros of an element whose row depends on the pose."""
    if element["kind"] != PAIR:
        return np.zeros((element["rows"], 6))
    frame = np.eye(4)
    frame[:3, :3] = element["child_rotation"].reshape(3, 3)
    frame[:3, 3] = element["child_point"]
    return element["forbidden"][: 6 * element["rows"]].reshape(-1, 6) @ SE3.Ad(SE3.inverse(frame))


def _solved_inertia(i, body, elements):
    """Inertia (3, 3) of body i about its centre of mass, for the arrays of the solve on SE(3)^n.

    Without inertia about an axis, that of the body's mass at its joints is added: no method solves
    with it (integrators/families.py), but the other arrays of the Model are used.
    """
    points = [elements[f"{end}_point"][elements[end] == i] for end in ("parent", "child")]
    reach = np.linalg.norm(np.concatenate(points), axis=1).max(initial=0.0)
    return invertible_inertia(body, reach or 1.0)


def _mass_matrix(body, inertia):
    """Mass matrix (6, 6) of a body of the scene about its centre of mass."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = inertia
    matrix[3:, 3:] = body.mass * np.eye(3)
    return matrix


def _mobility(body, jacobian):
    """Rows J M^-1 (k, 6) of a body."""
    return np.hstack(
        [
            jacobian[:, :3] @ body["inverse_inertia"].reshape(3, 3),
            jacobian[:, 3:] * body["inverse_mass"],
        ]
    )


def _ground_projector(bodies, joints, jacobians):
    """(m, 36) projectors on the part of the child's twist that a PAIR to ground forbids."""
    projectors = np.zeros((len(joints), 36))
    for projector, joint, jacobian in zip(projectors, joints, jacobians):
        if joint["parent"] == WORLD and joint["kind"] == PAIR:
            moved = _mobility(bodies[joint["child"]], jacobian)
            projector[:] = (moved.T @ np.linalg.solve(jacobian @ moved.T, jacobian)).ravel()
    return projectors


def _pivot_floor(bodies, elements, joints, jacobians, count, in_loops):
    """Smallest regular pivot of every scalar of K: a fraction of S_rr for rows of joints in loops.

    Bodies and joints of trees have no bound: their pivots are positive at every pose.
    S_rr with S = J M^-1 J^T is the pivot of a row without any other row. The child's part of it is
    used; both ends are of the same order. An element whose row depends on the pose uses the
    smallest mobility in the directions that its row may take.
    """
    floor = np.zeros(count)
    for j in in_loops:
        joint, jacobian = joints[j], jacobians[j]
        body = bodies[joint["child"]]
        if joint["kind"] != PAIR:
            directions = elements[joint["element"]]["forbidden"].reshape(6, 6)
            jacobian = directions[directions.any(axis=1)]
        size = (jacobian * _mobility(body, jacobian)).sum(axis=1)
        floor[joint["start"] : joint["start"] + joint["rows"]] = SMALLEST_PIVOT * (
            size if joint["kind"] == PAIR else size.min()
        )
    return floor


def _forces(scene, index, frames):
    """Forces of the scene as rows of every kind."""
    ends = {
        joint.name: (index[joint.parent], index[joint.child], *pair)
        for joint, pair in zip(scene.joints, frames)
    }
    springs = sum(force.counts_turns for force in scene.forces)
    servos = sum(force.type == "servo" for force in scene.forces)
    counted = [joint for joint, _ in scene.unwrapped[springs : len(scene.unwrapped) - servos]]
    return make_forces(scene.forces, index, ends, counted)


def refinements(bodies, inertias, ends, elements):
    """Number of iterative refinements that recover the digits lost in the solve.

    bodies : (n,) of BODY; inertias : (n,) their sums of principal moments that are solved with
    ends   : (parent, child) of each joint; elements : of ELEMENT
    """
    inverse = bodies["inverse_inertia"].reshape(-1, 3, 3)
    unlike = are_unlike(bodies["mass"], inertias, ends, levers(bodies["mass"], inverse, elements))
    mixed = _mixed_turns(inverse, elements, _outer_ends(len(bodies), ends, elements))
    return max(int(unlike), int(np.searchsorted(SLENDER, mixed)))


def levers(masses, inverse, elements):
    """m p^2 / I of every end of an element on a body, p its lever; inverse : (n, 3, 3) of I."""
    found = []
    for end in ("parent", "child"):
        held = elements[elements[end] != WORLD]
        lever = np.cross(np.eye(3), held[f"{end}_point"][:, None, :])
        turned = np.einsum("eri,eij,erj->e", lever, inverse[held[end]], lever)
        found.extend(masses[held[end]] * turned)
    return found


def _mixed_turns(inverse, elements, outer):
    """Largest ratio of a body's principal rotational mobilities that a joint row mixes.

    Rows that do not mix principal rotations count by the factor ALIGNED.
    inverse : (n, 3, 3) inverse inertias; outer : of every element the body farther from the world
    """
    forbidden = elements["forbidden"].reshape(-1, 6, 6)[:, :, :3]
    turns = forbidden.any(axis=(1, 2))
    if not turns.any():
        return 1.0
    moments, axes = np.linalg.eigh(inverse[outer[turns]])
    ratio = moments[:, :, None] / moments[:, None, :]
    rows = np.einsum(
        "erf,ebf,ebp->erp",
        forbidden[turns],
        elements["child_rotation"][turns].reshape(-1, 3, 3),
        axes,
    )
    mix = np.abs(rows[:, :, :, None] * rows[:, :, None, :]).max(axis=1)
    # In the parent's axes rows rotate with the joint, like rows that depend on the pose.
    mix[(outer != elements["child"])[turns] | (elements["kind"] != PAIR)[turns]] = 1.0
    return float((np.maximum(mix, ALIGNED) * ratio).max())


def _outer_ends(n, ends, elements):
    """Body of every element that is farther from the world, in number of joints."""
    near = [set() for _ in range(n + 1)]  # the last one, WORLD, is the world
    for a, b in ends:
        near[a].add(b)
        near[b].add(a)
    depth, front = np.full(n + 1, n + 1), [WORLD]
    depth[WORLD] = 0
    while front:
        reached = sorted({b for a in front for b in near[a] if depth[b] > n})
        depth[reached] = depth[front[0]] + 1
        front = reached
    return np.where(
        depth[elements["parent"]] > depth[elements["child"]], elements["parent"], elements["child"]
    )


def are_unlike(masses, inertias, ends, turned):
    """True if masses differ so much that the solve loses more than about three digits.

    ends   : (parent, child) of each joint: masses and inertias are compared with their neighbours'
    turned : of `levers`: ratio of the mobilities of a point by rotation and by translation of its body
    """
    ratios = [1.0] + [
        sizes[a] / sizes[b] for sizes in (masses, inertias) for a, b in ends if a != WORLD
    ]
    return (
        max(max(ratio, 1.0 / ratio) for ratio in ratios) > LARGE_RATIO
        or max(turned, default=0.0) > LARGE_RATIO
    )
