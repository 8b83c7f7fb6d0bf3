# SPDX-License-Identifier: Apache-2.0
"""Reactions of joints, and detection of the components that the equations of motion do not determine.

Redundant rows of closed loops leave reactions undetermined: J^T lambda determines lambda only up to the
null space N of J^T, and likewise the wrench A^T lambda of a joint with rows A. A component is determined
if its row of A^T N vanishes. This is a property of the linkage. It is computed at generic poses
(mechanism/redundancy.py), and again at a singular pose, where more components are undetermined.

Source: Wojtyra, Joint reactions in rigid body mechanisms with dependent constraints, Mechanism and
Machine Theory 44 (2009) 2265.
"""

from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import SameTypes
from liegroup_core.dynamics.reactions import copy_modes, impulse_wrenches, joint_wrenches, reaction_table
from liegroup_core.dynamics.switches import set_modes
from liegroup_core.errors import SimulationError
from liegroup_core.forces.external import no_wrenches
from liegroup_core.forces.kinds import efforts
from liegroup_core.joints import motion
from liegroup_core.joints.kinds import TYPES, forbidden_rows
from liegroup_core.joints.linkage import RANK_TOLERANCE, Linkage
from liegroup_core.mechanism.arrays import make_relative_work
from liegroup_core.mechanism.bodies import make_work
from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.mechanism.redundancy import dependent_groups, generic_poses
from liegroup_core.mechanism.spanning_tree import WORLD_NAME
from liegroup_core.scene.centres import pose_matrix
from liegroup_core.scene.consistency import (
    ResolvedCoupling,
    driven_joints,
    resolve_elements,
    resolve_frames,
    rigid_couplings,
)

COMPONENTS = ("torque x", "torque y", "torque z", "force x", "force y", "force z")
MOST = 5  # names in a reason
# Entries of A^T N are of order one or round-off. Residuals of the poses contribute 1e-12 / RANK_TOLERANCE.
VANISHING = 1e-6


class _Rows(NamedTuple):
    """Unit rows of a linkage at a pose, and their null space.

    shares : (joints, 6, rows) wrench that a unit multiplier of each row exerts on each joint's child,
             in the axes of the joint frame, (torque / length, force)
    null   : (rows, d) N of the unit rows
    """

    shares: np.ndarray
    null: np.ndarray


NO_EFFORTS = np.zeros(0)
REGULAR = -1  # result of `joint_wrenches` at a regular pose


