# SPDX-License-Identifier: Apache-2.0
"""URDF: the robot descriptions of ROS.

Source: the XML specification of URDF, http://wiki.ros.org/urdf/XML. Angles are in rad. The frame of a
joint is the frame of its child link.

Own code: urdf_parser_py and yourdfpy keep no line numbers and accept a mass that is nan and links of the
same name; the latter takes a missing moment of inertia as 1.
"""

import math
from functools import partial

import numpy as np
from lxml import etree

from liegroup_core.fields.frames import rotation_z_to
from liegroup_core.lie.groups import SE3

from .controllers import add_servos
from .description import NOT_DRAWN, WORLD, Collision, Link, Relation, Robot, RobotJoint, Visual, meant, place
from .omitted import ACTING, PARTS, omit
from .rotors import OF_ROTOR, add_rotor
from .sdf_frames import read_pose, text_of
from .sdf_sensors import joint_sensor, link_sensor
from .xml import Reader

# {type of a URDF joint: type in a scene}
JOINTS = {
    "fixed": "fixed",
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "planar": "planar",
    "floating": "floating",
}
# {type of a <drake:joint>: type in a scene}
OF_DRAKE = {"ball": "spherical", "universal": "universal", "planar": "planar", "screw": "screw"}
# {element: (children, attributes)} that are read, or that have no effect.
KNOWN = {
    "inertial": ("origin mass inertia", ""),
    "mass": ("", "value"),
    "inertia": ("", "ixx ixy ixz iyy iyz izz"),
    "origin": ("", "xyz rpy"),
    "visual": ("origin geometry material", "name"),
    "joint": ("parent child origin axis calibration dynamics limit mimic safety_controller", "name type"),
    "parent": ("", "link"),
    "child": ("", "link"),
    "axis": ("", "xyz"),
    "dynamics": ("", "damping friction"),
    "limit": ("", "lower upper effort velocity acceleration jerk"),
    "mimic": ("", "joint multiplier offset"),
}
# {element of <gazebo>: texts with which gravity does not act on the link}
GRAVITY = {"turnGravityOff": ("true", "1"), "gravity": ("false", "0")}
TOUCHING = ("mu2", "fdir1", "slip1", "slip2", "kp", "kd", "minDepth", "maxVel", "maxContacts")
NO_EFFECT = ("implicitSpringDamper", "provideFeedback", "preserveFixedJoint", "disableFixedJointLumping")
SPRING = {"springStiffness": "stiffness", "springReference": "rest"}  # elements of <gazebo>, for a joint
LIMITS = ("lower", "upper", "velocity", "effort")


def robot_of_urdf(root, file, text):
    """Robot of the root element of a URDF file. Raises SceneError."""
    reader = Reader(file)
    robot = Robot(root.get("name") or "robot", reader.file, "URDF", text=text)
    joints, colors = [], _colors(reader, robot, root)
    for element in root:
        if element.tag == "link":
            link = _link(reader, robot, element, colors)
            if link.name in robot.links:
                raise reader.error(
                    element,
                    f'link "{link.name}" is defined twice, first on line {robot.links[link.name].line}: keep one',
                )
            robot.links[link.name] = link
        elif element.tag == "joint" or _is_drake(element, "joint"):
            joints.append(element)
        elif element.prefix == "drake":
            own = etree.QName(element).localname
            robot.leave_out(f"drake:{own}", element.get("name") or "unnamed", not own.startswith("collision"))
        elif element.tag not in ("material", "gazebo", "transmission") and "}" not in element.tag:
            robot.leave_out(element.tag, element.get("name") or "unnamed")
    if not robot.links:
        raise reader.error(root, "has no <link>: give the description of a robot")
    for element in root:
        if element.tag in ("link", "joint"):
            robot.leave_out_unknown(element, KNOWN)
    lines = {}
    for element in joints:
        joint = _joint(reader, robot, element)
        if joint.name in lines:
            raise reader.error(
                element, f'joint "{joint.name}" is defined twice, first on line {lines[joint.name]}: keep one'
            )
        lines[joint.name] = joint.line
        robot.joints.append(joint)
    for element in root.iterfind("transmission"):
        _rotor(reader, robot, element)
    _couplings(reader, robot, joints)
    robot.check_couplings()
    _place_links(robot)
    for element in root.iterfind("gazebo"):
        _gazebo(reader, robot, element)
    for element in root.iterfind("ros2_control/joint"):
        _start(reader, robot, element)
    return robot


