# SPDX-License-Identifier: Apache-2.0
"""RelativeModel of a scene: links, freedoms, and the rows of the cut joints that are independent."""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from liegroup_core.joints.elements import ELEMENT, PAIR, WORLD
from liegroup_core.joints.linkage import RANK_TOLERANCE, Linkage
from liegroup_core.lie.groups import SE3
from liegroup_core.model.arrays import JOINT
from liegroup_core.model.build import are_unlike
from liegroup_core.model.redundancy import generic_poses, independent_rows, loop_joints
from liegroup_core.scene.consistency import resolve_elements, resolve_frames

from .arrays import (
    AFTER_CROSS,
    BALL,
    CROSS,
    CYLINDER,
    FREE,
    FREEDOMS,
    HINGE,
    LINK,
    OWN,
    PART,
    PLANE,
    PLANE_LINK,
    SCREW,
    SLIDE,
    PlaneModel,
    RelativeModel,
)
from .inertia import check_inertia
from .plane import align, find_plane, frame_in_plane, plane_axes
from .spanning_tree import WORLD_NAME, spanning_tree

GROUPS = {
    "revolute": HINGE,
    "prismatic": SLIDE,
    "screw": SCREW,
    "cylindrical": CYLINDER,
    "planar": PLANE,
    "spherical": BALL,
}
# Components of S in the order of the freedoms.
COMPONENTS = {
    HINGE: (2,),
    SLIDE: (5,),
    SCREW: (2,),
    CYLINDER: (2, 5),
    PLANE: (2, 3, 4),
    BALL: (0, 1, 2),
    FREE: (0, 1, 2, 3, 4, 5),
}
# Axes of a universal joint as z axes: x of its parent frame, y of its child frame.
FIRST_AXIS, SECOND_AXIS = np.eye(4)[:, [1, 2, 0, 3]], np.eye(4)[:, [2, 0, 1, 3]]


class _Link:
    """Link under construction: `placement` T in its parent, and poses of its bodies in it."""

    def __init__(self, joint, group, parent, placement, coordinates=OWN, pitch=0.0):
        self.joint, self.group, self.parent, self.placement = joint, group, parent, placement
        self.coordinates, self.pitch, self.bodies = coordinates, pitch, {}
        self.components = COMPONENTS[group]

    def directions(self):
        """S (6, freedoms)."""
        S = np.eye(6)[:, list(self.components)]
        if self.group == SCREW:
            S[5, 0] = self.pitch
        return S


def relative_model(scene, model, in_space=False):
    """RelativeModel of a mechanism; a PlaneModel if it is planar.

    scene    : Scene with body frames at the centres of mass
    model    : its Model
    in_space : True: never a PlaneModel
    """
    frames, parts = resolve_frames(scene), resolve_elements(scene)
    plane = None if in_space else find_plane(scene, frames, parts)
    normal, allowed = (None, None) if plane is None else plane
    tree = spanning_tree(scene, allowed)
    links, places = _links(scene, frames, tree, normal)
    index = {body.name: i for i, body in enumerate(scene.bodies)}
    records = _records(scene, links, index)
    cut, rows = _cut_rows(scene, frames, parts, tree, links, places, model)
    elements = _elements(model, frames, cut, places, scene)
    arrays = _loop_arrays(links, records, cut, rows, elements)
    part_records = np.array(
        [
            (
                places[body.name][0],
                places[body.name][1][:3, :3].ravel(),
                places[body.name][1][:3, 3],
            )
            for body in scene.bodies
        ],
        dtype=PART,
    )
    common = dict(
        space=model,
        gravity=model.gravity,
        bodies=records,
        parts=part_records,
        has_forces=any(map(len, model.forces.values())),
        elements=elements,
        refinements=_refinements(model),
        projects=bool(model.projects and len(arrays["joints"])),
        baumgarte_rate=model.baumgarte_rate,
        **arrays,
    )
    if normal is None:
        return RelativeModel(**common)
    return PlaneModel(**common, **_plane_arrays(model, links, records, places, scene, normal))


