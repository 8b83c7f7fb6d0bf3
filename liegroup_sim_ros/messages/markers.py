# SPDX-License-Identifier: Apache-2.0
"""visualization_msgs/MarkerArray of a scene for RViz and Foxglove.

A body is drawn as its shape, or as those of its contacts. A body without a shape is drawn as the homogeneous box of the
same mass and inertia, with edges x^2 = 6 (I_y + I_z - I_x) / m about the principal axes. A robot is drawn
with the visuals of its file; meshes must exist on this machine. A joint is a
small sphere at the child's joint frame. An applied wrench is drawn as two arrows at the body's
origin, one for the force and one for the torque; `arrow_scale` sets their length. So is the force of a contact on its
body, at its centre of pressure, while something presses. Points that press are small spheres, by whether they stick or
slip. The planes that contacts touch are squares.
"""

import dataclasses
import math

import numpy as np

from liegroup_core.forces.contact import drawn_by_contacts, faces, outline
from liegroup_core.robots.description import Visual, place
from liegroup_core.robots.resources import find_resource
from liegroup_core.scene.centres import PLACES
from liegroup_core.scene.names import WORLD

from .cdr import Template, stamp
from .links import placer
from .touching import PLANE, POINT, SLIPS, STICKS, planes

CUBE, SPHERE, CYLINDER, ARROW, SPHERES, MESH, TRIANGLES = 1, 2, 3, 0, 7, 10, 11
RIM = 0.08  # width of a wheel that is drawn, relative to its diameter
ADD, DELETE, DELETE_ALL = 0, 2, 3
BODY_COLOR = (0.35, 0.55, 0.8, 0.9)
JOINT_COLOR = (0.9, 0.6, 0.1, 1.0)
FORCE_COLOR, TORQUE_COLOR = (0.8, 0.1, 0.1, 1.0), (0.5, 0.1, 0.7, 1.0)
CONTACT_COLOR, PLANE_COLOR = (*STICKS, 1.0), (*PLANE, 0.4)
POINT_COLORS = (*STICKS, 1.0), (*SLIPS, 1.0)
# Relative to the size of the largest body of the scene.
JOINT_SIZE, SHAFT, HEAD, GROUND = 0.08, 0.03, 0.06, 20.0
THINNEST = 0.01  # smallest edge of a marker; RViz does not draw size 0
ENDS = ("parent_point", "child_point")
TYPES = {"box": CUBE, "cylinder": CYLINDER, "ellipsoid": SPHERE, "sphere": SPHERE}


