# SPDX-License-Identifier: Apache-2.0
"""robot_description: the URDF text for RViz's RobotModel and robot_state_publisher.

A robot from a URDF file keeps its text. Other scenes get a URDF of their links and joints. URDF has
no loops and no joints with two or three degrees of freedom. Links at such joints are floating, and RViz
takes their poses from /tf.
"""

import re
import struct
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from liegroup_core.robots.description import rpy_of_rotation
from liegroup_core.robots.resources import find_resource
from liegroup_core.robots.xml import read_xml

from .cdr import ENCAPSULATION
from .links import link_of_body, links_and_joints
from .markers import in_primitives, solid

TYPE = "std_msgs/msg/String"
COLOR = "0.35 0.55 0.8 1"
_FILENAME = re.compile(r"""(\bfilename\s*=\s*["'])([^"'<>]*)(["'])""")
FAR = 1e6  # m, m/s and N: stands for "no limit"


def robot_description(scene):
    """URDF text of a scene."""
    robot = scene.robot
    if robot is not None and robot.text:
        return _with_addresses(robot.text, robot.file)
    links, joints = links_and_joints(scene)
    visuals, folder = ({}, "") if robot is None else (dict(robot.visuals), robot.file)
    visuals = {link: [visual for visual in found if visual.asset < 0] for link, found in visuals.items()}
    drawn = {body for link, (body, _) in links.items() if visuals.get(link)}
    main = link_of_body(scene)
    visuals |= {main[body.name]: [solid(body, scene)] for body in scene.bodies if body.name not in drawn}
    parts = [f"<robot name={quoteattr(scene.name)}>", '  <link name="world"/>']
    for name in links:
        parts.append(f"  <link name={quoteattr(name)}>")
        parts += [_visual(part, folder) for visual in visuals.get(name, ()) for part in in_primitives(visual)]
        parts.append("  </link>")
    return "\n".join([*parts, *(_joint(joint) for joint in joints), "</robot>", ""])


def unheld_links(scene):
    """Links of `robot_description` without a parent joint, or with a floating one.

    robot_state_publisher publishes the transforms of all other links.
    """
    root = read_xml("robot_description", robot_description(scene))
    joints = [joint for joint in root.iterfind("joint") if joint.get("type") != "floating"]
    held = {joint.find("child").get("link") for joint in joints}
    return [link.get("name") for link in root.iterfind("link") if link.get("name") not in held]


def encoded(text):
    """Serialized std_msgs/String."""
    characters = text.encode() + b"\0"
    return ENCAPSULATION + struct.pack("<I", len(characters)) + characters


def _with_addresses(text, file):
    """URDF text with file:// addresses of meshes: viewers do not find paths relative to the file."""

    def address(found):
        name = found[2]
        path = None if "://" in name else find_resource(name, file)
        return found[0] if path is None else f"{found[1]}{Path(path).as_uri()}{found[3]}"

    return _FILENAME.sub(address, text)


def _joint(joint):
    """<joint> element. URDF requires limits for a prismatic joint."""
    lines = [
        f'  <joint name={quoteattr(joint.name)} type="{joint.type}">'
        f"<parent link={quoteattr(joint.parent)}/><child link={quoteattr(joint.child)}/>",
        f"    {_origin(joint.origin)}",
    ]
    if joint.axis is not None:
        lines.append(f'    <axis xyz="{_row(joint.axis)}"/>')
    if joint.type == "prismatic":
        lower, upper = (joint.data.get(end, far) for end, far in (("lower", -FAR), ("upper", FAR)))
        lines.append(f'    <limit lower="{lower}" upper="{upper}" effort="{FAR}" velocity="{FAR}"/>')
    return "\n".join([*lines, "  </joint>"])


def _origin(pose):
    rpy = rpy_of_rotation(pose[:3, :3])
    return f'<origin xyz="{_row(pose[:3, 3])}" rpy="{_row(rpy)}"/>'


def _visual(visual, file):
    """<visual> element; a mesh without a file on this machine keeps its address. An ellipsoid is a sphere."""
    if visual.kind == "box":
        shape = f'<box size="{_row(np.maximum(visual.size, 1e-6))}"/>'
    elif visual.kind == "cylinder":
        shape = f'<cylinder radius="{visual.size[0]!r}" length="{visual.size[1]!r}"/>'
    elif visual.kind in ("sphere", "ellipsoid"):
        shape = f'<sphere radius="{float(np.prod(visual.size) ** (1.0 / len(visual.size)))!r}"/>'
    else:
        path = find_resource(visual.mesh, file)
        address = visual.mesh if path is None else Path(path).as_uri()
        shape = f'<mesh filename={quoteattr(address)} scale="{_row(visual.size)}"/>'
    color = COLOR if visual.color is None else _row(visual.color)
    return (
        f"    <visual>{_origin(visual.pose)}<geometry>{shape}</geometry>"
        f'<material name="{color}"><color rgba="{color}"/></material></visual>'
    )


def _row(values):
    return " ".join(repr(float(value)) for value in values)