def tree_of(scene):
    """SpanningTree that a RelativeModel of a scene is built on."""
    plane = find_plane(scene, resolve_frames(scene), resolve_elements(scene))
    return spanning_tree(scene, None if plane is None else plane[1])


def _plane_arrays(model, links, records, places, scene, normal):
    """Fields of a PlaneModel that a RelativeModel does not have."""
    axes = plane_axes(normal)
    plane_links, heights = [], []
    for link, record in zip(links, records):
        T = link.placement
        if link.parent == WORLD:
            turned = np.eye(4)
            turned[:3, :3] = axes
            T = turned.T @ T
        turn = T[:2, 0] / np.linalg.norm(T[:2, 0])
        heights.append(T[2, 3] + (0.0 if link.parent == WORLD else heights[link.parent]))
        plane_links.append(
            (
                link.group,
                link.parent,
                record["freedom"],
                record["mass"],
                *record["moment"][:2],
                record["inertia"][5],
                *turn,
                *T[:2, 3],
            )
        )
    return {
        "axes": axes.reshape(1, 9),
        "plane_gravity": model.gravity @ axes[:, :2],
        "links": np.array(plane_links, dtype=PLANE_LINK),
        "link_heights": np.array(heights),
        "heights": np.array(
            [
                (0.0 if b == WORLD else heights[b]) + pose[2, 3]
                for b, pose in (places[body.name] for body in scene.bodies)
            ]
        ),
    }


def _refinements(model):
    """Number of refinements: one where neighbours differ so much that articulated inertias lose digits.

    Slender bodies and long levers lose none (test/verification/test_relative_accelerations.py).
    """
    bodies, elements = model.bodies, model.elements
    ends = list(zip(elements["parent"].tolist(), elements["child"].tolist()))
    traces = bodies["inertia"][:, [0, 4, 8]].sum(axis=1)
    traces[traces <= 0.0] = traces.max() or 1.0  # point masses
    return int(are_unlike(bodies["mass"], traces, ends, []))


def refuse_freedoms_without_inertia(scene):
    """Raise SceneError if a freedom of the spanning tree has no inertia.

    scene : Scene with body frames at the centres of mass
    """
    links, places = _links(scene, resolve_frames(scene), spanning_tree(scene), None)
    poses = {body.name: body.pose for body in scene.bodies} | {WORLD_NAME: np.eye(4)}
    check_inertia(scene, links, places, _link_poses(links, range(len(links)), poses))


def _welds(scene, frames, members):
    """{body: pose in the frame of the first body of its weld group (in the world for the world's)}."""
    poses = {}
    ends = [
        (joint.parent, joint.child, F_a @ SE3.inverse(F_b))
        for joint, (F_a, F_b) in zip(scene.joints, frames)
        if joint.type == "fixed"
    ]
    beside = {}
    for a, b, relative in ends:
        beside.setdefault(a, []).append((b, relative))
        beside.setdefault(b, []).append((a, SE3.inverse(relative)))
    for group, bodies in enumerate(members):
        root = WORLD_NAME if group == 0 else bodies[0]
        poses[root], pending = np.eye(4), [root]
        while pending:
            name = pending.pop()
            for other, relative in beside.get(name, ()):
                if other not in poses:
                    poses[other] = poses[name] @ relative
                    pending.append(other)
    return poses


