# SPDX-License-Identifier: Apache-2.0
"""Cut joints of a spanning tree: their independent rows, and their paths through the tree."""

import numpy as np
import scipy

from liegroup_core.errors import SceneError
from liegroup_core.joints.elements import ELEMENT, PAIR, WORLD, Element
from liegroup_core.joints.linkage import RANK_TOLERANCE, Linkage
from liegroup_core.lie.groups import SE3
from liegroup_core.motion_groups.table import FREEDOMS, ORDERS
from liegroup_core.scene.consistency import ResolvedCoupling, resolve_couplings

from .arrays import COUPLED, CUT, TERM
from .links import FIRST_AXIS, SECOND_AXIS, link_poses, path_to_world
from .redundancy import dependent_groups, generic_poses, independent_rows
from .spanning_tree import WORLD_NAME

# A coupling as a part of a cut joint: one row, which couplings.py writes.
COUPLING_PART = Element(PAIR, ("coupling",), np.zeros((1, 6)))


def coupled_links(scene, links):
    """[(ResolvedCoupling, indices of the links of its joints)] of couplings, then of driven joints.

    Raises SceneError for a joint that is not in the spanning tree, or has a rotor and is not.
    """
    of_joint = {link.joint: i for i, link in enumerate(links) if link.joint is not None}
    found = []
    driven = [j for j, joint in enumerate(scene.joints) if joint.driven]
    for j, joint in enumerate(scene.joints):
        if joint.rotor and j not in of_joint:
            raise SceneError(
                f'joints[{j}] "{joint.name}": it has a rotor, but closes a loop of joints with rotors, or its bodies '
                "are welded; leave out the rotor of one joint of this loop",
                ("joints", j, "rotor"),
            )
    for j in driven:
        if j not in of_joint:
            raise SceneError(
                f'joints[{j}] "{scene.joints[j].name}": it is driven, but closes a loop of driven or '
                "coupled joints, or its bodies are welded; drive another joint of this loop",
                ("joints", j, "driven"),
            )
    for i, coupling in enumerate(resolve_couplings(scene)):
        for end, j in zip(("joint", "other", *["terms"] * len(coupling.further)), coupling.joints):
            if j not in of_joint:
                raise SceneError(
                    f'couplings[{i}] "{scene.couplings[i].name}": joint "{scene.joints[j].name}" '
                    "closes a loop of coupled joints, or its bodies are welded; couple other joints "
                    "of this loop",
                    ("couplings", i, end),
                )
        found.append((coupling, tuple(of_joint[j] for j in coupling.joints)))
    return found + [(ResolvedCoupling(j, j, 0.0, 0.0), (of_joint[j],)) for j in driven]


def cut_rows(scene, frames, parts, tree, links, places, stops, coupled):
    """([(joint, element of the scene, part)], [kept rows]) of the cut joints, then of couplings.

    stops   : result of `stop_rows`; its entries are between the two and have element -1
    coupled : result of `coupled_links`; its entries have joint None
    """
    cut = []
    element = 0
    for j, elements in enumerate(parts):
        for part in elements:
            if j in tree.cut:
                cut.append((j, element, part))
            element += 1
    joints = len(cut)
    cut += [(j, -1, part) for j, part in stops]
    rigid = [c for c, (entry, _) in enumerate(coupled) if not entry.loose]
    first = len(cut)
    cut += [(None, element + i, COUPLING_PART) for i in range(len(coupled))]
    if not cut:
        return cut, []
    keep = [np.ones(len(part.names), dtype=bool) for _, _, part in cut]
    # A distance joint is cut even if it closes no loop; then its row is independent.
    for loops, numbers in dependent_groups(scene, [coupled[c][0] for c in rigid]):
        entries = [rigid[n] for n in numbers]
        closing = [k for k, (j, _, _) in enumerate(cut[:joints]) if j in loops]
        ends = sorted({cut[k][0] for k in closing})
        matrices = _tree_jacobians(scene, frames, parts, loops, ends, links, places, [coupled[c] for c in entries])
        closing += [first + c for c in entries]
        drives = np.array([False] * len(matrices[0]))
        drives[len(drives) - len(entries) :] = [coupled[c][0].is_given for c in entries]
        _refuse_dependent(scene, matrices, drives, [coupled[c][0].joint for c in entries])
        chosen, _ = independent_rows(matrices, np.zeros(len(drives), dtype=bool))
        at = 0
        for k in closing:
            keep[k] = chosen[at : at + len(keep[k])]
            at += len(keep[k])
    return cut, [np.flatnonzero(rows) for rows in keep]


