# SPDX-License-Identifier: Apache-2.0
"""MJCF: the models of MuJoCo, compiled by MuJoCo's own compiler.

Source: https://mujoco.readthedocs.io, chapters Computation and XML Reference. A body may have several
joints. They form a chain with links without mass between them; the first joint is next to the parent.
Joint coordinates are 0 in the pose of the file (qpos0).
"""

import json
import math
import os
import re
from functools import partial

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import rotation_z_to
from liegroup_core.lie.groups import SO3

from .access import is_permitted, outside
from .actuators import FREE, Actuator
from .apart import run_apart
from .description import NOT_DRAWN, WORLD, Collision, Link, Relation, Robot, RobotJoint, Visual, place, refusal
from .mjcf_sensors import read_sensors
from .resources import note_mesh
from .tendons import Tendon, add_relation
from .xml import Reader, read_xml

TYPES = {"ball": "spherical", "slide": "prismatic", "hinge": "revolute"}
# A tendon of fixed length between two sites is a rod without mass.
CLOSING = {"connect": "spherical", "weld": "fixed", "tendon": "distance"}
ACTUATORS = ("motor", "position", "velocity", "intvelocity", "general", "damper", "cylinder")
VISUALS = {"box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh"}
SHOWN = 2  # largest group of geoms that MuJoCo's viewer shows by default; collision shapes are often in others


def robot_of_mjcf(root, path):
    """Robot of an MJCF file; root: its root element. Raises SceneError."""
    _check_files(root, path)
    try:
        model = json.loads(run_apart("mjcf", path))
    except SceneError as error:
        raise _with_line(error, root, path) from None
    _refuse_infinite(path, model)
    lines = {(element.tag, element.get("name")): element.sourceline for element in root.iter() if element.get("name")}
    robot = Robot(
        root.get("model") or model["name"] or "model",
        Reader(path).file,
        "MJCF",
        free=True,
        gravity=tuple(model["gravity"]),
    )
    names = _names([body["name"] for body in model["bodies"]], "body")
    for body, name in zip(model["bodies"], names):
        _body(robot, model, body, name, names, lines)
    _joints(robot, model, names, lines)
    _equalities(robot, model, names, lines)
    _shapes(robot, model, names, lines)
    _poses(robot, model, names)
    _actuators(robot, model, lines)
    _others(robot, model, names, lines)
    read_sensors(robot, model, names, _rotation, lines)
    return robot


def _check_files(root, path):
    """Refuse files that the model includes and that may not be read: MuJoCo reads them as empty."""
    pending, seen = [(root, path)], set()
    for element, of in pending:
        for part in (*element.iter("include"), *element.iter("model")):
            file = os.path.realpath(os.path.join(os.path.dirname(path), part.get("file") or ""))
            if file in seen or not os.path.isfile(file):
                continue
            seen.add(file)
            if not is_permitted(file, path):
                raise refusal(of, part.sourceline, f"{part.get('file')} is not read: {outside(path)}")
            pending.append((read_xml(file), file))


def _with_line(error, root, path):
    """SceneError with the line from MuJoCo's message, or with the line that refers to a file it could not open."""
    head, text = f"{path}: ", str(error)
    for element in root.iter():
        name = element.get("file")
        if name and text.startswith(head) and f"{name}'" in text:
            return refusal(path, element.sourceline, text.removeprefix(head), type(error))
    line = re.search(r", line ([1-9]\d*)", text)
    # With <include>, the line may belong to an included file, whose name the message does not contain.
    if line and text.startswith(head) and root.find(".//include") is None:
        return refusal(path, int(line[1]), text.removeprefix(head), type(error))
    return error


def _refuse_infinite(path, value, place=()):
    """Raise SceneError if the compiled model contains a number that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        where = ", ".join(str(part) for part in place if not isinstance(part, int))
        raise refusal(path, 0, f"has a number that is not finite ({where}): correct the file")
    entries = value.items() if isinstance(value, dict) else ()
    if isinstance(value, list):
        # The message refers to an entry of a list by its name.
        entries = [(str(each.get("name") or i) if isinstance(each, dict) else i, each) for i, each in enumerate(value)]
    for key, each in entries:
        _refuse_infinite(path, each, (*place, key))


def _names(given, what):
    """Names, generated where the file has none."""
    taken = set(given)
    found = []
    for i, name in enumerate(given):
        own, k = name or f"{what}_{i + 1}", 2
        while not name and own in taken:
            own, k = f"{what}_{i + 1}_{k}", k + 1
        taken.add(own)
        found.append("world_body" if own == WORLD else own)
    return found


def _rotation(quaternion):
    """(3, 3) of a quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return SO3.from_quaternion(np.array([x, y, z, w])) if (x, y, z) != (0, 0, 0) else np.eye(3)