def _gazebo(reader, robot, element):
    """Read sensors, springs and gravity of a <gazebo> element, which refers to a link, a joint or the robot."""
    name = element.get("reference")
    link, joint = robot.links.get(name), robot.joint(name)
    label, left = name or "unnamed", False
    for part in element:
        if link is not None and part.tag == "mu1":
            for collision in link.collisions:
                collision.friction = partial(reader.number, part, part.get("value") or part.text, "<mu1>")
        elif link is not None and part.tag in TOUCHING:
            robot.leave_out("numbers of contacts in <gazebo>, but for mu1", label)
        elif part.tag == "sensor" and link is not None:
            link_sensor(reader, robot, part, name, _place_in(reader, robot, name, part))
        elif part.tag == "sensor" and joint is not None:
            joint_sensor(reader, robot, part, joint, _place_in(reader, robot, joint.child, part))
        elif part.tag == "sensor":
            robot.leave_out("sensor", part.get("name") or label)
        elif link is not None and part.tag in GRAVITY:
            link.weight = 0.0 if text_of(element, part.tag) in GRAVITY[part.tag] else link.weight
        elif joint is not None and part.tag in SPRING:
            setattr(joint, SPRING[part.tag], reader.number(part, part.text, f"<{part.tag}>"))
        elif part.tag == "plugin" and add_servos(reader, robot, part, str):
            continue
        elif part.tag in ("plugin", *ACTING, *PARTS):
            omit(robot, part, f"{part.tag} of <gazebo>", label)
        else:
            left |= part.tag not in NO_EFFECT
    if left:
        robot.leave_out("gazebo", label)
    if joint is not None and joint.stiffness < 0.0:
        raise reader.error(element, f'<springStiffness> of joint "{name}" must not be negative')


def _start(reader, robot, element):
    """Start values of a joint of <ros2_control>."""
    joint = robot.joint(element.get("name"))
    if joint is None or any(coupling.first == joint.name for coupling in robot.couplings):
        return
    for interface in element.iterfind("state_interface"):
        kind = interface.get("name")
        for part in interface.iterfind("param[@name='initial_value']"):
            if kind in ("position", "velocity"):
                robot.start_at(joint, reader.number(part, part.text, f"initial_value of {kind}"), kind == "velocity")
    for part in element.iterfind("param[@name='mimic']"):
        robot.leave_out("mimic of <ros2_control>", f"{joint.name} ({part.text})", changes_motion=True)


def _place_in(reader, robot, link, sensor):
    """(4, 4) pose of a sensor in the frame of a link, with all joint coordinates 0."""
    pose, base = read_pose(reader, sensor)
    # The frame of a joint is that of its child.
    base = next((joint.child for joint in robot.joints if joint.name == base), base)
    if base in (None, link):
        return pose
    if base not in robot.links:
        raise reader.unknown(sensor, "frame", base, robot.links)
    return SE3.inverse(robot.links[link].pose) @ robot.links[base].pose @ pose