def _links(scene, frames, tree, normal):
    """([_Link], {body or world: (link index or WORLD, pose (4, 4) in the link)}).

    normal : of the plane of a planar mechanism, else None
    """
    poses = {body.name: body.pose for body in scene.bodies} | {WORLD_NAME: np.eye(4)}
    welds = _welds(scene, frames, tree.members)
    places = {name: (WORLD, welds[name]) for name in (WORLD_NAME, *tree.members[0])}
    links = []
    for group, _, j in tree.links:
        bodies = tree.members[group]
        if j is None:
            # The link frame is at the common centre of mass, with the axes of the first body.
            masses = np.array([scene.bodies[_index(scene, name)].mass for name in bodies])
            centre = sum(m * welds[name][:3, 3] for m, name in zip(masses, bodies)) / masses.sum()
            frame = np.eye(4)
            frame[:3, 3] = centre
            links.append(_Link(None, FREE, WORLD, np.eye(4)))
        else:
            joint, (F_a, F_b) = scene.joints[j], frames[j]
            reverse = joint.child not in bodies
            inner, outer = (joint.child, joint.parent) if reverse else (joint.parent, joint.child)
            F_in, F_out = (F_b, F_a) if reverse else (F_a, F_b)
            if normal is not None:
                to_plane = frame_in_plane(joint.type, (poses[outer] @ F_out)[:3, :3], normal)
                F_in, F_out = F_in @ to_plane, F_out @ to_plane
            parent, pose = places[inner]
            placement = pose @ F_in
            if joint.type == "universal":
                first, second = (SECOND_AXIS, FIRST_AXIS) if reverse else (FIRST_AXIS, SECOND_AXIS)
                links.append(_Link(j, HINGE, parent, placement @ first, CROSS))
                links.append(_Link(j, HINGE, len(links) - 1, first.T @ second, AFTER_CROSS))
                frame = welds[outer] @ F_out @ second
            else:
                kind = GROUPS[joint.type]
                pitch = joint.pitch if joint.type == "screw" else 0.0
                links.append(_Link(j, kind, parent, placement, pitch=pitch))
                if normal is not None and kind == SLIDE:
                    links[-1].components = (3,)
                frame = welds[outer] @ F_out
        to_link = SE3.inverse(frame)
        links[-1].bodies = {name: to_link @ welds[name] for name in bodies}
        if normal is not None:
            for pose in links[-1].bodies.values():
                align(pose)
        for name in bodies:
            places[name] = (len(links) - 1, links[-1].bodies[name])
    return links, places


def _index(scene, name):
    """Index of a body."""
    return next(i for i, body in enumerate(scene.bodies) if body.name == name)


def _records(scene, links, index):
    """(L,) of LINK."""
    records, first = [], 0
    for link in links:
        mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
        for name, pose in link.bodies.items():
            body = scene.bodies[index[name]]
            R, c = pose[:3, :3], pose[:3, 3]
            mass += body.mass
            moment += body.mass * c
            inertia += R @ body.inertia_matrix @ R.T
            inertia += body.mass * ((c @ c) * np.eye(3) - np.outer(c, c))
        # The heaviest body represents the link: its pose is nearest to the centre of mass.
        main = max(link.bodies, key=lambda name: scene.bodies[index[name]].mass, default=None)
        pose = link.bodies.get(main, np.eye(4))
        records.append(
            (
                link.group,
                link.parent,
                first,
                FREEDOMS[link.group],
                WORLD if main is None else index[main],
                link.coordinates,
                link.placement[:3, :3].ravel(),
                link.placement[:3, 3],
                pose[:3, :3].ravel(),
                pose[:3, 3],
                link.pitch,
                mass,
                moment,
                inertia[np.triu_indices(3)],
            )
        )
        first += FREEDOMS[link.group]
    return np.array(records, dtype=LINK)


def _path(links, b):
    """Links between a link and the world, itself first."""
    path = []
    while b != WORLD:
        path.append(b)
        b = links[b].parent
    return path


def _cut_rows(scene, frames, parts, tree, links, places, model):
    """([(joint, element of `model`, part)], [kept rows (k, 6) or mask]) of the cut joints."""
    cut = []
    element = 0
    for j, elements in enumerate(parts):
        for part in elements:
            if j in tree.cut:
                cut.append((j, element, part))
            element += 1
    if not cut:
        return cut, []
    keep = [np.ones(len(part.names), dtype=bool) for _, _, part in cut]
    loops = loop_joints([(joint.parent, joint.child) for joint in scene.joints])
    # A distance joint is cut also where it closes no loop: then its row is independent.
    closing = [k for k, (j, _, _) in enumerate(cut) if j in set(loops)]
    if closing:
        joints = sorted({cut[k][0] for k in closing})
        matrices = _tree_jacobians(scene, frames, parts, loops, joints, links, places)
        chosen, _ = independent_rows(matrices, np.zeros(len(matrices[0]), dtype=bool))
        at = 0
        for k in closing:
            keep[k] = chosen[at : at + len(keep[k])]
            at += len(keep[k])
    return cut, [np.flatnonzero(rows) for rows in keep]


