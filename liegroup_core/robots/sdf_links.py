# SPDX-License-Identifier: Apache-2.0
"""Links of SDF: inertia and visuals.

A link without <inertial> has the format's defaults: 1 kg, and 1 kg m^2 about every axis. With
<inertial auto="true">, mass and inertia follow from the collision shapes.
"""

import math
from functools import partial

import numpy as np

from .description import NOT_DRAWN, Collision, Link, Visual
from .links import combined
from .omitted import OF_GRAVITY, omit
from .sdf_frames import read_pose, text_of
from .sdf_sensors import link_sensor
from .xml import value_of

OF_LINKS = ("pose", "inertial", "visual", "collision", "sensor", *OF_GRAVITY)  # that are read
WATER = 1000.0  # kg/m^3, the format's density of a shape


def read_link(reader, robot, model, element):
    name = model.full(element.get("name"))
    link = Link(name, element.sourceline, 1.0, inertia=np.eye(3))
    inertial = element.find("inertial")
    if inertial is None:
        robot.remark("without <inertial>, with the format's 1 kg and 1 kg m^2", name)
    else:
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        pose = read_pose(reader, inertial)[0]
        if mass is not None:
            link.mass = reader.number(mass, mass.text, f'<mass> of link "{name}"')
        if link.mass < 0.0:
            raise reader.error(mass, f'mass of link "{name}" must not be negative, got {link.mass:g}')
        if inertia is not None:
            xx, yy, zz, xy, xz, yz = (
                value_of(reader, inertia, key, default)
                for key, default in zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (1, 1, 1, 0, 0, 0))
            )
            link.inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not np.array_equal(pose[:3, :3], np.eye(3)):
            link.inertia = pose[:3, :3] @ link.inertia @ pose[:3, :3].T
        link.com = pose[:3, 3]
        if inertial.get("auto") in ("true", "1"):
            _fill(reader, robot, model, element, link)
        for part in inertial.iterfind("fluid_added_mass"):
            omit(robot, part, "fluid_added_mass of links", name)
    for visual in element.iterfind("visual"):
        visuals = _visuals(reader, visual, model.place_in(element, visual))
        link.visuals += visuals
        if not visuals:
            robot.leave_out(NOT_DRAWN, visual.get("name") or name)
    for part in element.iterfind("collision"):
        friction = part.find("surface/friction/ode/mu")
        read = None if friction is None else partial(reader.number, friction, friction.text, "<mu>")
        link.collisions.append(Collision(part.sourceline, partial(_shape, reader, model, part), read))
        surface = part.find("surface")
        if surface is not None and any(not len(each) and each is not friction for each in surface.iterdescendants("*")):
            robot.leave_out("numbers of contacts in <surface>, but for mu", name)
    if any(text_of(element, key) in ("false", "0") for key in OF_GRAVITY):
        link.weight = 0.0
    for part in element.iterfind("sensor"):
        link_sensor(reader, robot, part, name, model.place_in(element, part))
    for part in element:
        if part.tag not in OF_LINKS:
            omit(robot, part, f"{part.tag} of links", part.get("name") or name)
    return link


def _shape(reader, model, collision):
    """Visual of a <collision>, or None."""
    return next(iter(_visuals(reader, collision, model.place_in(collision.getparent(), collision))), None)


def _fill(reader, robot, model, element, link):
    """Set mass and inertia of a link from its collision shapes and their density, scaled to <mass> if given."""
    inertial, shapes = element.find("inertial"), []
    density = value_of(reader, inertial, "density", WATER)
    for collision in element.iterfind("collision"):
        geometry = collision.find("geometry")
        solid = None if geometry is None or not len(geometry) else geometry[0]
        filled = None if solid is None else _solid(reader, solid)
        if filled is None:
            raise reader.error(
                collision,
                f'inertia of link "{link.name}" is automatic, which is not supported for this shape: write '
                "its <mass> and <inertia>, and remove auto",
            )
        pose = model.place_in(element, collision)
        mass = value_of(reader, collision, "density", density) * filled[0]
        R = pose[:3, :3]
        shapes.append((mass, pose[:3, 3], R @ np.diag(mass * np.array(filled[1])) @ R.T))
    mass, com, inertia = combined(shapes)
    if not mass > 0.0:
        raise reader.error(
            inertial,
            f'inertia of link "{link.name}" is automatic, but the link has no collision shape with a '
            "density: write its <mass> and <inertia>",
        )
    factor = 1.0 if inertial.find("mass") is None else link.mass / mass
    link.mass, link.com, link.inertia = factor * mass, com, factor * inertia
    robot.remark("inertia computed from the collision shapes", link.name)


def _solid(reader, solid):
    """(volume, principal moments (3,) of the unit mass) of a shape about its centre, or None."""
    if solid.tag == "box" and solid.find("size") is not None:
        x, y, z = reader.numbers(solid, solid.find("size").text, 3, "<size>")
        return x * y * z, np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 12.0
    if solid.tag == "ellipsoid" and solid.find("radii") is not None:
        x, y, z = reader.numbers(solid, solid.find("radii").text, 3, "<radii>")
        moments = np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 5.0
        return 4.0 / 3.0 * math.pi * x * y * z, moments
    if solid.tag not in ("cylinder", "capsule", "sphere"):
        return None
    r = value_of(reader, solid, "radius", 1.0)
    length = 0.0 if solid.tag == "sphere" else value_of(reader, solid, "length", 1.0)
    # Volumes of a cylinder and of its round ends.
    tube = math.pi * r * r * length
    ball = 0.0 if solid.tag == "cylinder" else 4.0 / 3.0 * math.pi * r**3
    around = 0.5 * tube * r * r + 0.4 * ball * r * r
    across = tube * (3.0 * r * r + length * length) / 12.0
    across += ball * (0.4 * r * r + 0.25 * length * length + 0.375 * length * r)
    volume = (tube + ball) or 1.0
    return tube + ball, np.array([across, across, around]) / volume


def _visuals(reader, visual, pose):
    geometry = visual.find("geometry")
    if geometry is None or not len(geometry):
        return []
    solid, mesh = geometry[0], ""
    if solid.tag == "box" and solid.find("size") is not None:
        size = reader.numbers(solid, solid.find("size").text, 3, "<size>")
    elif solid.tag == "ellipsoid" and solid.find("radii") is not None:
        size = reader.numbers(solid, solid.find("radii").text, 3, "<radii>")
    elif solid.tag in ("cylinder", "capsule"):
        size = (value_of(reader, solid, key, 1.0) for key in ("radius", "length"))
    elif solid.tag == "sphere":
        size = (value_of(reader, solid, "radius", 1.0),)
    elif solid.tag == "mesh" and text_of(solid, "uri") and solid.find("submesh") is None:
        scale, mesh = solid.find("scale"), text_of(solid, "uri")
        size = (1.0,) * 3 if scale is None else reader.numbers(scale, scale.text, 3, "<scale>")
    else:
        return []
    return [Visual(solid.tag, tuple(map(float, size)), pose, mesh, _color(reader, visual))]


def _color(reader, visual):
    """Diffuse colour of a visual, else its ambient one, with its transparency; None if it has none."""
    material = visual.find("material")
    for part in () if material is None else filter(None, (material.findtext("diffuse"), material.findtext("ambient"))):
        found = reader.numbers(material, f"{part} 1" if len(part.split()) == 3 else part, 4, "colour of <material>")
        *color, opacity = found.tolist()
        return (*color, opacity * (1.0 - value_of(reader, visual, "transparency", 0.0)))
    return None
