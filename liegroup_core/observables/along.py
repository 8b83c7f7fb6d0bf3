# SPDX-License-Identifier: Apache-2.0
"""Observables of many states or bodies in one call, for long recordings and many messages."""

import numpy as np

from liegroup_core.compiling import SameTypes, kernel
from liegroup_core.dynamics.constraints import position_residuals
from liegroup_core.forces import kinds, law
from liegroup_core.forces.gravity import energy as gravity_energy
from liegroup_core.lie.so3 import so3_to_quaternion
from liegroup_core.lie.vec3 import load9
from liegroup_core.observables.invariants import energy

FIRST_LAW = len(kinds.POWERS)  # column of its power
STORES = ("kinetic energy", "potential energy", "energy of springs")


@kernel
def _along(model, angle, pose, twist, energy_out, parts_out, residual_out, angle_out):
    for k in range(len(pose)):
        kinds.count_turns(model.forces, pose[k], angle)
        total = energy(model, angle, pose[k], twist[k])
        energy_out[k] = total
        parts_out[k, 1] = gravity_energy(model, pose[k])
        parts_out[k, 2] = kinds.energy(model.forces, angle, pose[k])
        parts_out[k, 0] = total - (parts_out[k, 1] + parts_out[k, 2])
        position_residuals(model, pose[k], residual_out[k])
        angle_out[k] = angle


@SameTypes
@kernel
def _powers(forces, angle, targets, registers, times, pose, twist, out):
    for k in range(len(pose)):
        law.enter_numbers(forces.laws, times[k], angle[k], registers)
        law.measure(forces.laws, angle[k], pose[k], twist[k], registers)
        found = kinds.powers(forces, angle[k], targets, registers, pose[k], twist[k])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = found
        for e in range(len(forces.laws.outputs)):
            out[k, FIRST_LAW + forces.laws.owners[e]] += law.power_of(forces.laws, e, registers, pose[k], twist[k])


@SameTypes
@kernel
def _quaternions(pose, out):
    for k in range(len(pose)):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = so3_to_quaternion(load9(pose, k, 0))


def quaternions(pose):
    """Quaternions (..., 4) x, y, z, w >= 0 of poses (..., 12), bit-identical to those of Sample."""
    pose = np.array(pose, dtype=float, order="C")  # writable: always the same type
    out = np.empty((*pose.shape[:-1], 4))
    _quaternions(pose.reshape(-1, 12), out.reshape(-1, 4))
    return out


@SameTypes
@kernel
def _rows(pose, twist, out):
    for k in range(len(pose)):
        out[k, 3], out[k, 4], out[k, 5], out[k, 6] = so3_to_quaternion(load9(pose, k, 0))
        for i in range(3):
            out[k, i] = pose[k, 9 + i]
            out[k, 7 + i], out[k, 10 + i] = twist[k, 3 + i], twist[k, i]


def rows(pose, twist):
    """(n, 13) position, quaternion as above, v, omega of poses (n, 12) and twists (n, 6).

    The arrays must be C-contiguous and read-only, as in a Sample.
    """
    out = np.empty((len(pose), 13))
    _rows(pose, twist, out)
    return out


def powers(layout, angles, targets, times, pose, twist, known=()):
    """(k, p + l) W of the non-conservative forces of a layout by kinds.POWERS and of each law, in k states.

    known : [number of a law] that have no part in it, as their work is known
    The inputs are the same in all. angles (k, t) rad; targets as for kinds.powers; times (k,) s; pose (k, n, 12),
    twist (k, n, 6) of the frames at the centres of mass
    """
    out = np.zeros((len(pose), len(kinds.POWERS) + len(law.laws_of(layout.scene.forces))))
    forces = layout.model.forces
    given = [np.array(part, order="C") for part in (angles, targets, forces.laws.registers, times, pose, twist)]
    _powers(forces, *given, out)
    if known:
        out[:, [FIRST_LAW + law for law in known]] = 0.0
        out[:, FIRST_LAW - 1] = out[:, FIRST_LAW:].sum(axis=1)
    return out


class Along:
    """Observables along a motion of the body frames of a layout, block by block.

    Angles of torsional springs are unwrapped from one state to the next, so a joint must rotate by
    less than pi in between. Call `restart` at the start of another motion.
    """

    def __init__(self, layout):
        self._layout = layout
        joints = len(layout.scene.joints)
        self._of_joint = np.zeros((len(layout.joint_of_row), joints))
        self._of_joint[np.arange(len(layout.joint_of_row)), layout.joint_of_row] = 1.0
        self.restart()

    def restart(self, near=None):
        """Start another motion with the next state.

        near : (t,) rad, approximate angles of the torsional springs; None: between -pi and pi
        """
        self._angle, self._near = None, near

    def of(self, pose, twist):
        """Observables of the next k states.

        pose (k, n, 12), twist (k, n, 6) of the body frames, k > 0
        returns energy (k,) J, its parts (k, 3) J by STORES, norm of each joint's position residual
        (k, joints) m and rad, angles (k, t) rad of the torsional springs
        """
        layout = self._layout
        pose, twist = (np.ascontiguousarray(part) for part in layout.offsets.to_centres(pose, twist))
        if self._angle is None:
            self._angle = layout.angles(pose[0], self._near)
        k = len(pose)
        energies, parts = np.empty(k), np.empty((k, len(STORES)))
        residual = np.zeros((k, len(layout.joint_of_row)))
        angles = np.empty((k, len(self._angle)))
        _along(layout.model, self._angle, pose, twist, energies, parts, residual, angles)
        return energies, parts, np.sqrt(residual**2 @ self._of_joint), angles
