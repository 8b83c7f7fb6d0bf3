# SPDX-License-Identifier: Apache-2.0
"""robot_description: the URDF text that RViz's RobotModel and robot_state_publisher take.

A robot from a URDF file keeps its text. Other scenes get a URDF of their bodies, each held to the
world by a floating joint: RViz takes the poses from /tf. Imports no ROS.
"""

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from liegroup_core.robots.description import Visual, rpy_of_rotation
from liegroup_core.robots.resources import find_resource

from .cdr import Template
from .markers import CUBE, CYLINDER, SPHERE, solid

TYPE = "std_msgs/msg/String"
KINDS = {CUBE: "box", CYLINDER: "cylinder", SPHERE: "sphere"}
COLOR = "0.35 0.55 0.8 1"


def robot_description(scene):
    """URDF text of a scene."""
    robot = scene.robot
    if robot is not None and robot.text:
        return robot.text
    if robot is None:
        links = {body.name: [_solid(body)] for body in scene.bodies}
        folder = ""
    else:
        links, folder = robot.visuals, robot.file
    parts = [f"<robot name={quoteattr(scene.name)}>", '  <link name="world"/>']
    for name, visuals in links.items():
        parts.append(f"  <link name={quoteattr(name)}>")
        parts += [_visual(visual, folder) for visual in visuals]
        parts.append("  </link>")
        parts.append(
            f'  <joint name={quoteattr(f"{name}_to_world")} type="floating">'
            f'<parent link="world"/><child link={quoteattr(name)}/></joint>'
        )
    return "\n".join([*parts, "</robot>", ""])


def encoded(text):
    """Serialized std_msgs/String."""
    template = Template()
    template.string(text)
    return template.pack()


def _solid(body):
    """Visual of a body of a scene: its shape, or a box of the same mass and inertia."""
    kind, (x, y, z), pose = solid(body)
    size = {CUBE: (x, y, z), CYLINDER: (0.5 * x, z), SPHERE: (0.5 * x,)}[kind]
    return Visual(KINDS[kind], size, pose)


def _visual(visual, file):
    """<visual> element; a mesh that is no file of this machine keeps its address."""
    xyz = _row(visual.pose[:3, 3])
    rpy = _row(rpy_of_rotation(visual.pose[:3, :3]))
    if visual.kind == "box":
        shape = f'<box size="{_row(np.maximum(visual.size, 1e-6))}"/>'
    elif visual.kind == "cylinder":
        shape = f'<cylinder radius="{visual.size[0]!r}" length="{visual.size[1]!r}"/>'
    elif visual.kind == "sphere":
        shape = f'<sphere radius="{visual.size[0]!r}"/>'
    else:
        path = find_resource(visual.mesh, file)
        address = visual.mesh if path is None else Path(path).as_uri()
        shape = f'<mesh filename={quoteattr(address)} scale="{_row(visual.size)}"/>'
    return (
        f'    <visual><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry>'
        f'<material name="body"><color rgba="{COLOR}"/></material></visual>'
    )


def _row(values):
    return " ".join(repr(float(value)) for value in values)
