# SPDX-License-Identifier: Apache-2.0
"""Links that move as one: groups of links connected by fixed and locked joints, and their initial poses."""

from dataclasses import dataclass, field

import numpy as np

from liegroup_core.lie.groups import SE3

from .description import WORLD


@dataclass
class Group:
    """Links that move as one.

    links  : names; the frame of the first link is the frame of the group
    places : {link: (4, 4) pose in the frame of the group}
    pose   : (4, 4) in the world at the start
    twist  : (6,) at the start, angular first, axes of the group, rad/s and m/s
    """

    links: list
    places: dict = field(default_factory=dict)
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))
    twist: np.ndarray = field(default_factory=lambda: np.zeros(6))


def combined(parts):
    """(mass, centre of mass (3,), inertia (3, 3) about it) of several parts together; all in the same axes.

    parts : [(mass, centre, inertia)]; a single part is returned bit-identical
    """
    if len(parts) == 1:
        return parts[0]
    mass = sum(m for m, _, _ in parts)
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / (mass or 1.0)
    total = np.zeros((3, 3))
    for m, c, inertia in parts:
        d = c - com
        total += inertia + m * ((d @ d) * np.eye(3) - np.outer(d, d))
    return mass, com, total


class Grouping:
    """Groups of a robot.

    robot  : Robot
    welded : [(parent, child, (4, 4) pose of the child in the parent)] of links that do not move
             relative to each other
    held   : [(link, joint)] of links without mass at the end of a chain, which are held in place
    led    : {id of a group} without mass that couplings move, with no mass behind it
    joints : joints of the file that may move; `moving` are those between different groups
    """

    def __init__(self, robot, welded, joints):
        self.robot, self.held, self.led = robot, [], set()
        names = [WORLD, *(name for name in robot.links if name != WORLD)]
        leader = {name: name for name in names}

        def find(name):
            while leader[name] != name:
                leader[name] = leader[leader[name]]
                name = leader[name]
            return name

        for a, b, _ in welded:
            first, second = find(a), find(b)
            if second == find(WORLD):
                first, second = second, first
            leader[second] = first
        members = {}
        for name in names:
            members.setdefault(find(name), []).append(name)
        held = {joint.child for joint in joints if find(joint.parent) != find(joint.child)}
        beside = {}
        for a, b, relative in welded:
            beside.setdefault(a, []).append((b, relative))
            beside.setdefault(b, []).append((a, SE3.inverse(relative)))
        self.groups, self.of_link = [], {}
        for links in members.values():
            self._add(links, held, beside)
        self.moving = [joint for joint in joints if self.of_link[joint.parent] is not self.of_link[joint.child]]

    def _add(self, links, held, beside):
        """Append a group; if a link with mass is the child of a moving joint, its frame is the group's frame."""
        robot = self.robot
        if WORLD in links:
            main = WORLD
        else:
            heavy = [name for name in links if not robot.links[name].moves_nothing] or links
            main = next((name for name in heavy if name in held), heavy[0])
        group = Group([main, *(name for name in links if name != main)], {main: np.eye(4)})
        pending = [main]
        while pending:
            name = pending.pop()
            for other, relative in beside.get(name, ()):
                if other not in group.places:
                    group.places[other] = group.places[name] @ relative
                    pending.append(other)
        self.groups.append(group)
        for name in links:
            self.of_link[name] = group

    @property
    def world(self):
        """Group of the world."""
        return self.of_link[WORLD]

    def frames(self, joint):
        """Frames (4, 4) of a joint in the frames of the groups of its parent and its child."""
        return (
            self.of_link[joint.parent].places[joint.parent] @ joint.parent_frame,
            self.of_link[joint.child].places[joint.child] @ joint.child_frame,
        )

    def mass(self, group):
        """(mass, centre of mass (3,), inertia (3, 3) about it) of a group, in its frame.

        The numbers of a single link are bit-identical.
        """
        parts = []
        for name in group.links:
            if name != WORLD and not self.robot.links[name].moves_nothing:
                link, place = self.robot.links[name], group.places[name]
                R, centre, inertia = place[:3, :3], link.com, link.inertia
                if not np.array_equal(place, np.eye(4)):
                    centre, inertia = R @ centre + place[:3, 3], R @ inertia @ R.T
                parts.append((link.mass, centre, inertia))
        return combined(parts)

    def moves_nothing(self, group):
        """True for a group with neither mass nor inertia."""
        return all(name != WORLD and self.robot.links[name].moves_nothing for name in group.links)

    def place(self, values, velocities, first=()):
        """Set poses and twists of all groups at joint coordinates and velocities.

        Floating parts keep the pose and twist of their root link, in any order of the links; or those of the
        link in `first`. Returns the joints that close loops, and the links that kept their pose.
        """
        placed = {id(self.world)}
        of_group = {}
        for joint in self.moving:
            for name in (joint.parent, joint.child):
                of_group.setdefault(id(self.of_link[name]), []).append(joint)
        used, kept = set(), []
        roots = [name for name in (*first, *self.robot.roots) if name in self.of_link]
        # Links are placed along the joints of the file's tree, never along a closing joint.
        for name in (WORLD, *roots, *(group.links[0] for group in self.groups)):
            root = self.of_link[name]
            if root is not self.world:
                if id(root) in placed:
                    continue
                root.pose = self.robot.links[name].pose @ SE3.inverse(root.places[name])
                root.twist = SE3.Ad(root.places[name]) @ self.robot.links[name].twist
                kept.append(name)
                placed.add(id(root))
            pending = [root]
            while pending:
                group = pending.pop()
                for joint in of_group.get(id(group), ()):
                    a, b = self.of_link[joint.parent], self.of_link[joint.child]
                    other = b if a is group else a
                    if joint.closes or id(other) in placed:
                        continue
                    F_a, F_b = self.frames(joint)
                    between = F_a @ joint.motion(values[joint.name]) @ SE3.inverse(F_b)
                    own = SE3.Ad(F_b) @ joint.twist(velocities[joint.name])
                    if a is group:
                        other.pose = a.pose @ between
                        other.twist = SE3.Ad(SE3.inverse(between)) @ a.twist + own
                    else:
                        other.pose = b.pose @ SE3.inverse(between)
                        other.twist = SE3.Ad(between) @ (b.twist - own)
                    placed.add(id(other))
                    used.add(joint.name)
                    pending.append(other)
        return [joint for joint in self.moving if joint.name not in used], kept
