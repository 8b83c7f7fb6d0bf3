# SPDX-License-Identifier: Apache-2.0
"""Joint positions and velocities of the joints with one degree of freedom.

With the joint frames A on the parent and B on the child, z_A and z_B their axes in the world,
    revolute   theta = atan2(R10 - R01, R00 + R11) of R = R_A^T R_B,   z_B . (omega_b - omega_a)
    prismatic  z_A . (p_B - p_A),                                      z_B . (v_b - v_a) at p_B
    screw      theta + 2 pi k, nearest to z_A . (p_B - p_A) / pitch,       z_B . (omega_b - omega_a)
Their errors are of the order of the joint's residual. An angle is unwrapped if the joint has a torsional
spring or a servo, is coupled or driven. Other angles are between -pi and pi, but for screws.
"""

import math

import numpy as np

from liegroup_core.compiling import SameTypes, kernel
from liegroup_core.forces.axis import unwrapped
from liegroup_core.joints.kinds import TYPES
from liegroup_core.lie.groups import within_a_turn
from liegroup_core.lie.vec3 import ZERO3, add3, cross3, dot3, load3, load9, matmul3, matvec3, sub3, tmatmul3
from liegroup_core.scene.consistency import resolve_couplings


@kernel
def _placed(frames, j, start, pose, body):
    """Rotation and origin, in world axes, of the joint frame in row j of frames, columns from `start` on."""
    rot, point = load9(frames, j, start), load3(frames, j, start + 9)
    if body == len(pose):
        return rot, point
    turn = load9(pose, body, 0)
    return matmul3(turn, rot), add3(load3(pose, body, 9), matvec3(turn, point))


@kernel
def _motion(pose, twist, body, point):
    """Angular velocity of a body, and the velocity of its point at a world position; world axes."""
    if body == len(pose):
        return ZERO3, ZERO3
    turn = load9(pose, body, 0)
    spin, speed = matvec3(turn, load3(twist, body, 0)), matvec3(turn, load3(twist, body, 3))
    return spin, add3(speed, cross3(spin, sub3(point, load3(pose, body, 9))))


@SameTypes
@kernel
def _coordinates(ends, pitches, frames, poses, twists, out):
    """Positions and velocities of joints in m states, out (m, k, 2).

    ends   : (k, 2) indices of parent and child; that of the world is the number of bodies
    pitches: (k,) m/rad, of a revolute joint 0, of a prismatic one infinite
    frames : (k, 24) joint frames in parent and child: R row by row, point in m
    poses, twists : (m, n, 12), (m, n, 6)
    """
    for i in range(len(poses)):
        pose, twist = poses[i], twists[i]
        for j in range(len(ends)):
            a, b = ends[j]
            R_A, p_A = _placed(frames, j, 0, pose, a)
            R_B, p_B = _placed(frames, j, 12, pose, b)
            (spin_a, speed_a), (spin_b, speed_b) = (_motion(pose, twist, a, p_B), _motion(pose, twist, b, p_B))
            z_B = (R_B[2], R_B[5], R_B[8])
            z = dot3((R_A[2], R_A[5], R_A[8]), sub3(p_B, p_A))
            if math.isinf(pitches[j]):
                out[i, j, 0] = z
                out[i, j, 1] = dot3(z_B, sub3(speed_b, speed_a))
            else:
                R = tmatmul3(R_A, R_B)
                angle = math.atan2(R[3] - R[1], R[0] + R[4])
                out[i, j, 0] = unwrapped(angle, z / pitches[j]) if abs(z) < 1e15 * abs(pitches[j]) else angle
                out[i, j, 1] = dot3(z_B, sub3(spin_b, spin_a))