def _body(robot, model, body, name, names, lines):
    R = _rotation(body["iquat"])
    parent = WORLD if body["parent"] == 0 else names[body["parent"] - 1]
    above = np.eye(4) if parent == WORLD else robot.links[parent].pose
    inertia = R @ np.diag(body["inertia"]) @ R.T
    robot.links[name] = Link(
        name,
        lines.get(("body", body["name"]), 0),
        body["mass"],
        np.array(body["ipos"]),
        0.5 * (inertia + inertia.T),
        above @ place(body["pos"], _rotation(body["quat"])),
        weight=1.0 - body["gravcomp"],
    )
    if body["mocap"] >= 0:
        robot.leave_out("mocap bodies, which stay in place", name)


def _joints(robot, model, names, lines):
    """Joints of all bodies, with links without mass between several joints of a body."""
    own = {}
    labels = _names([joint["name"] for joint in model["joints"]], "joint")
    for joint, label in zip(model["joints"], labels):
        joint["label"] = label
        own.setdefault(joint["body"], []).append(joint)
    for i, (body, name) in enumerate(zip(model["bodies"], names), 1):
        parent = WORLD if body["parent"] == 0 else names[body["parent"] - 1]
        place_in_parent = place(body["pos"], _rotation(body["quat"]))
        line = robot.links[name].line
        joints = own.get(i, [])
        if not joints:
            robot.joints.append(RobotJoint(f"{name}_weld", "fixed", parent, name, place_in_parent, np.eye(4), line))
        for number, joint in enumerate(joints, 1):
            line_of = lines.get(("joint", joint["name"]), line)
            if joint["type"] == "free":
                _free(robot, joint, name)
                continue
            child = name if number == len(joints) else f"{name}_{joint['label']}"
            if child != name:
                robot.links[child] = Link(child, line_of, pose=robot.links[name].pose)
            robot.joints.append(_joint(robot, joint, parent, child, place_in_parent, line_of))
            parent, place_in_parent = child, np.eye(4)


def _free(robot, joint, name):
    """Record a free joint: the body floats, and no force of a scene acts in this joint."""
    robot.roots.append(name)
    if joint["damping"] or joint["stiffness"] or joint["friction"] or joint["armature"]:
        robot.leave_out("springs, damping, friction and armature of free joints", joint["label"], changes_motion=True)


def _joint(robot, joint, parent, child, placement, line):
    turn = np.eye(3)
    if joint["type"] != "ball":
        turn = rotation_z_to(joint["axis"])
    frame = place(joint["pos"], turn)
    if joint["type"] == "slide":  # the position of its axis has no effect
        frame[:3, 3] = 0.0
    found = RobotJoint(joint["label"], TYPES[joint["type"]], parent, child, placement @ frame, frame, line)
    found.damping, found.stiffness = joint["damping"], joint["stiffness"]
    found.efforts = tuple(joint["efforts"] or FREE)
    if joint["type"] != "ball":
        found.rest = joint["spring"] - joint["zero"]
    if joint["nonlinear"]:
        robot.leave_out("nonlinear springs and dampers", joint["label"], changes_motion=True)
    if joint["type"] != "ball" and joint["zero"]:
        robot.remark(
            f"coordinate of joint {joint['label']} is 0 at its ref {joint['zero']:.6g} of the file",
            "qpos = coordinate + ref",
        )
    if joint["armature"] and joint["type"] == "ball":
        robot.leave_out("armature of ball joints", joint["label"], changes_motion=True)
    elif joint["armature"]:
        found.rotor = {"inertia": joint["armature"]}
    if joint["friction"]:
        found.data["friction"] = joint["friction"]
    if joint["range"] is not None and joint["type"] == "ball":
        robot.leave_out(
            "limits of the rotation angle of ball joints, which differs from the angle of a cone",
            joint["label"],
            changes_motion=True,
        )
    elif joint["range"] is not None:
        found.data["lower"], found.data["upper"] = (value - joint["zero"] for value in joint["range"])
    return found


