# SPDX-License-Identifier: Apache-2.0
"""Tables *.csv of an offline run: states of bodies and joints, or efforts of driven joints.

A header row with units in brackets, then a row per sample; numbers are exact when read back. The
classes have the interface of those in write_run.py. Existing files are never overwritten.
"""

import csv
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from liegroup_core.joint_events import has_impacts

from .errors import OutputError

BODY = (
    *(f"{axis} [m]" for axis in "xyz"),
    *(f"q{axis}" for axis in "xyzw"),
    *(f"w{axis} [rad/s]" for axis in "xyz"),
    *(f"v{axis} [m/s]" for axis in "xyz"),
)
PARTS = (("position", ""), ("velocity", "/s"))
ERRORS = ("position_error [m]", "attitude_error [rad]", "velocity_error [m/s]", "angular_velocity_error [rad/s]")
REACTION = (*(f"t{axis} [N m]" for axis in "xyz"), *(f"f{axis} [N]" for axis in "xyz"))
IMPULSE = (*(f"impulse_t{axis} [N m s]" for axis in "xyz"), *(f"impulse_f{axis} [N s]" for axis in "xyz"))


def new_file(path, mode, **options):
    """Open a file that does not exist yet, as `open`. Raises OutputError."""
    try:
        return open(path, mode, **options)
    except FileExistsError:
        raise OutputError(f"{path}: the file already exists; remove it or choose another name") from None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None


def close_new(stream, path, remove):
    """Close a file of `new_file`; remove it if it cannot be written, or on request. Raises OutputError."""
    try:
        stream.close()
    except OSError as error:
        remove = True
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        if remove:
            with suppress(OSError):
                Path(path).unlink()


class Quantity(NamedTuple):
    """What a file has of each sample."""

    key: str  # in *.npz; "": it is not there
    labels: list  # columns of *.csv, one for each number; none: it is not there
    of: Callable  # function sample -> number or array


def quantities(simulation, reactions):
    """[Quantity] of the files of a run."""
    layout, joints = simulation.layout, joint_names(simulation)
    units, bodies, forces = layout.coordinates.units, layout.body_names, layout.joint_forces

    def labels(names, columns):
        return [f"{name}.{column}" for name in names for column in columns]

    names = layout.coordinates.names
    coordinates = [f"{joint}.{part} [{units[joint]}{per}]" for joint in names for part, per in PARTS]
    found = [
        Quantity("time", ["time [s]"], lambda sample: sample.time),
        Quantity("steps", [], lambda sample: sample.steps),
        Quantity("poses", [], lambda sample: sample.pose_matrices),
        Quantity("twists", [], lambda sample: sample.twist),
        Quantity(
            "", labels(bodies, BODY), lambda sample: np.hstack([sample.pose[:, 9:], sample.orientation, sample.twist])
        ),
        Quantity("", coordinates, lambda sample: [sample.joint_coordinates[name] for name in names]),
        Quantity("energy", ["energy [J]"], lambda sample: sample.energy),
        Quantity("residual", ["constraint_residual [m or rad]"], lambda sample: sample.constraint_residual),
    ]
    if has_estimate(simulation):
        found.append(Quantity("errors", labels(bodies, ERRORS), lambda sample: sample.errors))
    if reactions:
        efforts = [f"{name}.effort [{'N m' if forces.turns[name] else 'N'}]" for name in forces.names]
        drives = [f"{joint}.drive_effort [{'N' if units.get(joint) == 'm' else 'N m'}]" for joint in layout.motions]
        found.append(Quantity("reactions", labels(joints, REACTION), lambda sample: sample.reaction_array))
        found.append(Quantity("efforts", efforts, lambda sample: list(sample.force_efforts.values())))
        if drives:
            found.append(Quantity("drive_efforts", drives, lambda sample: list(sample.drive_efforts.values())))
    for name in simulation.sample().sensors:
        found.append(Quantity(f"sensors/{name}", [], lambda sample, name=name: sample.sensors[name]))
    return found


