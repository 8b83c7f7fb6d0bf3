# SPDX-License-Identifier: Apache-2.0
"""SDF: the models and worlds of Gazebo. Joints connect any two links, so they also close loops.

Source: http://sdformat.org/spec. Models float unless a joint or <static> fixes them to the world. A link
without <inertial> has the format's defaults: 1 kg, and 1 kg m^2 about every axis.
"""

import math

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.fields.frames import rotation_z_to
from liegroup_core.lie.groups import SE3

from .access import permit
from .controllers import add_servos
from .description import WORLD, Link, Relation, Robot, RobotJoint, place
from .omitted import omit
from .resources import LATEST_SDF, find_resource, model_file, resolve
from .rotors import add_rotor
from .sdf_frames import SdfModel, text_of
from .sdf_links import read_link
from .sdf_sensors import joint_sensor
from .tendons import add_relation
from .xml import Reader, read_xml, value_of

TYPES = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
    "ball": "spherical",
    "screw": "screw",
    "universal": "universal",
    "revolute2": "universal",
}

OWN_RULES = (1, 7)  # earlier versions have other rules for the axes of joints
RIGID = 1e8  # default stiffness of stops in the format
DEEPEST = 20  # levels of nested models and includes
# {element: (children, attributes)} that are read, or that have no effect.
KNOWN = {
    "inertial": ("pose mass inertia density auto_inertia_params fluid_added_mass", "auto"),
    "inertia": ("ixx ixy ixz iyy iyz izz", ""),
    "joint": (
        "parent child pose axis axis2 physics sensor screw_thread_pitch thread_pitch gearbox_ratio "
        "gearbox_reference_body",
        "name type",
    ),
    "axis": ("xyz limit dynamics mimic initial_position use_parent_model_frame", ""),
    "dynamics": ("damping friction spring_reference spring_stiffness", ""),
    "limit": ("lower upper effort velocity stiffness dissipation", ""),
    "mimic": ("multiplier offset reference", "joint axis"),
}
KNOWN["axis2"] = KNOWN["axis"]
AXES, LAWS = ("axis", "axis2"), ("limit", "dynamics", "mimic")
PARTS_OF_WORLDS = ("model", "include", "frame", "joint", "gravity")
PARTS = ("link", "joint", "frame", "model", "pose", "static", "include")


class _Loader:
    def __init__(self, path, version):
        self.reader, self.path, self.version = Reader(path), path, version
        self.robot = Robot("model", self.reader.file, "SDF", free=True)


def robot_of_sdf(root, path):
    """Robot of the root element of an SDF file. Raises SceneError."""
    reader = Reader(path)
    version = _version(root)
    loader = _Loader(path, version)
    robot = loader.robot
    if version > LATEST_SDF:
        robot.remark("SDF version above 1.12, read by the rules of 1.12", root.get("version"))
    if version < OWN_RULES:
        robot.remark(
            "SDF version before 1.7, read by the rules of 1.7, except for the axes of its joints", root.get("version")
        )
    world = root.find("world")
    top = root if world is None else world
    if world is not None:
        robot.name = world.get("name") or "world"
        gravity = next(world.iterfind("gravity"), world.find("physics/gravity"))  # in <physics> up to version 1.4
        if gravity is not None:
            robot.gravity = tuple(reader.numbers(gravity, gravity.text, 3, "<gravity>"))
    _include(loader, top, 0)
    models = top.findall("model")
    if not models:
        raise reader.error(root, "has no <model>: give an SDF file with a model")
    if world is None:
        robot.name = models[0].get("name") or "model"
    for element in top:
        if world is not None and element.tag not in PARTS_OF_WORLDS:
            omit(robot, element, f"{element.tag} of the world", element.get("name") or "unnamed")
    robot.leave_out_unknown(root, KNOWN)
    space = SdfModel(reader, top, "", is_world=True)
    _nest(loader, space, 0)
    for name, model in space.nested.items():
        _model(loader, model, space.pose(name, model.element))
    _joints(loader, space, np.eye(4))
    robot.check_couplings()
    return robot


def _version(root):
    """(major, minor) of the format."""
    try:
        return tuple(int(part) for part in (root.get("version") or "1.7").split(".")[:2])
    except ValueError:
        return 1, 7


def _permit(reader, include, path, file):
    try:
        permit(path, file)
    except SceneError as error:
        raise reader.error(include, str(error)) from None


