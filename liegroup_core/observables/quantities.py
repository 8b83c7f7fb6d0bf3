# SPDX-License-Identifier: Apache-2.0
"""Catalogue of the quantities of a run: the names that tables, sweeps, linear systems, logs, plots and the page know.

A column is a number with a name: `time`, `energy`, BODY.x, JOINT.position, FORCE.effort, SENSOR.0. A group stands for
all columns of a kind: `twists`. Frames and axes are those of Sample.
"""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import suggestion
from liegroup_core.forces.contact import UNITS
from liegroup_core.forces.law import laws_of

POSITION, QUATERNION, ROTATION = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz")
TWIST, ACCELERATION = ("wx", "wy", "wz", "vx", "vy", "vz"), ("alpha_x", "alpha_y", "alpha_z", "ax", "ay", "az")
WRENCH, COORDINATE = ("tx", "ty", "tz", "fx", "fy", "fz"), ("position", "velocity")
ERRORS = ("position_error", "attitude_error", "velocity_error", "angular_velocity_error")
MOMENTUM = tuple(f"{what}momentum_{axis}" for what in ("angular_", "") for axis in "xyz")
PLACES, RATES, LOADS, NO_STATE = range(4)  # what a number depends on: positions, also rates, also what acts; the run
# {group: groups that it joins, owner by owner}
JOINED = {
    "bodies": ("rotations", "positions"),
    "poses": ("positions", "orientations"),
    "states": ("positions", "orientations", "twists"),
}
# Former endings of columns, and what they are now.
FORMER = dict(zip((f"{what}_{axis}" for what in ("torque", "force") for axis in "xyz"), WRENCH)) | {
    "drive_effort": "effort",
    "residual": "constraint_residual",
}


class Row(NamedTuple):
    """Group of columns OWNER.PART of a mechanism, with a number for each part of each owner."""

    owners: str  # "body", "joint", "force", "sensor", "" for the mechanism, or one of KINDS
    parts: tuple
    units: tuple  # of equal numbers of successive parts; {q} and {effort} are those of the owner
    frame: str  # axes, and what the numbers are
    of: Callable  # function (Sample, Columns) -> numbers, in any shape
    depends: int | tuple = LOADS  # of each part, or all: PLACES, RATES, LOADS or NO_STATE
    # Function (states, rows (m,), Columns) -> the numbers of m states, as of a Path: bodies (poses (k, n, 12),
    # twists (k, n, 6)), joints (k, j, 2). None: from Samples.
    along: Callable | None = None


KINDS = {
    "coordinate": "joint",
    "driven": "joint",
    "contact": "joint",
    "touching": "force",
    "signal": "law",
}  # of owners


def _rotations(poses, columns):
    """(..., n, 3) rotation vectors of poses (..., n, 12) from the attitudes of Columns."""
    R = columns.turns.transpose(0, 2, 1) @ poses[..., :9].reshape(*poses.shape[:-1], 3, 3)
    found = scipy.spatial.transform.Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return found.reshape(*poses.shape[:-1], 3)


def _errors(sample, _):
    return np.full((len(sample.pose), 4), np.nan) if sample.errors is None else sample.errors


def _efforts(sample, columns):
    found = sample.all_efforts
    return [found.get(joint, 0.0) for joint in columns.owners["driven"]]


def _totals(sample, _):
    return [sample.total_efforts.get(joint, 0.0) for joint in sample.joint_coordinates]


def _powers(sample, _):
    found = sample.total_efforts
    return [found.get(joint, 0.0) * rate for joint, (_, rate) in sample.joint_coordinates.items()]


def _sensors(sample, columns):
    if columns.ideal:
        return [number for each in sample.scene.sensors for number in np.ravel(_ideal(each).measure(sample))]
    return [number for values in sample.sensors.values() for number in np.ravel(values)]