class JointCoordinates:
    """Joint positions and velocities of a state.

    scene  : Scene with frames at the centres of mass
    frames : (parent frame, child frame), each (4, 4), of its joints
    names, units : joints with exactly one coordinate; {joint: "rad" or "m"}
    """

    def __init__(self, scene, frames):
        place = {body.name: i for i, body in enumerate(scene.bodies)}
        found = [(joint, pair) for joint, pair in zip(scene.joints, frames) if TYPES[joint.type].coordinate is not None]
        self.names = tuple(joint.name for joint, _ in found)
        self.units = {joint.name: TYPES[joint.type].coordinate for joint, _ in found}
        n = len(place)
        ends = [(place.get(joint.parent, n), place[joint.child]) for joint, _ in found]
        self._ends = np.array(ends, dtype=np.int64).reshape(-1, 2)
        pitches = [math.inf if self.units[joint.name] == "m" else getattr(joint, "pitch", 0.0) for joint, _ in found]
        self._pitches = np.array(pitches, dtype=float)
        rows = [[*C[:3, :3].ravel(), *C[:3, 3]] for _, pair in found for C in pair]
        self._frames = np.array(rows, dtype=float).reshape(-1, 24)
        counted = [joint for joint, _ in scene.unwrapped]
        # Couplings by the places of their joints in `names`.
        place_of = {j: self.names.index(joint.name) for j, joint in enumerate(scene.joints) if joint.name in self.units}
        couplings = [
            (entry, found.numbered(place_of))
            for entry, found in zip(scene.couplings, resolve_couplings(scene))
            if place_of.keys() >= set(found.joints)
        ]
        # Angles that follow from a coupling: (joint, ResolvedCoupling).
        self._coupled = [(e.joint, found) for e, found in couplings if self.units[e.joint] == "rad" and not found.loose]
        # Couplings that drift: {name: (joint, ResolvedCoupling)}.
        self._curved = {
            entry.name: (entry.joint, found) for entry, found in couplings if entry.curve and not found.loose
        }
        self._counted = {
            name: counted.index(name) for name in self.names if name in counted and self.units[name] == "rad"
        }

    @property
    def gap_units(self):
        """{coupling: unit of its violation} of the couplings that drift, because they are curved."""
        return {name: self.units[joint] for name, (joint, *_) in self._curved.items()}

    def gaps(self, pose, twist, angles):
        """Violations of the couplings in `gap_units`, rad or m; arguments: as of `at`."""
        found = self.at(pose, twist, angles) if self._curved else {}
        at = [q for q, _ in found.values()]
        return [at[entry.joint] - entry.rise(at) - entry.offset for _, entry in self._curved.values()]

    @property
    def counted(self):
        """Names of the joints whose angle is unwrapped."""
        return {*self._counted, *(name for name, *_ in self._coupled)}

    def write(self, pose, twist, angles, out):
        """Write positions and velocities (j, 2) in the order of `names`; arguments as of `at`."""
        if self._counted or self._coupled:
            out[:] = list(self.at(pose, twist, angles).values())
        elif self.names:
            self._write(pose[None], twist[None], out[None])

    def _write(self, poses, twists, out):
        _coordinates(self._ends, self._pitches, self._frames, poses, twists, out)

    def along(self, poses, twists, angles):
        """Positions and velocities (m, j, 2) in the order of `names`, of m states; arguments as of `at`, for each."""
        found = np.empty((len(poses), len(self.names), 2))
        self._write(poses, twists, found)

        def unwrap(name, near):
            turned = found[:, self.names.index(name), 0]
            turned -= 2.0 * np.pi * np.floor((turned - near) / (2.0 * np.pi) + 0.5)

        for name, number in self._counted.items():
            unwrap(name, angles[:, number])
        for name, entry in self._coupled:
            unwrap(name, entry.rise(found[..., 0].T) + entry.offset)
        return found

    def at(self, pose, twist, angles):
        """{joint: (position, velocity)}: rad and rad/s, or m and m/s.

        pose, twist : (n, 12), (n, 6) of the frames at the centres of mass
        angles      : (k,) rad, `Sample.angles`
        """
        if not self.names:
            return {}
        out = np.empty((len(self.names), 2))
        self._write(pose[None], twist[None], out[None])
        found = dict(zip(self.names, map(tuple, out.tolist())))
        for name, number in self._counted.items():
            angle, rate = found[name]
            found[name] = within_a_turn(angle, float(angles[number])), rate
        for name, entry in self._coupled:
            angle, rate = found[name]
            found[name] = within_a_turn(angle, entry.rise([q for q, _ in found.values()]) + entry.offset), rate
        return found
