# SPDX-License-Identifier: Apache-2.0
"""Build a Model from a scene: indices for names, independent rows, refinements of a solve."""

import numpy as np

from liegroup_core.forces import rotors
from liegroup_core.forces.kinds import make_forces
from liegroup_core.joints.elements import ELEMENT, PAIR, WORLD
from liegroup_core.joints.kinds import TYPES
from liegroup_core.joints.motion import COLUMNS
from liegroup_core.scene.consistency import driven_joints, resolve_elements, resolve_frames
from liegroup_core.scene.massless import invertible_inertia

from .bodies import BODY, Model
from .redundancy import kept_rows

# Where masses or inertias of neighbours differ by this ratio or more, iterative refinement is used.
LARGE_RATIO = 1e3
# Ratios of a body's moments of inertia above which a solve takes one, two and three refinements. Measured relative
# error: 1e-12 times the ratio for twelve rods with joint rows that mix principal rotations, a thousandth of that
# for four rods without such rows. Each refinement about squares the relative error.
SLENDER, ALIGNED = (1e2, 1e6, 1e8), 1e-4


def initial_state(scene):
    """Pose (n, 12) and twist (n, 6) of all bodies at the start of a scene."""
    pose = np.array([np.concatenate([body.rotation.ravel(), body.position]) for body in scene.bodies]).reshape(-1, 12)
    twist = np.array([body.twist for body in scene.bodies], dtype=float).reshape(-1, 6)
    return pose, twist


def build_model(scene):
    """Model of a scene, with the names of its parts as in layout.Layout.

    scene : consistent, body frames at the centres of mass (scene.centres)
    returns (model, frames, owners, row_names, kept): frames of every joint; for every element its
    scene joint, the names of its rows, and the rows that are not redundant, which are solved for.
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
    inertias = [_solved_inertia(i, body, elements) for i, body in enumerate(scene.bodies)]
    bodies = np.array(
        [
            (body.mass, 1.0 / body.mass, body.inertia_matrix.ravel(), np.linalg.inv(inertia).ravel())
            for body, inertia in zip(scene.bodies, inertias)
        ],
        dtype=BODY,
    )
    model = Model(
        gravity=np.array([scene.gravity], dtype=float),
        bodies=bodies,
        forces=_forces(scene, index, frames),
        rotors=rotors.rows(scene.joints, frames, index),
        motions=np.zeros((len(driven_joints(scene)), COLUMNS)),  # set before every step
        elements=elements,
        row_residual=np.array([elements[e]["row_start"] + r for e in solved for r in kept[e]], dtype=np.int64),
        refinements=refinements(bodies, np.trace(inertias, axis1=1, axis2=2), ends, elements),
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


def _solved_inertia(i, body, elements):
    """Inertia (3, 3) of body i about its centre of mass, for the arrays of the solve on SE(3)^n.

    If the body has no inertia about an axis, that of its mass at its joints is added. No method then solves
    with these arrays (methods/families.py), but the rest of the Model is used.
    """
    points = [elements[f"{end}_point"][elements[end] == i] for end in ("parent", "child")]
    reach = np.linalg.norm(np.concatenate(points), axis=1).max(initial=0.0)
    return invertible_inertia(body, reach or 1.0)


def _forces(scene, index, frames):
    """Forces of the scene as rows of every kind."""
    ends = {joint.name: (index[joint.parent], index[joint.child], *pair) for joint, pair in zip(scene.joints, frames)}
    slides = {joint.name for joint in scene.joints if TYPES[joint.type].coordinate == "m"}
    return make_forces(scene.forces, index, ends, scene.unwrapped, slides, scene.sensors)


def refinements(bodies, inertias, ends, elements):
    """Number of iterative refinements that recover the digits lost in the solve.

    bodies : (n,) of BODY; inertias : (n,) sums of principal moments that the solve uses
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

    Ratios of rows that do not mix principal rotations are multiplied by ALIGNED.
    inverse : (n, 3, 3) inverse inertias; outer : of every element the body farther from the world
    """
    forbidden = elements["forbidden"].reshape(-1, 6, 6)[:, :, :3]
    turns = forbidden.any(axis=(1, 2))
    if not turns.any():
        return 1.0
    moments, axes = np.linalg.eigh(inverse[outer[turns]])
    ratio = moments[:, :, None] / moments[:, None, :]
    rows = np.einsum("erf,ebf,ebp->erp", forbidden[turns], elements["child_rotation"][turns].reshape(-1, 3, 3), axes)
    mix = np.abs(rows[:, :, :, None] * rows[:, :, None, :]).max(axis=1)
    # In the parent's axes rows rotate with the joint, like rows that depend on the pose.
    mix[(outer != elements["child"])[turns] | (elements["kind"] != PAIR)[turns]] = 1.0
    return float((np.maximum(mix, ALIGNED) * ratio).max())


def _outer_ends(n, ends, elements):
    """Of the two bodies of every element, the one that is farther from the world in number of joints."""
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
    return np.where(depth[elements["parent"]] > depth[elements["child"]], elements["parent"], elements["child"])


def are_unlike(masses, inertias, ends, turned):
    """True if masses differ so much that the solve loses more than about three digits.

    ends   : (parent, child) of each joint: masses and inertias are compared with their neighbours'
    turned : of `levers`: ratio of the mobilities of a point by rotation and by translation of its body
    """
    ratios = [1.0] + [sizes[a] / sizes[b] for sizes in (masses, inertias) for a, b in ends if a != WORLD]
    return max(max(ratio, 1.0 / ratio) for ratio in ratios) > LARGE_RATIO or max(turned, default=0.0) > LARGE_RATIO