_IN_CHILD = "axes and origin of the joint frame of the child"
_TRANSMITTED, _TO_PLANE = tuple(f"transmitted_{part}" for part in WRENCH), ("normal_force", "tangential_force")
_ON_BODY = "on the body, in its axes, about its origin; p: centre of pressure, world axes"
_ALL_EFFORTS = "motors, servos, drives, springs, dampers and commands at the joint"
TABLE = {
    "time": Row("", ("time",), ("s",), "", lambda s, _: s.time, NO_STATE),
    "steps": Row("", ("steps",), ("",), "", lambda s, _: s.steps, NO_STATE),
    "positions": Row(
        *("body", POSITION, ("m",), "world axes", lambda s, _: s.pose[:, 9:], PLACES),
        along=lambda p, k, _: p.bodies[0][k][..., 9:],
    ),
    "orientations": Row("body", QUATERNION, ("",), "body to world", lambda s, _: s.orientation, PLACES),
    "rotations": Row(
        *("body", ROTATION, ("rad",), "rotation vector", lambda s, c: _rotations(s.pose, c), PLACES),
        along=lambda p, k, c: _rotations(p.bodies[0][k], c),
    ),
    "twists": Row(
        *("body", TWIST, ("rad/s", "m/s"), "body axes", lambda s, _: s.twist, RATES),
        along=lambda p, k, _: p.bodies[1][k],
    ),
    "accelerations": Row(
        *("body", ACCELERATION, ("rad/s^2", "m/s^2"), "body axes", lambda s, _: list(s.accelerations.values()))
    ),
    "joints": Row(
        *("coordinate", COORDINATE, ("{q}", "{q}/s"), "about or along the axis"),
        *(lambda s, _: list(s.joint_coordinates.values()), (PLACES, RATES), lambda p, k, _: p.joints[k]),
    ),
    "energy": Row("", ("energy",), ("J",), "kinetic and potential", lambda s, _: s.energy, RATES),
    "power": Row("", ("power",), ("W",), "of non-conservative forces", lambda s, _: s.power),
    "momentum": Row(
        *("", MOMENTUM, ("N m s", "N s"), "world axes, about the world's origin"),
        lambda s, _: s.spatial_momentum,
        RATES,
    ),
    "constraint_residual": Row(
        *("", ("constraint_residual",), ("m or rad",), "largest of all joints"),
        *(lambda s, _: s.constraint_residual, PLACES),
    ),
    "residuals": Row(
        "joint", ("constraint_residual",), ("m or rad",), "norm", lambda s, _: list(s.joint_residuals.values()), PLACES
    ),
    "errors": Row("body", ERRORS, ("m", "rad", "m/s", "rad/s"), "estimated", _errors, NO_STATE),
    "reactions": Row("joint", WRENCH, ("N m", "N"), _IN_CHILD, lambda s, _: s.reaction_array),
    "transmitted": Row("joint", _TRANSMITTED, ("N m", "N"), _IN_CHILD, lambda s, _: list(s.transmitted.values())),
    "contacts": Row(
        "contact", _TO_PLANE, ("N",), "of what rolls, to its plane", lambda s, _: list(s.contacts.values())
    ),
    "contact_wrenches": Row(
        *("touching", ("px", "py", "pz", *WRENCH), ("m", "N m", "N"), _ON_BODY, lambda s, _: s.touching, RATES)
    ),
    "efforts": Row("driven", ("effort",), ("{effort}",), "of servo, drive, laws and commands", _efforts),
    "forces": Row(
        "force", ("effort",), ("{effort}",), "on the child of its joint", lambda s, _: list(s.force_efforts.values())
    ),
    "totals": Row("coordinate", ("total_effort",), ("{effort}",), _ALL_EFFORTS, _totals),
    "powers": Row("coordinate", ("power",), ("W",), "total effort times velocity", _powers),
    "law_powers": Row(
        "law", ("power",), ("W",), "of its efforts and wrenches", lambda s, _: list(s.law_powers.values())
    ),
    "signals": Row("signal", (), (), "numbers of a law", lambda s, _: list(s.signals.values()), RATES),
    "sensors": Row("sensor", (), (), "as the sensor measures", _sensors),
}
GROUPS = (*TABLE, *JOINED)


