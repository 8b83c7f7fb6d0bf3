# SPDX-License-Identifier: Apache-2.0
"""Links of the spanning tree of a scene, and their records."""

import math

import numpy as np

from liegroup_core.forces.law import states_of
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.groups import SE3
from liegroup_core.motion_groups.table import COMPONENTS, FREE, FREEDOMS, HINGE, OF_JOINT, PLANE_COMPONENTS, SLIDE

from .arrays import AFTER_CROSS, CROSS, LINK, OWN
from .planar import align, frame_in_plane
from .spanning_tree import WORLD_NAME

# Axes of a universal joint as z axes: x of its parent frame, y of its child frame.
FIRST_AXIS, SECOND_AXIS = np.eye(4)[:, [1, 2, 0, 3]], np.eye(4)[:, [2, 0, 1, 3]]


class TreeLink:
    """Link under construction: `placement` T in its parent, and poses of its bodies in it.

    sign  : 1 if its coordinate increases with that of the joint, -1 if it decreases
    rotor : inertia of the rotor of its joint, kg m^2 or kg
    state : LAW.STATE whose value is its rate, or ""
    """

    def __init__(self, joint, group, parent, placement, coordinates=OWN, pitch=0.0, in_plane=False):
        self.joint, self.group, self.parent, self.placement = joint, group, parent, placement
        self.coordinates, self.pitch, self.bodies = coordinates, pitch, {}
        self.components = (PLANE_COMPONENTS if in_plane else COMPONENTS)[group]
        self.sign, self.aligned, self.rotor, self.state = 1.0, False, 0.0, ""

    @property
    def turns(self):
        """Whether its first degree of freedom is a rotation."""
        return self.components[0] < 3

    @property
    def is_plain_hinge(self):
        """Whether it is a revolute joint: not one of the two axes of a universal joint."""
        return self.group == HINGE and self.coordinates == OWN

    def directions(self):
        """S (6, degrees of freedom)."""
        S = np.eye(6)[:, list(self.components)]
        S[5, 0] += self.pitch
        return S


def find_links(scene, frames, tree, normal, floating=FREE):
    """([TreeLink], {body or world: (link index or WORLD, pose (4, 4) in the link)}).

    normal   : of the plane of a planar mechanism, else None
    floating : motion group of a floating link
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
            links.append(TreeLink(None, floating, WORLD, np.eye(4)))
        else:
            joint, (F_a, F_b) = scene.joints[j], frames[j]
            reverse = joint.child not in bodies
            inner, outer = (joint.child, joint.parent) if reverse else (joint.parent, joint.child)
            F_in, F_out = (F_b, F_a) if reverse else (F_a, F_b)
            to_plane = np.eye(4)
            if normal is not None:
                to_plane = frame_in_plane(joint.type, (poses[outer] @ F_out)[:3, :3], normal)
                F_in, F_out = F_in @ to_plane, F_out @ to_plane
            parent, pose = places[inner]
            placement = pose @ F_in
            if joint.type == "universal":
                first, second = (SECOND_AXIS, FIRST_AXIS) if reverse else (FIRST_AXIS, SECOND_AXIS)
                links.append(TreeLink(j, HINGE, parent, placement @ first, CROSS))
                links.append(TreeLink(j, HINGE, len(links) - 1, first.T @ second, AFTER_CROSS))
                frame = welds[outer] @ F_out @ second
            else:
                kind, in_plane = OF_JOINT[joint.type], normal is not None
                pitch = getattr(joint, "pitch", 0.0)
                links.append(TreeLink(j, kind, parent, placement, pitch=pitch, in_plane=in_plane))
                links[-1].rotor = joint.rotor_inertia
                along = to_plane[2, links[-1].components[0] % 3]
                links[-1].sign = -along if reverse else along
                frame = welds[outer] @ F_out
        to_link = SE3.inverse(frame)
        links[-1].bodies = {name: to_link @ welds[name] for name in bodies}
        if normal is not None:
            for pose in links[-1].bodies.values():
                align(pose)
        for name in bodies:
            places[name] = (len(links) - 1, links[-1].bodies[name])
    if normal is None:
        _align_hinges(links)
    for name, _ in states_of(scene.forces):
        # A rotor without a body, on a slide: its acceleration is its effort, whatever the gravity.
        links.append(TreeLink(None, SLIDE, WORLD, np.eye(4), in_plane=normal is not None))
        links[-1].rotor, links[-1].state = 1.0, name
    return links, places


def _align_hinges(links):
    """Turn the frames of hinges about their axes, so that the next axis of a chain is normal to x.

    Then its placement, and so its pose in its parent, is a rotation about x and one about z, which saves
    work in add_aligned_hinge_inertia. The coordinates do not change. If a hinge has several children, its
    frame is aligned with the first of them.
    """
    turns = {}
    for link in links:
        parent = links[link.parent] if link.parent != WORLD else None
        if parent is not None and parent.is_plain_hinge and link.is_plain_hinge:
            if link.parent not in turns:
                x, y = link.placement[:2, 2]
                link.aligned = True
                turns[link.parent] = SE3.exp([0, 0, math.atan2(x, -y), 0, 0, 0])
    for i, link in enumerate(links):
        if link.parent in turns:
            link.placement[:] = turns[link.parent].T @ link.placement
        if link.aligned:
            link.placement[0, 2] = 0.0
        if i in turns:
            link.placement[:] = link.placement @ turns[i]
            for pose in link.bodies.values():
                pose[:] = turns[i].T @ pose


def _index(scene, name):
    """Index of a body."""
    return next(i for i, body in enumerate(scene.bodies) if body.name == name)


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


def link_records(scene, links, index):
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
                link.aligned,
                link.pitch,
                link.rotor,
                mass,
                moment,
                inertia[np.triu_indices(3)],
            )
        )
        first += FREEDOMS[link.group]
    return np.array(records, dtype=LINK)


def path_to_world(links, b):
    """Links between a link and the world, itself first."""
    path = []
    while b != WORLD:
        path.append(b)
        b = links[b].parent
    return path


def in_general_position(links, rng, size=1.0):
    """{link or WORLD: pose (4, 4) in the world} at random coordinates; size: m, of displacements of floating links."""
    world = {WORLD: np.eye(4)}
    for i, link in enumerate(links):
        S = link.directions()
        X = SE3.exp(S @ rng.uniform(0.3, 1.0, size=S.shape[1]))
        if link.joint is None:
            X[:3, 3] *= size
        world[i] = world[link.parent] @ link.placement @ X
    return world


def link_poses(links, needed, poses):
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
