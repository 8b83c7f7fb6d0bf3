# SPDX-License-Identifier: Apache-2.0
"""Layout of a scene: its model, and the names and frames of its arrays."""

import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from liegroup_core.dynamics.usual_pivot import with_usual_pivot
from liegroup_core.errors import SceneError
from liegroup_core.forces import kinds
from liegroup_core.forces.acting import Acting
from liegroup_core.forces.applied_wrench import wrenches_of
from liegroup_core.forces.commands import MOTION, SCENE, Command
from liegroup_core.forces.joint_effort import unit_wrenches
from liegroup_core.forces.law import held_of, laws_of, leaders, signals_of, states_of
from liegroup_core.joints.coupling import COUPLED
from liegroup_core.joints.kinds import ROLLING
from liegroup_core.joints.limits import limits_of
from liegroup_core.joints.motion import COLUMNS, row_at
from liegroup_core.joints.pairs import LOWER_PAIRS
from liegroup_core.lie.groups import UNKNOWN_TURN
from liegroup_core.mechanism.arrays import PlaneModel
from liegroup_core.mechanism.bodies import Model
from liegroup_core.mechanism.body_model import build_model, initial_state, levers
from liegroup_core.mechanism.freedoms import freedoms_of
from liegroup_core.mechanism.mechanism import refuse_cut_couplings, refuse_freedoms_without_inertia, relative_model
from liegroup_core.mechanism.size import mechanism_size
from liegroup_core.mechanism.spanning_tree import WORLD_NAME
from liegroup_core.methods.table import RELATIVE
from liegroup_core.observables.joint_coordinates import JointCoordinates
from liegroup_core.observables.quantities import Catalogue
from liegroup_core.observables.reactions import Reactions
from liegroup_core.observables.sample import Sample
from liegroup_core.observables.touching import Touching
from liegroup_core.scene.assembly import ready
from liegroup_core.scene.centres import Offsets
from liegroup_core.scene.consistency import resolve_drives, resolve_frames
from liegroup_core.scene.description import Scene
from liegroup_core.scene.drive import wheels_of
from liegroup_core.scene.massless import lack_of_inertia
from liegroup_core.scene.switches import switches_of, unit_of
from liegroup_core.threads import one_blas_thread

NO_MOTIONS = np.zeros((0, COLUMNS))
NO_ANGLES = np.zeros(0)
# m p^2 / I of a joint at a distance p, above which 1 / m is lost to round-off next to p^2 / I in W of a cut joint.
LONGEST_LEVER = 2.0**52