class Quantity(NamedTuple):
    """Row of TABLE in a scene."""

    kind: str  # of the owners: "body", "joint", "force", "sensor", "" for the mechanism
    names: tuple  # of the columns
    units: tuple  # of each, "" for none
    depends: tuple  # of each
    frame: str
    of: Callable
    along: Callable | None


class Catalogue:
    """Quantities of a scene with a Layout."""

    def __init__(self, layout):
        self._layout = layout

    @cached_property
    def owners(self):
        """{owners of TABLE: {name: units of the owner}}; of a sensor [(part, unit)]."""
        layout, forces, units = self._layout, self._layout.joint_forces, self._layout.coordinates.units
        of_forces = {name: {"effort": "N m" if force.joint_moves == "turns" else "N"} for name, force in forces.items()}
        of_joints = {forces[name].joint: own for name, own in of_forces.items()}
        of_joints |= {joint: {"q": unit, "effort": "N" if unit == "m" else "N m"} for joint, unit in units.items()}
        return {
            "": {"": {}},
            "body": dict.fromkeys(layout.body_names, {}),
            "joint": dict.fromkeys((joint.name for joint in layout.scene.joints), {}),
            "coordinate": {joint: of_joints[joint] for joint in units},
            "driven": {joint: of_joints[joint] for joint in (*layout.servos, *layout.motions, *layout.unit_efforts)},
            "contact": dict.fromkeys((joint.name for joint, *_ in layout.contacts), {}),
            "touching": dict.fromkeys(layout.touching.names, {}),
            "force": of_forces,
            "law": dict.fromkeys((law.name for law in laws_of(layout.scene.forces)), {}),
            "signal": {name: self._units_of_signal(*name.rsplit(".", 1)) for name in layout.signals},
            "sensor": {each.name: _parts(each, units) for each in layout.scene.sensors},
        }

    def _units_of_signal(self, law, name):
        return {"signal": UNITS[name]} if law in self._layout.touching.names else {}

    @cached_property
    def quantities(self):
        """{group: Quantity}."""
        return {group: self._quantity(row) for group, row in TABLE.items()}

    def _quantity(self, row):
        if row.owners == "sensor":
            columns = [
                (f"{name}.{k}", unit, _depends(unit))
                for name, parts in self.owners["sensor"].items()
                for k, (_, unit) in enumerate(parts)
            ]
        elif row.owners == "signal":
            columns = [(name, units.get("signal", ""), row.depends) for name, units in self.owners["signal"].items()]
        else:
            units = np.repeat(row.units, len(row.parts) // len(row.units)).tolist()
            depends = row.depends if isinstance(row.depends, tuple) else (row.depends,) * len(row.parts)
            columns = [
                (f"{owner}.{part}" if owner else part, unit.format(**own), on)
                for owner, own in self.owners[row.owners].items()
                for part, unit, on in zip(row.parts, units, depends)
            ]
        each = [tuple(column[i] for column in columns) for i in range(3)]
        return Quantity(KINDS.get(row.owners, row.owners), *each, row.frame, row.of, row.along)

    @cached_property
    def groups(self):
        """{group: names of its columns}."""
        found = {group: quantity.names for group, quantity in self.quantities.items()}
        for group, parts in JOINED.items():
            owners = zip(*(np.reshape(found[part], (len(self._layout.body_names), -1)).tolist() for part in parts))
            found[group] = tuple(name for names in owners for part in names for name in part)
        return found

    @cached_property
    def places(self):
        """{column: (its group, place there)}."""
        return {
            name: (group, place) for group, each in self.quantities.items() for place, name in enumerate(each.names)
        }

    def names(self, wanted, what="column"):
        """Names of columns, each once, for a list of names, in which groups stand for all of theirs.

        Raises SceneError for an unknown name.
        """
        return expanded(wanted, self.groups, self.places, what, self._layout.scene.sensors)

    def columns(self, wanted, what="column", turns=None, ideal=False):
        """Columns for a list of names. Raises SceneError for an unknown name."""
        return Columns(self, self.names(wanted, what), turns, ideal)


def expanded(wanted, groups, known, what, sensors=()):
    """Names of columns, each once, in which names of groups stand for all of theirs. Raises SceneError for others.

    groups : {group: names};  known : names of columns;  sensors : of the scene, for their other names
    """
    if isinstance(wanted, str):
        raise SceneError(f"{what}s must be a list of names, got the text {wanted!r}")
    found = {}
    for name in wanted:
        own = name if name in known else present_name(name, sensors)
        if name not in groups and own not in known:
            raise SceneError(f"unknown {what} {name!r}; {suggestion(name, [*groups, *sorted(known)])}")
        found |= dict.fromkeys(groups.get(name, (own,)))
    return list(found)


def present_name(name, sensors):
    """Name of a column for a former name, or for a number of a sensor by what it is, such as imu.wx; or the name."""
    owner, dot, part = name.rpartition(".")
    for parts in ([text.partition(" [")[0] for text in each.parts] for each in sensors if each.name == owner):
        return f"{owner}.{parts.index(part)}" if part in parts else name
    return f"{owner}{dot}{FORMER.get(part, part)}"


class Columns:
    """Some columns of a Catalogue, as functions of Samples.

    turns : (n, 3, 3) attitudes to which rotation vectors refer; None: the world axes
    ideal : whether sensors have neither noise nor steps of resolution
    names, units : of each column;  labels : name and [unit]
    depends, quantities : of each: PLACES, RATES, LOADS or NO_STATE, and its Quantity
    """

    def __init__(self, catalogue, names, turns=None, ideal=False):
        self.owners, self.ideal = catalogue.owners, ideal
        self.turns = np.broadcast_to(np.eye(3), (len(self.owners["body"]), 3, 3)) if turns is None else turns
        self.names, places = list(names), [catalogue.places[name] for name in names]
        self._quantities = {group: catalogue.quantities[group] for group, _ in places}
        begins = dict(zip(self._quantities, np.cumsum([0, *(len(each.names) for each in self._quantities.values())])))
        self._places = [int(begins[group]) + place for group, place in places]
        self.quantities = [catalogue.quantities[group] for group, _ in places]
        self.units = [each.units[place] for each, (_, place) in zip(self.quantities, places)]
        self.depends = [each.depends[place] for each, (_, place) in zip(self.quantities, places)]

    def __len__(self):
        return len(self.names)

    @property
    def groups(self):
        """Groups that have the columns."""
        return self._quantities.keys()

    @property
    def labels(self):
        """Names with units in brackets."""
        return [f"{name} [{unit}]" if unit else name for name, unit in zip(self.names, self.units)]

    def of(self, sample):
        """(k,) numbers of a Sample."""
        parts = [np.ravel(each.of(sample, self)) for each in self._quantities.values()]
        return np.concatenate(parts, dtype=float)[self._places] if parts else np.empty(0)

    def of_states(self, states, rows):
        """(m, k) numbers of the states with numbers rows (m,); see Quantity.along, and `sample(row)` of the states."""
        samples, parts = None, []
        for each in self._quantities.values():
            if each.along is None:
                samples = [states.sample(row) for row in rows] if samples is None else samples
                found = np.array([np.ravel(each.of(sample, self)) for sample in samples])
            else:
                found = each.along(states, rows, self)
            parts.append(np.reshape(found, (len(rows), len(each.names))))
        return np.hstack(parts)[:, self._places] if parts else np.empty((len(rows), 0))


def _parts(sensor, units):
    """[(part, unit)] of the numbers of a sensor; units : {joint: "rad" or "m"}."""
    found = (text.removesuffix("]").partition(" [") for text in sensor.parts)
    return [(part, units[sensor.joint] if unit == "rad or m" else unit) for part, _, unit in found]


def _depends(unit):
    """What the number of a sensor depends on, by its unit."""
    return PLACES if unit in ("", "m", "rad") else RATES if unit in ("m/s", "rad/s") else LOADS


def _ideal(sensor):
    """Sensor without steps of resolution; `measure` has no noise."""
    return sensor.model_copy(update={"resolution": None}) if hasattr(sensor, "resolution") else sensor
