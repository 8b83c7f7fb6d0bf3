# SPDX-License-Identifier: Apache-2.0
"""Exact motions of free bodies and of the symmetric heavy top.

They use Jacobi's elliptic functions (elliptic.py), which need mpmath. They take no steps: the error
of a run of any length can be evaluated at any of its times.
"""

import numpy as np

from .trajectory import Distance, Trajectory

DIGITS = 25  # more than those of float64, even after the loss next to a separatrix
# Relative difference of inertias below which a body is symmetric: round-off.
ROUND_OFF = 1e-14
EPS = np.finfo(float).eps


def exact_solution(layout, pose, twist):
    """Exact motion of the scene of a layout without external wrenches, or None if not known.

    pose (n, 12), twist (n, 6) : at time 0, of the frames at the centres of mass
    """
    try:
        from . import elliptic
    except ImportError:  # no mpmath
        return None
    scene = layout.centred
    if scene.forces:
        return None
    if not scene.joints:
        return Exact(
            "free bodies",
            layout,
            pose,
            twist,
            [
                _free_body(elliptic, body, state, turn, scene.gravity)
                for body, state, turn in zip(scene.bodies, pose, twist)
            ],
        )
    top = _top_of(layout)
    if top is None:
        return None
    try:
        motion = _heavy_top(elliptic, *top, pose[0], twist[0], scene.gravity)
        motion(0.0)
    except ValueError:  # the axis of the top is or becomes vertical
        return None
    return Exact("symmetric heavy top", layout, pose, twist, [motion])


class Exact:
    """Exact motion of a scene.

    name    : for messages
    motions : one function per body, time in s -> (R (3, 3), position (3,), twist (6,)) of the frame
              at the centre of mass
    """

    def __init__(self, name, layout, pose, twist, motions):
        self.name, self._offsets, self._motions = name, layout.offsets, motions

    def at(self, times):
        """Trajectory of the body frames at times (k,), s."""
        k, n = len(times), len(self._motions)
        pose, twist = np.empty((k, n, 12)), np.empty((k, n, 6))
        for row, time in enumerate(times.tolist()):
            for i, motion in enumerate(self._motions):
                rotation, position, twist[row, i] = motion(time)
                pose[row, i, :9], pose[row, i, 9:] = rotation.ravel(), position
        pose, twist = self._offsets.to_bodies(pose, twist)
        return Trajectory(times, pose[..., :9].reshape(k, n, 3, 3), pose[..., 9:], twist)

    @staticmethod
    def uncertainty(trajectory):
        """Distance (k, n) caused by round-off of initial state, times and result."""
        time = np.abs(trajectory.times)[:, None]
        w, v = (np.linalg.norm(part, axis=2) for part in (trajectory.twist[..., :3], trajectory.twist[..., 3:]))
        angle = 4 * EPS * (1.0 + w * time)
        reach = np.linalg.norm(trajectory.position, axis=2) + v * time
        return Distance(4 * EPS * reach, angle, angle, angle * (w + EPS), angle * (v + w * reach + EPS))


def _free_body(elliptic, body, pose, twist, gravity):
    """Motion of a body in free flight: function of time, see Exact."""
    R, position, gravity = pose[:9].reshape(3, 3), pose[9:], np.array(gravity)
    velocity = R @ twist[3:]

    def motion(time):
        rotation, omega = map(elliptic.to_floats, elliptic.free_body(body.inertia_matrix, R, twist[:3], time, DIGITS))
        speed = velocity + gravity * time
        return (
            rotation,
            position + (velocity + 0.5 * gravity * time) * time,
            np.concatenate([omega, rotation.T @ speed]),
        )

    return motion


def _top_of(layout):
    """Parameters of a symmetric top on a spherical joint to the world, or None.

    returns (body, moments of inertia perpendicular to its axis and about it, both about the centre
    of mass, pivot in the frame at the centre of mass, pivot in the world)
    """
    scene = layout.centred
    if not (
        len(scene.bodies) == len(scene.joints) == 1
        and any(scene.gravity)
        and scene.joints[0].type == "spherical"
        and scene.joints[0].parent == "world"
    ):
        return None
    ((parent, child),) = layout.joint_frames
    pivot = np.asarray(child)[:3, 3]
    length = np.linalg.norm(pivot)
    if length == 0.0:
        return None
    body, axis = scene.bodies[0], -pivot / length
    inertia = body.inertia_matrix
    spin = axis @ inertia @ axis
    across = 0.5 * (np.trace(inertia) - spin)
    symmetric = across * np.eye(3) + (spin - across) * np.outer(axis, axis)
    if np.abs(inertia - symmetric).max() > ROUND_OFF * np.abs(inertia).max():
        return None
    return body, across, spin, pivot, np.asarray(parent)[:3, 3]


def _heavy_top(elliptic, body, across, spin, pivot, pivot_world, pose, twist, gravity):
    """Motion of a top about its pivot: function of time, see Exact.

    across, spin : kg m^2, moments of inertia as from `_top_of`
    pivot, pivot_world : (3,) m, in the frame at the centre of mass and in the world
    """
    length = np.linalg.norm(pivot)

    def motion(time):
        rotation, omega = map(
            elliptic.to_floats,
            elliptic.heavy_top(
                across + body.mass * length**2,
                spin,
                body.mass * length,
                -pivot / length,
                gravity,
                pose[:9].reshape(3, 3),
                twist[:3],
                time,
                DIGITS,
            ),
        )
        return (rotation, pivot_world - rotation @ pivot, np.concatenate([omega, np.cross(omega, -pivot)]))

    return motion