def _rotor(reader, robot, element):
    """Rotor of a <transmission>, in the extensions of Drake: drake:rotor_inertia and drake:gear_ratio."""
    actuator, end, name = element.find("actuator"), element.find("joint"), element.get("name") or "unnamed"
    of_drake = [] if actuator is None else [part for part in actuator if part.prefix == "drake"]
    for part in of_drake:
        own = etree.QName(part).localname
        if own not in OF_ROTOR:
            where = f"<drake:{own}> in <actuator> of line {part.sourceline}{meant(own, OF_ROTOR)}"
            robot.leave_out("unknown parts of the URDF file", where, changes_motion=True)
    joint = None if end is None else robot.joint(end.get("name"))
    if joint is None:
        what = "transmission without a known joint" if of_drake else "transmission"
        robot.leave_out(what, name, changes_motion=bool(of_drake))
        return
    if of_drake:
        add_rotor(reader, robot, actuator, joint, lambda part: part.get("value"))
        if element.find(".//mechanicalReduction") is not None and "ratio" not in joint.rotor:
            robot.leave_out("mechanicalReduction beside a rotor without <drake:gear_ratio>", name, changes_motion=True)
    if not joint.rotor:
        robot.leave_out("transmission", name, changes_motion=bool(of_drake))


def _link(reader, robot, element, colors):
    link = Link(reader.name(element), element.sourceline)
    if link.name == WORLD and element.find("inertial") is not None:
        robot.leave_out("inertia of the world", WORLD)
    inertial = element.find("inertial")
    if inertial is not None and link.name != WORLD:
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        for part, what in ((inertia, "inertia"), (mass, "mass")):
            if part is None:
                link.lacks = inertial.sourceline, f'<inertial> of link "{link.name}" has no <{what}>'
        link.mass = 0.0 if mass is None else reader.attribute(mass, "value")
        if link.mass < 0.0:
            raise reader.error(mass, f'mass of link "{link.name}" must not be negative, got {link.mass:g}')
        origin = _origin(reader, inertial)
        R = origin[:3, :3]
        if inertia is not None:
            xx, yy, zz = (reader.attribute(inertia, key) for key in ("ixx", "iyy", "izz"))
            xy, xz, yz = (reader.attribute(inertia, key, 0.0) for key in ("ixy", "ixz", "iyz"))
            link.inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not np.array_equal(R, np.eye(3)):
            link.inertia = R @ link.inertia @ R.T
        link.com = origin[:3, 3]
    for visual in element.iterfind("visual"):
        visuals = _visuals(reader, visual, colors)
        link.visuals += visuals
        if not visuals:
            robot.leave_out(NOT_DRAWN, link.name)
    for part in element.iterfind("collision"):
        link.collisions.append(Collision(part.sourceline, partial(_shape, reader, part)))
        if part.find("contact_coefficients") is not None:  # published files give mu 0
            robot.leave_out("contact_coefficients of links", link.name)
    for child in element:
        if child.tag == "contact":
            _contact(reader, robot, child, link)
        elif child.tag not in ("inertial", "visual", "collision", "material"):
            omit(robot, child, f"{child.tag} of links", link.name)
    return link


def _contact(reader, robot, element, link):
    """Read the friction of a <contact> of Bullet; the ground of the options has its own stiffness and restitution."""
    for part in element:
        if part.tag == "lateral_friction":
            for collision in link.collisions:
                collision.friction = partial(reader.attribute, part, "value")
        else:
            robot.leave_out(f"{part.tag} in <contact> of links", link.name)


def _shape(reader, collision):
    """Visual of a <collision>, or None."""
    return next(iter(_visuals(reader, collision, {})), None)


