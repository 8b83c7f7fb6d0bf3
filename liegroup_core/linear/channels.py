# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of a linearised mechanism, by name.

Inputs: JOINT.effort (N m or N), JOINT.target and JOINT.target_velocity of a servo, BODY.torque_x .. BODY.force_z
in body axes. Outputs: columns of observables/quantities.py; rotation vectors are in body axes, from the state, sensors
without noise and steps of resolution.
"""

from functools import cached_property

import numpy as np

from liegroup_core.errors import SceneError
from liegroup_core.forces.external import set_wrench
from liegroup_core.observables.quantities import NO_STATE, QUATERNION, RATES, Columns, expanded

WRENCH = ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z")
INPUTS = ("efforts", "targets", "wrenches")  # names that stand for many


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
        known = {kind: self._kinds[kind] for kind in kinds}
        self.names = expanded(wanted, known, {name for names in known.values() for name in names}, "input")

    def __len__(self):
        return len(self.names)

    @property
    def sizes(self):
        """(k,) natural sizes: changes of inputs for differences."""
        return np.ones(len(self.names))

    def starting(self, rates):
        """(k,) changes of the inputs after which servos want given {joint: rate}, so that these do not saturate."""
        u, targets = np.zeros(len(self)), self._probe.acting.targets
        for joint, rate in rates.items():
            if (name := f"{joint}.target_velocity") in self.names:
                u[self.names.index(name)] = rate - targets[self._kinds["targets"][name]]
        return u

    def target(self, name):
        """Present value of a target; 0 of another input, which adds to what acts."""
        place = self._kinds["targets"].get(name)
        return 0.0 if place is None else float(self._probe.acting.targets[place])

    def applied(self, u):
        """Acting of the Probe with changes u (k,) of the inputs."""
        external, targets, _ = acting = self._probe.acting.copy()
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
        return acting

    def efforts(self, u):
        """{joint: commanded effort} as of a Sample, with changes u (k,) of the inputs."""
        found = {**self._probe.base.joint_efforts}
        for name, value in zip(self.names, u):
            if name in self._kinds["efforts"]:
                joint = name.removesuffix(".effort")
                found[joint] = found.get(joint, 0.0) + value
        return found

    def changes(self, first):
        """(first + k, n, COLUMNS), (first + k, s, 2) changes of external wrenches and targets, `first` of them zero."""
        present = self._probe.acting[:2]
        found = tuple(np.zeros((first + len(self), *each.shape)) for each in present)
        for k, row in enumerate(np.eye(len(self))):
            for changes, applied, before in zip(found, self.applied(row), present):
                changes[first + k] = applied - before
        return found


def _add(external, body, wrench):
    """Add a wrench in body axes at the origin of the body frame."""
    one = external[body : body + 1].copy()
    one[0, :6] = 0.0
    set_wrench(one, 0, wrench, "body")
    external[body, :6] += one[0, :6]


class OutputChannels(Columns):
    """Outputs of a Probe: columns of the Catalogue that a state and what acts determine.

    wanted : names, or groups; None: joints
    turns  : (n, 3, 3) attitudes to which rotation vectors refer; None: those of the state
    Raises SceneError for an unknown name.
    """

    def __init__(self, probe, wanted=None, turns=None):
        layout = probe.layout
        turns = probe.base.pose[:, :9].reshape(-1, 3, 3) if turns is None else turns
        names = layout.catalogue.names(["joints"] if wanted is None else wanted, "output")
        super().__init__(layout.catalogue, names, turns, ideal=True)
        for name, depends in zip(self.names, self.depends):
            if depends == NO_STATE:
                raise SceneError(f"{name} is no function of the state: it cannot be an output")
        self._sensors = layout.scene.sensors
        own = {each.name: (f, each.sign) for f, each in enumerate(layout.freedoms) if each.is_of_joint}
        found = [
            (own.get(name.rpartition(".")[0]), depends == RATES) for name, depends in zip(self.names, self.depends)
        ]
        self._freedoms = None
        if self.groups <= {"joints"} and all(freedom for freedom, _ in found):
            self._freedoms = [(f, sign, int(is_rate)) for (f, sign), is_rate in found]

    def along(self, directions):
        """(d, k) derivatives along directions (d, f, 2) where all outputs are coordinates and rates, else None."""
        if self._freedoms is None:
            return None
        rows = [sign * directions[:, f, rate] for f, sign, rate in self._freedoms]
        return np.reshape(rows, (len(rows), len(directions))).T

    @property
    def quaternions(self):
        """[four places of outputs that are the quaternion of a body or sensor]."""
        bodies = dict.fromkeys(name.removesuffix(".qx") for name in self.names if name.endswith(".qx"))
        found = [[f"{body}.{part}" for part in QUATERNION] for body in bodies]
        for each in self._sensors:
            if "qx" in each.parts:
                found.append([f"{each.name}.{each.parts.index('qx') + k}" for k in range(4)])
        return [[self.names.index(name) for name in names] for names in found if set(names) <= set(self.names)]

    @cached_property
    def angles(self):
        """(k,) whether an output is an angle, which values have modulo 2 pi."""
        encoders = [f"{each.name}.0" for each in self._sensors if each.type == "encoder"]
        found = zip(self.names, self.units)
        return np.array(
            [unit == "rad" and (name.endswith(".position") or name in encoders) for name, unit in found], bool
        )

    def apart(self, values, base):
        """Differences (..., k) of outputs, of angles modulo 2 pi."""
        return apart(values, base, self.angles)


class StateChannels(OutputChannels):
    """All that a state has: poses and twists of all bodies, and states of laws, also of contacts."""

    def __init__(self, probe, names=("bodies", "twists"), turns=None):
        super().__init__(probe, names, turns)
        self._states = len(probe.layout.model.forces.laws.states)

    def __len__(self):
        return len(self.names) + self._states

    def of(self, sample):
        """(p,) numbers of a Sample."""
        return np.concatenate([super().of(sample), sample.angles[len(sample.angles) - self._states :]])

    @cached_property
    def angles(self):
        """(p,) no number is an angle."""
        return np.zeros(len(self), bool)


def apart(values, base, angles):
    """Differences (..., k) of outputs, of those that are angles (k,) modulo 2 pi."""
    found = values - base
    found[..., angles] = (found[..., angles] + np.pi) % (2.0 * np.pi) - np.pi
    return found