class Reactions:
    """Reactions of all joints of a layout.

    names      : names of the joints, in the order of all arrays
    has_inputs : True if reactions depend on more than the state and the external wrenches
    idle       : array without external wrenches
    """

    def __init__(self, layout):
        self._bodies = layout.body_names
        self.names = tuple(joint.name for joint in layout.scene.joints)
        self._model, self._layout = layout.relative_in_space, layout
        given = self._model.couplings[self._model.couplings["motion"] >= 0]
        self._drive_rows = given["row"][np.argsort(given["motion"])]
        self.idle = no_wrenches(layout.offsets)
        self._copy_modes = SameTypes(copy_modes)
        self._work = work = make_relative_work(self._model, make_work(layout.model, 0), 0)
        inputs = (work.angle, work.targets, work.motions, self._model.switches)
        self.has_inputs = any(map(len, inputs))
        self._scene = scene = layout.centred
        couplings = rigid_couplings(scene)
        couplings += [ResolvedCoupling(j, j, 0.0, 0.0) for j in driven_joints(scene)]
        frames, parts = resolve_frames(scene), resolve_elements(scene)
        # [(joints, their Linkage with free driven joints, their Linkage with prescribed driven joints)]
        self._groups = []
        for loops, numbers in dependent_groups(scene, couplings):
            entries = [couplings[n] for n in numbers]
            joints = {*loops, *(j for entry in entries for j in entry.joints)}
            # Same order as in mechanism/redundancy.py, so that the cached analysis is used.
            group = sorted(joints, key=lambda j: (scene.joints[j].parent != WORLD_NAME, j))
            own = [entry.numbered({j: i for i, j in enumerate(group)}) for entry in entries]
            moving, held = (
                Linkage(scene, frames, parts, group, couplings=kept)
                for kept in ([entry for entry in own if not entry.is_given], own)
            )
            self._groups.append((group, moving, held))

    def warm_up(self):
        """Compile the kernels and analyse the linkage, with the initial state of the scene."""
        pose, twist = initial_state(self._scene)
        _ = self.present
        if self._layout.joint_forces:
            out, targets = np.zeros(len(self._layout.joint_forces)), self._layout.targets
            forces, registers = self._model.space.forces, self._work.registers.copy()
            efforts(forces, np.zeros(len(self._work.angle)), targets, registers, pose, twist, out)

    @cached_property
    def _table(self):
        table = reaction_table(self._layout)
        table.hidden[:] = self.undetermined
        return table

    @cached_property
    def _open_table(self):
        """ReactionTable that sets no component to NaN."""
        return self._table.replace(hidden=np.zeros_like(self._table.hidden))

    @cached_property
    def _joint_wrenches(self):
        """Compiled `joint_wrenches` for writable arrays, as the engine has them."""
        call = SameTypes(joint_wrenches)
        arguments = self._model, self._work, self._table, *initial_state(self._scene), self.idle
        call(*arguments, self.empty())
        return call

    @cached_property
    def present(self):
        """Function (pose, twist, external, out) that calls `joint_wrenches` with arrays of the engine.

        It calls compiled code without checks or copies. The inputs are those of the last `take`.
        """
        _ = self._joint_wrenches
        return partial(self._joint_wrenches.machine_code, self._model, self._work, self._table)

    def empty(self):
        """Array for the results of `joint_wrenches`."""
        return np.empty((len(self.names) + len(self._bodies), 6))

    @cached_property
    def undetermined(self):
        """(J, 6) mask of the components that are undetermined at generic poses."""
        mask = np.zeros((len(self.names), 6), dtype=bool)
        for group, linkage, _ in self._groups:
            # Driven joints are independent of each other (mechanism/cuts.py).
            for poses in generic_poses(linkage):
                mask[group] |= _undetermined(_rows(linkage, poses))
        return mask

    def reasons(self, mask):
        """{joint: reason why some of its components are undetermined}; mask : (J, 6)."""
        found = {}
        for group, *_ in self._groups:
            joints = [j for j in group if mask[j].any()]
            for j in joints:
                others = [self.names[k] for k in joints if k != j]
                more = f" and {len(others) - MOST} more" if len(others) > MOST else ""
                others = ", ".join(others[:MOST]) + more
                parts = ", ".join(part for part, bad in zip(COMPONENTS, mask[j]) if bad)
                shared = f"shared with {others} in any proportion" if others else "any value"
                if j != joints[0]:
                    shared = f"see {self.names[joints[0]]}"
                found[self.names[j]] = f"{parts}: redundant constraints, {shared}"
        return found

    def at(self, pose, twist, angles, acting, modes, time, table=None):
        """Return (wrenches and motion (J + n, 6), mask of undetermined components (J, 6), efforts (d,)).

        pose, twist : (n, 12), (n, 6) of frames at the centres of mass
        angles      : (k,) rad, `Sample.angles`
        acting      : Acting
        modes       : (k, 5) of the joints with stops or friction; None: unchanged
        time        : s
        table       : ReactionTable with the components to set to NaN; None: the undetermined ones
        wrenches, motion : see `joint_wrenches`;  efforts : of the driven joints, N m or N
        Raises SimulationError if the accelerations cannot be computed.
        """
        work, out = self._work, self.empty()
        self.take(angles, acting, modes, time)
        table = self._table if table is None else table
        found = self._joint_wrenches(self._model, work, table, pose, twist, acting.external, out)
        if found >= 0:
            raise SimulationError("the reactions cannot be computed: constraint rows are dependent")
        efforts = -work.multipliers[self._drive_rows] if len(self._drive_rows) else NO_EFFORTS
        if found == REGULAR:
            return out, self.undetermined, efforts
        mask = self.undetermined.copy()  # a singular pose
        places = self._places(pose)
        for group, _, linkage in self._groups:
            mask[group] |= _undetermined(_rows(linkage, places))
        if table is self._table:
            out[: len(mask)][mask] = np.nan
        return out, mask, efforts

    def take(self, angles, acting, modes, time):
        """Set the inputs of a state, see `at`."""
        work = self._work
        work.angle[:] = angles
        work.targets[:] = acting.targets
        work.motions[:], work.clock.now[0] = acting.motions, time
        if modes is not None and len(modes):
            set_modes(self._model, work, modes)

    def take_modes(self, model, work):
        """Copy the modes of the joints with stops or friction from an integrator's arrays.

        returns True if they are known there
        """
        return self._copy_modes(model, work, self._model, self._work)

    def of_impact(self, pose, angles, impulses):
        """(J, 6) impulses of all joints at an impact, N m s and N s; NaN if undetermined.

        pose     : (n, 12) of frames at the centres of mass;  angles : (u,) rad, near those of `Sample.angles`
        impulses : (k,) impulses of the stops, along the coordinates of the joints with stops or friction
        Raises SimulationError if they cannot be computed.
        """
        work, out = self._work, self.empty()
        work.held[:], work.angle[:] = 0.0, angles
        on_links, still = impulses * self._model.switches["sign"], np.zeros((len(pose), 6))
        arguments = work, self._table, pose, still, on_links, out
        if impulse_wrenches(self._model, *arguments) >= 0:
            raise SimulationError("the impulses cannot be computed: constraint rows are dependent")
        return out[: len(self.names)]

    def powers(self, pose, twist, angles, acting, modes, times):
        """Powers of the joints on the bodies: of the drives, and of stops and friction; (k, 2) W in k states.

        pose (k, n, 12), twist (k, n, 6), angles (k, t), times (k,); others as of `at`

        Redundant constraints leave single wrenches undetermined, but not the sum of their powers. The power that
        accelerates rotors is left out: their energy is kinetic energy.
        """
        turning = np.setdiff1d(np.flatnonzero(self._model.links["rotor"]), self._model.law_links)
        rotors = self._model.links[turning]
        wrenches, out = np.empty((len(pose), len(self.names), 6)), np.zeros((len(pose), 2))
        for k, time in enumerate(times):
            found, _, efforts = self.at(pose[k], twist[k], angles[k], acting, modes, time, self._open_table)
            wrenches[k] = found[: len(self.names)]
            rates = [motion.at(row, time)[1] for row in acting.motions]
            out[k, 0] = efforts @ rates if len(efforts) else 0.0
            own = self._work.stage_twist[len(self._bodies) + turning, 0]
            out[k, 1] = (rotors["rotor"] * own * self._work.acceleration[rotors["freedom"], 0]).sum()
        out[:, 1] += np.einsum("kjc,kjc->k", wrenches, self._relative_twists(pose, twist)) - out[:, 0]
        return out

    @cached_property
    def _ends(self):
        """Indices of parents and children (J,), of the world n, and (J, 4, 4) frames in the children."""
        places = {name: i for i, name in enumerate((*self._bodies, WORLD_NAME))}
        ends = np.array([(places[joint.parent], places[joint.child]) for joint in self._scene.joints])
        return *ends.T, np.array([frame for _, frame in self._layout.joint_frames])

    def _relative_twists(self, pose, twist):
        """(k, J, 6) of the joint frames in the children relative to the parents, in their axes."""
        k, n = pose.shape[:2]
        turn, at = pose[..., :9].reshape(k, n, 3, 3), pose[..., 9:]
        spin, speed = (np.einsum("knij,knj->kni", turn, part) for part in (twist[..., :3], twist[..., 3:]))
        # The world is the last body.
        spin, speed, at = (np.concatenate([part, np.zeros((k, 1, 3))], axis=1) for part in (spin, speed, at))
        parent, child, frames = self._ends
        arm = np.einsum("kjab,jb->kja", turn[:, child], frames[:, :3, 3])
        axes = np.einsum("kjab,jbc->kjac", turn[:, child], frames[:, :3, :3])
        ahead, behind = speed[:, child] + np.cross(spin[:, child], arm), speed[:, parent]
        behind = behind + np.cross(spin[:, parent], at[:, child] + arm - at[:, parent])
        parts = spin[:, child] - spin[:, parent], ahead - behind
        return np.concatenate([np.einsum("kjac,kja->kjc", axes, part) for part in parts], axis=2)

    def _places(self, pose):
        """{body: (4, 4)} poses of the frames at the centres of mass, and of the world."""
        places = dict(zip(self._bodies, map(pose_matrix, pose)))
        return places | {WORLD_NAME: np.eye(4)}

    def minimum_norm(self, pose, *others):
        """(J, 6) possible wrenches with the minimum-norm multipliers of unit rows.

        Arguments as for `at`. For the norm, torques are divided by the linkage's characteristic length.
        """
        wrenches = self.at(pose, *others, self._open_table)[0][: len(self.names)]
        out, places = wrenches.copy(), self._places(pose)
        for group, _, linkage in self._groups:
            rows = _rows(linkage, places)
            units = np.repeat([linkage.length, 1.0], 3)
            shares = rows.shares.reshape(6 * len(group), -1)
            own = np.linalg.lstsq(shares, (wrenches[group] / units).ravel(), rcond=None)[0]
            excess = shares @ (rows.null @ (rows.null.T @ own))
            out[group] -= units * excess.reshape(-1, 6)
        return out


