# SPDX-License-Identifier: Apache-2.0
"""A mechanism in the page's 3-D view: bodies, joints, springs, wrenches, contacts, traces and error halos.

Names of nodes are numbers: a name of a file may contain anything.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from liegroup_core.scene.names import WORLD
from liegroup_sim_ros.messages.markers import THINNEST, edges, in_primitives, links, solid
from liegroup_sim_ros.messages.touching import PLANE, SLIPS, STICKS, arrows, measure, patches, radius, rulings
from liegroup_sim_ros.report.shapes import decoded

from .boxes import Boxes
from .server import mover


def _bytes(colour):
    return tuple(round(255.0 * part) for part in colour)


COLOURS = (
    (76, 120, 168),
    (245, 133, 24),
    (84, 162, 75),
    (228, 87, 86),
    (114, 183, 178),
    (178, 121, 162),
    (238, 202, 59),
    (157, 117, 93),
)
JOINT, SPRING, TRACE, HALO, GHOST = (230, 160, 30), (120, 120, 120), (150, 60, 160), (220, 40, 40), (150, 150, 150)
FORCE, TORQUE, PULL, GRAVITY, REACTION = (200, 30, 30), (130, 30, 180), (20, 120, 20), (60, 60, 60), (30, 90, 200)
CONTACT, TOUCHES = _bytes(STICKS), (_bytes(STICKS), _bytes(SLIPS))
THICK = 0.025  # radius of a point, by the size for which an arrow of a contact is thick
RULING = (150, 160, 170)
SHADE = 0.35  # opacity of the planes of contacts, which are below their lines by BELOW of the mechanism
BELOW = 1e-3
PART, MOST_LARGE = 0.035, 6  # size of a joint relative to the mechanism; joints of this size, more are smaller
LONGEST = 0.3  # of an arrow, relative to the mechanism
MOST_TRACE = 400  # points of a trace
# Shapes of joints: those that turn about an axis, those that slide along it, others.
TURNS, SLIDES = ("revolute", "screw", "cylindrical", "universal"), ("prismatic", "cylindrical")
# A pose is sent if its position, relative to the size of the mechanism, or its quaternion changed by more than this.
UNSEEN = 1e-6
# Halos are three circles of radius 1 each: lines hide nothing of the mechanism.
_TURN = np.linspace(0.0, 2.0 * math.pi, 49)
_RING = np.stack([np.cos(_TURN), np.sin(_TURN), 0.0 * _TURN], axis=1)
RINGS = np.concatenate(
    [np.stack([ring[:-1], ring[1:]], axis=1) for ring in (np.roll(_RING, k, axis=1) for k in range(3))]
)
LARGEST_HALO = 0.4  # radius relative to the mechanism: a camera inside a halo would not show it
CHANGE = 0.05  # of the radius of a halo


class Look(NamedTuple):
    """What is drawn besides the bodies."""

    joints: bool = True
    frames: bool = False
    wrenches: bool = True
    contacts: bool = True
    reactions: bool = False
    gravity: bool = False
    trace: bool = False
    halo: bool = True
    magnification: float = 1e6  # of the halo


class Drawing:
    """Nodes of one mechanism.

    server : ViserServer
    layout : Layout of its scene
    shapes : {body: [triangles]} of report.shapes; other bodies are drawn as solids with their inertia
    ghost  : True: pale, without joints, for a motion beside another one
    boxes  : Boxes about its bodies
    bodies : [handles of the shapes of each body], for callbacks of the mouse
    """

    def __init__(self, server, layout, shapes, ghost=False):
        self._server, self._layout = server, layout
        self.boxes = Boxes(layout, shapes)
        self.size, self.middle = self.boxes.size, self.boxes.middle
        self._part = PART * self.size * min(1.0, math.sqrt(MOST_LARGE / max(1, len(layout.scene.joints))))
        scene, api = layout.scene, server.scene
        self._root = "/ghost" if ghost else "/mechanism"
        self._frames, self.bodies, self._rows = [], [], None
        with server.atomic():
            for i, body in enumerate(scene.bodies):
                name = f"{self._root}/{i}"
                self._frames.append(
                    api.add_frame(name, show_axes=False, axes_length=0.2 * self.size, axes_radius=0.006 * self.size)
                )
                colour = GHOST if ghost else COLOURS[i % len(COLOURS)]
                self.bodies.append(self._shapes(f"{name}/shape", body, shapes, colour, ghost))
            if not ghost:
                self._meshes(f"{self._root}/world", shapes.get(WORLD) or (), GHOST, ghost)
            framed = [] if ghost else [k for k, joint in enumerate(scene.joints) if not hasattr(joint, "child_point")]
            self._joints = [self._joint(k, scene.joints[k]) for k in framed]
            for k, handle in zip(framed, self._joints):  # a thin body is easier to pick at its joint
                self.bodies[layout.body_names.index(scene.joints[k].child)].append(handle)
            self._halos = (
                []
                if ghost
                else [
                    api.add_line_segments(f"{self._root}/{i}/halo", RINGS, HALO, thickness=1.5,
                                          thickness_units="screen", visible=False, position=body.com)
                    for i, body in enumerate(scene.bodies)
                ]
            )  # fmt: skip
            # Frames move at once; a browser takes longer for new points of arrows.
            self._touches = [
                api.add_frame(f"{self._root}/touch{k}", show_axes=False, visible=False)
                for k in range(0 if ghost else len(layout.touching.names))
            ]
        self._measure = measure(scene, 2.0 * self.boxes.halves.max(axis=1))
        self._radius, self._points = radius(scene, self._measure[0], self.size), {}
        self._movers = [mover(server, handle) for handle in (*self._frames, *self._touches)]
        self._springs = [] if ghost else links(scene)
        self._handles, self._largest, self._trace = {}, {}, []
        self._weights = np.outer([body.mass for body in scene.bodies], scene.gravity)
        self._look, self._radii = None, np.zeros(len(self._frames))

    def remove(self):
        """Delete all nodes."""
        points = (handle for handle, _ in self._points.values())
        for handle in (*self._frames, *self._touches, *self._handles.values(), *points):
            handle.remove()

    def _meshes(self, name, shapes, colour, ghost):
        """[Handles] of shapes of report.shapes, in their own colours if they have some."""
        handles = []
        for k, shape in enumerate(shapes):
            *own, opacity = (None,) if ghost or shape["color"] is None else shape["color"]
            own = tuple(round(255.0 * part) for part in own) or colour
            opacity = 0.3 if ghost else None if opacity == 1.0 else opacity
            handles.append(
                self._server.scene.add_mesh_simple(
                    f"{name}{k}", *decoded(shape), color=own, side="double", opacity=opacity, cast_shadow=not ghost
                )
            )
        return handles

    def _shapes(self, name, body, shapes, colour, ghost):
        if shapes.get(body.name):
            return self._meshes(name, shapes[body.name], colour, ghost)
        api, common = self._server.scene, {"opacity": 0.3 if ghost else None, "cast_shadow": not ghost}
        if body.name in shapes:
            return [api.add_icosphere(name, 0.2 * PART * self.size, colour, position=body.com, **common)]
        parts = in_primitives(solid(body, self._layout.scene))
        return [self._solid(f"{name}{k}", part, colour, common) for k, part in enumerate(parts)]

    def _solid(self, name, visual, colour, common):
        api, size = self._server.scene, np.maximum(edges(visual), THINNEST * self.size)
        place = {"wxyz": _wxyz(visual.pose[:3, :3]), "position": visual.pose[:3, 3]}
        if visual.kind == "box":
            return api.add_box(name, colour, tuple(size), **place, **common)
        if visual.kind == "sphere":
            return api.add_icosphere(name, 0.5 * size[0], colour, **place, **common)
        return api.add_cylinder(name, 0.5 * size[0], size[2], colour, **place, **common)

    def _joint(self, k, joint):
        """Node of a joint on its child: a cylinder about an axis, a box along it, else a sphere."""
        names, api = self._layout.body_names, self._server.scene
        child = names.index(joint.child)
        local, size = self._layout.joint_frames[k][1], self._part
        place = {"position": local[:3, 3] + self._layout.offsets.com[child], "wxyz": _wxyz(local[:3, :3])}
        name = f"{self._root}/{child}/joint{k}"
        if joint.type in SLIDES:
            return api.add_box(name, JOINT, (0.6 * size, 0.6 * size, 3.0 * size), **place)
        if joint.type in TURNS:
            return api.add_cylinder(name, 0.4 * size, 2.4 * size, JOINT, **place)
        return api.add_icosphere(name, 0.6 * size, JOINT, subdivisions=2, **place)

    def hide(self, is_hidden):
        """Hide or show all bodies."""
        for handle in self._frames:
            _set(handle, "visible", not is_hidden)

    def show(self, frame, look, pull=None):
        """Move everything to a ViewFrame.

        pull : (start, tip) m, of the spring of the mouse, or None
        """
        rows = frame.sample.rows[:, :7]
        with self._server.atomic():
            before = np.full_like(rows, np.inf) if self._rows is None else self._rows
            changed = np.abs(rows - before)
            moved = changed[:, :3].max(axis=1) > UNSEEN * self.size
            turned = changed[:, 3:].max(axis=1) > UNSEEN
            values = rows[:, [0, 1, 2, 6, 3, 4, 5]].tolist()
            for i in np.flatnonzero(moved):
                self._movers[i][0](values[i][:3])
            for i in np.flatnonzero(turned):
                self._movers[i][1](values[i][3:])
            self._rows = rows.copy()
            if self._halos:
                self._show_more(frame, look, pull)

    def _show_more(self, frame, look, pull):
        sample, place = frame.sample, self._rows[:, :3]
        turns = sample.pose[:, :9].reshape(-1, 3, 3)
        if look != self._look:
            self._look = look
            for handle in self._joints:
                handle.visible = look.joints
            for handle in self._frames:
                handle.show_axes = look.frames
        errors = np.zeros(len(place)) if sample.errors is None or not look.halo else sample.errors[:, 0]
        self._show_halos(np.minimum(look.magnification * errors, LARGEST_HALO * self.size))
        centres = place + np.einsum("nij,nj->ni", turns, self._layout.offsets.com)
        self._show_lines("springs", self._ends(place, turns), SPRING)
        wrenches = sample.external_wrenches
        world = np.einsum("nij,nkj->nki", turns, wrenches.reshape(-1, 2, 3))
        self._arrows("forces", place, world[:, 1], FORCE, look.wrenches)
        self._arrows("torques", place, world[:, 0], TORQUE, look.wrenches)
        for k, (start, tip) in enumerate(arrows(sample, *self._measure)):
            presses = look.contacts and bool(np.isfinite(start[0]))
            _set(self._touches[k], "visible", presses)
            if presses:
                self._movers[len(place) + k][0](start.tolist())
                self._show_arrows(
                    f"touch{k}/force", np.array([[np.zeros(3), tip - start]]), CONTACT, self._radius / THICK
                )
        self._show_points(sample.pressing if look.contacts else np.empty((0, 5)))
        self._arrows("gravity", centres, self._weights, GRAVITY, look.gravity)
        starts, forces = self._reactions(sample) if look.reactions else (np.empty((0, 3)), np.empty((0, 3)))
        self._arrows("reactions", starts, forces, REACTION, look.reactions)
        self._show_lines("pull", np.empty((0, 2, 3)) if pull is None else np.array([pull]), PULL, 5.0)
        if look.trace:
            if not self._trace or np.abs(self._trace[-1] - centres).max() > 0.002 * self.size:
                self._trace = [*self._trace[1 - MOST_TRACE :], centres]
            points = np.array(self._trace)
            lines = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)
        else:
            self._trace, lines = [], np.empty((0, 2, 3))
        self._show_lines("trace", lines, TRACE)

    def _show_halos(self, radii):
        """Show halos of these radii (n,), m; a change below CHANGE is not seen."""
        radii = np.where(radii > UNSEEN * self.size, radii, 0.0)  # not of an unknown error, NaN, either
        for i in np.flatnonzero(np.abs(radii - self._radii) > CHANGE * self._radii):
            halo = self._halos[i]
            _set(halo, "visible", bool(radii[i] > 0.0))
            if radii[i] > 0.0:
                halo.scale = float(radii[i])
            self._radii[i] = radii[i]

    def forget_trace(self):
        """Start new traces: the motion jumped."""
        self._trace = []

    def _ends(self, place, turns):
        ends = [[p if i < 0 else place[i] + turns[i] @ p for i, p in line] for line in self._springs]
        return np.array(ends).reshape(-1, 2, 3)

    def _reactions(self, sample):
        """Points (m, 3) and forces (m, 3), world axes, of the reactions on the children of joints."""
        starts, forces = [], []
        names = list(self._layout.body_names)
        for joint, frames in zip(self._layout.scene.joints, self._layout.joint_frames):
            wrench = sample.reactions.get(joint.name)
            if wrench is None or not np.isfinite(wrench[3:]).all():
                continue
            child = names.index(joint.child)
            turn = sample.pose[child, :9].reshape(3, 3)
            starts.append(self._rows[child, :3] + turn @ (frames[1][:3, 3] + self._layout.offsets.com[child]))
            forces.append(turn @ frames[1][:3, :3] @ wrench[3:])
        return np.array(starts).reshape(-1, 3), np.array(forces).reshape(-1, 3)

    def _arrows(self, name, starts, vectors, colour, is_shown):
        """Arrows whose longest is LONGEST of the mechanism at the largest vector so far."""
        length = np.linalg.norm(vectors, axis=1)
        some = length > 0.0
        if not is_shown or not some.any():
            self._show_arrows(name, np.empty((0, 2, 3)), colour)
            return
        largest = self._largest[name] = max(self._largest.get(name, 0.0), length.max())
        tips = starts + vectors * (LONGEST * self.size / largest)
        self._show_arrows(name, np.stack([starts[some], tips[some]], axis=1), colour)

    def show_planes(self, low, high):
        """Shade the planes of contacts, with their edges, where bodies move; low, high : (3,) m, bounds of these."""
        cell = 10.0 ** math.floor(math.log10(self.size))
        for k, corners in enumerate(patches(self._layout.scene, low, high)):
            faces = [(0, i, i + 1) for i in range(1, len(corners) - 1)]
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            below = corners - BELOW * self.size * normal / np.linalg.norm(normal)
            self._server.scene.add_mesh_simple(
                f"{self._root}/plane{k}", below, np.array(faces), color=_bytes(PLANE), side="double", opacity=SHADE,
                cast_shadow=False,
            )  # fmt: skip
            self._show_lines(f"edge{k}", np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), _bytes(PLANE))
            self._show_lines(f"rulings{k}", rulings(corners, cell), RULING, 1.0)

    def _show_points(self, points):
        """Points (m, 5) of contacts, as Sample.pressing; a node of each one that has pressed, which moves at once."""
        for k in np.flatnonzero(points[:, 0]) if len(points) else ():
            colour = TOUCHES[int(points[k, 4])]
            if k not in self._points:
                handle = self._server.scene.add_icosphere(
                    f"{self._root}/point{k}", self._radius, colour, subdivisions=2, cast_shadow=False
                )
                self._points[k] = handle, mover(self._server, handle)[0]
            handle, move = self._points[k]
            move(points[k, 1:4].tolist())
            _set(handle, "color", colour)
        for k, (handle, _) in self._points.items():
            _set(handle, "visible", bool(points[k, 0]) if len(points) else False)

    def _show_arrows(self, name, points, colour, size=None):
        """Arrows from and to points (k, 2, 3); size : m, by which they are thick; None: of the mechanism."""
        handle, size = self._handles.get(name), size or self.size
        if not len(points):
            if handle is not None:
                _set(handle, "visible", False)
            return
        points = points.astype(np.float32)
        if handle is None or len(handle.points) != len(points):
            self._handles[name] = self._server.scene.add_arrows(
                f"{self._root}/{name}", points, colour, shaft_radius=0.008 * size, head_radius=0.02 * size,
                head_length=0.05 * size,
            )  # fmt: skip
            return
        if np.abs(handle.points - points).max() > UNSEEN * size:
            handle.points = points
        _set(handle, "visible", True)

    def _show_lines(self, name, lines, colour, width=3.0):
        handle = self._handles.get(name)
        if not len(lines):
            if handle is not None:
                _set(handle, "visible", False)
            return
        lines = lines.astype(np.float32)
        if handle is None or len(handle.points) != len(lines):
            self._handles[name] = self._server.scene.add_line_segments(
                f"{self._root}/{name}", lines, colour, thickness=width, thickness_units="screen"
            )
            return
        handle.points = lines
        _set(handle, "visible", True)


def _set(handle, name, value):
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def _wxyz(turn):
    return Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]]