@dataclass(frozen=True)
class Layout:
    """Model of a scene, with the names of its indices and the frames of its quantities.

    Model and states refer to frames at the centres of mass. Samples and external wrenches refer to
    the body frames of the scene.
    """

    scene: Scene  # as written, but assembled
    centred: Scene  # the same with body frames at the centres of mass
    offsets: Offsets  # from the body frames to the centres of mass
    model: Model
    joint_frames: tuple  # (parent frame, child frame) of the joints of `centred`
    owners: tuple  # scene joint of each element of the model
    row_names: tuple  # names of the rows of each element
    kept_rows: tuple  # numbers of the independent rows of each element

    @cached_property
    def relative(self):
        """RelativeModel of the scene; a PlaneModel if the joints keep all bodies in a plane."""
        return self._with_usual_pivot(relative_model(self.centred, self.model))

    @property
    def normal(self):
        """Unit normal (3,), world axes, of the plane in which the joints keep all bodies, or None."""
        planar = isinstance(self.relative, PlaneModel)
        return self.relative.axes[0, 2::3] if planar else None

    @cached_property
    def relative_in_space(self):
        """RelativeModel of the scene that is not a PlaneModel."""
        if self.normal is None:
            return self.relative
        return self._with_usual_pivot(relative_model(self.centred, self.model, in_space=True))

    @cached_property
    def in_space(self):
        """The same Layout with a `relative` that is not a PlaneModel, and its freedoms."""
        layout = replace(self)
        layout.__dict__.update(relative=self.relative_in_space, motions=self.motions)
        return layout

    def floating(self, group):
        """RelativeModel with an empty tree, on a group of FLOATING: all bodies float, all joints are cut."""
        if group not in self._floating:
            inverse = self.model.bodies["inverse_inertia"].reshape(-1, 3, 3)
            ratios = levers(self.model.bodies["mass"], inverse, self.model.elements)
            if max(ratios, default=0.0) > LONGEST_LEVER:
                raise _unsolvable(self.scene, "check their units, or use group relative")
            self._floating[group] = self._with_usual_pivot(
                relative_model(self.centred, self.model, in_space=True, group=group)
            )
        return self._floating[group]

    @cached_property
    def _floating(self):
        return {}

    def _with_usual_pivot(self, model):
        pose, twist = initial_state(self.centred)
        return with_usual_pivot(model, pose, twist, self.angles(pose, None))

    def drifts(self, group):
        """Whether joints drift with a Munthe-Kaas method on a group.

        In relative coordinates, cut and driven joints and curved couplings do, but other couplings do not. On
        SE(3)^n all joints do except one lower pair per body to ground, on (SO(3) x R^3)^n all.
        """
        if group == RELATIVE:
            couplings = self.relative.couplings
            exact = (couplings["motion"] < 0) & (couplings["curved"] == 0)
            return len(self.relative.cuts) > exact.sum()
        joints = self.scene.joints
        held = [body for joint in joints for body in (joint.parent, joint.child)]
        return group == "so3xr3" or any(
            joint.type not in LOWER_PAIRS
            or WORLD_NAME not in (joint.parent, joint.child)
            or max(map(held.count, {joint.parent, joint.child} - {WORLD_NAME})) > 1
            for joint in joints
        )

    @cached_property
    def lack_of_inertia(self):
        """Text that names a body without inertia about an axis, or ""; see scene/massless.py."""
        return lack_of_inertia(self.centred)

    @property
    def needs_relative(self):
        """Reason why the scene needs relative coordinates, or ""."""
        if self.lack_of_inertia or self.scene.couplings:
            return self.lack_of_inertia or "it has couplings"
        if any(joint.rotor for joint in self.scene.joints):
            return "its joints have rotors"
        return "it has driven joints" if self.motions else self.needs_events

    @cached_property
    def switches(self):
        """[Switch]: coordinates with stops or friction, in the order of all arrays."""
        return switches_of(self.scene)

    @cached_property
    def switch_sizes(self):
        """(k,) characteristic length in the unit of each switch: 1 rad, or m."""
        units = [unit_of(switch, self.scene) for switch in self.switches]
        return np.array([self.size if unit == "m" else 1.0 for unit in units])

    @property
    def rolls(self):
        """Text that names joints which forbid velocities only, or ""."""
        return "it has wheels, balls that roll, or knife edges" if self._rolling else ""

    @property
    def _rolling(self):
        return any(joint.type in ROLLING for joint in self.scene.joints)

    @property
    def needs_events(self):
        """Reason why the scene needs events, or ""."""
        return "its joints have limits or friction" if self.switches else ""

    @cached_property
    def no_modes(self):
        """(k, 5) modes of the joints with stops or friction that are all free, see Sample.switching."""
        return np.zeros((len(self.switches), 5))

    @cached_property
    def motions(self):
        """{joint: (m, 7) its prescribed motions} of the driven joints of the scene, in its order."""
        drives = resolve_drives(self.centred)
        return {self.centred.joints[j].name: rows for j, rows in drives.items()}

    def with_motions(self, motions):
        """Layout with other prescribed motions {joint: (m, 7)} of driven joints, wherever these are at the start."""
        layout = replace(self)
        layout.__dict__["motions"] = self.motions | motions
        return layout

    def with_model(self, model):
        """Layout with other options of its model; reuses everything that does not depend on them."""
        layout = replace(self, model=model)
        layout.__dict__.update(lack_of_inertia=self.lack_of_inertia, motions=self.motions)

        def changed(relative):
            return relative.replace(
                space=model, projects=model.projects and len(relative.cuts) > 0, baumgarte_rate=model.baumgarte_rate
            )

        for name in ("relative", "relative_in_space"):
            if name in self.__dict__:
                layout.__dict__[name] = changed(self.__dict__[name])
        layout._floating.update({group: changed(m) for group, m in self._floating.items()})
        return layout

    @cached_property
    def joint_of_row(self):
        """Index of the scene joint of each position residual, (all rows,)."""
        return np.repeat(np.array(self.owners, dtype=np.int64), self.model.elements["rows"])

    @property
    def body_names(self):
        """Names of the bodies, in the order of all arrays."""
        return tuple(body.name for body in self.scene.bodies)

    @property
    def dropped_rows(self):
        """[(joint, row)] of redundant rows, which are eliminated; rows are named wx..vz."""
        return [
            (self.scene.joints[self.owners[e]].name, name)
            for e, (names, kept) in enumerate(zip(self.row_names, self.kept_rows))
            for r, name in enumerate(names)
            if r not in kept
        ]

    @cached_property
    def catalogue(self):
        """Catalogue of the quantities of the scene."""
        return Catalogue(self)

    @cached_property
    def coordinates(self):
        """JointCoordinates of the joints with one degree of freedom."""
        return JointCoordinates(self.centred, self.joint_frames)

    @cached_property
    def reactions(self):
        """Reactions of the joints, and the wrenches of the forces at them."""
        return Reactions(self)

    @cached_property
    def child_frames(self):
        """{joint: (4, 4) its frame in the body frame of its child}."""
        frames = resolve_frames(self.scene)
        return {joint.name: F_b for joint, (_, F_b) in zip(self.scene.joints, frames)}

    @cached_property
    def freedoms(self):
        """[Freedom] of the spanning tree of `relative`."""
        return freedoms_of(self.centred, self.normal)

    @cached_property
    def contacts(self):
        """[(rolling joint, parent or None: the world, normal (3,) of its plane there, child, frame (4, 4) in it)]."""
        frames = resolve_frames(self.scene)
        return [
            (joint, joint.parent if joint.parent in self.body_names else None, F_a[:3, 2], joint.child, F_b)
            for joint, (F_a, F_b) in zip(self.scene.joints, frames)
            if joint.type in ROLLING and hasattr(joint, "radius")
        ]

    @cached_property
    def touching(self):
        """Touching: the points of the contacts of the scene."""
        return Touching(self)

    @cached_property
    def joint_forces(self):
        """{name: force} of the forces about or along the z axis of a joint."""
        return {force.name: force for force in self.scene.forces if force.joint_moves}

    @cached_property
    def signals(self):
        """{LAW.SIGNAL: its register} of the laws of the scene."""
        return signals_of(self.centred.forces)  # numbers of a contact depend on the frame of its body

    @cached_property
    def states(self):
        """Names of what sampled laws hold and of the states of laws, LAW.STATE, in the order of `angles`."""
        return (*held_of(self.scene.forces), *(name for name, _ in states_of(self.scene.forces)))

    @cached_property
    def law_efforts(self):
        """[(joint, register)] of the efforts of laws."""
        rows = self.model.forces.laws.outputs[:]
        outputs = [each for law in laws_of(self.scene.forces) for each in law.outputs]
        joints = [each.joint for each in outputs if each.servo is None]
        return [(joint, int(row["registers"][0])) for joint, row in zip(joints, rows) if joint is not None]

    @cached_property
    def unit_efforts(self):
        """{joint: [(body index, wrench (6,))]} of unit efforts; see forces/joint_effort.py."""
        index = {name: i for i, name in enumerate(self.body_names)}
        return unit_wrenches(self.scene.joints, self.joint_frames, index, self.offsets.com)

    @cached_property
    def servos(self):
        """{joint: number} of the joints with a servo; the number is that of its targets."""
        return {servo.joint: i for i, servo in enumerate(kinds.servos(self.scene.forces))}

    @cached_property
    def leaders(self):
        """{joint: law} of the servos whose target is an output of a law."""
        joints = {servo.name: servo.joint for servo in kinds.servos(self.scene.forces)}
        return {joints[name]: law for name, law in leaders(self.scene.forces).items()}

    @cached_property
    def size(self):
        """Characteristic length of the mechanism, m."""
        return mechanism_size(self.model, self.scene.joints)

    @cached_property
    def wheels(self):
        """Wheels of the drive of the scene, or None."""
        return None if self.scene.drive is None else wheels_of(self.centred, self.joint_frames)

    @cached_property
    def limits(self):
        """{joint: CommandLimits} of commands to the joints with one coordinate, including screws."""
        return {j.name: limits_of(j, self.size) for j in self.scene.joints if j.type in COUPLED}

    @cached_property
    def targets(self):
        """(k, 2) target positions and velocities of the servos without a command."""
        return kinds.target_values(self.model.forces)

    @cached_property
    def commands(self):
        """[(start, end in s, Command)] of the scene: its applied wrenches, and the motions of its driven joints."""
        _, wrenches = self._wrenches
        found = [(each.start, math.inf if each.end is None else each.end, each.command) for each in wrenches]
        for joint, rows in self.motions.items():
            starts = [-math.inf, *rows[1:, 0].tolist()]
            rows = map(tuple, rows.tolist())
            found += [(start, math.inf, Command(MOTION, joint, row, source=SCENE)) for start, row in zip(starts, rows)]
        return found

    def wrenches_at(self, time):
        """(n, COLUMNS) external wrenches of the scene that act from a time in s on."""
        index, forces = self._wrenches
        return wrenches_of(forces, index, self.offsets, time)

    @cached_property
    def _wrenches(self):
        """{body: number}, and the applied wrenches of the scene."""
        forces = [force for force in self.scene.forces if force.type == "applied_wrench"]
        return {name: i for i, name in enumerate(self.body_names)}, forces

    def acting_at(self, time):
        """Acting, what acts by the scene from a time in s on."""
        return Acting(self.wrenches_at(time), self.targets, self.motions_at(time))

    def motions_at(self, time):
        """(d, 7) motion of each driven joint that holds from a time on; see joints/motion.py."""
        if not self.motions:
            return NO_MOTIONS
        origins, table = self._rows_of_motions
        if len(table) == len(origins):
            return table.copy()
        return table[[max(0, bisect_right(some, time) - 1) + at for at, some in origins]]

    def motions_along(self, times):
        """(m, d, 7) motions of the scene that hold at times (m,) in s."""
        found = np.empty((len(times), len(self.motions), COLUMNS))
        for joint, rows in enumerate(self.motions.values()):
            found[:, joint] = row_at(rows, times)
        return found

    @cached_property
    def _rows_of_motions(self):
        """([(first row, origins in s) of each driven joint], all rows) of `motions`."""
        counts = [len(rows) for rows in self.motions.values()]
        origins = [rows[:, 0].tolist() for rows in self.motions.values()]
        firsts = np.cumsum([0, *counts[:-1]]).tolist()
        return list(zip(firsts, origins)), np.vstack(list(self.motions.values()))

    def sample(self, pose, twist, time=0.0, time_ns=0, steps=0, near=None):
        """Create a Sample from pose (n, 12) and twist (n, 6) of the body frames, as in a recording.

        near : (k,) rad, earlier `Sample.angles` that differ by less than pi: a pose determines
               angles only modulo 2 pi. None: all angles are in (-pi, pi]
        """
        near = None if near is None else np.array(near)
        pose, twist = self.offsets.to_centres(
            np.array(pose, dtype=float, order="C"), np.array(twist, dtype=float, order="C")
        )
        return Sample(self, time, time_ns, steps, pose, twist, near)

    def angles(self, pose, near=None):
        """Unwrapped angles (k,), see `Scene.unwrapped`, at a pose (n, 12), rad, then numbers of laws, see `states`.

        near : see `sample`
        """
        forces = self.model.forces
        if not kinds.count(forces):
            return NO_ANGLES
        angles = np.full(kinds.count(forces), UNKNOWN_TURN)
        angles[len(forces.counted) :] = forces.laws.start
        if near is not None:
            angles[:] = near
        kinds.count_turns(forces, pose, angles)
        return angles


