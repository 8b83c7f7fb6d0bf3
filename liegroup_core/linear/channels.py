# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of a linearised mechanism, by name.

Inputs: JOINT.effort (N m or N), JOINT.target and JOINT.target_velocity of a servo, BODY.torque_x .. BODY.force_z
in body axes. Outputs: JOINT.position and JOINT.velocity; BODY.rx .. BODY.z, the rotation vector in body axes and
the displacement in world axes; BODY.wx .. BODY.vz, the twist in body axes; BODY.alpha_x .. BODY.az, the
acceleration of the body frame in body axes; JOINT.effort of a servo or a driven joint; JOINT.torque_x ..
JOINT.force_z, the reaction on the child in its joint frame; SENSOR.0, SENSOR.1, ..., without noise and steps of
resolution.
"""

from functools import cached_property

import numpy as np
import scipy

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import suggestion
from liegroup_core.forces.external import set_wrench

WRENCH = ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z")
POSE, TWIST = ("rx", "ry", "rz", "x", "y", "z"), ("wx", "wy", "wz", "vx", "vy", "vz")
ACCELERATION = ("alpha_x", "alpha_y", "alpha_z", "ax", "ay", "az")
# Names that stand for many.
INPUTS = ("efforts", "targets", "wrenches")
OUTPUTS = ("joints", "bodies", "twists", "accelerations", "efforts", "reactions", "sensors")


class InputChannels:
    """Inputs of a Probe.

    wanted : names, or those of INPUTS that stand for many; None: targets of all servos and efforts of all joints
             with one coordinate that are not driven
    kinds  : those of INPUTS that are known
    names, units : of the inputs
    Raises SceneError for an unknown name.
    """

    def __init__(self, probe, wanted=None, kinds=INPUTS):
        self._probe, layout = probe, probe.layout
        efforts = {
            f"{joint}.effort": parts for joint, parts in layout.unit_efforts.items() if joint not in layout.motions
        }
        targets = {
            f"{joint}.{name}": (number, column)
            for joint, number in layout.servos.items()
            for column, name in enumerate(("target", "target_velocity"))
        }
        wrenches = {
            f"{body}.{name}": (i, column)
            for i, body in enumerate(layout.body_names)
            for column, name in enumerate(WRENCH)
        }
        self._kinds = {"efforts": efforts, "targets": targets, "wrenches": wrenches}
        if wanted is None:
            wanted = [*(name for name in targets if name.endswith(".target")), *efforts]
        self.names = _expanded(wanted, {kind: self._kinds[kind] for kind in kinds}, "input")

    def __len__(self):
        return len(self.names)

    @property
    def sizes(self):
        """(k,) natural sizes: changes of inputs for differences."""
        return np.ones(len(self.names))

    def starting(self, rates):
        """(k,) changes of the inputs after which servos want given {joint: rate}, so that these do not saturate."""
        u, targets = np.zeros(len(self)), self._probe.targets
        for joint, rate in rates.items():
            if (name := f"{joint}.target_velocity") in self.names:
                u[self.names.index(name)] = rate - targets[self._kinds["targets"][name]]
        return u

    def target(self, name):
        """Present value of a target; 0 of another input, which adds to what acts."""
        place = self._kinds["targets"].get(name)
        return 0.0 if place is None else float(self._probe.targets[place])

    def applied(self, u):
        """(external, targets) of the Probe with changes u (k,) of the inputs."""
        probe = self._probe
        external, targets = probe.external.copy(), probe.targets.copy()
        for name, value in zip(self.names, u):
            if value == 0.0:
                continue
            if name in self._kinds["targets"]:
                number, column = self._kinds["targets"][name]
                targets[number, column] += value
            elif name in self._kinds["efforts"]:
                for body, wrench in self._kinds["efforts"][name]:
                    _add(external, body, value * wrench)
            else:
                body, column = self._kinds["wrenches"][name]
                _add(external, body, value * np.eye(6)[column])
        return external, targets

    def changes(self, first):
        """(first + k, n, COLUMNS), (first + k, s, 2) changes of external wrenches and targets, `first` of them zero."""
        external, present = self._probe.external, self._probe.targets
        wrenches, targets = (np.zeros((first + len(self), *each.shape)) for each in (external, present))
        for k, row in enumerate(np.eye(len(self))):
            found = self.applied(row)
            wrenches[first + k], targets[first + k] = found[0] - external, found[1] - present
        return wrenches, targets


def _add(external, body, wrench):
    """Add a wrench in body axes at the origin of the body frame."""
    one = external[body : body + 1].copy()
    one[0, :6] = 0.0
    set_wrench(one, 0, wrench, "body")
    external[body, :6] += one[0, :6]


class OutputChannels:
    """Outputs of a Probe, as functions of a Sample.

    wanted : names, or those of OUTPUTS that stand for many; None: joints
    turns  : (n, 3, 3) attitudes to which rotation vectors refer; None: those of the state
    names  : of the outputs
    Raises SceneError for an unknown name.
    """

    def __init__(self, probe, wanted=None, turns=None):
        layout, scene = probe.layout, probe.layout.scene
        joints, self._units = layout.coordinates.names, layout.coordinates.units
        bodies = layout.body_names
        self._ideal = [_ideal(sensor) for sensor in scene.sensors]
        sizes = [len(np.atleast_1d(sensor.measure(probe.base))) for sensor in self._ideal]
        kinds = {
            "joints": [f"{joint}.{name}" for joint in joints for name in ("position", "velocity")],
            "bodies": [f"{body}.{name}" for body in bodies for name in POSE],
            "twists": [f"{body}.{name}" for body in bodies for name in TWIST],
            "accelerations": [f"{body}.{name}" for body in bodies for name in ACCELERATION],
            "efforts": [f"{joint}.effort" for joint in (*layout.servos, *layout.motions)],
            "reactions": [f"{joint}.{name}" for joint in [each.name for each in scene.joints] for name in WRENCH],
            "sensors": [f"{each.name}.{k}" for each, size in zip(self._ideal, sizes) for k in range(size)],
        }
        self.names = _expanded(["joints"] if wanted is None else wanted, kinds, "output")
        chosen = set(self.names)
        self._kinds = {kind: len(names) for kind, names in kinds.items() if chosen & set(names)}
        order = [name for kind in self._kinds for name in kinds[kind]]
        self._places = [order.index(name) for name in self.names]
        self.turns = probe.base.pose[:, :9].reshape(-1, 3, 3) if turns is None else turns
        own = {each.name: (f, each.sign) for f, each in enumerate(layout.freedoms) if each.is_of_joint}
        found = [(own.get(name.rpartition(".")[0]), name.endswith(".velocity")) for name in self.names]
        self._freedoms = None
        if self.are_joints and all(freedom for freedom, _ in found):
            self._freedoms = [(f, sign, int(is_rate)) for (f, sign), is_rate in found]

    def __len__(self):
        return len(self.names)

    def along(self, directions):
        """(d, k) derivatives along directions (d, f, 2) where all outputs are coordinates and rates, else None."""
        if self._freedoms is None:
            return None
        rows = [sign * directions[:, f, rate] for f, sign, rate in self._freedoms]
        return np.reshape(rows, (len(rows), len(directions))).T

    @property
    def are_joints(self):
        """Whether all outputs are coordinates and rates of joints."""
        return set(self._kinds) <= {"joints"}

    @property
    def quaternions(self):
        """[four places of outputs that are the quaternion of a sensor]."""
        found = []
        for each in self._ideal:
            first = next((k for k, part in enumerate(each.parts) if part == "qx"), None)
            names = [] if first is None else [f"{each.name}.{first + k}" for k in range(4)]
            if names and set(names) <= set(self.names):
                found.append([self.names.index(name) for name in names])
        return found

    @cached_property
    def angles(self):
        """(k,) whether an output is an angle, which values have modulo 2 pi."""
        units = self._units
        return np.array([name.endswith(".position") and units.get(name[:-9]) == "rad" for name in self.names], bool)

    def apart(self, values, base):
        """Differences (..., k) of outputs, of angles modulo 2 pi."""
        return apart(values, base, self.angles)

    def of_path(self, path, rows):
        """(m, k) outputs of m states of a Path, whose numbers are rows (m,)."""
        of_arrays = {
            "joints": lambda: path.joints[rows],
            "bodies": lambda: self._poses(path.bodies[0][rows]),
            "twists": lambda: path.bodies[1][rows],
        }
        samples = [path.sample(row) for row in rows] if set(self._kinds) - of_arrays.keys() else []
        parts = [
            of_arrays[kind]() if kind in of_arrays else np.array([getattr(self, f"_{kind}")(each) for each in samples])
            for kind in self._kinds
        ]
        found = [part.reshape(len(rows), count) for part, count in zip(parts, self._kinds.values())]
        return np.hstack(found)[:, self._places] if found else np.empty((len(rows), 0))

    def of(self, sample):
        """(k,) outputs of a Sample."""
        parts = [getattr(self, f"_{kind}")(sample) for kind in self._kinds]
        return np.concatenate(parts)[self._places] if parts else np.empty(0)

    def _joints(self, sample):
        return np.array(list(sample.joint_coordinates.values())).ravel()

    def _bodies(self, sample):
        return self._poses(sample.pose).ravel()

    def _poses(self, poses):
        """(..., n, 6) rotation vectors from `turns`, and positions."""
        turns = self.turns.transpose(0, 2, 1) @ poses[..., :9].reshape(*poses.shape[:-1], 3, 3)
        vectors = scipy.spatial.transform.Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec()
        return np.concatenate([vectors.reshape(*poses.shape[:-1], 3), poses[..., 9:]], axis=-1)

    def _twists(self, sample):
        return sample.twist.ravel()

    def _accelerations(self, sample):
        return np.array(list(sample.accelerations.values())).ravel()

    def _efforts(self, sample):
        return np.array([*sample.servo_efforts.values(), *sample.drive_efforts.values()])

    def _reactions(self, sample):
        return sample.reaction_array.ravel()

    def _sensors(self, sample):
        return np.concatenate([np.atleast_1d(sensor.measure(sample)) for sensor in self._ideal])


def apart(values, base, angles):
    """Differences (..., k) of outputs, of those that are angles (k,) modulo 2 pi."""
    found = values - base
    found[..., angles] = (found[..., angles] + np.pi) % (2.0 * np.pi) - np.pi
    return found


def _ideal(sensor):
    """Sensor without steps of resolution; `measure` has no noise."""
    return sensor.model_copy(update={"resolution": None}) if hasattr(sensor, "resolution") else sensor


def _expanded(wanted, kinds, what):
    """Names, each once, in which names of kinds stand for all of them."""
    if isinstance(wanted, str):
        raise SceneError(f"{what}s must be a list of names, got the text {wanted!r}")
    known = {name for names in kinds.values() for name in names}
    found = []
    for name in wanted:
        if name not in kinds and name not in known:
            raise SceneError(f"unknown {what} {name!r}; {suggestion(name, [*kinds, *sorted(known)])}")
        found += [each for each in (kinds.get(name) if name in kinds else [name]) if each not in found]
    return found
