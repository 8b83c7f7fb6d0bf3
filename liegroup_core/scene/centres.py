# SPDX-License-Identifier: Apache-2.0
"""Centres of mass: transformation between body frames and frames at the centres of mass.

The equations are simplest in frames at the centres of mass. The model is built from the scene
that `at_centres_of_mass` returns; states and wrenches are shifted by `Offsets`. With the centre
of mass at c in the body frame, all in body axes,

    position  r_com = r + R c       velocity  v_com = v + w x c       point  p_com = p - c
    torque    t_com = t - c x f

If all centres of mass are at the origins of the body frames, all numbers pass unchanged.
"""

import numpy as np

# {key whose value is a point or frame in a body's frame: key with the name of this body}, of joints, forces, sensors.
# test/core/test_centres.py finds keys that are missing here.
PLACES = {
    "parent_frame": "parent",
    "child_frame": "child",
    "parent_point": "parent",
    "child_point": "child",
    "point": "body",
    "frame": "body",
}


def at_centres_of_mass(scene):
    """Scene of the same mechanism with every body frame at the centre of mass, so that all com are zero.

    scene : assembled scene
    returns a Scene with mass and inertia in place of shapes; the given scene if all its com are zero
    """
    com = {body.name: np.array(body.com) for body in scene.bodies}
    if not any(offset.any() for offset in com.values()):
        return scene
    com["world"] = np.zeros(3)
    return scene.remade(
        bodies=[_body_at_centre(body) for body in scene.bodies],
        joints=[_shifted(joint, com) for joint in scene.joints],
        forces=[_shifted(force, com) for force in scene.forces],
        sensors=[_shifted(sensor, com) for sensor in scene.sensors],
    )


def _body_at_centre(body):
    """The body with its frame at its centre of mass."""
    com = np.array(body.com)
    w, v = np.array(body.angular_velocity), np.array(body.linear_velocity)
    return body.remade(
        leave_out=("com", "shape"),
        mass=body.mass,
        inertia=body.inertia,
        position=body.position + body.rotation @ com,
        linear_velocity=v + np.cross(w, com),
    )


def _shifted(link, com):
    """Joint, force or sensor with its points and frames relative to the centres of mass."""
    moved = link.at_centres(com) if hasattr(link, "at_centres") else {}
    for key, end in PLACES.items():
        place = getattr(link, key, None)
        if place is None or not hasattr(link, end):  # the frame of a force-torque sensor is in the child of its joint
            continue
        offset = com[getattr(link, end)]
        moved[key] = (
            place.remade(position=place.position - offset) if key.endswith("frame") else np.array(place) - offset
        )
    return link.remade(**moved)


class Offsets:
    """Offsets of the centres of mass of all bodies of a scene.

    com : (n, 3) m, in the body frames
    """

    def __init__(self, scene):
        self.com = np.array([body.com for body in scene.bodies], dtype=float).reshape(-1, 3)
        self.none, self._columns = not self.com.any(), self.com[..., None]
        # (n, 3, 3): the product with w is w x com; for a few bodies ten times as fast as np.cross.
        self._crossed = np.cross(np.eye(3), self.com[:, None]).transpose(0, 2, 1).copy()

    def to_centres(self, pose, twist):
        """Poses (..., n, 12) and twists (..., n, 6) of the frames at the centres of mass."""
        return self._moved(pose, twist, np.add)

    def to_bodies(self, pose, twist):
        """Poses (..., n, 12) and twists (..., n, 6) of the body frames; inverse of to_centres."""
        return self._moved(pose, twist, np.subtract)

    def _moved(self, pose, twist, by):
        if self.none:
            return pose, twist
        pose, twist = np.array(pose), np.array(twist)
        R, r, v = pose[..., :9].reshape(*pose.shape[:-1], 3, 3), pose[..., 9:], twist[..., 3:]
        by(r, (R @ self._columns)[..., 0], out=r)
        by(v, (self._crossed @ twist[..., :3, None])[..., 0], out=v)
        return pose, twist

    def wrench_at_centre(self, body, wrench):
        """Wrench (6,) about the centre of mass of body number `body`; wrench: about the origin of its frame."""
        wrench = np.array(wrench, dtype=float)
        if not self.none:
            wrench[:3] -= np.cross(self.com[body], wrench[3:])
        return wrench


def pose_matrix(row):
    """Pose (12,) as a matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = row[:9].reshape(3, 3), row[9:]
    return matrix
