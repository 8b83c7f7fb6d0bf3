# SPDX-License-Identifier: Apache-2.0
"""Straight tendons between two points as springs, cables and struts of a scene."""

from dataclasses import dataclass

import numpy as np

from .description import Coupling
from .names import unique_names
from .options import ALL


@dataclass
class Tendon:
    """Straight tendon between points of two links.

    ends    : [(link or world, (3,) point in its frame, m)], two
    rest    : (shortest, longest) length without a force of its spring, m;  stiffness N/m, damping N s/m
    range   : (least, largest) length, m, or None
    """

    name: str
    line: int
    ends: list
    rest: tuple
    stiffness: float = 0.0
    damping: float = 0.0
    range: tuple | None = None


def add_tendons(robot, options, grouping, parts, body_of, taken):
    """Append the tendons whose ends move relative to each other.

    body_of : {id of a group: name of its body};  taken : names of joints and forces
    """
    for tendon in robot.tendons:
        groups = [grouping.of_link.get(link) for link, _ in tendon.ends]
        if None in groups or groups[0] is groups[1]:
            continue
        if groups[1] is grouping.world:  # in a scene, the child must be a body
            tendon.ends.reverse()
            groups.reverse()
        places = [group.places[link] for group, (link, _) in zip(groups, tendon.ends)]
        points = [place[:3, :3] @ point + place[:3, 3] for place, (_, point) in zip(places, tendon.ends)]
        at = [(group.pose if group is not grouping.world else np.eye(4)) for group in groups]
        length = np.linalg.norm(np.subtract(*(pose[:3, :3] @ point + pose[:3, 3] for pose, point in zip(at, points))))
        names = dict(zip(("parent", "child"), (body_of[id(group)] for group in groups)))
        for key, entry in _entries(robot, options, tendon, length):
            if key == "forces":
                entry = names | {"parent_point": points[0], "child_point": points[1]} | entry
            else:
                frames = {"parent_frame": {"position": points[0]}, "child_frame": {"position": points[1]}}
                entry = names | frames | entry
            (name,) = unique_names([tendon.name], taken)
            taken.add(name)
            entries = getattr(parts, key)
            parts.lines[key, len(entries)] = tendon.line
            parts.comments[key, len(entries)] = f"tendon of line {tendon.line}" if tendon.line else "tendon"
            entries.append({"name": name} | entry)


def _entries(robot, options, tendon, length):
    """Yield (joints or forces, keys) of a tendon; length: at the start, m."""
    least, most = tendon.rest
    slack = tendon.stiffness > 0.0 and least < most
    if tendon.damping or (tendon.stiffness and not slack):
        stiffness = 0.0 if slack else tendon.stiffness
        spring = {"type": "spring_damper", "stiffness": stiffness, "damping": tendon.damping}
        yield "forces", spring | ({"rest_length": most} if stiffness else {})
    if slack:  # the spring only acts beyond its range of lengths
        yield "joints", {"type": "cable", "length": most, "stiffness": tendon.stiffness}
        if least > 0.0:
            yield "joints", {"type": "strut", "length": least, "stiffness": tendon.stiffness}
    if tendon.range is None:
        return
    shortest, longest = tendon.range
    if ALL not in options.stops or not shortest <= length <= longest:
        what = "limits of tendons" if ALL not in options.stops else "limits of tendons that start outside of them"
        robot.leave_out(what, tendon.name, changes_motion=True)
        return
    yield "joints", {"type": "cable", "length": longest}
    if shortest > 0.0:
        yield "joints", {"type": "strut", "length": shortest}


def add_relation(robot, name, terms, constant, line):
    """Add sum c x = constant of joints {name: c}: a locked joint, or a coupling. Returns False without joints."""
    terms = {joint: c for joint, c in terms.items() if c}
    if not terms:
        return False
    (first, c), *others = terms.items()
    shares = [(joint, -other / c) for joint, other in others]
    if not shares:
        robot.locked[first] = constant / c
    else:
        entries = robot.couplings if len(shares) == 1 else robot.relations
        entries.append(Coupling(name, first, *shares[0], constant / c, line, further=dict(shares[1:])))
    return True