class Markers:
    """Encoder of all markers of a scene.

    layout      : Layout of the scene
    world_frame : frame id of the poses
    arrow_scale : m per N and per N m; may be changed
    """

    def __init__(self, layout, world_frame, arrow_scale):
        scene = layout.scene
        self.arrow_scale = arrow_scale
        # Point masses have no size.
        largest = max(max(edges(solid(body, scene))) for body in scene.bodies) or layout.size
        self._template = template = Template()
        self._end = Template()
        self._end.put("I", 1)
        _add(self._end, "", 0, CUBE, world_frame, (0.0,) * 3, (0.0,) * 4)
        owners, local = [], []  # body, and pose in it, of each marker except arrows
        shapes, grounds = drawn(scene), planes(scene, np.mean([body.position for body in scene.bodies], axis=0))
        contacts, points = layout.touching.names, layout.touching.count
        count = len(shapes) + len(scene.joints) + len(grounds) + 2 * len(scene.bodies) + len(contacts)
        template.put("I", count + bool(points))
        for i, (body, kind, size, pose, mesh, color) in enumerate(shapes):
            if kind not in (MESH, TRIANGLES):
                size = np.maximum(size, THINNEST * largest)
            _add(template, "bodies", i, kind, world_frame, size, color, mesh)
            owners.append(body)
            local.append(pose)
        offsets = {body.name: np.array(body.com) for body in scene.bodies}
        for i, (joint, (_, frame)) in enumerate(zip(scene.joints, layout.joint_frames)):
            _add(template, "joints", i, SPHERE, world_frame, (JOINT_SIZE * largest,) * 3, JOINT_COLOR)
            local.append(frame.copy())  # relative to the frame at the centre of mass
            local[-1][:3, 3] += offsets[joint.child]
            owners.append(joint.child)
        thin = THINNEST * largest
        for i, (point, turn) in enumerate(grounds):
            _add(template, "planes", i, CUBE, world_frame, (GROUND * largest, GROUND * largest, thin), PLANE_COLOR)
            owners.append(WORLD)
            local.append(np.eye(4))
            local[-1][:3, :3], local[-1][:3, 3] = turn, point - 0.5 * thin * turn[:, 2]
        self._places = placer(layout, owners, local)
        for name, color in (("forces", FORCE_COLOR), ("torques", TORQUE_COLOR)):
            for i in range(len(scene.bodies)):
                _add(template, name, i, ARROW, world_frame, (SHAFT * largest, HEAD * largest, 0.0), color)
        for i in range(len(contacts)):
            _add(template, "contacts", i, ARROW, world_frame, (SHAFT * largest, HEAD * largest, 0.0), CONTACT_COLOR)
        if points:
            _add(
                template, "points", 0, SPHERES, world_frame, (2.0 * POINT * largest,) * 3, CONTACT_COLOR, points=points
            )

    def encode(self, stamp_ns, sample):
        """The serialized message."""
        time = stamp(stamp_ns)
        slots = [slot for pose in self._places(sample) for slot in (time, (ADD,), pose)]
        places = np.hstack([sample.pose[:, 9:], sample.orientation]).tolist()
        wrenches = sample.external_wrenches.tolist()
        for part in (slice(3, 6), slice(0, 3)):
            for wrench, pose in zip(wrenches, places):
                vector = wrench[part]
                tip = [self.arrow_scale * component for component in vector]
                slots += (time, (ADD if any(vector) else DELETE,), pose, (0.0, 0.0, 0.0, *tip))
        for point, force in sample.contact_forces:
            presses = bool(np.isfinite(point[0]))
            ends = (*point, *(point + self.arrow_scale * force)) if presses else (0.0,) * 6
            slots += (time, (ADD if presses else DELETE,), (0.0,) * 6 + (1.0,), ends)
        if len(sample.pressing):
            # As many as there are: where one does not press, it is at one that does.
            presses, at, slips = np.split(sample.pressing, [1, 4], axis=1)
            rows = np.where(presses[:, 0] > 0.0, np.arange(len(presses)), int(presses.argmax()))
            is_any = bool(presses.any())
            colours = np.array(POINT_COLORS)[slips[rows, 0].astype(int)]
            slots += (time, (ADD if is_any else DELETE,), (0.0,) * 6 + (1.0,), at[rows].ravel(), colours.ravel())
        return self._template.pack(*slots)

    def encode_end(self, stamp_ns):
        """The serialized message that deletes all markers; viewers keep them otherwise."""
        return self._end.pack(stamp(stamp_ns), (DELETE_ALL,), (0.0,) * 6 + (1.0,))


