# SPDX-License-Identifier: Apache-2.0
"""Joint positions and velocities of the joints with one degree of freedom.

They are those of forces/axis.py: the displacement of a prismatic joint, the angle of others. Their errors are of the
order of the joint's residual. An angle is unwrapped if the joint has a torsional spring or a servo, is coupled or
driven; that of a screw is nearest to its displacement / pitch. Other angles are between -pi and pi.
"""

import numpy as np

from liegroup_core.compiling import SameTypes, kernel
from liegroup_core.forces import axis
from liegroup_core.joints.elements import WORLD
from liegroup_core.joints.kinds import TYPES
from liegroup_core.lie.groups import within_a_turn
from liegroup_core.scene.consistency import resolve_couplings


@SameTypes
@kernel
def _coordinates(rows, pitches, poses, twists, out):
    """Positions and velocities of joints in m states, out (m, k, 2).

    rows   : (k,) of axis.ROW;  pitches: (k,) m/rad, 0 for a joint that is no screw
    poses, twists : (m, n, 12), (m, n, 6)
    """
    for i in range(len(poses)):
        pose, twist = poses[i], twists[i]
        for j in range(len(rows)):
            row, near = rows[j], 0.0
            if pitches[j] != 0.0:
                rise = axis.displacement(row, pose)
                if abs(rise) < 1e15 * abs(pitches[j]):
                    near = rise / pitches[j]
            out[i, j, 0] = axis.coordinate(row, pose, near)
            out[i, j, 1] = axis.rate(row, axis.unit_wrenches(row, pose), twist)


class JointCoordinates:
    """Joint positions and velocities of a state.

    scene  : Scene with frames at the centres of mass
    frames : (parent frame, child frame), each (4, 4), of its joints
    names, units : joints with exactly one coordinate; {joint: "rad" or "m"}
    """

    def __init__(self, scene, frames):
        index = {body.name: i for i, body in enumerate(scene.bodies)} | {"world": WORLD}
        found = [(joint, pair) for joint, pair in zip(scene.joints, frames) if TYPES[joint.type].coordinate is not None]
        self.names = tuple(joint.name for joint, _ in found)
        self.units = {joint.name: TYPES[joint.type].coordinate for joint, _ in found}
        self._pitches = np.array([getattr(joint, "pitch", 0.0) for joint, _ in found], dtype=float)
        rows = [
            axis.fields(self.units[joint.name] == "m", index[joint.parent], index[joint.child], *pair)
            for joint, pair in found
        ]
        self._rows = np.array(rows, dtype=axis.ROW)
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
        _coordinates(self._rows, self._pitches, poses, twists, out)

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
