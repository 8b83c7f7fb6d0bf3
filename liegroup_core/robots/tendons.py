# SPDX-License-Identifier: Apache-2.0
"""Tendons: straight ones as springs, cables and struts of a scene, fixed ones as couplings with backlash."""

from dataclasses import dataclass, field

import numpy as np

from .description import Relation
from .options import ALL


@dataclass
class Tendon:
    """Straight tendon between points of two links, or fixed tendon, whose length is linear in joint coordinates.

    ends    : [(link or world, (3,) point in its frame, m)], two; none of a fixed tendon
    rest    : (shortest, longest) length without a force of its spring, m;  stiffness N/m, damping N s/m
    range   : (least, largest) length, m, or None
    terms   : {joint: change of the length} of a fixed one, whose length is 0 at coordinates 0
    """

    name: str
    line: int
    ends: list
    rest: tuple
    stiffness: float = 0.0
    damping: float = 0.0
    range: tuple | None = None
    terms: dict = field(default_factory=dict)


def add_tendons(robot, options, grouping, parts, body_of, taken):
    """Append the tendons whose ends move relative to each other.

    body_of : {id of a group: name of its body};  taken : names of joints and forces
    """
    for tendon in (each for each in robot.tendons if each.ends):
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
            comment = f"tendon of line {tendon.line}" if tendon.line else "tendon"
            parts.add(key, {"name": tendon.name} | entry, tendon.line, comment, taken)


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
    if tendon.range and _has_limits(robot, options, tendon, length):
        shortest, longest = tendon.range
        yield "joints", {"type": "cable", "length": longest}
        if shortest > 0.0:
            yield "joints", {"type": "strut", "length": shortest}


def _has_limits(robot, options, tendon, length):
    """Whether the limits of a tendon act; else a note says why not."""
    if ALL in options.stops and tendon.range[0] <= length <= tendon.range[1]:
        return True
    what = "limits of tendons" if ALL not in options.stops else "limits of tendons that start outside of them"
    robot.leave_out(what, tendon.name, changes_motion=True)
    return False


def fixed_tendons(robot, options, moving, values):
    """Yield the springs with damping, and the limits, of fixed tendons as Relations with backlash.

    moving : names of the joints with one coordinate that move;  values : {joint: coordinate at the start}
    """
    for tendon in (each for each in robot.tendons if each.terms):
        terms = {name: c for name, c in tendon.terms.items() if c and name in moving}
        start, length = (sum(c * values[name] for name, c in each.items()) for each in (terms, tendon.terms))
        if len(terms) == 1:  # a coupling has two joints
            terms |= dict.fromkeys(sorted(moving - terms.keys())[:1], 0.0)
        if len(terms) < 2:
            robot.leave_out("fixed tendons of the only joint, or of none that moves", tendon.name, bool(terms))
            continue
        c = next(iter(terms.values()))
        law = {"gap": (tendon.rest[1] - tendon.rest[0]) / abs(c), "stiffness": c * c * tendon.stiffness}
        laws = [((law if tendon.stiffness else {}) | {"viscous": c * c * tendon.damping}, tendon.rest)]
        if tendon.range and _has_limits(robot, options, tendon, length):
            laws.append(({"gap": (tendon.range[1] - tendon.range[0]) / abs(c)}, tendon.range))
        for law, ends in laws if tendon.stiffness or tendon.damping else laws[1:]:
            yield _relation(tendon.name, terms, start - length + 0.5 * sum(ends), tendon.line, law)


def among(robot, coupling, moving, values):
    """Relation of its joints that move, where the others are constants; None if there is none, or with a note."""
    terms = {name: c for name, c in coupling.terms.items() if name in moving}
    is_cut = any(robot.joint(name).child not in robot.links for name in coupling.terms)
    if terms and (is_cut or len(terms) == 1 or coupling.backlash or (coupling.curve and coupling.second in terms)):
        what = "couplings with cut joints, or with backlash or a curve and joints that do not move"
        robot.leave_out(what, coupling.name, changes_motion=True)
    elif terms:
        off = 0.0 if coupling.offset is None else values[coupling.first] - coupling.solved(coupling.first, values)
        return _relation(coupling.name, terms, sum(c * values[name] for name, c in terms.items()) - off, coupling.line)
    return None


def _relation(name, terms, constant, line, backlash=()):
    """Relation sum c x = constant of two or more joints {name: c}."""
    (first, c), *others = terms.items()
    shares = [(joint, -other / c) for joint, other in others]
    return Relation(name, first, *shares[0], constant / c, line, (), dict(shares[1:]), backlash)


def add_relation(robot, name, terms, constant, line):
    """Add sum c x = constant of joints {name: c}: a locked joint, or a coupling. Returns False without joints."""
    terms = {joint: c for joint, c in terms.items() if c}
    if len(terms) == 1:
        robot.locked |= {joint: constant / c for joint, c in terms.items()}
    elif terms:
        (robot.couplings if len(terms) == 2 else robot.relations).append(_relation(name, terms, constant, line))
    return bool(terms)