def _include(loader, element, depth):
    """Replace <include> elements by the models that they refer to."""
    reader = loader.reader
    if depth > DEEPEST:
        raise reader.error(element, f"models include each other more than {DEEPEST} levels deep")
    for include in element.findall("include"):
        uri = text_of(include, "uri")
        if uri is None:
            raise reader.error(include, "<include> has no <uri>: give one")
        if include.get("merge", "false") in ("true", "1"):
            raise reader.error(include, "<include merge> is not supported: omit merge and write links as MODEL::LINK")
        path = find_resource(uri, loader.path)
        for name in () if uri.endswith(".sdf") else ("model.config", "model.sdf"):
            inside = find_resource(f"{uri.rstrip('/')}/{name}", loader.path)
            if inside is not None:
                path = model_file(inside.parent)
                break
        if path is None:
            try:
                path = resolve(uri)
            except SceneError as error:
                raise reader.error(include, str(error)) from None
        if not path.is_file():
            raise reader.error(include, f"the included model {uri!r:.80} is not found")
        # A model may be outside of the tree, but a request may only use the folders that are served.
        _permit(reader, include, path, path if uri.startswith("model://") else reader.file)
        model = read_xml(path).find("model")
        if model is None:
            raise reader.error(include, f"{path} has no <model>")
        for key in ("pose", "name", "static"):
            given = include.find(key)
            if given is not None and key == "name":
                model.set("name", given.text.strip())
            elif given is not None:
                for old in model.findall(key):
                    model.remove(old)
                model.append(given)
        _include(loader, model, depth + 1)
        element.replace(include, model)
    for model in element.findall("model"):
        _include(loader, model, depth + 1)


def _nest(loader, model, depth):
    """Add the nested models of a model. If a world has only one model, its links get no prefix."""
    if depth > DEEPEST:
        raise loader.reader.error(model.element, f"models are nested deeper than {DEEPEST} levels")
    elements = model.element.findall("model")
    for element in elements:
        name = loader.reader.name(element)
        full = "" if model.is_world and len(elements) == 1 else model.full(name)
        model.nested[name] = SdfModel(loader.reader, element, full, model)
        _nest(loader, model.nested[name], depth + 1)


def _model(loader, model, pose):
    """Add the links and joints of a model; pose : (4, 4) of its frame in the world."""
    reader, robot = loader.reader, loader.robot
    own = [part for part in model.element if part.tag == "link"]
    for element in own:
        link = read_link(reader, robot, model, element)
        link.pose = pose @ model.pose(element.get("name"), element)
        robot.links[link.name] = link
    canonical = model.element.get("canonical_link")
    if canonical:
        robot.roots.append(model.link_of(canonical, model.element))
    elif own:
        robot.roots.append(model.full(own[0].get("name")))
    for name, inner in model.nested.items():
        _model(loader, inner, pose @ model.pose(name, inner.element))
    if text_of(model.element, "static") in ("true", "1"):
        for element in own:
            name = model.full(element.get("name"))
            robot.joints.append(RobotJoint(f"{name}_static", "fixed", WORLD, name, robot.links[name].pose, np.eye(4)))
    _joints(loader, model, pose)
    for part in model.element:
        if part.tag == "plugin" and add_servos(reader, robot, part, model.full):
            continue
        if part.tag not in PARTS:
            omit(robot, part, part.tag, part.get("name") or model.name or robot.name)


def _joints(loader, model, pose):
    """Add the joints and gearboxes of a model or world; pose : (4, 4) of its frame in the world."""
    gears = []
    for element in model.element.iterfind("joint"):
        if element.get("type") == "gearbox":
            gears.append(element)
        else:
            _joint(loader, model, element, pose)
    for element in gears:
        _gearbox(loader, model, element, pose)


def _joint(loader, model, element, model_pose):
    reader, robot = loader.reader, loader.robot
    name, kind = model.full(reader.name(element)), element.get("type", "")
    if kind not in TYPES:
        raise reader.error(
            element, f'joint "{name}" has the type {kind!r:.40}; choose one of: {", ".join(TYPES)}, gearbox'
        )
    ends = []
    for end in ("parent", "child"):
        given = text_of(element, end)
        if given is None:
            raise reader.error(element, f'joint "{name}" has no <{end}>: give one')
        ends.append(model.link_of(given, element))
    if ends[0] == ends[1]:
        raise reader.error(element, f'joint "{name}" has "{ends[0]}" as parent and as child')
    X = model_pose @ model.pose(element.get("name"), element)
    joint = _placed(robot, element, name, TYPES[kind], ends, X)
    at, joints = joint.child_frame, [joint]
    if kind not in ("fixed", "ball"):
        add_rotor(reader, robot, element, joint, lambda part: part.text)
    if joint.type == "universal":
        joints = _universal(loader, model, element, joint, X)
    elif kind not in ("fixed", "ball"):
        _turn(joint, rotation_z_to(_axis(loader, model, element, "axis")))
        _law(reader, robot, model, element, joint, "axis")
    elif kind == "ball" and any(element.find(f"{key}/{part}") is not None for key in AXES for part in LAWS):
        robot.leave_out("limits and dynamics of ball joints", name, changes_motion=True)
    if kind == "screw":
        joint.pitch = _pitch(reader, element, name)
    for part in element.iterfind("sensor"):
        joint_sensor(reader, robot, part, joints[-1], at @ model.place_in(element, part))
    for part in element.iterfind("physics"):
        robot.leave_out("physics of joints", part.get("name") or name)
    robot.joints += joints