def _tree_jacobians(scene, frames, parts, loops, joints, links, places):
    """Rows of the cut joints of loops for the freedoms of the tree, at generic poses.

    loops, joints : indices of the joints in loops, and of the cut ones among them
    """
    first = np.concatenate([[0], np.cumsum([FREEDOMS[link.group] for link in links])])
    ends = {
        j: [
            _path(links, places[name][0])
            for name in (scene.joints[j].child, scene.joints[j].parent)
        ]
        for j in joints
    }
    # On their common path to the world both ends of a joint move alike.
    needed = sorted(set().union(*(set(a) ^ set(b) for a, b in ends.values())))
    # The loops move with welded bodies, and with the joints that hold them beside a floating part.
    used = {links[i].joint for i in needed} - {None}
    used |= {j for j, joint in enumerate(scene.joints) if joint.type == "fixed"}
    # In the order of model/redundancy.py: the same linkage is analysed once.
    used = sorted(used.union(loops), key=lambda j: (scene.joints[j].parent != WORLD_NAME, j))
    linkage = Linkage(scene, frames, parts, used)
    length = linkage.length
    # Rotations and translations in comparable units.
    units = np.concatenate(
        [np.where(link.directions()[:3].any(axis=0), length, 1.0) for link in links]
    )
    matrices = []
    for poses in generic_poses(linkage):
        world = _link_poses(links, needed, poses)
        motions = {i: SE3.Ad(world[i]) @ links[i].directions() for i in needed}
        blocks = []
        for j in joints:
            J = linkage.joint_rows(used.index(j), poses)
            J = J / np.linalg.norm(J / ([length] * 3 + [1.0] * 3), axis=1, keepdims=True)
            J = J @ SE3.Ad(SE3.inverse(poses[scene.joints[j].child]))
            block = np.zeros((len(J), first[-1]))
            child, parent = ends[j]
            for sign, path, other in ((1.0, child, parent), (-1.0, parent, child)):
                for i in set(path) - set(other):
                    block[:, first[i] : first[i + 1]] = sign * J @ motions[i]
            blocks.append(block)
        matrix = np.concatenate(blocks) / units
        # Rows that the tree satisfies already, such as those out of the plane of planar loops.
        matrix[np.linalg.norm(matrix, axis=1) < RANK_TOLERANCE] = 0.0
        matrices.append(matrix)
    return matrices


def _link_poses(links, needed, poses):
    """{link: (4, 4)} in the world, from poses of the bodies."""

    def of_bodies(i):
        if i == WORLD:
            return np.eye(4)
        name, place = next(iter(links[i].bodies.items()))
        return poses[name] @ SE3.inverse(place)

    world = {}
    for i in needed:
        link = links[i]
        if link.bodies:
            world[i] = of_bodies(i)
            continue
        # The massless link of a universal joint: both its axes are those of its neighbours.
        start = of_bodies(link.parent) @ link.placement
        after = links[i + 1].placement[:3, 2]
        z, second = start[:3, 2], of_bodies(i + 1)[:3, 2]
        own = np.column_stack([after, np.cross(after, (0.0, 0.0, 1.0)), (0.0, 0.0, 1.0)])
        world[i] = start.copy()
        world[i][:3, :3] = np.column_stack([second, np.cross(second, z), z]) @ own.T
    return world


def _elements(model, frames, cut, places, scene):
    """ELEMENT records of the cut joints, between links and in link frames."""
    records = np.zeros(len(cut), dtype=ELEMENT)
    first = 0
    for record, (j, element, part) in zip(records, cut):
        joint, (F_a, F_b) = scene.joints[j], frames[j]
        (a, pose_a), (b, pose_b) = places[joint.parent], places[joint.child]
        F_a, F_b = pose_a @ F_a, pose_b @ F_b
        if b == WORLD:
            # The child of a joint moves: exchange the ends.
            if joint.type == "universal":
                F_a, F_b = F_a @ SECOND_AXIS, F_b @ FIRST_AXIS
            a, b, F_a, F_b = b, a, F_b, F_a
        records_of = part.record(a, b, first, F_a, F_b)
        for name, value in zip(ELEMENT.names, records_of):
            record[name] = value
        first += len(part.names)
    return records