def _origin(reader, element):
    """(4, 4) pose from the <origin> of an element."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz = reader.vector(origin, "xyz", (0.0, 0.0, 0.0))
    rpy = reader.vector(origin, "rpy", (0.0, 0.0, 0.0))
    return reader.pose_of(np.concatenate([xyz, rpy]))


def _colors(reader, robot, root):
    """{name of a <material>: color, of the first one of that name that has one}."""
    named = {}
    for material in root.iter("material"):
        named.setdefault(material.get("name"), _color(reader, material)) or named.pop(material.get("name"))
        if material.find("texture") is not None:
            robot.leave_out("textures of visuals", material.get("name") or "unnamed")
    return named


def _color(reader, material):
    color = None if material is None else material.find("color")
    if color is None:
        return None
    return tuple(reader.numbers(color, color.get("rgba"), 4, "rgba of <color>").tolist())


def _visuals(reader, visual, colors):
    """Visuals of a <visual>: one or none."""
    geometry, material = visual.find("geometry"), visual.find("material")
    if geometry is None or not len(geometry):
        return []
    pose, solid, mesh = _origin(reader, visual), geometry[0], ""
    kind = etree.QName(solid).localname  # Drake has a capsule and an ellipsoid of its own
    if kind == "box":
        size = reader.numbers(solid, solid.get("size"), 3, "size of <box>")
    elif kind in ("cylinder", "capsule"):
        size = (reader.attribute(solid, key) for key in ("radius", "length"))
    elif kind == "sphere":
        size = (reader.attribute(solid, "radius"),)
    elif kind == "ellipsoid":
        size = (reader.attribute(solid, key) for key in "abc")
    elif kind == "mesh":
        size, mesh = reader.vector(solid, "scale", (1.0, 1.0, 1.0)), reader.name(solid, "filename")
    else:
        return []
    color = None if material is None else _color(reader, material) or colors.get(material.get("name"))
    return [Visual(kind, tuple(map(float, size)), pose, mesh, color)]


def _joint(reader, robot, element):
    name = reader.name(element)
    kind, kinds = element.get("type", ""), OF_DRAKE if _is_drake(element, "joint") else JOINTS
    if kind not in kinds:
        raise reader.error(element, f'joint "{name}" has the type {kind!r:.40}; choose one of: {", ".join(kinds)}')
    ends = []
    for end in ("parent", "child"):
        part = element.find(end)
        if part is None:
            raise reader.error(element, f'joint "{name}" has no <{end} link="...">: give one')
        link = reader.name(part, "link")
        if link not in robot.links:
            raise reader.unknown(part, f'{end} of joint "{name}": link', link, robot.links)
        ends.append(link)
    if ends[0] == ends[1]:
        raise reader.error(element, f'joint "{name}" has "{ends[0]}" as parent and as child')
    turn = np.eye(4)
    if kind not in ("fixed", "floating", "ball", "universal"):
        axis = element.find("axis")
        vector = np.array([1.0, 0.0, 0.0]) if axis is None else reader.vector(axis, "xyz", (1.0, 0.0, 0.0))
        turn = place(
            rotation=rotation_z_to(reader.direction(element if axis is None else axis, vector, f'axis of "{name}"'))
        )
    joint = RobotJoint(name, kinds[kind], *ends, _origin(reader, element) @ turn, turn, element.sourceline)
    for part in element if kinds is OF_DRAKE else ():
        if _is_drake(part, "screw_thread_pitch"):
            joint.pitch = reader.attribute(part, "value") / (2.0 * math.pi)  # m per turn
        elif part.tag not in KNOWN["joint"][0].split():
            where = f"<{etree.QName(part).localname}> in <drake:joint> of line {part.sourceline}"
            robot.leave_out("unknown parts of the URDF file", where, changes_motion=True)
    if kind == "screw" and not joint.pitch:
        raise reader.error(element, f'joint "{name}" has no <drake:screw_thread_pitch>: give one, in m per turn')
    _law(reader, robot, element, joint, kind)
    return joint


def _is_drake(element, name):
    """Whether an element is `name` in the extensions of Drake."""
    return element.prefix == "drake" and etree.QName(element).localname == name


def _law(reader, robot, element, joint, kind):
    """Damping, friction and limits of a joint."""
    dynamics, limit = element.find("dynamics"), element.find("limit")
    if joint.type in ("fixed", "floating"):
        return
    if dynamics is not None:
        damping = dynamics.get("damping", "").split() if kind == "planar" else ()
        if len(damping) == 3:  # of Drake: of both displacements and the rotation
            joint.damping = max(abs(reader.numbers(dynamics, dynamics.get("damping"), 3, "damping")))
        else:
            joint.damping = reader.attribute(dynamics, "damping", 0.0)
        friction = reader.attribute(dynamics, "friction", 0.0)
        for value, what in ((joint.damping, "damping"), (friction, "friction")):
            if value < 0.0:
                raise reader.error(dynamics, f'{what} of joint "{joint.name}" must not be negative, got {value:g}')
        if friction:
            joint.data["friction"] = friction
    if limit is not None:
        for key in LIMITS:
            if limit.get(key) is not None:
                joint.data[key] = reader.attribute(limit, key)
    elif kind in ("revolute", "prismatic"):
        robot.remark("unlimited, because the <limit> that URDF requires is missing", joint.name)
    if kind == "continuous":  # position limits have no meaning
        joint.data.pop("lower", None)
        joint.data.pop("upper", None)
    for tag in ("safety_controller", "calibration"):
        if element.find(tag) is not None:
            robot.leave_out(tag, joint.name)


def _couplings(reader, robot, elements):
    for element in elements:
        mimic = element.find("mimic")
        if mimic is None:
            continue
        name, other = element.get("name"), reader.name(mimic, "joint")
        if len(element.findall("mimic")) > 1:
            raise reader.error(element, f'joint "{name}" has two <mimic>: keep one')
        robot.couplings.append(
            Relation(
                f"{name}_mimic",
                name,
                other,
                reader.attribute(mimic, "multiplier", 1.0),
                reader.attribute(mimic, "offset", 0.0),
                mimic.sourceline,
            )
        )


def _place_links(robot):
    """Set the poses of all links at zero joint coordinates; raises SceneError if the joints form no tree."""
    holder, below = {}, {}
    for joint in robot.joints:
        if joint.child in holder:
            raise robot.error(
                joint.line,
                f'joint "{joint.name}": link "{joint.child}" is already the child of joint '
                f'"{holder[joint.child].name}" (line {holder[joint.child].line}); URDF has no '
                "loops: close them by a joint in a scene file",
            )
        if joint.child == WORLD:
            raise robot.error(joint.line, f'joint "{joint.name}" has the link "world" as child: exchange the ends')
        holder[joint.child] = joint
        below.setdefault(joint.parent, []).append(joint)
    robot.roots = [name for name in robot.links if name not in holder]
    if not robot.roots:
        first = robot.joints[0]
        raise robot.error(first.line, "the joints form a circle: every link has a parent, so there is no root link")
    if len(robot.roots) > 1:
        second = robot.links[robot.roots[1]]
        raise robot.error(
            second.line,
            f'links "{robot.roots[0]}" and "{second.name}" have no parent, but URDF has one root '
            "link: connect them by a joint",
        )
    pending, placed = list(robot.roots), 0
    while pending:
        name = pending.pop()
        placed += 1
        for joint in below.get(name, ()):
            # At coordinate 0 the two joint frames coincide.
            robot.links[joint.child].pose = robot.links[name].pose @ joint.parent_frame @ _transposed(joint.child_frame)
            pending.append(joint.child)
    if placed < len(robot.links):
        name = next(j for j in robot.joints if not _reaches(j.child, holder, robot.roots[0])).name
        raise robot.error(
            next(j.line for j in robot.joints if j.name == name),
            f'joint "{name}" belongs to a circle of joints that is not connected to the root link "{robot.roots[0]}"',
        )


def _reaches(name, holder, root):
    """True if the parents of a link lead to the root."""
    for _ in range(len(holder) + 1):
        if name == root:
            return True
        name = holder[name].parent
    return False


def _transposed(pose):
    """Inverse of a pure rotation."""
    return pose.T