def _equalities(robot, model, names, lines):
    """Equality constraints: closing joints, couplings, locked joints."""
    label = [joint["label"] for joint in model["joints"]]
    for equality in model["equalities"]:
        kind, name, data = equality["type"], equality["name"], equality["data"]
        line = lines.get((kind, name), 0)
        if not equality["active"]:
            robot.leave_out("equality constraints that are not active", name)
        elif kind in ("connect", "weld") or equality.get("length", 0.0) > 0.0:
            robot.joints.append(_closing(robot, equality, names, line))
        elif kind == "joint" and equality["second"] >= 0:
            ends = (label[equality[end]] for end in ("first", "second"))
            robot.couplings.append(Relation(name, *ends, data[1], data[0], line, tuple(np.trim_zeros(data[2:5], "b"))))
        elif kind == "joint" and equality["second"] < 0:
            robot.locked[label[equality["first"]]] = data[0]
        elif not add_relation(robot, name, _terms(equality, label), data[0], line):
            robot.leave_out(f"equality constraints of {kind}s", name, changes_motion=True)


def _terms(entry, label):
    """{joint: c} of the length of a fixed tendon, or of the relation that an equality of fixed tendons prescribes."""
    terms = {}
    for joint, share in entry.get("terms", ()):
        terms[label[joint]] = terms.get(label[joint], 0.0) + share
    return terms


def _closing(robot, equality, names, line):
    """RobotJoint of a connect or weld between two bodies, or two sites, or of a straight tendon."""
    data = equality["data"]
    if "sites" in equality:
        ends = [0 if site["body"] == 0 else site["body"] for site in equality["sites"]]
        frames = [place(site["pos"], _rotation(site["quat"])) for site in equality["sites"]]
    else:
        ends = [equality["first"], equality["second"]]
        if equality["type"] == "connect":
            frames = [place(data[0:3]), place(data[3:6])]
        else:  # anchor in the second body, pose of the second body in the first
            frames = [place(data[3:6], _rotation(data[6:10])), place(data[0:3])]
    parent, child = (WORLD if end == 0 else names[end - 1] for end in ends)
    F_a, F_b = frames
    if child == WORLD:
        parent, child, F_a, F_b = child, parent, F_b, F_a
    return RobotJoint(
        equality["name"],
        CLOSING[equality["type"]],
        parent,
        child,
        F_a,
        F_b,
        line,
        closes=True,
        length=equality.get("length"),
    )


def _shapes(robot, model, names, lines):
    """Add visuals and collision shapes. Of a body without a shape that MuJoCo shows, all are visuals."""
    shown = {geom["body"] for geom in model["geoms"] if geom["group"] <= SHOWN}
    for geom in model["geoms"]:
        name, kind, (x, y, z) = (WORLD, *names)[geom["body"]], geom["type"], geom["size"]
        pose, sizes = place(geom["pos"], _rotation(geom["quat"])), {"box": (2 * x, 2 * y, 2 * z), "sphere": (x,)}
        size = (sizes | {"ellipsoid": (x, y, z)}).get(kind, (x, 2 * y))
        if geom["collides"] and name != WORLD:
            label = f"mesh {geom['missing']}, which is missing," if geom["missing"] else kind
            visual = partial(Visual, label, size, pose, asset=geom["asset"])
            line = lines.get(("geom", geom["name"]), robot.links[name].line)
            robot.links[name].collisions.append(Collision(line, visual, partial(float, geom["friction"])))
        if geom["missing"]:
            note_mesh(robot, geom["missing"], name)
        elif geom["group"] > SHOWN and geom["body"] in shown:
            robot.leave_out(
                f"shapes of geom groups above {SHOWN}, which MuJoCo hides", geom["name"] or f"{kind} of {name}"
            )
        elif kind == "plane" and geom["collides"] and name == WORLD:
            label = f"{kind} {geom['name']}".strip() + f" of {name}"
            robot.planes.append((label, pose, float(geom["friction"])))
        elif kind not in VISUALS:
            robot.leave_out(NOT_DRAWN, f"{kind} {geom['name']}".strip() + f" of {name}")
        else:
            color = geom["color"] and tuple(geom["color"])
            visuals = robot.fixtures if name == WORLD else robot.links[name].visuals
            visuals.append(Visual(kind, size, pose, "", color, geom["asset"]))
    for name in model["skins"]:
        robot.leave_out(NOT_DRAWN, name)


