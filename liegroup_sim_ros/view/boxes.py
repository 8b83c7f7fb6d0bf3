# SPDX-License-Identifier: Apache-2.0
"""Boxes about the drawn bodies: what the camera frames, and what the mouse picks."""

import itertools

import numpy as np

from liegroup_sim_ros.messages.markers import edges, solid
from liegroup_sim_ros.report.shapes import box_of

SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
LARGEST = 4.0  # size of a framed motion, relative to that of the mechanism; a larger one is followed
ROOM = 0.1  # about what is framed, relative to it
THICK = 0.01  # of a box that is picked, relative to the mechanism: thin bodies are hard to hit


class Boxes:
    """Boxes about the bodies of a Layout; shapes: {body: [triangles]} of report.shapes, others are their solids.

    size, middle : m, (3,) m: diagonal and centre of the box about all bodies at the start
    halves : (n, 3) m, half the edges of the boxes
    """

    def __init__(self, layout, shapes):
        scene = layout.scene
        self._places, self.halves = np.tile(np.eye(4), (len(scene.bodies), 1, 1)), np.zeros((len(scene.bodies), 3))
        for i, body in enumerate(scene.bodies):
            if shapes.get(body.name):
                self._places[i, :3, 3], lengths = box_of(shapes[body.name])
            else:
                visual = solid(body, scene)
                lengths, self._places[i] = edges(visual), visual.pose
            self.halves[i] = 0.5 * np.asarray(lengths)
        start = np.array([[*body.rotation.ravel(), *body.position] for body in scene.bodies])
        low, high = self.bounds(start)
        self.size, self.middle = float(np.linalg.norm(high - low)) or layout.size, 0.5 * (low + high)

    def _frames(self, poses):
        """Centres (..., n, 3) and axes (..., n, 3, 3) of the boxes at poses (..., n, 12)."""
        turns = poses[..., :9].reshape(*poses.shape[:-1], 3, 3)
        at = poses[..., 9:] + (turns @ self._places[:, :3, 3:])[..., 0]
        return at, turns @ self._places[:, :3, :3]

    def centres(self, poses):
        """Centres (..., n, 3) m, world axes, of the bodies at poses (..., n, 12), and radii (n,) m about them."""
        return self._frames(poses)[0], np.linalg.norm(self.halves, axis=1)

    def bounds(self, poses):
        """Least and largest coordinates (3,), (3,) m, world axes, of the bodies at poses (..., n, 12)."""
        at, axes = self._frames(poses)
        reach = (np.abs(axes) @ self.halves[:, :, None])[..., 0]
        return (at - reach).reshape(-1, 3).min(axis=0), (at + reach).reshape(-1, 3).max(axis=0)

    def framed(self, poses, before=None):
        """Bounds that a camera frames, and keeps while the bodies are in them, unless these need far less.

        before : those of now, or None
        """
        low, high = self.bounds(poses)
        most = LARGEST * max(self.size, np.linalg.norm(high - low))
        is_inside = before is not None and (before[0] <= low).all() and (high <= before[1]).all()
        if is_inside and np.linalg.norm(before[1] - before[0]) <= most:
            return before
        room = ROOM * np.linalg.norm(high - low)
        own = low - room, high + room
        if before is None:
            return own
        both = np.minimum(own[0], before[0]), np.maximum(own[1], before[1])
        is_large = np.linalg.norm(both[1] - both[0]) > most
        return (own[0] - 5.0 * room, own[1] + 5.0 * room) if is_large else both

    def picked(self, origin, direction, poses, body=None):
        """(number of the instant, body, point (3,) in its frame) of the first instant at which a ray meets a body.

        If it meets none, it is the body that it passes most closely.

        origin, direction : (3,) m and (3,) unit vector, world axes, of the ray
        poses             : (m, n, 12), instants, the newest one first
        body              : number of the only body to look at; None: all
        """
        at, axes = self._frames(poses)
        start, along = origin - at, np.broadcast_to(direction, at.shape)
        start, along = ((vector[..., None, :] @ axes)[..., 0, :] for vector in (start, along))
        half = self.halves + THICK * self.size
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(-half - start) / along, (half - start) / along])
        others = np.zeros(at.shape[1], dtype=bool) if body is None else np.arange(at.shape[1]) != body
        enter, leave = np.where(others, np.inf, np.fmin(*ends).max(axis=-1)), np.fmax(*ends).min(axis=-1)
        meets = (enter <= leave) & (leave > 0.0)
        if meets.any():
            k = int(np.flatnonzero(meets.any(axis=1))[0])
            i = int(np.where(meets[k], enter[k], np.inf).argmin())
            depth = max(enter[k, i], 0.0)
        else:
            depths = (at - origin) @ direction
            apart = np.linalg.norm(at - origin - depths[..., None] * direction, axis=-1) - np.linalg.norm(half, axis=-1)
            apart[others | ~np.isfinite(apart)] = np.inf
            k, i = np.unravel_index(apart.argmin(), apart.shape)
            depth = depths[k, i]
        local = np.clip(start[k, i] + depth * along[k, i], -self.halves[i], self.halves[i])
        return int(k), int(i), self._places[i, :3, 3] + self._places[i, :3, :3] @ local


def camera_at(low, high, ahead, up, slope, window):
    """(position (3,), point that it looks at (3,)) of a camera that shows a box in a part of its picture.

    low, high : (3,) m, corners of the box
    ahead, up : (3,) unit vectors, from the box to the camera, and that is vertical in the picture
    slope     : (2,) tangents of half the viewing angles, to the right and up
    window    : ((left, right), (bottom, top)) of the part, from -1 to 1
    """
    right = np.cross(up, ahead)
    right /= np.linalg.norm(right)
    above = np.cross(ahead, right)
    corners = 0.5 * SIGNS * (high - low)
    depths, far, shift = corners @ ahead, 0.0, np.zeros(3)
    for side, tangent, (least, most) in zip((right, above), slope, window):
        middle, across = 0.5 * (least + most), corners @ side
        # A corner at the depth far - ahead.c has to be between both edges at this depth.
        needed = np.maximum(across + most * tangent * depths, -across - least * tangent * depths)
        far = max(far, float((needed / (tangent * (most - middle))).max()), 1.05 * float(depths.max()))
        shift += -middle * tangent * side
    position = 0.5 * (low + high) + far * (ahead + shift)
    return position, position - far * ahead