@one_blas_thread()
def make_layout(scene):
    """Build the Layout of a scene. Raises SceneError."""
    try:
        try:
            described, centred = ready(scene)
            layout = Layout(described, centred, Offsets(described), *build_model(centred))
            if layout.scene.couplings or layout.motions:
                refuse_cut_couplings(centred)
            if layout.needs_relative:
                _ = layout.relative  # refuses driven joints that depend on others, cut switches and rotors
            if layout.lack_of_inertia:
                refuse_freedoms_without_inertia(centred)
            return layout
        except np.linalg.LinAlgError:
            raise _unsolvable(scene) from None
    except SceneError as error:
        raise scene.located(error) from None


def _unsolvable(scene, advice="check their units"):
    """SceneError for matrices that are singular in floating point; names the most likely body."""

    def spread(i):
        moments = np.linalg.eigvalsh(scene.bodies[i].inertia_matrix)
        numbers = np.log(np.maximum([scene.bodies[i].mass, *moments], 1e-300))
        return numbers.max() - numbers.min()

    i = max(range(len(scene.bodies)), key=spread)
    body = scene.bodies[i]
    inertia = np.linalg.eigvalsh(body.inertia_matrix).min()
    return SceneError(
        f'bodies[{i}] "{body.name}": its mass of {body.mass:g} kg and its inertia of '
        f"{inertia:g} kg m^2 differ too much for the equations to be solved; {advice}",
        ("bodies", i),
    )
