# SPDX-License-Identifier: Apache-2.0
"""Joint positions and velocities of the joints with one degree of freedom.

With the joint frames A on the parent and B on the child, z_A and z_B their axes in the world,
    revolute   theta = atan2(R10 - R01, R00 + R11) of R = R_A^T R_B,   z_B . (omega_b - omega_a)
    prismatic  z_A . (p_B - p_A),                                      z_B . (v_b - v_a) at p_B
Their error is of the order of the joint's residual. An angle is unwrapped if the joint has a
torsional spring or is coupled; other angles are between -pi and pi.
"""

import math

import numpy as np

from liegroup_core.joints.kinds import TYPES
from liegroup_core.lie.groups import within_a_turn
from liegroup_core.scene.consistency import resolve_couplings


class JointCoordinates:
    """Joint positions and velocities of a state.

    scene  : Scene with frames at the centres of mass
    frames : (parent frame, child frame), each (4, 4), of its joints
    names, units : joints that have a coordinate; {joint: "rad" or "m"}
    """

    def __init__(self, scene, frames):
        place = {body.name: i for i, body in enumerate(scene.bodies)}
        found = [
            (joint, pair)
            for joint, pair in zip(scene.joints, frames)
            if TYPES[joint.type].coordinate is not None
        ]
        self.names = tuple(joint.name for joint, _ in found)
        self.units = {joint.name: TYPES[joint.type].coordinate for joint, _ in found}
        # The world has the index after the last body.
        self._parent = [place.get(joint.parent, len(place)) for joint, _ in found]
        self._child = [place[joint.child] for joint, _ in found]
        self._parent_frame = np.array([pair[0] for _, pair in found]).reshape(-1, 4, 4)
        self._child_frame = np.array([pair[1] for _, pair in found]).reshape(-1, 4, 4)
        counted = [joint for joint, _ in scene.unwrapped]
        # Angles that follow from a coupling: (joint, other, ratio, offset).
        self._coupled = [
            (entry.joint, entry.other, *numbers[2:])
            for entry, numbers in zip(scene.couplings, resolve_couplings(scene))
            if self.units.get(entry.joint) == "rad" and entry.other in self.units
        ]
        self._counted = [counted.index(name) if name in counted else None for name in self.names]

    def at(self, pose, twist, angles):
        """{joint: (position, velocity)}: rad and rad/s, or m and m/s.

        pose, twist : (n, 12), (n, 6) of the frames at the centres of mass
        angles      : (k,) rad, `Sample.angles`
        """
        if not self.names:
            return {}
        R = np.concatenate([pose[:, :9].reshape(-1, 3, 3), np.eye(3)[None]])
        r = np.concatenate([pose[:, 9:], np.zeros((1, 3))])
        spin, speed = np.zeros((2, len(R), 3))  # world axes
        spin[:-1] = np.einsum("nij,nj->ni", R[:-1], twist[:, :3])
        speed[:-1] = np.einsum("nij,nj->ni", R[:-1], twist[:, 3:])
        a, b = self._parent, self._child
        R_A, R_B = R[a] @ self._parent_frame[:, :3, :3], R[b] @ self._child_frame[:, :3, :3]
        p_A = r[a] + np.einsum("nij,nj->ni", R[a], self._parent_frame[:, :3, 3])
        p_B = r[b] + np.einsum("nij,nj->ni", R[b], self._child_frame[:, :3, 3])
        R_rel = R_A.transpose(0, 2, 1) @ R_B
        turn = np.arctan2(R_rel[:, 1, 0] - R_rel[:, 0, 1], R_rel[:, 0, 0] + R_rel[:, 1, 1])
        way = np.einsum("ni,ni->n", R_A[:, :, 2], p_B - p_A)
        turn_rate = np.einsum("ni,ni->n", R_B[:, :, 2], spin[b] - spin[a])
        way_rate = np.einsum(
            "ni,ni->n",
            R_B[:, :, 2],
            speed[b] + np.cross(spin[b], p_B - r[b]) - speed[a] - np.cross(spin[a], p_B - r[a]),
        )
        found = {}
        for j, name in enumerate(self.names):
            if self.units[name] == "m":
                found[name] = float(way[j]), float(way_rate[j])
            else:
                angle = float(turn[j])
                if self._counted[j] is not None:
                    counted = angles[self._counted[j]]
                    angle += 2.0 * math.pi * round((counted - angle) / (2.0 * math.pi))
                found[name] = angle, float(turn_rate[j])
        for name, other, ratio, offset in self._coupled:
            angle, rate = found[name]
            found[name] = within_a_turn(angle, ratio * found[other][0] + offset), rate
        return found
