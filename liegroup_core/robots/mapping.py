# SPDX-License-Identifier: Apache-2.0
"""Conversion of a robot to the entries of a scene: bodies, joints, forces, and notes on differences.

Links connected by fixed or locked joints become one body. Links fixed to the world become no body. A
link without mass between two joints becomes a point mass far below the round-off of its neighbours. At
the end of a chain, such a link does not influence the motion and is held in place.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from liegroup_core.fields.curve import counted_from, rise
from liegroup_core.fields.values import NEGATIVE_ROUND_OFF, TRIANGLE_TOLERANCE

from .actuators import add_drives
from .additions import added_couplings, added_drive, added_forces, added_joints
from .chains import base_of, grouped, kept_joints, locked_joints, place_links
from .description import ONE_COORDINATE, WORLD, frame_keys, listed
from .ground import add_contacts
from .held_joints import add_servos
from .names import scene_name, unique_names
from .options import BEYOND, is_within
from .resources import note_mesh
from .rotors import cut_rotors
from .sensors import add_sensors, check_kept, kept_fixed_joints
from .stiffness import stiffness_notes
from .tendons import add_tendons, among, fixed_tendons

# Mass of a link without mass between two joints, relative to the lightest body: its effect on
# accelerations is below round-off.
NO_MASS = 1e-16
OF_LED = 0.01  # m, radius of gyration of a link without mass that a coupling moves
# Moments of inertia per mass in m^2 that count as 0: radii of gyration below 3e-8 m.
NO_INERTIA = 1e-15
GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, for files without gravity


@dataclass
class SceneParts:
    """Entries of a scene, as keys and values, with their lines in the robot file.

    comments : {("bodies", i): text}, also for joints, forces and sensors
    lines    : {("bodies", i): line of the file, or path inside the additions}, also for single keys
    names    : {("bodies", name in the scene): name in the file}, also for joints
    frames   : {link: (name of its body or world, (4, 4) pose in the frame of the body)}
    still    : {joint with one coordinate that is locked: coordinate}
    """

    name: str
    description: str
    gravity: tuple
    assemble: bool
    bodies: list = field(default_factory=list)
    joints: list = field(default_factory=list)
    couplings: list = field(default_factory=list)
    forces: list = field(default_factory=list)
    sensors: list = field(default_factory=list)
    drive: dict | None = None
    notes: list = field(default_factory=list)
    comments: dict = field(default_factory=dict)
    lines: dict = field(default_factory=dict)
    names: dict = field(default_factory=dict)
    frames: dict = field(default_factory=dict)
    still: dict = field(default_factory=dict)

    def add(self, kind, entry, line, comment=None, taken=None):
        """Append an entry of a kind, such as "forces".

        taken : names in use: that of the entry becomes another one
        """
        if taken is not None:
            (entry["name"],) = unique_names([entry["name"]], taken)
            taken.add(entry["name"])
        place = kind, len(getattr(self, kind))
        self.lines[place] = line
        if comment:
            self.comments[place] = comment
        getattr(self, kind).append(entry)


def scene_parts(robot, options):
    """SceneParts of a Robot with the additions of a user. Raises SceneError."""
    for coupling in added_couplings(options, robot):
        rigid = robot.relations if coupling.further else robot.couplings
        (robot.loose if coupling.backlash else rigid).append(coupling)
    values = options.coordinates(robot)
    notes = []
    joints = kept_joints(robot, options, notes)
    options.check_kept({joint.name for joint in joints})
    base = base_of(robot, options, notes)
    placed = place_links(robot, options, base, notes)
    lock = locked_joints(robot, options, values, notes) - kept_fixed_joints(robot, options)
    grouping = grouped(robot, options, base, joints, lock, values, notes)
    closing, kept = grouping.place(values, options.velocities(robot, values), placed)
    options.check_placed(placed, kept)
    cut_rotors(robot, grouping, closing)
    options.check_velocities({joint.name for joint in grouping.moving})
    options.check_driven({joint.name: joint.type for joint in grouping.moving}, {joint.name for joint in robot.joints})
    check_kept(options, {joint.name for joint in grouping.moving})
    extra = added_joints(options, grouping)
    closing += extra
    parts = SceneParts(
        scene_name(options.name or robot.name),
        options.description or f"{robot.kind} file {robot.file.rpartition('/')[2]}",
        tuple(options.gravity or robot.gravity or GRAVITY),
        bool(closing or robot.relations),
    )
    used = _bodies(robot, grouping, parts, notes)
    # Assembly keeps the user's start values if there are loops.
    given = (options.numbers, options.start_velocity) if closing else ({}, {})
    for link, start in placed.items() if closing else ():
        group = grouping.of_link[link]
        body = next(each for each in parts.bodies if each["name"] == used[id(group)])
        body["initial"] = "fixed"
        if start.model_fields_set & {"angular_velocity", "linear_velocity"}:
            body["angular_velocity"], body["linear_velocity"] = np.split(group.twist, 2)
    own = {entry.name for entry in (*options.couplings, *options.forces)}
    places = [*(("joints", i) for i in range(len(options.joints))), *(("roll", name) for name in options.roll)]
    taken = _joints(robot, grouping, parts, used, (extra, places, given, own), values)
    _drive(options, parts)
    names = {joint.name for joint in grouping.moving if joint.type in ONE_COORDINATE}
    coupled = [entry for entry in robot.couplings if {entry.first, entry.second} <= names]
    switches = options.with_switches(grouping.moving, values, coupled)
    _switch(switches, parts, values)
    robot.loose += fixed_tendons(robot, options, names, values)
    _couplings(robot, grouping, parts, values, taken)
    _lift(robot, grouping, parts, used, taken)
    add_drives(robot, options, parts, values, taken)
    add_servos(robot, options, grouping, parts, values, taken)
    add_tendons(robot, options, grouping, parts, used, taken)
    contacts = add_contacts(robot, options, grouping, parts, used, taken)
    for i, entry in enumerate(added_forces(options, grouping, parts)):
        parts.add("forces", entry, ("forces", i))
    add_sensors(robot, options, grouping, parts, used)
    parts.frames = {
        link: (used[id(group)], group.places[link]) for link, group in grouping.of_link.items() if link != WORLD
    }
    outside = _outside_limits(grouping.moving, values, switches[0])
    if given := sorted(outside.keys() & options.numbers.keys()) if options.stops else ():
        degrees = f"{values[given[0]]:.6g} degrees are {np.radians(values[given[0]]):.6g} rad"
        text = f"start: {outside[given[0]]} is outside of its limits: give rad or m ({degrees}), or no stops"
        raise options.error(("start", given[0]), text)
    if outside:
        notes.append(
            f"changes the motion: start outside of the limits, which do not act: {listed(outside.values())}; "
            "give start values"
        )
    if not closing:  # with loops, joints move more inertia than stiffness_notes computes
        notes += stiffness_notes(grouping)
    moving = {joint.name for joint in grouping.moving}
    parts.still = {
        joint.name: values[joint.name] for joint in joints if joint.type in ONE_COORDINATE and joint.name not in moving
    }
    for what in ("bodies", "joints"):
        renamed = [f"{file} is {name}" for (key, name), file in parts.names.items() if key == what and name != file]
        if renamed:
            notes.append(f"renamed {what}: {listed(renamed)}")
    parts.drive = added_drive(options, parts)
    parts.notes = [*notes, *contacts, *_left_out(robot, grouping, switches, outside)]
    return parts


def _bodies(robot, grouping, parts, notes):
    """Append the bodies. Returns {id of a group: name of its body}."""
    movable = [group for group in grouping.groups if group is not grouping.world]
    if not movable:
        if grouping.held:
            link, joint = grouping.held[0]
            raise robot.error(
                robot.links[link].line,
                f'joint "{joint.name}" moves only link "{link}", which has no mass: give the link an inertial',
            )
        advice = (
            "let the root float with base: floating (--base floating), unlock a joint, or keep more links with only"
            if robot.roots
            else "give a body a joint"
        )
        raise robot.error(0, f"has no link that moves: all links are fixed to the world; {advice}")
    static = [name for name in grouping.world.links if name != WORLD]
    if static:
        notes.append(f"fixed to the world: {listed(static)}")
    names = unique_names([group.links[0] for group in movable], {WORLD})
    masses = [grouping.mass(group) for group in movable]
    lightest = min((mass for mass, _, _ in masses if mass > 0.0), default=1.0)
    body_of = {id(grouping.world): WORLD}
    for group, name, (mass, com, inertia) in zip(movable, names, masses):
        body_of[id(group)] = name
        _check_complete(robot, group)
        line = robot.links[group.links[0]].line
        body = {"name": name}
        if mass == 0.0:
            body["mass"] = NO_MASS * lightest
            kind = "between joints, " + ("modelled with its inertia and a mass" if inertia.any() else "a point mass")
            if id(group) in grouping.led:
                kind, inertia = "moved by couplings, a mass", body["mass"] * OF_LED**2 * np.eye(3)
            notes.append(f"without mass: {listed(group.links)} {kind} of {NO_MASS:g} of the lightest body")
        else:
            body["mass"] = mass
        if np.abs(inertia).max() <= NO_INERTIA * body["mass"]:
            inertia = np.zeros((3, 3))
        body["inertia"] = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        _check_inertia(robot, group, line, inertia, body, notes)
        if com.any():
            body["com"] = com
        body |= frame_keys(group.pose)
        for key, value in zip(("angular_velocity", "linear_velocity"), np.split(group.twist, 2)):
            if value.any():
                body[key] = value
        parts.names["bodies", name] = group.links[0]
        merged = group.links[1:]
        if merged:
            notes.append(f"merged into {name}: {listed(merged)}")
        comment = _from_line(robot, line) + (f", with {listed(merged)}" if merged else "")
        parts.add("bodies", body, line, comment)
    return body_of


def _check_complete(robot, group):
    """Refuse a body without <mass> or without any <inertia>; a link without <inertia> merges as a point mass."""
    links = [robot.links[name] for name in group.links]
    for link in links:
        if link.lacks and (not link.mass or not any(each.inertia.any() for each in links)):
            raise robot.error(link.lacks[0], f"{link.lacks[1]}, and the link moves: give one, or fix it to the world")
        if link.lacks:
            robot.remark("without <inertia>, merged as a point mass", link.name)


def _check_inertia(robot, group, line, inertia, body, notes):
    """Refuse a negative moment of inertia; add a note if no rigid body has these moments."""
    moments = np.linalg.eigvalsh(inertia)
    scale = np.abs(moments).max()
    text = ", ".join(f"{moment:.6g}" for moment in moments)
    what = f'link "{group.links[0]}"' + (" with what is fixed to it" if group.links[1:] else "")
    if moments[0] < -NEGATIVE_ROUND_OFF * scale:
        for name in group.links:
            own = np.linalg.eigvalsh(robot.links[name].inertia)
            if own[0] < -NEGATIVE_ROUND_OFF * np.abs(own).max():
                line = robot.links[name].line
        raise robot.error(
            line,
            f"{what} has a negative moment of inertia (principal moments {text} kg m^2): correct its "
            "<inertia>, which is about the centre of mass",
        )
    if moments[2] > moments[0] + moments[1] + TRIANGLE_TOLERANCE * scale:
        body["unphysical"] = True
        notes.append(
            f"inertia that no rigid body can have: {what}, principal moments {text} kg m^2, used as given"
            + (f" (line {line})" if line else "")
        )


def _joints(robot, grouping, parts, body_of, added, values):
    """Append the joints, and the forces of their springs and dampers. Returns all their names.

    added : (joints of the user, their places in the additions, ({joint: coordinate}, {joint: velocity}) that
            assembly keeps, names of other entries)
    values : {joint: coordinate at the start}
    """
    extra, places, (coordinates, rates), own_names = added
    moving = [*grouping.moving, *extra]
    own_names |= {joint.name for joint in extra}
    names = unique_names([joint.name for joint in grouping.moving], own_names)
    names += [joint.name for joint in extra]
    taken = set(names) | own_names
    for joint, name in zip(moving, names):
        number = len(parts.joints)
        F_a, F_b = grouping.frames(joint)
        parent, child = (body_of[id(grouping.of_link[end])] for end in (joint.parent, joint.child))
        if child == WORLD:  # in a scene, the child of a joint must be a body
            parent, child, F_a, F_b = child, parent, *exchanged(joint.type, F_a, F_b)
        entry = {"name": name, "type": joint.type, "parent": parent, "child": child}
        if joint.type == "screw":
            entry["pitch"] = joint.pitch
        for key in ("length", "radius", "mu", "frictionless"):
            if getattr(joint, key) is not None:
                entry[key] = getattr(joint, key)
        entry["parent_frame"], entry["child_frame"] = frame_keys(F_a), frame_keys(F_b)
        for key, given in (("coordinate", coordinates), ("rate", rates)):
            value = given.get(joint.name, getattr(joint, key))
            if value is not None:
                entry[key] = float(value)
                if joint.name in given:
                    of = "start" if key == "coordinate" else "start_velocity"
                    parts.lines["joints", number, key] = (of, joint.name)
        if joint.rotor and joint.type in ONE_COORDINATE:
            entry["rotor"] = dict(joint.rotor)
        if joint.data:
            entry["data"] = dict(joint.data)
        own = number - len(grouping.moving)
        comment = _from_line(robot, joint.line) if own < 0 else f"added between {joint.parent} and {joint.child}"
        parts.add("joints", entry, joint.line if own < 0 else places[own], comment)
        parts.names["joints", name] = joint.name
        _law(robot, parts, joint, name, taken, values.get(joint.name, 0.0))
    return taken


def _drive(options, parts):
    """Add the prescribed motions of driven joints."""
    for number, entry in enumerate(parts.joints):
        name = parts.names["joints", entry["name"]]
        if name in options.driven:
            entry["driven"] = True
            if options.driven[name] is not None:
                entry["motion"] = options.driven[name].model_dump(exclude_defaults=True)
            for key in ("driven", "motion"):
                parts.lines["joints", number, key] = ("driven", name)


def _switch(switches, parts, values):
    """Add stops and friction; switches: see Options.with_switches.

    Assembly keeps the coordinate of a joint that starts at a stop, which it must not pass.
    """
    for number, entry in enumerate(parts.joints):
        name = parts.names["joints", entry["name"]]
        for key, option, of in zip(("limits", "friction"), ("stops", "friction"), switches):
            if of.get(name):
                entry[key] = of[name]
                parts.lines["joints", number, key] = (option, 0)
        ends = [end for key, end in entry.get("limits", {}).items() if key in ("lower", "upper")]
        if parts.assemble and any(abs(end - values[name]) <= BEYOND for end in ends):
            entry.setdefault("coordinate", values[name])


def _couplings(robot, grouping, parts, values, taken):
    """Append the couplings of joints that move; taken: names of joints and forces."""
    moving = {joint.name for joint in grouping.moving}
    joints = {joint.name: joint for joint in robot.joints}
    in_scene = {file: name for (kind, name), file in parts.names.items() if kind == "joints"}
    for coupling in (*robot.couplings, *robot.relations, *robot.loose):
        if not {coupling.first, coupling.second, *coupling.further} <= moving:
            coupling = among(robot, coupling, moving, values)
        if coupling is None:
            continue
        is_added, second = isinstance(coupling.line, tuple), values[coupling.second]
        offset = coupling.offset
        if offset is None:
            offset = values[coupling.first] - rise(coupling, second) - coupling.rest(values)
        turned = {name: joint.turned(values[name]) for name, joint in joints.items() if name in moving}
        offset += coupling.rest(turned) - (turned[coupling.first] if coupling.backlash else 0.0)
        law = counted_from(replace(coupling, offset=offset), turned[coupling.second])
        entry = (
            {
                "name": coupling.name,
                "joint": in_scene[coupling.first],
                "other": in_scene[coupling.second],
                "ratio": law["ratio"],
                "offset": law["offset"],
            }
            | ({"curve": law["curve"]} if law["curve"] else {})
            | ({"terms": {in_scene[key]: c for key, c in coupling.further.items()}} if coupling.further else {})
            | ({"backlash": coupling.backlash} if coupling.backlash else {})
        )
        comment = "added" if is_added else _from_line(robot, coupling.line)
        # Names given by the user do not change.
        parts.add("couplings", entry, coupling.line, comment, None if is_added else taken)


def exchanged(kind, F_a, F_b):
    """Frames (4, 4) of the same joint with parent and child exchanged, and the same coordinate.

    The z axes are reversed, so that the reverse motion has the same sign.
    """
    reverse = np.diag([1.0, -1.0, -1.0, 1.0])
    if kind == "universal":  # exchanges the axes of the cross: x of the parent, y of the child
        reverse = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    return F_b @ reverse, F_a @ reverse


def _law(robot, parts, joint, name, taken, start):
    """Append the spring and damper of a joint, or note that no force of a scene can model them."""
    if not joint.damping and not joint.stiffness:
        return
    kinds = {"revolute": "torsional", "screw": "torsional", "prismatic": "linear"}
    if joint.type not in kinds:
        robot.leave_out(f"springs and damping of {joint.type} joints", joint.name, changes_motion=True)
        return
    kind = kinds[joint.type]
    entry = {
        "name": f"{name}_{'spring' if joint.stiffness else 'damping'}",
        "type": f"{kind}_spring_damper",
        "joint": name,
        "stiffness": joint.stiffness,
        "damping": joint.damping,
    }
    if joint.stiffness:
        entry["rest_angle" if kind == "torsional" else "rest_position"] = joint.rest - joint.turned(start)
    parts.add("forces", entry, joint.line, _from_line(robot, joint.line), taken)


def _lift(robot, grouping, parts, body_of, taken):
    """Append forces against the weight of links on which gravity does not act, or acts in part."""
    for name, group in grouping.of_link.items():
        if group is grouping.world or robot.links[name].weight == 1.0:
            continue
        link, place = robot.links[name], group.places[name]
        robot.remark("without gravity" if link.weight == 0.0 else "with a part of its weight", name)
        force = (link.weight - 1.0) * link.mass * np.array(parts.gravity)
        entry = {
            "name": f"{name}_without_gravity",
            "type": "applied_wrench",
            "body": body_of[id(group)],
            "axes": "world",
        }
        entry |= {"force": force, "point": place[:3, :3] @ link.com + place[:3, 3]}
        parts.add("forces", entry, link.line, _from_line(robot, link.line), taken)


def _outside_limits(joints, values, stops):
    """{joint that starts outside its limits: text}; values: {joint: coordinate}, stops: of joints that have them."""
    found = {}
    for joint in joints:
        lower, upper = joint.data.get("lower", -np.inf), joint.data.get("upper", np.inf)
        if (
            joint.type in ONE_COORDINATE
            and lower <= upper
            and not is_within(joint, values[joint.name])
            and joint.name not in stops
        ):
            found[joint.name] = f"{joint.name} at {values[joint.name]:.6g} (from {lower:.6g} to {upper:.6g})"
    return found


def _is_point(joint):
    """Whether the limits of a joint leave it no range."""
    return joint.data.get("lower", -np.inf) == joint.data.get("upper", np.inf)


def _left_out(robot, grouping, switches, outside):
    """Notes on omitted parts of the robot file; switches: see Options.with_switches, outside: joints of other notes."""
    stops, friction = switches
    notes = []
    moving = {joint.name: joint for joint in grouping.moving}
    for keys, text, acting in (
        (("lower", "upper"), "joint limits are not enforced", {*stops, *outside}),
        (("friction",), "joint friction is not simulated", friction),
    ):
        names = [
            f"{name} (both are {joint.data['upper']:.6g})" if "upper" in keys and _is_point(joint) else name
            for name, joint in moving.items()
            if set(keys) & joint.data.keys() and name not in acting
        ]
        if names:
            notes.append(f"changes the motion: {text}: {listed(names)}")
    swapped = [
        name for name, joint in moving.items() if joint.data.get("lower", -np.inf) > joint.data.get("upper", np.inf)
    ]
    if swapped:
        notes.append(f"error in the file: the lower limit is above the upper one: {listed(swapped)}")
    for name in grouping.of_link:
        for visual in robot.links[name].visuals if name in robot.links else ():
            _check_visual(robot, visual, name)
    notes += [f"{what}: {listed(names)}" for what, names in robot.remarks.items()]
    for what, names in robot.changes.items():
        notes.append(f"changes the motion: {what}, left out: {listed(names)}")
    for what, names in robot.left_out.items():
        notes.append(f"left out: {what} ({listed(names)})")
    return notes


def _check_visual(robot, visual, link):
    """Note what a viewer cannot draw as the file says, and clip its colour."""
    if visual.mesh:
        note_mesh(robot, visual.mesh, link)
    if visual.asset < 0 and not (all(visual.size) if visual.mesh else min(visual.size) > 0.0):
        size = " ".join(f"{part:g}" for part in visual.size)
        robot.remark("visuals with a size that has no volume", f"{visual.kind} {size} of {link}")
    if visual.color and not 0.0 <= min(visual.color) <= max(visual.color) <= 1.0:
        color = " ".join(f"{part:g}" for part in visual.color)
        robot.remark("colours clipped to the range from 0 to 1", f"{color} of {link}")
        visual.color = tuple(np.clip(visual.color, 0.0, 1.0).tolist())


def _from_line(robot, line):
    return f"line {line}" if line else f"of the {robot.kind} file"
