# SPDX-License-Identifier: Apache-2.0
"""Selection of the links to keep, and of the links that move as one body.

A user may cut links outside the chains of interest, and lock joints. Joints that are coupled to a locked
joint are locked too. Links without mass at the end of a chain are held in place.
"""

import numpy as np

from liegroup_core.lie.groups import SE3

from .description import ONE_COORDINATE, WORLD, listed
from .links import Grouping


def kept_joints(robot, options, notes):
    """Joints of the file that are kept; with `only`, those on the chains to the given links."""
    if not options.only:
        return list(robot.joints)
    for i, name in enumerate(options.only):
        if name not in robot.links:
            raise options.unknown(("only", i), "only: link", name, robot.links)
    holders = {joint.child: joint for joint in robot.joints if not joint.closes}
    kept = set(robot.roots)
    for name in options.only:
        seen = set()
        while name not in kept and name not in seen:
            seen.add(name)
            if name not in holders:
                break
            name = holders[name].parent
        kept |= seen
    # Links that fixed joints connect to a kept link are parts of the same body.
    grown = True
    while grown:
        grown = False
        for joint in robot.joints:
            if joint.type == "fixed" and joint.parent in kept and joint.child not in kept:
                kept.add(joint.child)
                grown = True
    cut = [name for name in robot.links if name not in kept]
    if cut:
        mass = sum(robot.links[name].mass for name in cut)
        notes.append(f"changes the motion: cut {listed(cut)}, {mass:.6g} kg in all")
    for name in cut:
        del robot.links[name]
    kept.add(WORLD)
    return [joint for joint in robot.joints if joint.parent in kept and joint.child in kept]


def locked_joints(robot, options, values, notes):
    """Names of joints that do not move: fixed and locked joints, and joints coupled to them."""
    types = {joint.name: joint.type for joint in robot.joints}
    still = set(options.lock) | set(robot.locked) | {name for name, kind in types.items() if kind == "fixed"}
    couplings, changed = [*robot.couplings, *robot.relations], True
    while changed:
        changed = False
        for coupling in couplings:
            moving = [name for name in coupling.terms if name not in still]
            if len(moving) == 1:
                if coupling.offset is not None:  # otherwise the start values define the offset
                    values[moving[0]] = coupling.solved(moving[0], values)
                still.add(moving[0])
                changed = True
    for coupling in couplings:
        ends = coupling.terms
        if coupling.offset is None or not all(name in still and types.get(name) in ONE_COORDINATE for name in ends):
            continue
        wanted = coupling.solved(coupling.first, values)
        if abs(values[coupling.first] - wanted) > 1e-9 * (1.0 + abs(wanted)):
            at = " and ".join(f"{name} at {values[name]:.6g}" for name in ends)
            raise options.error(
                ("lock", coupling.first),
                f"lock: {at} contradict their coupling, which requires {wanted:.6g} for {coupling.first}: "
                f"lock {'one' if len(ends) == 2 else 'fewer'} of them",
            )
    for name in still:
        if types[name] != "fixed":
            own = name in options.lock or name in robot.locked
            why = "" if own else ", because a locked joint drives it"
            value = values[name]
            at = "its pose of the start" if isinstance(value, np.ndarray) else f"{value:.6g}"
            notes.append(f"locked: joint {name} at {at}{why}")
    options.check_start(values)
    return still


def base_of(robot, options, notes):
    """Whether the root links are fixed to the world or float."""
    if options.base == "floating" and WORLD in robot.roots:
        notes.append(
            "base floating has no effect: the root link is called world, which is the fixed frame; "
            "rename it to let it float"
        )
    if options.base is not None:
        return options.base
    if robot.free:
        return "floating"
    if options.joints or any(joint.type != "fixed" for joint in robot.joints):
        return "fixed"
    notes.append("floating: the robot has no joint that moves")
    return "floating"


def place_links(robot, options, base, notes):
    """Give floating links their pose and twist at the start; add a note if a root link of the pose is fixed.

    Returns {link: its path in the additions} of the links that the user placed.
    """
    placed = options.placed_links(robot)
    for name, state in robot.root_poses.get(options.pose, {}).items():
        if base == "floating" and name in robot.links:
            robot.links[name].pose, robot.links[name].twist = state
        elif name in (WORLD, *robot.links) and name not in placed:
            notes.append(
                f'changes the motion: pose of the root link in "{options.pose}" left out, because it does not float'
            )
    for name, start in placed.items():
        link = robot.links[name]
        link.pose, link.twist = start.over(link.pose, link.twist)
    return placed


def grouped(robot, options, base, joints, lock, values, notes):
    """Grouping of the kept links; links without mass at the end of a chain are held in place."""
    welded = [
        (j.parent, j.child, j.parent_frame @ j.motion(values[j.name]) @ SE3.inverse(j.child_frame))
        for j in joints
        if j.name in lock and not j.closes
    ]
    if base == "fixed":
        welded += [(WORLD, name, robot.links[name].pose) for name in robot.roots if name != WORLD]
    moving = [j for j in joints if j.name not in lock or j.closes]
    moving = [j for j in moving if j.type != "floating"]
    tied = {end for entry in options.joints for end in (entry.parent, entry.child)}
    grouping = Grouping(robot, welded, moving)
    light = _light_joints(robot, grouping, tied)
    led = _led(robot, {joint.name for joint in grouping.moving} - light.keys())
    for name, (group, joint) in light.items():
        if name in led:
            continue
        notes.append(f"held in place: {listed(group.links)} at the end of joint {name}, without mass")
        place = joint.parent_frame @ joint.motion(values[name]) @ SE3.inverse(joint.child_frame)
        welded.append((joint.parent, joint.child, place))
    if light:
        held = [(group.links[0], joint) for name, (group, joint) in light.items() if name not in led]
        grouping = Grouping(robot, welded, moving)
        ends = {group.links[0] for name, (group, _) in light.items() if name in led}
        grouping.held, grouping.led = held, {id(grouping.of_link[end]) for end in ends}
    return grouping


def _led(robot, moving):
    """Names of the joints that couplings move, with those that move mass."""
    found, before = set(moving), -1
    while len(found) != before:
        before = len(found)
        for coupling in (*robot.couplings, *robot.relations):
            if found & coupling.terms.keys():
                found |= coupling.terms.keys()
    return found


def _light_joints(robot, grouping, tied):
    """{joint: (group, joint)} of groups without mass at the end of a chain, from there inwards."""
    joints, found = {}, {}
    for joint in grouping.moving:
        for name in (joint.parent, joint.child):
            joints.setdefault(id(grouping.of_link[name]), []).append(joint)
    more = True
    while more:
        more = False
        for group in grouping.groups:
            if group is grouping.world or tied & set(group.links) or not grouping.moves_nothing(group):
                continue
            rest = [joint for joint in joints.get(id(group), ()) if joint.name not in found]
            if len(rest) == 1:
                found[rest[0].name], more = (group, rest[0]), True
            elif not joints.get(id(group)):
                raise robot.error(
                    robot.links[group.links[0]].line,
                    f'link "{group.links[0]}" moves freely and has no mass: give it an inertial, or fix it to another '
                    "link",
                )
    return found