def _rows(linkage, poses):
    """_Rows of a linkage at poses."""
    plain = linkage.velocity_rows(poses)
    unit = linkage.jacobian(poses)
    turned = plain.copy()
    turned.reshape(len(plain), -1, 6)[:, :, :3] /= linkage.length
    sizes = np.linalg.norm(turned, axis=1)
    left, values, _ = np.linalg.svd(unit)
    rank = int((values > RANK_TOLERANCE).sum())
    shares, at = np.zeros((len(linkage.joints), 6, len(plain))), 0
    units = np.repeat([linkage.length, 1.0], 3)
    for j, part in enumerate(linkage.parts):
        rows = forbidden_rows(part, linkage.relative(j, poses)) / units
        shares[j, :, at : at + len(rows)] = (rows / sizes[at : at + len(rows), None]).T
        at += len(rows)
    for r, entry in enumerate(linkage.couplings, at):
        for j, factor in zip(entry.joints, linkage.factors(entry, poses)):
            axis = TYPES[linkage.joints[j].type].rate
            shares[j, axis, r] += factor / units[axis] / sizes[r]
    return _Rows(shares, left[:, rank:])


def _undetermined(rows):
    """(joints, 6) mask of the wrench components that depend on the null space."""
    return np.abs(rows.shares @ rows.null).max(axis=2, initial=0.0) > VANISHING