def _refuse_dependent(scene, matrices, drives, joints):
    """Refuse a driven joint whose coordinate other joints determine: its effort is undetermined.

    matrices : rows at generic poses;  drives : mask of those of driven joints
    joints   : of the last rows
    """
    for r in np.flatnonzero(drives):
        others = np.arange(len(drives)) != r
        if max(map(_rank, matrices)) > max(_rank(matrix[others]) for matrix in matrices):
            continue
        j = joints[r - len(drives)]
        raise SceneError(
            f'joints[{j}] "{scene.joints[j].name}": it cannot be driven, because the other joints, '
            "couplings and driven joints already determine its coordinate",
            ("joints", j, "driven"),
        )


def _rank(matrix):
    return np.linalg.matrix_rank(matrix, tol=RANK_TOLERANCE) if matrix.size else 0


def _tree_jacobians(scene, frames, parts, loops, joints, links, places, coupled):
    """Rows of cut joints, then of couplings, for the tree's degrees of freedom at generic poses.

    loops, joints : indices of the joints in loops, and of the cut ones among them
    coupled       : as of `coupled_links`; they hold at these poses if one of them is curved
    """
    kept = [entry for entry, _ in coupled if not entry.is_given] if any(entry.curve for entry, _ in coupled) else []
    if not (joints or kept):
        return [_coupling_rows(links, coupled, 1.0, [entry.factors() for entry, _ in coupled])]
    first = _first_freedoms(links)
    ends = {
        j: [path_to_world(links, places[name][0]) for name in (scene.joints[j].child, scene.joints[j].parent)]
        for j in joints
    }
    # On their common path to the world both ends of a joint move together.
    needed = sorted(set().union(*(set(a) ^ set(b) for a, b in ends.values())))
    # The loops move with welded bodies, and with the joints that hold them beside a floating part.
    used = ({links[i].joint for i in needed} - {None}).union(loops)
    used |= {j for entry in kept for j in entry.joints}
    used |= _welded(scene, used)
    # In the order of mechanism/redundancy.py, so that the same linkage is analysed only once.
    used = sorted(used, key=lambda j: (scene.joints[j].parent != WORLD_NAME, j))
    own = {entry: entry.numbered({j: i for i, j in enumerate(used)}) for entry in kept}
    linkage = Linkage(scene, frames, parts, used, couplings=list(own.values()))
    length = linkage.length
    # Rotations and translations in comparable units.
    units = np.concatenate([np.where(link.directions()[:3].any(axis=0), length, 1.0) for link in links])
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
        matrix = np.concatenate([np.zeros((0, first[-1])), *blocks]) / units
        # Rows that the tree satisfies already, such as those out of the plane of planar loops.
        matrix[np.linalg.norm(matrix, axis=1) < RANK_TOLERANCE] = 0.0
        factors = [linkage.factors(own[entry], poses) if entry in own else entry.factors() for entry, _ in coupled]
        matrices.append(np.concatenate([matrix, _coupling_rows(links, coupled, length, factors)]))
    return matrices


def _first_freedoms(links):
    """(links + 1,) first degree of freedom of each link."""
    return np.concatenate([[0], np.cumsum([FREEDOMS[link.group] for link in links])])


def _coupling_rows(links, coupled, length, factors):
    """Unit rows of the couplings for the degrees of freedom of the tree, (omega length, v).

    factors : of the rates of the joints of each
    """
    first = _first_freedoms(links)
    rows = np.zeros((len(coupled), first[-1]))
    for row, (_, ends), own in zip(rows, coupled, factors):
        for i, factor in zip(ends, own):
            unit = length if links[i].turns else 1.0
            row[first[i]] += links[i].sign * factor / unit
        row /= np.linalg.norm(row)
    return rows


def _welded(scene, joints):
    """Fixed joints that weld bodies to those of `joints`, directly or through each other."""
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


def cut_elements(scene, frames, cut, places, coupled):
    """ELEMENT records of the cut joints, between links and in link frames; then of couplings."""
    records = np.zeros(len(cut), dtype=ELEMENT)
    first = 0
    for record, (j, element, part) in zip(records, cut):
        if j is None:
            child, *others = coupled[element - (cut[-1][1] + 1 - len(coupled))][1]
            parent = others[0] if others else child
            for name, value in zip(ELEMENT.names, part.record(parent, child, first)):
                record[name] = value
            first += 1
            continue
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


