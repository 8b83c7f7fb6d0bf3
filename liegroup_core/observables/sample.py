# SPDX-License-Identifier: Apache-2.0
"""Sample: an immutable, named copy of a state. Users and outputs see states only as Samples."""

import math
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from liegroup_core.dynamics.constraints import position_residuals
from liegroup_core.forces import kinds, law
from liegroup_core.forces.acting import Acting
from liegroup_core.forces.external import acts, set_external_wrenches
from liegroup_core.forces.external import power as power_of
from liegroup_core.forces.instants import just_after
from liegroup_core.joints import motion
from liegroup_core.joints.kinds import TYPES
from liegroup_core.lie.groups import cross, within_a_turn
from liegroup_core.observables import invariants

from .along import powers, quaternions, rows

PULLS = 1e-9  # of the weight, or at 1 m/s^2: a force that pulls more is not round-off


class Sample:
    """State of a mechanism at one instant.

    layout : Layout of its scene
    time, time_ns, steps : s, ns, and number of steps since the start or the last reset
    errors : (n, 4) estimated errors, see `error`; None without an estimate
    bound : (m, rad) largest pose errors that an accuracy allows at this time; None with a method
    acting : Acting, at the end of the last step; by default that of the scene from this time on
    joint_efforts : {joint: N m or N} commanded efforts that acted at the end of the last step
    switching : (k, 5) modes of the joints with stops or friction, in the order of the scene: 1 if held, 2 if
                it rests because other joints are held; direction of slip; touched stop (-1 lower, 1 upper);
                coordinate; effort in case of 2. None: all free
    The constructor takes pose and twist at the centres of mass; all attributes refer to the body
    frames of the scene. Derived quantities are computed on first access and cached.
    """

    errors = None
    bound = None
    joint_efforts: Mapping[str, float] = MappingProxyType({})
    switching = None

    def __init__(self, layout, time, time_ns, steps, pose, twist, near):
        self._layout, self._near = layout, near
        self.time, self.time_ns, self.steps = time, time_ns, steps
        self._state = pose, twist
        for array in self._state:
            array.flags.writeable = False

    def __repr__(self) -> str:
        bodies = ", ".join(f"{name} at {at.round(6).tolist()} m" for name, at in list(self.positions.items())[:3])
        return f"Sample(t = {self.time:.9g} s, step {self.steps}: {bodies}{', ...' if len(self.pose) > 3 else ''})"

    @cached_property
    def _at_bodies(self):
        found = self._layout.offsets.to_bodies(*self._state)
        for array in found:
            array.flags.writeable = False
        return found

    @cached_property
    def pose(self) -> NDArray[np.float64]:
        """(n, 12) per body R row by row, then r in m; body frame -> world."""
        return self._at_bodies[0]

    @cached_property
    def twist(self) -> NDArray[np.float64]:
        """(n, 6) per body omega rad/s, v m/s; body axes, v of the frame's origin."""
        return self._at_bodies[1]

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies in the order of `pose` and `twist`."""
        return self._layout.body_names

    def _by_body(self, values):
        return dict(zip(self._layout.body_names, values))

    @cached_property
    def pose_matrices(self) -> NDArray[np.float64]:
        """(n, 4, 4) homogeneous poses, body frame -> world."""
        matrices = np.zeros((len(self.pose), 4, 4))
        matrices[:, :3, :3] = self.pose[:, :9].reshape(-1, 3, 3)
        matrices[:, :3, 3] = self.pose[:, 9:]
        matrices[:, 3, 3] = 1.0
        matrices.flags.writeable = False
        return matrices

    @cached_property
    def poses(self) -> dict[str, NDArray[np.float64]]:
        """{body: (4, 4)} homogeneous poses, body frame -> world."""
        return self._by_body(self.pose_matrices)

    @cached_property
    def twists(self) -> dict[str, NDArray[np.float64]]:
        """{body: (6,)} (omega, v), body-fixed."""
        return self._by_body(self.twist)

    @cached_property
    def positions(self) -> dict[str, NDArray[np.float64]]:
        """{body: (3,)} positions of the body frame's origin, m, world axes."""
        return self._by_body(self.pose[:, 9:])

    @cached_property
    def orientation(self) -> NDArray[np.float64]:
        """(n, 4) quaternions x, y, z, w of the rotations body -> world, w >= 0."""
        return quaternions(self.pose)

    @cached_property
    def quaternions(self) -> dict[str, NDArray[np.float64]]:
        """{body: (4,)} quaternion x, y, z, w of the rotation body -> world, w >= 0."""
        return self._by_body(self.orientation)

    @property
    def error(self) -> dict[str, NDArray[np.float64]] | None:
        """{body: (4,)} estimated errors of position m, attitude rad, velocity m/s, rotation rad/s.

        How far the state may be from the exact motion of the scene since the start, all earlier steps and wrenches
        included. To an accuracy it is 9 times the true error in the median, and in 2 % of all samples below half of
        it (benchmarks/estimate_coverage.py). None if the simulation carries no estimate.
        """
        return None if self.errors is None else self._by_body(self.errors)

    @property
    def rows(self) -> NDArray[np.float64]:
        """(n, 13) per body x, y, z, qx, qy, qz, qw, v, omega, as in ROS messages."""
        return rows(self.pose, self.twist)

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """(k,) rad, unwrapped angles of all torsional springs, then of couplings; see Scene."""
        return self._layout.angles(self._state[0], self._near)

    @cached_property
    def joint_coordinates(self) -> dict[str, tuple[float, float]]:
        """{joint: (position, velocity)}, in rad and rad/s for revolute and screw, in m and m/s for prismatic joints.

        The angle is unwrapped if the joint is a screw, has a torsional spring, is coupled or driven. Other angles
        are between -pi and pi.
        """
        found = self._layout.coordinates.at(*self._state, self.angles)
        for joint, (position, *_) in self.prescribed.items():
            if self._layout.coordinates.units.get(joint) == "rad":
                angle, rate = found[joint]
                found[joint] = within_a_turn(angle, position), rate
        return found

    @cached_property
    def energy(self) -> float:
        """Kinetic energy plus potential energy of gravity and springs, J."""
        return invariants.energy(self._layout.model, self.angles, *self._state)

    @cached_property
    def power(self) -> float:
        """Power of the scene's non-conservative forces, W; the rate of `energy` without external wrenches.

        It includes motors, servos, applied wrenches of the scene, dampers, drag and driven joints. It does
        not include the power of external wrenches.
        """
        forces = self._layout.model.forces
        rates = self.prescribed
        driving = sum(effort * rates[joint][1] for joint, effort in self.drive_efforts.items())
        driving += kinds.power(forces, self.angles, self.acting.targets, self.registers, *self._state)
        return driving + power_of(self._layout.wrenches_at(just_after(self.time)), *self._state)

    @cached_property
    def acting(self) -> Acting:
        """External wrenches, targets of the servos and motions of the driven joints that act."""
        return self._layout.acting_at(just_after(self.time))

    @property
    def _inputs(self):
        """Arguments of Reactions.at."""
        return *self._state, self.angles, self.acting, self._switching, self.time

    @cached_property
    def _reactions(self):
        return self._layout.reactions.at(*self._inputs)

    @property
    def _switching(self):
        if self.switching is not None:
            return self.switching
        return self._layout.no_modes

    @property
    def modes(self) -> dict[str, str]:
        """{joint: "free", "lower" or "upper" (at this stop), "stick"} for joints with stops or friction.

        Cylindrical joints have the keys JOINT/rotation and JOINT/translation, couplings with backlash their name.
        """
        names = [switch.name for switch in self._layout.switches]
        return {
            name: "lower" if side < 0.0 else "upper" if side > 0.0 else "stick" if held else "free"
            for name, (held, _, side, *_) in zip(names, self._switching.tolist())
        }

    def _by_joint(self, values):
        return dict(zip(self._layout.reactions.names, values))

    @property
    def reaction_array(self) -> NDArray[np.float64]:
        """(J, 6) `reactions` of all joints, in the order of the scene."""
        return self._reactions[0][: len(self._layout.reactions.names)]

    @cached_property
    def reactions(self) -> dict[str, NDArray[np.float64]]:
        """{joint: (6,)} torque N m, force N that the joint exerts on its child.

        In the axes and about the origin of the child's joint frame. Components that redundant constraints
        leave undetermined are NaN, see `undetermined`. Stops and friction are included, about or along
        the axis, and couplings along the axes of their two joints. Springs, motors and other forces are
        not, see `force_efforts` and `transmitted`. External wrenches are those of the last step. At the end
        of a tree of n bodies, errors are about n times those of a wrench: test/verification/test_reactions.py.
        """
        return self._by_joint(self._reactions[0])

    @cached_property
    def contacts(self) -> dict[str, tuple[float, float]]:
        """{wheel or ball that rolls: (force normal to its plane, along it)} on it, N; a negative first one pulls.

        What redundant constraints leave undetermined is the smallest one, see `minimum_norm_reactions`.
        """
        layout, found = self._layout, {}
        forces = self.minimum_norm_reactions if layout.contacts else {}
        turns = dict(zip(layout.body_names, self.pose[:, :9].reshape(-1, 3, 3)))
        for joint, parent, normal, child, frame in layout.contacts:
            force = turns[child] @ frame[:3, :3] @ forces[joint.name][3:]
            n = normal if parent is None else turns[parent] @ normal
            up = float(force @ n)
            found[joint.name] = up, float(np.linalg.norm(force - up * n))
        return found

    @cached_property
    def contact_points(self) -> dict[str, NDArray[np.float64]]:
        """{wheel, ball that rolls, or contact that presses: (3,) m, world axes} points at which they touch.

        Of a contact with several points it is their mean, weighted by the normal forces: the centre of pressure.
        """
        layout, poses = self._layout, self.poses
        found = {name: at for name, at in zip(layout.touching.names, self.touching[:, :3]) if at[0] == at[0]}
        for joint, parent, normal, child, frame in layout.contacts:
            n = normal if parent is None else poses[parent][:3, :3] @ normal
            own = poses[child] @ frame
            if joint.type == "wheel":  # towards where its rim is lowest
                n = n - own[:3, 2] * (own[:3, 2] @ n)
                n /= np.linalg.norm(n)
            found[joint.name] = own[:3, 3] - joint.radius * n
        return found

    @cached_property
    def touching(self) -> NDArray[np.float64]:
        """(c, 9) of each contact: `contact_points`, NaN where nothing presses, and `contact_wrenches`."""
        touching = self._layout.touching
        return touching.at(self.registers, self._state[0]) if touching.names else np.empty((0, 9))

    @property
    def contact_wrenches(self) -> dict[str, NDArray[np.float64]]:
        """{contact: (6,)} torque N m, force N on its body; body axes, about the origin of the body frame."""
        return dict(zip(self._layout.touching.names, self.touching[:, 3:]))

    @property
    def contact_forces(self) -> NDArray[np.float64]:
        """(c, 2, 3) of each contact: point as in `contact_points`, or NaN, and force on the body; world axes."""
        turns = self.pose[self._layout.touching.bodies, :9].reshape(-1, 3, 3)
        return np.stack([self.touching[:, :3], (turns @ self.touching[:, 6:, None])[..., 0]], axis=1)

    @property
    def pressing(self) -> NDArray[np.float64]:
        """(m, 5) of each point of the contacts: 1 where it presses, x, y, z in m, world axes, 1 where it slips, else 0.

        The four points of a rim of a cylinder are one, their centre of pressure. Without friction a point slips.
        """
        touching = self._layout.touching
        return touching.pressing(self.registers, self._state[0]) if touching.names else np.empty((0, 5))

    @property
    def slipping(self) -> tuple[str, ...]:
        """Joints whose contact would need a force that pulls, or more friction than their `mu`.

        Without any `mu`, shares of normal forces that are undetermined are not computed, which takes longer.
        """
        scene, rolling = self._layout.scene, [joint for joint, *_ in self._layout.contacts]
        if not rolling:
            return ()
        contacts = self._determined_normals if all(joint.mu is None for joint in rolling) else self.contacts
        least = PULLS * sum(body.mass for body in scene.bodies) * max(1.0, float(np.linalg.norm(scene.gravity)))
        return tuple(
            joint.name
            for joint in rolling
            if contacts[joint.name][0] < -least
            or joint.mu is not None
            and contacts[joint.name][1] > joint.mu * contacts[joint.name][0]
        )

    @property
    def _determined_normals(self):
        """{contact: (normal force, )}, NaN where redundant constraints leave it undetermined."""
        turns, found = dict(zip(self._layout.body_names, self.pose[:, :9].reshape(-1, 3, 3))), {}
        for joint, parent, normal, child, frame in self._layout.contacts:
            n = (turns[child] @ frame[:3, :3]).T @ (normal if parent is None else turns[parent] @ normal)
            force = self.reactions[joint.name][3:]
            found[joint.name] = (float(np.where(np.abs(n) > PULLS, n * force, 0.0).sum()),)
        return found

    @cached_property
    def external_wrenches(self) -> NDArray[np.float64]:
        """(n, 6) sum of the applied wrenches on each body: N m, N; body axes, about the origin of its frame.

        Those of `apply_wrench`, `apply_effort` and `pull`, at the end of the last step, and of the scene.
        """
        external, found = self.acting.external, np.zeros((len(self.pose), 6))
        if acts(external):
            set_external_wrenches(external, *self._state, found)
            found[:, :3] += cross(self._layout.offsets.com, found[:, 3:])
        return found

    @cached_property
    def force_efforts(self) -> dict[str, float]:
        """{force: effort on the child, N m about or N along the z axis of its joint}.

        These are the springs, dampers, motors and servos of the scene at joints. Commanded efforts are in
        `joint_efforts`.
        """
        layout, out = self._layout, np.zeros(len(self._layout.joint_forces))
        if len(out):
            given = self.angles, self.acting.targets, self.registers
            kinds.efforts(layout.model.forces, *given, *self._state, out)
        found = {force.name: effort for force, effort in zip(kinds.joint_laws(self.scene.forces), out.tolist())}
        return {name: found[name] for name in layout.joint_forces}

    @cached_property
    def registers(self) -> NDArray[np.float64]:
        """(m, 2) numbers of the laws, see forces/law.py."""
        found = kinds.registers_at(self._layout.model.forces, self.time, self.angles)
        law.measure_all(self._layout.model.forces.laws, self.angles, *self._state, found)
        return found

    @cached_property
    def signals(self) -> dict[str, float]:
        """{LAW.SIGNAL: number} of the laws of the scene."""
        places = self._layout.signals
        return dict(zip(places, self.registers[list(places.values()), 0].tolist())) if places else {}

    @cached_property
    def law_powers(self) -> dict[str, float]:
        """{law: power in W of its efforts and wrenches}, also of contacts."""
        laws = law.laws_of(self.scene.forces)
        state = self.angles[None], self.acting.targets, [self.time], *(part[None] for part in self._state)
        found = powers(self._layout, *state)[0, len(kinds.POWERS) :] if laws else ()
        return dict(zip((each.name for each in laws), map(float, found)))

    @cached_property
    def law_efforts(self) -> dict[str, float]:
        """{joint: N m or N} sum of the efforts of the laws on the child of a joint."""
        found = {}
        for joint, register in self._layout.law_efforts:
            found[joint] = found.get(joint, 0.0) + float(self.registers[register, 0])
        return found

    @cached_property
    def transmitted(self) -> dict[str, NDArray[np.float64]]:
        """{joint: (6,)} wrench that a joint transmits to its child; axes as for `reactions`.

        Sum of the reaction, `force_efforts`, `law_efforts` and `joint_efforts`, as an ideal force-torque sensor
        between the joint and its child measures it.
        """
        found = {joint: wrench.copy() for joint, wrench in self.reactions.items()}
        for force, effort in zip(self._layout.joint_forces.values(), self.force_efforts.values()):
            found[force.joint][2 if force.joint_moves == "turns" else 5] += effort
        units = self._layout.coordinates.units
        for joint, effort in (*self.joint_efforts.items(), *self.law_efforts.items()):
            found[joint][2 if units[joint] == "rad" else 5] += effort
        return found

    @cached_property
    def accelerations(self) -> dict[str, NDArray[np.float64]]:
        """{body: (6,)} angular acceleration, rad/s^2, and that of the body frame's origin, m/s^2; body axes.

        The wrenches are the same as for `reactions`.
        """
        motion = self._reactions[0][len(self._layout.reactions.names) :]
        R = self.pose[:, :9].reshape(-1, 3, 3)
        w, dw = self.twist[:, :3], motion[:, :3]
        arm = -self._layout.offsets.com
        linear = motion[:, 3:] + cross(dw, arm) + cross(w, cross(w, arm))
        linear += np.array(self.scene.gravity) @ R
        return self._by_body(np.hstack([dw, linear]))

    @cached_property
    def sensors(self) -> dict[str, NDArray[np.float64]]:
        """{sensor: measured numbers} of the scene's sensors, with noise; see docs/reference/scene_format.md."""
        return {sensor.name: sensor.read(self) for sensor in self.scene.sensors}

    @property
    def child_frames(self) -> dict[str, NDArray[np.float64]]:
        """{joint: (4, 4) joint frame in the frame of the child}, the frames of `reactions`."""
        return self._layout.child_frames

    @property
    def scene(self):
        """Scene of the mechanism."""
        return self._layout.scene

    @cached_property
    def minimum_norm_reactions(self) -> dict[str, NDArray[np.float64]]:
        """As `reactions`, with undetermined components from the minimum-norm multipliers of unit rows.

        For the norm, torques are divided by the characteristic length of the closed loop.
        """
        return self._by_joint(self._layout.reactions.minimum_norm(*self._inputs))

    @cached_property
    def undetermined(self) -> dict[str, str]:
        """{joint: reason why components of its reaction are undetermined}, only joints that have some."""
        return self._layout.reactions.reasons(self._reactions[1])

    @cached_property
    def servo_efforts(self) -> dict[str, float]:
        """{joint: effort of its servo}, N m or N, within its limit."""
        if not self._layout.servos:
            return {}
        return {servo.joint: self.force_efforts[servo.name] for servo in kinds.servos(self.scene.forces)}

    @property
    def all_efforts(self) -> dict[str, float]:
        """{joint: N m or N}: sum of its effort in `joint_efforts` and those of its servo or drive and of laws."""
        efforts = {**self.servo_efforts, **self.drive_efforts}
        for joint, effort in (*self.joint_efforts.items(), *self.law_efforts.items()):
            efforts[joint] = efforts.get(joint, 0.0) + effort
        return efforts

    @cached_property
    def total_efforts(self) -> dict[str, float]:
        """{joint: N m or N}: sum of its effort in `joint_efforts`, those of its drive, laws and `force_efforts`.

        Joints at which nothing acts are not in it. Friction and stops are not included.
        """
        efforts = {**self.joint_efforts}
        found = ((force.joint, self.force_efforts[name]) for name, force in self._layout.joint_forces.items())
        for joint, effort in (*self.drive_efforts.items(), *found, *self.law_efforts.items()):
            efforts[joint] = efforts.get(joint, 0.0) + effort
        return efforts

    @cached_property
    def saturated(self) -> tuple[str, ...]:
        """Joints whose servo is at its effort limit."""
        limits = (servo.effort_limit or math.inf for servo in kinds.servos(self.scene.forces))
        return tuple(joint for (joint, effort), most in zip(self.servo_efforts.items(), limits) if abs(effort) >= most)

    @property
    def prescribed(self) -> dict[str, tuple[float, float, float]]:
        """{driven joint: prescribed position, velocity, acceleration}, rad or m, and per s and s^2."""
        return {joint: motion.at(row, self.time) for joint, row in zip(self._layout.motions, self.acting.motions)}

    @cached_property
    def drive_efforts(self) -> dict[str, float]:
        """{driven joint: effort that its motion requires}, N m or N on the child.

        NaN if redundant constraints leave it undetermined. It does not include motors, springs and other
        forces at the joint, nor the efforts of couplings. Tested in test/verification/test_driven.py.
        """
        if not self._layout.motions:
            return {}
        _, mask, efforts = self._reactions
        lost = dict(zip(self._layout.reactions.names, mask))
        types = {joint.name: joint.type for joint in self.scene.joints}
        return {
            joint: math.nan if lost[joint][TYPES[types[joint]].rate] else float(effort)
            for joint, effort in zip(self._layout.motions, efforts)
        }

    @cached_property
    def spatial_momentum(self) -> NDArray[np.float64]:
        """(6,) angular momentum about the world origin, then linear momentum; world axes."""
        mass, inertia = (self._layout.model.bodies[key] for key in ("mass", "inertia"))
        return np.concatenate(invariants.momenta(mass, inertia.reshape(-1, 3, 3), *self._state, np.zeros(3)))

    @cached_property
    def joint_residuals(self) -> dict[str, float]:
        """{joint: norm of its position residual}, m and rad."""
        model, joints = self._layout.model, self._layout.scene.joints
        residual = np.zeros(len(self._layout.joint_of_row))
        position_residuals(model, self._state[0], residual)
        squares = np.bincount(self._layout.joint_of_row, residual**2, len(joints))
        return {joint.name: float(norm) for joint, norm in zip(joints, np.sqrt(squares))}

    @cached_property
    def constraint_residual(self) -> float:
        """The largest joint residual, 0 without joints."""
        return max(self.joint_residuals.values(), default=0.0)