def _placed(robot, element, name, kind, ends, X):
    """RobotJoint between two links; X : (4, 4) pose of both frames in the world."""
    frames = [(np.eye(4) if end == WORLD else SE3.inverse(robot.links[end].pose)) @ X for end in ends]
    return RobotJoint(name, kind, *ends, *frames, element.sourceline)


def _turn(joint, R):
    """Rotate both frames of a RobotJoint by R (3, 3)."""
    turn = place(rotation=R)
    joint.parent_frame, joint.child_frame = joint.parent_frame @ turn, joint.child_frame @ turn


def _universal(loader, model, element, joint, X):
    """[RobotJoint] of a universal joint with both frames at X: itself, or two hinges with a massless link between them.

    It is two hinges if an axis has limits, friction, a spring or another law, or if the angle of the axes is not right.
    """
    reader, robot, name, cross = loader.reader, loader.robot, joint.name, f"{joint.name}::cross"
    axes = [_axis(loader, model, element, key) for key in AXES]
    if np.linalg.norm(np.cross(*axes)) < 1e-6:
        raise reader.error(element, f'joint "{name}" has parallel axes: make it a revolute joint')
    robot.links[cross] = Link(cross, element.sourceline, pose=X)
    hinges = []
    for key, axis, pair in zip(AXES, axes, ((joint.parent, cross), (cross, joint.child))):
        hinges.append(_placed(robot, element, f"{name}::{key}", "revolute", pair, X))
        _turn(hinges[-1], rotation_z_to(axis))
        _law(reader, robot, model, element, hinges[-1], key)
    acts = any(hinge.damping or hinge.stiffness or hinge.name in robot.start for hinge in hinges)
    acts |= any({"lower", "upper", "friction"} & hinge.data.keys() for hinge in hinges)
    acts |= any(element.find(f"{key}/mimic") is not None for key in AXES)
    if acts or abs(axes[0] @ axes[1]) > 1e-9:
        return hinges
    del robot.links[cross]
    _turn(joint, np.column_stack([*axes, np.cross(*axes)]))
    return [joint]


def _axis(loader, model, element, key):
    """Unit vector (3,) of an axis in the frame of its joint."""
    reader, axis = loader.reader, element.find(key)
    default = np.array([0.0, 0.0, 1.0]) if key == "axis" else np.array([0.0, 1.0, 0.0])
    xyz = None if axis is None else axis.find("xyz")
    if xyz is None:
        return default
    vector = reader.numbers(xyz, xyz.text, 3, f"<xyz> of <{key}>")
    vector = reader.direction(xyz, vector, f"<xyz> of <{key}>")
    base = xyz.get("expressed_in")
    if loader.version < OWN_RULES and base is None:
        # Up to version 1.4, axes refer to the frame of the model; from 1.5 to 1.6 only with this flag.
        flag = text_of(axis, "use_parent_model_frame")
        if flag in ("true", "1") or (flag is None and loader.version < (1, 5)):
            base = "__model__"
    if not base:
        return vector
    R = model.pose(element.get("name"), element)[:3, :3].T @ model.pose(base, element)[:3, :3]
    return vector if np.array_equal(R, np.eye(3)) else R @ vector


def _pitch(reader, element, name):
    """Displacement in m per radian of a screw."""
    pitch, old = element.find("screw_thread_pitch"), element.find("thread_pitch")
    if pitch is not None:  # m per turn, right-handed
        return reader.number(pitch, pitch.text, "<screw_thread_pitch>") / (2.0 * math.pi)
    if old is not None:  # rad per m, left-handed
        value = reader.number(old, old.text, "<thread_pitch>")
        if value:
            return -1.0 / value
    raise reader.error(element, f'joint "{name}" has no <screw_thread_pitch>: give one, in m per turn')


