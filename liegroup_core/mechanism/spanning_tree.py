# SPDX-License-Identifier: Apache-2.0
"""Spanning tree of a mechanism: which bodies are one link, which joints are cut.

Bodies that fixed joints weld are one link. The tree prefers joints with the most rows, which leaves the
fewest rows for cut joints. Coupled and driven joints and those with stops, friction or rotors come first,
because their rows, modes and inertias refer to joints of the tree. Among equals it prefers those nearest to
the world, because short paths make loops cheap. Distance joints are always cut, because their motions are not a group.
"""

from dataclasses import dataclass

from liegroup_core.motion_groups.table import FREEDOMS, OF_JOINT

WORLD_NAME = "world"
# Rows of the joints of a tree; a universal joint is two hinges.
ROWS = {kind: 6 - FREEDOMS[code] for kind, code in OF_JOINT.items()} | {"universal": 4}
COUPLED_FIRST = 7  # in place of the rows of a coupled joint; of one with stops or friction, 6


@dataclass(frozen=True)
class SpanningTree:
    """Tree of links.

    group  : {body: number of its weld group}; group 0 is the world's
    members: bodies of each group, those of 0 without the world
    links  : (group, parent group, joint or None) in an order where parents precede children;
             None: a floating group, with the world as its parent
    cut    : joints that close loops
    """

    group: dict
    members: list
    links: list
    cut: list


def spanning_tree(scene, allowed=None):
    """SpanningTree of a scene; allowed: joints that the tree may contain, None: all."""
    group, members = _welded(scene)
    joints = [
        (j, group[joint.parent], group[joint.child])
        for j, joint in enumerate(scene.joints)
        if joint.type != "fixed" and group[joint.parent] != group[joint.child]
    ]
    of_group = {}
    for entry in joints:
        if scene.joints[entry[0]].type in ROWS and (allowed is None or entry[0] in allowed):
            for g in entry[1:]:
                of_group.setdefault(g, []).append(entry)
    depth, links, used = {0: 0}, [], set()
    _grow(scene, of_group, depth, links, used, 0)
    while len(depth) < len(members):
        # A floating part is rooted where it branches most, so that paths are short.
        rest = [g for g in range(len(members)) if g not in depth]
        root = max(rest, key=lambda g: (len(of_group.get(g, ())), -g))
        depth[root] = 1
        links.append((root, 0, None))
        _grow(scene, of_group, depth, links, used, root)
    cut = [j for j, _, _ in joints if j not in used]
    return SpanningTree(group, members, links, cut)


def _welded(scene):
    """({body: weld group}, members of the groups); the world is in group 0."""
    leader = {body.name: body.name for body in scene.bodies} | {WORLD_NAME: WORLD_NAME}

    def find(name):
        while leader[name] != name:
            name = leader[name]
        return name

    for joint in scene.joints:
        if joint.type == "fixed":
            first, second = find(joint.parent), find(joint.child)
            if second == WORLD_NAME:
                first, second = second, first
            leader[second] = first
    number, members = {WORLD_NAME: 0}, [[]]
    for body in scene.bodies:
        found = find(body.name)
        if found not in number:
            number[found] = len(members)
            members.append([])
        members[number[found]].append(body.name)
    group = {body.name: number[find(body.name)] for body in scene.bodies} | {WORLD_NAME: 0}
    return group, members


def _grow(scene, of_group, depth, links, used, root):
    """Add all groups that joints connect to a root, by Prim's method."""
    frontier = list(of_group.get(root, ()))
    first = {joint.name: COUPLED_FIRST - 1 for joint in scene.joints if joint.switches}
    first |= {name: COUPLED_FIRST for entry in scene.couplings for name in (entry.joint, *entry.others)}
    first |= {joint.name: COUPLED_FIRST for joint in scene.joints if joint.driven or joint.rotor}
    while frontier:
        best, key = None, None
        for j, a, b in frontier:
            if (a in depth) == (b in depth):
                continue
            joint = scene.joints[j]
            rows = first.get(joint.name, ROWS[joint.type])
            found = (-rows, depth[a if a in depth else b], j)
            if key is None or found < key:
                best, key = (j, a, b), found
        if best is None:
            return
        j, a, b = best
        parent, child = (a, b) if a in depth else (b, a)
        depth[child] = depth[parent] + 1
        links.append((child, parent, j))
        used.add(j)
        frontier = [entry for entry in (*frontier, *of_group[child]) if (entry[1] in depth) != (entry[2] in depth)]