def _add(template, namespace, number, kind, frame, size, color, mesh="", points=0):
    """Append a visualization_msgs/Marker; slots: stamp, action, pose, for arrows the ends, for SPHERES points, colors.

    mesh   : address of the mesh of a MESH, or corners (k, 3) of TRIANGLES
    points : number of the points of SPHERES
    """
    template.header(frame)
    template.string(namespace)
    template.put("2i", number, kind)
    template.slot("i")
    template.slot("7d")
    template.put("3d", *size)
    template.put("4f", *color)
    template.put("iI", 0, 0)  # lifetime: unlimited
    template.put("B", False)  # not locked to the frame
    corners, mesh = (np.ravel(mesh), "") if kind == TRIANGLES else ((), mesh)
    template.put("I", 2 if kind == ARROW else points or len(corners) // 3)
    if len(corners):
        template.put(f"{len(corners)}d", *corners)
    if kind == ARROW:
        template.slot("6d")
    if points:
        template.slot(f"{3 * points}d")
    template.put("I", points)  # colours of points
    if points:
        template.slot(f"{4 * points}f")
    template.string("")  # texture: its resource, then the image:
    template.put("iI", 0, 0)
    template.string("")
    template.string("")
    template.put("I", 0)
    template.put("I", 0)  # texture coordinates
    for text in ("", mesh, ""):  # text, mesh resource, file name of the mesh
        template.string(text)
    template.put("I", 0)  # the mesh
    template.put("B", bool(mesh) and color is BODY_COLOR)  # with its own materials


def markers(encoder):
    """[(topic, type, encode)] as in samples.py."""
    return [("~/markers", "visualization_msgs/msg/MarkerArray", encoder.encode)]


def drawn(scene):
    """[(name of the body or world, kind, sizes (3,) in m, pose (4, 4) in the body's frame, mesh, color)].

    All visuals of a robot; else the shapes of a body's contacts, or one shape. mesh: see `_add`.
    """
    found, shown = [], set()
    for body, pose, visual in () if scene.robot is None else scene.robot.drawn():
        for each in in_primitives(visual):
            shape = _of_visual(each, scene.robot.file)
            if shape is not None:
                kind, size, mesh = shape
                own = np.linalg.solve(visual.pose, each.pose)
                found.append((body, kind, size, pose @ own, mesh, visual.color or BODY_COLOR))
                shown.add(body)
    touching = drawn_by_contacts(scene)
    for body in scene.bodies:
        if body.name not in shown:
            own = touching.get(body.name, ())
            hulls = [outline(shape) for shape in own if shape.type == "hull"]
            visuals = [_visual(shape) for shape in own if shape.type != "hull"] if own else [solid(body, scene)]
            parts = [part for each in visuals for part in in_primitives(each)]
            found += [(body.name, TYPES[each.kind], edges(each), each.pose, "", BODY_COLOR) for each in parts]
            corners = [each[faces(each)].reshape(-1, 3) for each in hulls]
            found += [(body.name, TRIANGLES, (1.0,) * 3, np.eye(4), each, BODY_COLOR) for each in corners]
    return found


def in_primitives(visual):
    """[Visual] of boxes, cylinders, ellipsoids, spheres and meshes that show a Visual."""
    if visual.kind != "capsule":
        return [visual]
    caps = [visual.pose @ place((0.0, 0.0, end * visual.size[1])) for end in (-0.5, 0.5)]
    return [dataclasses.replace(visual, kind="cylinder")] + [
        dataclasses.replace(visual, kind="sphere", size=visual.size[:1], pose=pose) for pose in caps
    ]


def edges(visual):
    """Edges (3,) in m of the box about a Visual that is no mesh, along its axes."""
    if visual.kind == "box":
        return visual.size
    if visual.kind == "ellipsoid":
        return tuple(2.0 * radius for radius in visual.size)
    across, long = 2.0 * visual.size[0], sum(visual.size[1:])
    return across, across, long if visual.kind == "cylinder" else long + across


def _of_visual(visual, file):
    """(kind, sizes (3,), address of the mesh) of a visual in primitives, or None if the mesh has no file."""
    if visual.kind == "mesh":
        path = find_resource(visual.mesh, file) if visual.mesh else None
        return None if path is None else (MESH, visual.size, path.as_uri())
    return TYPES[visual.kind], edges(visual), ""


def links(scene):
    """[[(index of a body or -1 for the world, point (3,) in its frame)] * 2] of springs, cables and distance joints."""
    index = {body.name: i for i, body in enumerate(scene.bodies)} | {WORLD: -1}
    return [
        [(index[getattr(link, PLACES[key])], np.array(getattr(link, key), dtype=float)) for key in ENDS]
        for link in (*scene.forces, *scene.joints)
        if all(getattr(link, key, None) is not None for key in ENDS)
    ]


def solid(body, scene):
    """Visual that represents a body of a scene: its shape, or a box of the same mass and inertia."""
    shape = body.shape
    rolling = next((j for j in scene.joints if j.child == body.name and hasattr(j, "radius")), None)
    if shape is None and rolling is not None:
        is_ball, radius = rolling.type == "ball_on_plane", rolling.radius
        kind, size = ("sphere", (radius,)) if is_ball else ("cylinder", (radius, RIM * 2.0 * radius))
        return Visual(kind, size, rolling.child_frame.pose)
    if shape is None:
        local, (moments, axes) = np.eye(4), np.linalg.eigh(body.inertia_matrix)
        local[:3, :3] = axes * np.linalg.det(axes)  # a rotation, not a reflection
        local[:3, 3] = body.com
        squares = 6.0 * (moments.sum() - 2.0 * moments) / body.mass
        return Visual("box", tuple(math.sqrt(max(0.0, square)) for square in squares), local)
    return _visual(shape)


def _visual(shape):
    """Visual of a shape of a body or of a contact that is no hull."""
    local = np.eye(4)
    local[:3, :3], local[:3, 3] = shape.rotation, shape.position
    if shape.type == "box":
        return Visual("box", tuple(shape.size), local)
    size = (shape.radius,) if shape.type == "sphere" else (shape.radius, shape.length)
    return Visual("cylinder" if shape.type == "rod" else shape.type, size, local)
