# SPDX-License-Identifier: Apache-2.0
"""Detection of planar mechanisms, and their PlanarModel.

A lower pair is planar if it allows planar motions only: a revolute joint along the normal, a
prismatic joint in the plane, a planar joint. If such pairs connect every body to the world, no body
can leave the plane, for any wrench and any inertia: their constraint wrenches balance all
out-of-plane loads. The in-plane part of (6.22) with three coordinates per body is then exact. All
other joints close loops; only the in-plane part of their rows is kept.

The normal must be a world axis and an axis of each body. Planar coordinates are then a permutation
of spatial ones, without round-off.
"""

from functools import lru_cache

import numpy as np
import scipy

from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.linkage import Linkage
from liegroup_core.lie.groups import SE3
from liegroup_core.model.build import LARGE_RATIO, SMALLEST_PIVOT, are_unlike, initial_state
from liegroup_core.model.redundancy import REMEMBERED, generic_poses, independent_rows, loop_joints
from liegroup_core.model.sparsity import cheapest_structure
from liegroup_core.scene.consistency import resolve_elements, resolve_frames

from .arrays import PLANAR_BODY, PlanarModel
from .state import IN_PLANE
from .tree import tree_links

# Planar axes in world axes, as rows, for a normal along z, y and x.
PLANES = (np.eye(3), np.eye(3)[[2, 0, 1]], np.eye(3)[[1, 2, 0]])
# Smallest in-plane part of a unit row that is independent of the others.
ROW_TOLERANCE = 1e-6


def planar_model(scene, model):
    """PlanarModel of a mechanism, or None if it is not planar.

    scene : Scene with body frames at the centres of mass
    model : its Model
    """
    if len(model.elements) == 0 or (model.elements["kind"] != PAIR).any():
        return None
    pose, _ = initial_state(scene)
    for world in PLANES:
        axes = _body_axes(world, pose)
        if axes is not None and _is_connected(world[2], pose, model.elements):
            return _build(scene, model, world, axes)
    return None


def _body_axes(world, pose):
    """Planar axes of every body in its body axes, as rows (n, 3, 3); None if there are none.

    A body axis must be parallel to the normal; the two others are then the planar axes.
    """
    axes = []
    for R in pose[:, :9].reshape(-1, 3, 3):
        normal = R.T @ world[2]
        k = int(np.argmax(np.abs(normal)))
        if np.abs(np.delete(normal, k)).max() > IN_PLANE:
            return None
        # (k+1, k+2, k) is right-handed; for a normal along -k the first two are exchanged.
        sign = 1.0 if normal[k] > 0.0 else -1.0
        first, second = (k + 1) % 3, (k + 2) % 3
        if sign < 0.0:
            first, second = second, first
        rows = np.eye(3)[[first, second, k]]
        rows[2] *= sign
        axes.append(rows)
    return np.array(axes)


def _is_connected(normal, pose, elements):
    """True if planar pairs connect every body to the world."""
    reached, last = {WORLD}, 0
    links = [
        (int(e["parent"]), int(e["child"])) for e in elements if _moves_in_plane(normal, pose, e)
    ]
    while len(reached) > last:
        last = len(reached)
        for pair in links:
            if reached.intersection(pair):
                reached.update(pair)
    return len(reached) == len(pose) + 1


def _moves_in_plane(normal, pose, element):
    """True if a pair allows only rotations about the normal and translations in the plane."""
    R = pose[element["child"], :9].reshape(3, 3) @ element["child_rotation"].reshape(3, 3)
    free = scipy.linalg.null_space(element["forbidden"][: 6 * element["rows"]].reshape(-1, 6))
    turns, shifts = R @ free[:3], R @ free[3:]
    return (
        np.abs(np.cross(normal, turns.T)).max(initial=0.0) <= IN_PLANE
        and np.abs(normal @ shifts).max(initial=0.0) <= IN_PLANE
    )