class _Table:
    """Table in a file, with a number of samples and the step of the last one."""

    def __init__(self, path):
        self.count, self.last_step = 0, -1
        self._path = Path(path)
        self._stream = new_file(path, "x", encoding="utf-8", newline="")
        self._rows = csv.writer(self._stream)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        close_new(self._stream, self._path, isinstance(exception[1], OutputError))

    def _write(self, *values):
        try:
            self._rows.writerow(values)
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None

    def finish(self, simulation, stopped, failed, wall_seconds):
        """Do nothing: all rows are written."""


class TableFile(_Table):
    """Table of states.

    Columns: time; of each body position x y z (m, world),
    quaternion qx qy qz qw (body to world), angular velocity wx wy wz (rad/s) and velocity vx vy vz
    (m/s) in body axes; position and velocity of each joint with one degree of freedom (rad and
    rad/s, or m and m/s); energy (J); largest constraint residual (m or rad); estimated errors of
    each body, if the simulation has an estimate; on request the reaction of each joint, torque
    tx ty tz (N m) and force fx fy fz (N), see Sample.reactions, and the effort (N m or N) of each
    spring, motor and servo at a joint, see Sample.force_efforts, and of each driven joint; with rigid
    stops the sum of the impulses of each joint at the impacts since the last row (N m s, N s), see
    Engine.drain_impacts.
    """

    def __init__(self, path, simulation, _every, _samples, reactions=False):
        super().__init__(path)
        self._columns = [each for each in quantities(simulation, reactions) if each.labels]
        self._has_impacts, self._simulation = reactions and has_impacts(simulation.scene), simulation
        labels = [label for each in self._columns for label in each.labels]
        if self._has_impacts:
            simulation.drain_impacts()  # the simulation collects impacts from here on
            labels += [f"{joint}.{name}" for joint in joint_names(simulation) for name in IMPULSE]
        self._write(*labels)

    def sample(self, sample):
        """Write a row."""
        values = [number for each in self._columns for number in np.ravel(each.of(sample)).tolist()]
        self._write(*values, *(self._impulses() if self._has_impacts else ()))
        self.count, self.last_step = self.count + 1, sample.steps

    def _impulses(self):
        """Impulses of all joints since the last row, [N m s, N s]."""
        total = np.zeros((len(joint_names(self._simulation)), 6))
        for impact in self._simulation.drain_impacts():
            total += impact.array
        return total.ravel().tolist()


class TorqueFile(_Table):
    """Table of driven joints: time; position, velocity and required effort of each joint.

    rad, rad/s and N m, or m, m/s and N; nan where redundant constraints leave an effort undetermined.
    A screw has the angle, and the torque about its axis.
    """

    def __init__(self, path, simulation):
        units = {
            joint.name: ("m", "m/s", "N") if joint.type == "prismatic" else ("rad", "rad/s", "N m")
            for joint in simulation.scene.joints
            if joint.driven
        }
        if not units:
            raise OutputError(
                f"{path}: the scene has no driven joint: add driven: true to those whose efforts you need"
            )
        super().__init__(path)
        self._write(
            "time [s]",
            *(
                f"{joint}.{what} [{unit}]"
                for joint, of_joint in units.items()
                for what, unit in zip(("position", "velocity", "effort"), of_joint)
            ),
        )

    def sample(self, sample):
        """Write a row."""
        efforts, motions = sample.drive_efforts, sample.prescribed
        self._write(sample.time, *(number for joint in efforts for number in (*motions[joint][:2], efforts[joint])))
        self.count, self.last_step = self.count + 1, sample.steps


def joint_names(simulation):
    """Names of all joints of a simulation."""
    return [joint.name for joint in simulation.scene.joints]


def has_estimate(simulation):
    """Whether a simulation estimates its error."""
    return simulation.sample().errors is not None
