# SPDX-License-Identifier: Apache-2.0
"""Tables *.csv of an offline run.

A header row with units in brackets, then a row per sample; numbers are exact when read back. The
classes have the interface of those in write_run.py. Existing files are never overwritten.
"""

import csv
from contextlib import suppress
from pathlib import Path

import numpy as np

from liegroup_core.joint_events import has_impacts
from liegroup_core.observables.quantities import COORDINATE, WRENCH

from .errors import OutputError

IMPULSE = tuple(f"impulse_{part} [{unit}]" for part, unit in zip(WRENCH, 3 * ["N m s"] + 3 * ["N s"]))


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


def usual_columns(simulation, reactions):
    """Names of the columns that a table has if none are chosen."""
    found = ["time", "states", "joints", "energy", "constraint_residual"]
    if has_estimate(simulation):
        found.append("errors")
    if reactions:
        found += ["reactions", "forces", *(f"{joint}.effort" for joint in simulation.layout.motions)]
    return found


def torque_columns(simulation, path):
    """Names of the columns of a table of driven joints; an effort is nan where constraints leave it undetermined."""
    joints = [joint.name for joint in simulation.scene.joints if joint.driven]
    if not joints:
        raise OutputError(f"{path}: the scene has no driven joint: add driven: true to those whose efforts you need")
    return [f"{joint}.{part}" for joint in joints for part in (*COORDINATE, "effort")]


class TableFile:
    """Table of columns of the Catalogue in a file, with a number of samples and the step of the last one.

    By default time; position, quaternion and twist of each body; position and velocity of each joint with one degree
    of freedom; energy; largest constraint residual; estimated errors of each body, if the simulation has an estimate;
    on request the reaction of each joint, see Sample.reactions, the effort of each spring, motor and servo at a joint,
    and of each driven joint; with rigid stops the sum of the impulses of each joint at the impacts since the last row
    (N m s, N s), see Engine.drain_impacts.
    """

    def __init__(self, path, simulation, _every=None, _samples=None, reactions=False, columns=None):
        wanted = ["time", *columns] if columns else usual_columns(simulation, reactions)
        self._columns = simulation.layout.catalogue.columns(wanted)
        self._has_impacts, self._simulation = reactions and has_impacts(simulation.scene), simulation
        labels = self._columns.labels
        self.count, self.last_step, self._path = 0, -1, Path(path)
        self._stream = new_file(path, "x", encoding="utf-8", newline="")
        self._rows = csv.writer(self._stream)
        if self._has_impacts:
            simulation.drain_impacts()  # the simulation collects impacts from here on
            labels += [f"{joint}.{name}" for joint in joint_names(simulation) for name in IMPULSE]
        self._write(labels)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        close_new(self._stream, self._path, isinstance(exception[1], OutputError))

    def _write(self, values):
        try:
            self._rows.writerow(values)
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None

    def sample(self, sample):
        """Write a row."""
        self._write([*self._columns.of(sample).tolist(), *(self._impulses() if self._has_impacts else ())])
        self.count, self.last_step = self.count + 1, sample.steps

    def finish(self, simulation, stopped, failed, wall_seconds):
        """Do nothing: all rows are written."""

    def _impulses(self):
        """Impulses of all joints since the last row, [N m s, N s]."""
        total = np.zeros((len(joint_names(self._simulation)), 6))
        for impact in self._simulation.drain_impacts():
            total += impact.array
        return total.ravel().tolist()


def joint_names(simulation):
    """Names of all joints of a simulation."""
    return [joint.name for joint in simulation.scene.joints]


def has_estimate(simulation):
    """Whether a simulation estimates its error."""
    return simulation.sample().errors is not None