def loop_arrays(links, records, cut, rows, elements, coupled, counted, loops):
    """Arrays of the cut joints and couplings, ordered so that the envelope of W is narrow.

    counted : index of the first unwrapped angle that belongs to a coupling
    loops   : for an empty tree the joints of the scene in closed loops, else None
    """
    solved = [k for k in range(len(cut)) if len(rows[k])]
    ends = [tuple(int(element[end]) for end in ("parent", "child")) for element in elements[: len(cut) - len(coupled)]]
    ends += [of_joints for _, of_joints in coupled]
    paths = [sorted({i for end in ends[k] for i in path_to_world(links, end)}, reverse=True) for k in solved]
    order = _narrow([set(path) for path in paths])
    solved, paths = [solved[k] for k in order], [paths[k] for k in order]
    joints = np.zeros(len(solved), dtype=CUT)
    jacobians, residuals, turns, first = [np.zeros((0, 6))], [], [], 0
    for joint, k in zip(joints, solved):
        element = elements[k]
        joint["parent"], joint["child"], joint["kind"] = (element["parent"], element["child"], element["kind"])
        joint["element"], joint["rows"], joint["first"] = k, len(rows[k]), first
        joint["in_loop"] = loops is None or cut[k][0] in loops
        joint["own_points"] = loops is None and element["turns_freely"]
        first += len(rows[k])
        residuals += [element["row_start"] + r for r in rows[k]]
        turns += [cut[k][2].names[r].startswith("w") for r in rows[k]]
        jacobian = np.zeros((element["rows"], 6))
        if element["kind"] == PAIR:
            frame = np.eye(4)
            frame[:3, :3] = element["child_rotation"].reshape(3, 3)
            frame[:3, 3] = element["child_point"]
            jacobian = element["forbidden"][: 6 * element["rows"]].reshape(-1, 6) @ SE3.Ad(SE3.inverse(frame))
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
            for number in ORDERS[group]:
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
        [joints[first_joint[i]]["first"] for i in range(len(joints)) for _ in range(joints[i]["rows"])], dtype=np.int64
    )
    number = {len(cut) - len(coupled) + i: i for i in range(len(coupled))}
    coupling = np.array([number.get(k, -1) for k in solved], dtype=np.int64)
    return {
        "cuts": joints,
        "coupling": _numbered(coupling),
        **_couplings(links, joints, coupling, residuals, coupled, counted),
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


def _numbered(coupling):
    """Position of each coupling among those that are solved for; -1 stays."""
    numbers = np.full(len(coupling), -1, dtype=np.int64)
    numbers[coupling >= 0] = np.arange((coupling >= 0).sum())
    return numbers


def _couplings(links, joints, coupling, residuals, coupled, counted):
    """COUPLED in the order of the joints, and their terms; coupling: which of `coupled` a joint is, or -1."""
    motions = np.cumsum([entry.is_given for entry, _ in coupled]) - 1
    counts = [[links[i].turns and (k > 0 or entry.loose) for k, i in enumerate(ends)] for entry, ends in coupled]
    angles = counted + np.cumsum([0, *map(sum, counts)])
    rows, terms = [], []
    for joint, c in zip(joints, coupling):
        if c < 0:
            continue
        (entry, ends), begin, angle = coupled[c], len(terms), angles[c]
        for k, (i, factor) in enumerate(zip(ends, entry.factors())):
            terms.append((i, factor * links[i].sign, angle if counts[c][k] else -1, links[i].sign))
            angle += counts[c][k]
        rows.append(
            (
                joint["first"],
                residuals[joint["first"]],
                (begin, len(terms)),
                (entry.ratio, *entry.curve, 0.0, 0.0, 0.0)[:4],
                any(entry.curve),
                entry.offset,
                links[ends[0]].turns and not entry.loose,
                motions[c] if entry.is_given else -1,
                2,
            )
        )
    return {"couplings": np.array(rows, dtype=COUPLED), "coupling_terms": np.array(terms, dtype=TERM)}


def _narrow(paths):
    """Order of the cut joints with a narrow envelope, by reverse Cuthill-McKee."""
    if not paths:
        return []
    touch = np.array([[bool(a & b) for b in paths] for a in paths])
    return scipy.sparse.csgraph.reverse_cuthill_mckee(scipy.sparse.csr_matrix(touch), symmetric_mode=True).tolist()
