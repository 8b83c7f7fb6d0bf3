# SPDX-License-Identifier: Apache-2.0
"""Links of SDF: inertia and visuals.

A link without <inertial> has the format's defaults: 1 kg, and 1 kg m^2 about every axis.
"""

import numpy as np

from .description import Link, Visual
from .sdf_frames import read_pose, text_of

# Parts of a link that have no influence on its motion.
OF_LINKS = ("pose", "inertial", "visual", "collision", "self_collide", "gravity")


def read_link(reader, robot, model, element):
    name = model.full(element.get("name"))
    link = Link(name, element.sourceline, 1.0, inertia=np.eye(3))
    inertial = element.find("inertial")
    if inertial is None:
        robot.leave_out("links without <inertial>, with the format's 1 kg and 1 kg m^2", name)
    else:
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        pose = read_pose(reader, inertial)[0]
        if mass is not None:
            link.mass = reader.number(mass, mass.text, f'<mass> of link "{name}"')
        if link.mass < 0.0:
            raise reader.error(
                mass, f'mass of link "{name}" must not be negative, got {link.mass:g}'
            )
        if inertia is not None:
            xx, yy, zz, xy, xz, yz = (
                value_of(reader, inertia, key, default)
                for key, default in zip(
                    ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (1, 1, 1, 0, 0, 0)
                )
            )
            link.inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not np.array_equal(pose[:3, :3], np.eye(3)):
            link.inertia = pose[:3, :3] @ link.inertia @ pose[:3, :3].T
        link.com = pose[:3, 3]
    for visual in element.iterfind("visual"):
        link.visuals += _visuals(reader, visual)
    for _ in element.iterfind("collision"):
        robot.leave_out("collision", name, changes_motion=True)
    if text_of(element, "gravity") in ("false", "0"):
        robot.leave_out("links without gravity", name, changes_motion=True)
    for part in element:
        if part.tag not in OF_LINKS:
            robot.leave_out(f"{part.tag} of links", part.get("name") or name)
    return link


def value_of(reader, element, key, default):
    """Number of a child element."""
    found = element.find(key)
    return float(default) if found is None else reader.number(found, found.text, f"<{key}>")


def _visuals(reader, visual):
    geometry = visual.find("geometry")
    if geometry is None or not len(geometry):
        return []
    pose, solid = read_pose(reader, visual)[0], geometry[0]
    if solid.tag == "box" and solid.find("size") is not None:
        size = reader.numbers(solid, solid.find("size").text, 3, "<size>")
        return [Visual("box", tuple(size), pose)]
    if solid.tag in ("cylinder", "capsule"):
        size = tuple(value_of(reader, solid, key, 1.0) for key in ("radius", "length"))
        return [Visual("cylinder", size, pose)]
    if solid.tag == "sphere":
        return [Visual("sphere", (value_of(reader, solid, "radius", 1.0),), pose)]
    if solid.tag == "mesh" and text_of(solid, "uri"):
        scale = solid.find("scale")
        numbers = (1.0,) * 3 if scale is None else reader.numbers(scale, scale.text, 3, "<scale>")
        return [Visual("mesh", tuple(numbers), pose, text_of(solid, "uri"))]
    return []