def _loop_arrays(links, records, cut, rows, elements):
    """Arrays of the cut joints, ordered so that the envelope of W is narrow."""
    solved = [k for k in range(len(cut)) if len(rows[k])]
    paths = [
        sorted(
            {i for end in ("parent", "child") for i in _path(links, int(elements[k][end]))},
            reverse=True,
        )
        for k in solved
    ]
    order = _narrow([set(path) for path in paths])
    solved, paths = [solved[k] for k in order], [paths[k] for k in order]
    joints = np.zeros(len(solved), dtype=JOINT)
    jacobians, residuals, turns, first = [np.zeros((0, 6))], [], [], 0
    for joint, k in zip(joints, solved):
        element = elements[k]
        joint["parent"], joint["child"], joint["kind"] = (
            element["parent"],
            element["child"],
            element["kind"],
        )
        joint["element"], joint["rows"], joint["first"] = k, len(rows[k]), first
        joint["start"] = first
        first += len(rows[k])
        residuals += [element["row_start"] + r for r in rows[k]]
        turns += [cut[k][2].names[r].startswith("w") for r in rows[k]]
        jacobian = np.zeros((element["rows"], 6))
        if element["kind"] == PAIR:
            frame = np.eye(4)
            frame[:3, :3] = element["child_rotation"].reshape(3, 3)
            frame[:3, 3] = element["child_point"]
            jacobian = element["forbidden"][: 6 * element["rows"]].reshape(-1, 6) @ SE3.Ad(
                SE3.inverse(frame)
            )
        jacobians.append(jacobian[rows[k]])
    ranges, at = [], 0
    for path in paths:
        ranges.append((at, at + len(path)))
        at += len(path)
    path_places, path_freedoms, path_ends, spots, at = [], [], [0], [], 0
    for path, joint in zip(paths, joints):
        path_places.append(at)
        spot = {}
        for i in path:
            group, f, count = records[i]["group"], records[i]["freedom"], records[i]["freedoms"]
            # In the order of elimination, see rows._number.
            numbers = (2, 0, 1, *range(3, count)) if group >= BALL else range(count)
            for number in numbers:
                spot[int(f + number)] = at
                at += int(joint["rows"])
        spots.append(spot)
        path_freedoms += spot
        path_ends.append(len(path_freedoms))
    shared, entries = [], []
    first_joint = list(range(len(joints)))
    for i, spot_i in enumerate(spots):
        for j in range(i):
            common = sorted(spot_i.keys() & spots[j].keys())
            if common:
                entries += [(f, spot_i[f], spots[j][f]) for f in common]
                shared.append((i, j, len(entries)))
                first_joint[i] = min(first_joint[i], j)
    column = np.array(
        [
            joints[first_joint[i]]["first"]
            for i in range(len(joints))
            for _ in range(joints[i]["rows"])
        ],
        dtype=np.int64,
    )
    return {
        "joints": joints,
        "owners": np.array([cut[k][1] for k in solved], dtype=np.int64),
        "row_turns": np.array(turns, dtype=np.int64),
        "row_residual": np.array(residuals, dtype=np.int64),
        "child_jacobian": np.concatenate(jacobians),
        "paths": np.array(ranges, dtype=np.int64).reshape(-1, 2),
        "path_links": np.array([i for path in paths for i in path], dtype=np.int64),
        "path_freedoms": np.array(path_freedoms, dtype=np.int64),
        "path_ends": np.array(path_ends, dtype=np.int64),
        "path_places": np.array([*path_places, at], dtype=np.int64),
        "shared": np.array(shared, dtype=np.int64).reshape(-1, 3),
        "shared_freedoms": np.array(entries, dtype=np.int64).reshape(-1, 3),
        "first_column": column,
    }


def _narrow(paths):
    """Order of the cut joints with a narrow envelope, by reverse Cuthill-McKee."""
    if not paths:
        return []
    touch = np.array([[bool(a & b) for b in paths] for a in paths])
    return reverse_cuthill_mckee(csr_matrix(touch), symmetric_mode=True).tolist()