def _build(scene, model, world, axes):
    """PlanarModel of a planar mechanism."""
    # Per body (6, 3): maps a planar twist to the spatial twist.
    lift = np.zeros((len(axes), 6, 3))
    lift[:, :3, 0] = axes[:, 2]
    lift[:, 3:, 1:] = axes[:, :2].transpose(0, 2, 1)
    rows = _kept_rows(scene, model.elements, lift)
    solved = [e for e, kept in enumerate(rows) if len(kept)]
    jacobians = [rows[e] for e in solved]
    ends = [(int(model.elements[e]["parent"]), int(model.elements[e]["child"])) for e in solved]
    n, m = len(axes), len(solved)
    inertias = np.array(
        [
            axis[2] @ body["inertia"].reshape(3, 3) @ axis[2]
            for axis, body in zip(axes, model.bodies)
        ]
    )
    masses = [
        np.diag([inertia, body["mass"], body["mass"]])
        for inertia, body in zip(inertias, model.bodies)
    ]
    unlike = are_unlike(
        model.bodies["mass"],
        inertias,
        ends,
        _lever_ratios(model.elements, axes, model.bodies["mass"], inertias),
    )
    structure = cheapest_structure(
        3, n, [len(jacobian) for jacobian in jacobians], ends, [False] * m, not unlike
    )
    joints = structure.joints()
    joints["element"] = solved
    projectors = np.zeros((m, 9))
    floor = np.zeros(structure.unknowns)
    # Every joint has one element, because all are lower pairs.
    loops = set(loop_joints([(joint.parent, joint.child) for joint in scene.joints]))
    for j, ((parent, child), jacobian) in enumerate(zip(ends, jacobians)):
        mobility = jacobian / np.diag(masses[child])
        if solved[j] in loops:
            floor[joints[j]["start"] : joints[j]["start"] + len(jacobian)] = SMALLEST_PIVOT * (
                jacobian * mobility
            ).sum(axis=1)
        if parent == WORLD:
            projectors[j] = (mobility.T @ np.linalg.solve(jacobian @ mobility.T, jacobian)).ravel()
    alike = not unlike and _are_alike(model.bodies["mass"], inertias)
    links = tree_links(len(axes), ends, jacobians if alike else [])
    return PlanarModel(
        space=model,
        has_forces=any(map(len, model.forces.values())),
        world=world.reshape(1, 9),
        gravity=model.gravity @ world[:2].T,
        bodies=np.array(
            [
                (body["mass"], inertia, axis.ravel())
                for body, inertia, axis in zip(model.bodies, inertias, axes)
            ],
            dtype=PLANAR_BODY,
        ),
        joints=joints,
        child_jacobian=np.concatenate([np.zeros((0, 3)), *jacobians]),
        ground_projector=projectors,
        pivot_floor=floor,
        refinements=int(unlike),
        projects=model.projects,
        links=links,
        **structure.arrays(masses, jacobians),
    )


def _lever_ratios(elements, axes, masses, inertias):
    """m p^2 / I at both ends of each element; p: its point in the plane, from the centre of mass."""
    ratios = []
    for end in ("parent", "child"):
        movable = elements[elements[end] != WORLD]
        body = movable[end]
        points = np.einsum("erc,ec->er", axes[body, :2], movable[f"{end}_point"])
        ratios.extend(masses[body] * (points**2).sum(axis=1) / inertias[body])
    return ratios


def _are_alike(*sizes):
    """True if masses and inertias differ by less than LARGE_RATIO: tree.py would lose digits."""
    return all(np.ptp(np.log(size)) <= np.log(LARGE_RATIO) for size in sizes)


def _kept_rows(scene, elements, lift):
    """Independent rows (k, 3) of each element, for the planar twist of its child."""
    rows = []
    for element in elements:
        frame = np.eye(4)
        frame[:3, :3] = element["child_rotation"].reshape(3, 3)
        frame[:3, 3] = element["child_point"]
        matrix = element["forbidden"][: 6 * element["rows"]].reshape(-1, 6)
        matrix = matrix @ SE3.Ad(SE3.inverse(frame)) @ lift[element["child"]]
        rows.append(_independent(matrix))
    loops = loop_joints([(joint.parent, joint.child) for joint in scene.joints])
    loops.sort(key=lambda j: scene.joints[j].parent != "world")
    if not loops:
        return rows
    linkage = Linkage(scene, resolve_frames(scene), resolve_elements(scene), loops)
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    chosen = _chosen(
        linkage,
        *(
            tuple(matrix.tobytes() for matrix in matrices)
            for matrices in (
                [rows[j] @ lift[elements[j]["child"]].T for j in loops],
                [lift[index[name]] for name in linkage.bodies],
            )
        ),
    )
    at = 0
    for j in loops:
        rows[j], at = rows[j][chosen[at : at + len(rows[j])]], at + len(rows[j])
    return rows


@lru_cache(maxsize=REMEMBERED)
def _chosen(linkage, in_space, lifts):
    """Mask of the rows to keep.

    in_space : bytes of the rows (k, 6) of each joint; lifts: bytes of (6, 3) of each body
    """
    in_space = [np.frombuffer(rows).reshape(-1, 6) for rows in in_space]
    flat = scipy.linalg.block_diag(*(np.frombuffer(lift).reshape(6, 3) for lift in lifts))
    flat[:, ::3] /= linkage.length
    matrices = []
    for poses in generic_poses(linkage):
        matrix = linkage.velocity_rows(poses, in_space) @ flat
        matrices.append(matrix / np.linalg.norm(matrix, axis=1, keepdims=True))
    chosen, _ = independent_rows(
        matrices,
        [joint.parent == "world" for joint, rows in zip(linkage.joints, in_space) for _ in rows],
    )
    chosen.flags.writeable = False
    return chosen


def _independent(matrix):
    """Linearly independent rows of a matrix (k, 3)."""
    _, R, order = scipy.linalg.qr(matrix.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    count = int((size > ROW_TOLERANCE * max(size.max(initial=0.0), 1.0)).sum())
    return matrix[np.sort(order[:count])]
