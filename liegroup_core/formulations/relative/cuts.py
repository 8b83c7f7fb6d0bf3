# SPDX-License-Identifier: Apache-2.0
"""Cut joints of a spanning tree: the rows that are independent, and where each touches the tree."""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from liegroup_core.joints.elements import ELEMENT, PAIR, WORLD
from liegroup_core.joints.linkage import RANK_TOLERANCE, Linkage
from liegroup_core.lie.groups import SE3
from liegroup_core.model.arrays import JOINT
from liegroup_core.model.redundancy import generic_poses, independent_rows, loop_groups

from .arrays import FREEDOMS
from .links import FIRST_AXIS, SECOND_AXIS, eliminated, link_poses
from .spanning_tree import WORLD_NAME


def cut_rows(scene, frames, parts, tree, links, places):
    """([(joint, element of the scene, part)], [kept rows]) of the cut joints."""
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
    # A distance joint is cut also where it closes no loop: then its row is independent.
    for loops in loop_groups([(joint.parent, joint.child) for joint in scene.joints]):
        closing = [k for k, (j, _, _) in enumerate(cut) if j in loops]
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
    used = ({links[i].joint for i in needed} - {None}).union(loops)
    used |= _welded(scene, used)
    # In the order of model/redundancy.py: the same linkage is analysed once.
    used = sorted(used, key=lambda j: (scene.joints[j].parent != WORLD_NAME, j))
    linkage = Linkage(scene, frames, parts, used)
    length = linkage.length
    # Rotations and translations in comparable units.
    units = np.concatenate(
        [np.where(link.directions()[:3].any(axis=0), length, 1.0) for link in links]
    )
    matrices = []
    for poses in generic_poses(linkage):
        world = link_poses(links, needed, poses)
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


def _welded(scene, joints):
    """Fixed joints that hold bodies to those of other joints, directly or by each other."""
    bodies = {end for j in joints for end in (scene.joints[j].parent, scene.joints[j].child)}
    bodies.discard(WORLD_NAME)
    found, grown = set(), True
    while grown:
        grown = False
        for j, joint in enumerate(scene.joints):
            ends = {joint.parent, joint.child} - {WORLD_NAME}
            if joint.type == "fixed" and j not in found and ends & bodies:
                found.add(j)
                bodies |= ends
                grown = True
    return found


def cut_elements(scene, frames, cut, places):
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


def _path(links, b):
    """Links between a link and the world, itself first."""
    path = []
    while b != WORLD:
        path.append(b)
        b = links[b].parent
    return path


def loop_arrays(links, records, cut, rows, elements):
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
            group, f = records[i]["group"], records[i]["freedom"]
            for number in eliminated(group):
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