def _law(reader, robot, model, element, joint, key):
    """Damping, spring and limits of a joint with one coordinate, from <axis> or <axis2>."""
    axis = element.find(key)
    if axis is None:
        return
    dynamics, limit = axis.find("dynamics"), axis.find("limit")
    if axis.find("initial_position") is not None:
        robot.start_at(joint, value_of(reader, axis, "initial_position", 0.0))
    if axis.find("mimic") is not None:
        _mimic(reader, robot, model, axis.find("mimic"), joint)
    damping, stiffness, friction = (
        0.0 if dynamics is None else value_of(reader, dynamics, part, 0.0)
        for part in ("damping", "spring_stiffness", "friction")
    )
    if min(damping, stiffness, friction) < 0.0:
        raise reader.error(dynamics, f'damping, friction and stiffness of "{joint.name}" must not be negative')
    joint.damping, joint.stiffness = damping, stiffness
    if stiffness:
        joint.rest = value_of(reader, dynamics, "spring_reference", 0.0)
    if friction:
        joint.data["friction"] = friction
    if limit is not None:
        for part in ("lower", "upper", "velocity", "effort"):
            value = text_of(limit, part)
            number = math.inf if value is None else _limit(reader, limit, value, part)
            # The format writes 1e16 and inf for no limit, and -1 for no effort or velocity.
            if abs(number) < 1e15 and (part in ("lower", "upper") or number >= 0.0):
                joint.data[part] = number
        joint.stop = _stop(reader, limit)


def _stop(reader, limit):
    """Stiffness and damping of compliant stops; {} for rigid ones, such as with the default stiffness of 1e8."""
    found = []
    for part, usual in (("stiffness", RIGID), ("dissipation", 1.0)):
        value = text_of(limit, part)
        found.append(usual if value is None else _limit(reader, limit, value, part))
    stiffness, damping = found
    if not 0.0 < stiffness < RIGID or not 0.0 <= damping < math.inf:
        return {}
    return {"stiffness": stiffness, "damping": damping}


def _limit(reader, element, text, part):
    """Number that may be infinite."""
    if text.lower().strip("+-") in ("inf", "infinity"):
        return math.inf
    return reader.number(element, text, f"<{part}>")


def _mimic(reader, robot, model, mimic, joint):
    """Relation of <mimic>: coordinate = multiplier (other - reference) + offset."""
    ratio, offset, reference = (
        value_of(reader, mimic, key, default)
        for key, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
    )
    holder, other = model.split(reader.name(mimic, "joint"), mimic)
    robot.couplings.append(
        Relation(
            f"{joint.name}_mimic", joint.name, holder.full(other), ratio, offset - ratio * reference, mimic.sourceline
        )
    )


def _gearbox(loader, model, element, model_pose):
    """Add the coupling of a gearbox. Both links rotate relative to the reference body: child = -ratio * parent."""
    reader, robot = loader.reader, loader.robot
    name = model.full(reader.name(element))
    parts = {}
    for key in ("parent", "child", "gearbox_reference_body"):
        given = text_of(element, key)
        if given is None:
            raise reader.error(element, f'gearbox "{name}" has no <{key}>: give one')
        parts[key] = model.link_of(given, element)
    ratio = value_of(reader, element, "gearbox_ratio", 1.0)
    X = model_pose @ model.pose(element.get("name"), element)
    terms = {}
    for key, of_gear, factor in (("child", "axis2", 1.0), ("parent", "axis", ratio)):
        path = _hinges(robot, parts["gearbox_reference_body"], parts[key])
        if not path:
            raise reader.error(
                element,
                f'gearbox "{name}": no revolute joints connect "{parts[key]}" to the reference body '
                f'"{parts["gearbox_reference_body"]}"',
            )
        axes = [(_held(robot, joint.child) @ joint.child_frame)[:3, 2] for joint, _ in path]
        own = axes[-1]
        if element.find(of_gear) is not None:
            own = X[:3, :3] @ _axis(loader, model, element, of_gear)
        for (joint, sign), hinge in zip(path, axes):
            # The axis of the gear must be parallel or antiparallel to the axes of the joints.
            if abs(abs(own @ hinge) - 1.0) > 1e-6:
                raise reader.error(element, f'gearbox "{name}": <{of_gear}> is not parallel to that of "{joint.name}"')
            terms[joint.name] = terms.get(joint.name, 0.0) + factor * sign * float(np.sign(own @ hinge))
    if not add_relation(robot, name, terms, 0.0, element.sourceline):
        raise reader.error(element, f'gearbox "{name}": parent and child are the same link')


def _held(robot, link):
    """Pose (4, 4) of a link or the world at the start."""
    return np.eye(4) if link == WORLD else robot.links[link].pose


def _hinges(robot, start, end):
    """[(joint, sign)] of the fewest revolute joints that lead from a link to another; sign: 1 from parent to child."""
    paths = {start: []}
    pending = [start]
    for link in pending:
        for joint in robot.joints:
            for sign, near, far in ((1.0, joint.parent, joint.child), (-1.0, joint.child, joint.parent)):
                if near == link and far not in paths and joint.type in ("revolute", "fixed"):
                    paths[far] = paths[link] + ([(joint, sign)] if joint.type == "revolute" else [])
                    pending.append(far)
    return paths.get(end, [])