def _poses(robot, model, names):
    """Add the keyframes as joint coordinates and velocities.

    Velocities of a free joint are in world axes, angular ones of free and ball joints in axes of the child.
    """
    for key in model["keys"]:
        if key["mocap"]:
            robot.leave_out("poses of mocap bodies in keyframes", key["name"], changes_motion=True)
        places, rates, free = (
            kind.setdefault(key["name"], {}) for kind in (robot.poses, robot.velocities, robot.root_poses)
        )
        for joint in model["joints"]:
            q, v, label = key["qpos"][joint["qpos"] :], key["qvel"][joint["dof"] :], joint["label"]
            if joint["type"] == "free":
                pose = place(q[:3], _rotation(q[3:7]))
                free[names[joint["body"] - 1]] = pose, np.array([*v[3:6], *(pose[:3, :3].T @ v[:3])])
            elif joint["type"] == "ball":
                places[label], rates[label] = place(rotation=_rotation(q[:4])), np.array([*v[:3], 0.0, 0.0, 0.0])
            else:
                places[label], rates[label] = q[0] - joint["zero"], v[0]


def _actuators(robot, model, lines):
    """Actuators of hinges and slides, directly or by a fixed tendon, with their commands in keyframes."""
    for each in model["actuators"]:
        name, joints = each["name"], [(model["joints"][i], share) for i, share in each["shares"] or ()]
        if joints and each["linear"]:
            shares = {joint["label"]: share for joint, share in joints}
            length = sum(share * joint["zero"] for joint, share in joints)
            laws = np.array(each["bias"]), np.array(each["gain"])
            ranges = (tuple(each[key] or FREE) for key in ("controls", "forces"))
            line = next((lines[tag, name] for tag in ACTUATORS if (tag, name) in lines), 0)
            robot.actuators.append(Actuator(name, line, shares, length, *laws, *ranges, each["dynamics"]))
        elif each["acts"] or any(key["ctrl"][each["ctrl"]] for key in model["keys"]):
            what = "actuators that are not affine, or not of joints with one coordinate"
            robot.leave_out(what, name, changes_motion=True)
        else:
            robot.leave_out("actuators", name)
    for key in model["keys"]:
        robot.commands[key["name"]] = {
            each["name"]: (key["ctrl"][each["ctrl"]], key["act"][each["act"]] if each["act"] >= 0 else 0.0)
            for each in model["actuators"]
        }


def _others(robot, model, names, lines):
    """Add straight and fixed tendons, and note the parts that a scene cannot model."""
    if model["fluid"]:
        robot.leave_out("forces of a fluid", "option density or viscosity", changes_motion=True)
    # A tendon that is imported as a joint has constant length, so its springs and limits do no work.
    active = [each for each in model["equalities"] if each["active"]]
    rods = {each["tendon"] for each in active if each.get("length")}
    # Equalities that are couplings and actuators act through their tendons, also through those without own forces.
    used = {tendon for each in (*active, *model["actuators"]) for tendon in each["tendons"]}
    for i, tendon in enumerate(model["tendons"]):
        acts = tendon["stiffness"] or tendon["damping"] or tendon["range"]
        if i in rods:
            continue
        if not acts and not tendon["other"]:
            if i not in used:
                robot.leave_out("tendons", tendon["name"])
            continue
        sites, terms = tendon["sites"] or (), _terms(tendon, [joint["label"] for joint in model["joints"]])
        if (sites or terms) and acts:
            ends = [(WORLD if s["body"] == 0 else names[s["body"] - 1], np.array(s["pos"])) for s in sites]
            line = lines.get(("spatial" if sites else "fixed", tendon["name"]), 0)
            laws = (tendon[key] for key in ("rest", "stiffness", "damping", "range"))
            robot.tendons.append(Tendon(tendon["name"], line, ends, *laws, terms))
            what = "friction, inertia and nonlinear laws of tendons"
        else:
            what = "tendons with forces or limits that are not straight between two points"
        if tendon["other"] or not (sites or terms):
            robot.leave_out(what, tendon["name"], changes_motion=True)
    for what in ("flexes", "plugins"):
        for name in model[what]:
            robot.leave_out(what, name, changes_motion=True)
