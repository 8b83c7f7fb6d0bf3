# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim inverse`: the efforts that a motion needs, with its energy and power. No ROS."""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import scipy
from rich.console import Console
from rich.text import Text

from liegroup_core import Simulation, SimulationError
from liegroup_core.engine import METHOD
from liegroup_core.fields.values import LARGEST_NUMBER
from liegroup_core.layout import make_layout
from liegroup_core.linear import inverse_dynamics
from liegroup_core.linear.coordinates import Coordinates
from liegroup_core.linear.inverse import joints_of_motions
from liegroup_core.linear.probe import Probe
from liegroup_sim_ros.numbers import counted, shown
from liegroup_sim_ros.recording.motion import RecordedMotion
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.recording.write_tables import new_file
from liegroup_sim_ros.report.tables import table_of
from liegroup_sim_ros.report.terminal import printed

from .robot_options import add_robot_options, robot_scene
from .states import StateError, refuse_repeated, stopped

DEGREES = 3, 5  # of the splines whose derivatives are velocities and accelerations; the first for an error
CONTRADICTS = 0.1  # of the way: difference of the integral of a derivative
NOISE = 1e-3  # rad, or share of the mechanism's size, of measured positions; of velocities per s
MADE = 1e-6  # of the largest acceleration plus gravity: what the inputs may leave
COARSE = 0.01  # of it: uncertainty between the times from which on a line says so
PARTS = ("position", "velocity", "acceleration")


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Efforts that a motion needs, in loops too: those of the smallest sum of squares if more joints are actuated "
        "than needed. Derivatives that the motion does not have are those of splines of degree 5."
    )
    parser.add_argument("scene", metavar="SCENE", help="path of a scene or robot file, or name of an example scene")
    parser.add_argument(
        "--motion",
        required=True,
        metavar="FILE",
        help="table (*.csv) with the columns time and JOINT.position, possibly JOINT.velocity and JOINT.acceleration, "
        "with units in brackets or without; or recording (*.mcap) of the scene",
    )
    parser.add_argument(
        "--joints", nargs="+", metavar="JOINT", help="independent joints that follow it (default: those that can)"
    )
    parser.add_argument(
        "--inputs", nargs="+", metavar="JOINT.effort", help="actuated joints (default: the joints that follow it)"
    )
    parser.add_argument("--out", metavar="FILE", help="table (*.csv) of efforts and power; it must not exist")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_robot_options(parser)


def run(args):
    """Run the subcommand; returns the exit code."""
    if args.out is not None and Path(args.out).suffix != ".csv":
        raise StateError(f"{args.out}: the name must end in .csv")
    refuse_repeated("--joints", args.joints or [])
    refuse_repeated("--inputs", args.inputs or [])
    scene = robot_scene(args.scene, args)
    is_recording = Path(args.motion).suffix == ".mcap"
    simulation = Simulation(scene, METHOD, estimate=False, quiet=True)
    kinds = simulation.layout.coordinates.units
    times, columns = _of_recording(args.motion, scene) if is_recording else _of_table(args.motion, kinds)
    joints = args.joints or _followed(simulation, columns)
    parts, sampling = _parts(args.motion, times, columns, joints, kinds, simulation.layout.size)
    try:
        found = inverse_dynamics(simulation, times, *parts, joints, args.inputs)
    except SimulationError as error:
        return stopped(error)
    units = {joint: "N m" if unit == "rad" else "N" for joint, unit in kinds.items()}
    names = [name.removesuffix(".effort") for name in found.inputs]
    if args.out is not None:
        _write(args.out, found, names, units)
    rows = [
        {
            "joint": name,
            "unit": units[name],
            "peak_effort": float(np.abs(found.efforts[:, k]).max()),
            "rms_effort": float(np.sqrt(np.mean(found.efforts[:, k] ** 2))),
            "peak_power_W": float(np.abs(found.power[:, k]).max()),
            "energy_J": float(found.energy[k]),
            "undetermined": found.inputs[k] in found.undetermined,
        }
        for k, name in enumerate(names)
    ]
    residual, largest = float(found.residual.max()), float(np.abs(parts[2]).max())
    is_made = residual <= max(sampling, MADE * (largest + max(float(np.linalg.norm(scene.gravity)), 1.0)))
    unit = " or ".join(f"{each}/s^2" for each in ("rad", "m") if each in map(kinds.get, joints))
    if args.json:
        print(
            json.dumps(
                {"joints": rows, "residual": residual, "sampling": sampling, "samples": len(times)}, allow_nan=False
            )
        )
    else:
        _print(scene.name, rows, residual, sampling, times, unit)
    if not is_made:
        print(f"{scene.name}: these inputs cannot make this motion: give more of them with --inputs", file=sys.stderr)
    elif sampling > COARSE * largest:
        print(
            f"{args.motion}: the times are too far apart for accelerations: they are uncertain by {sampling:.3g} of "
            f"{largest:.3g} {unit}, and efforts likewise; give more times, or columns of accelerations",
            file=sys.stderr,
        )
    return 0 if is_made else 1


def _of_table(path, units):
    """(times, {column: numbers}) of a table; units : {joint: "rad" or "m"}."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        text = getattr(error, "strerror", None) or "it is not a text file of comma-separated values"
        raise StateError(f"{path}: cannot be read: {text}") from None
    if len(lines) < 3:
        raise StateError(f"{path}: needs a line with names and at least two lines of numbers")
    names = [name.partition("[")[0].strip() for name in lines[0]]
    for name, text in zip(names, lines[0]):
        unit, expected = "".join(text.partition("[")[2].partition("]")[0].split()), _unit(name, units)
        if unit and expected and unit != expected:
            raise StateError(f"{path}:1: the column {text.strip()} must be in {expected}")
    if "time" not in names:
        raise StateError(f"{path}:1: has no column time")
    for name in names:
        if names.count(name) > 1:
            raise StateError(f"{path}:1: has two columns {name}")
    numbers = np.empty((len(lines) - 1, len(names)))
    for row, line in enumerate(lines[1:], start=2):
        try:
            found = [float(text) for text in line]
        except ValueError:
            found = []
        if len(found) != len(names):
            raise StateError(f"{path}:{row}: expected {len(names)} numbers, separated by commas")
        if not (np.abs(found) <= LARGEST_NUMBER).all():
            raise StateError(f"{path}:{row}: the numbers must be finite, and at most {LARGEST_NUMBER:g}")
        numbers[row - 2] = found
    times = numbers[:, names.index("time")]
    return _increasing(path, times), dict(zip(names, numbers.T))


def _unit(name, units):
    """Unit of a column of the time or of a joint, or ""."""
    joint, _, part = name.rpartition(".")
    if part not in PARTS or joint not in units:
        return "s" if name == "time" else ""
    return units[joint] + ("", "/s", "/s^2")[PARTS.index(part)]


def _increasing(path, times):
    if not (np.diff(times) > 0.0).all():
        raise StateError(f"{path}: the times must increase")
    return times


def _of_recording(path, scene):
    """(times, {column: numbers}) of the joints with one coordinate in a recording."""
    layout, recording = make_layout(scene), read_recording(path)
    if list(layout.body_names) != list(recording.bodies):
        raise StateError(f"{path}: its bodies are not those of {scene.name}")
    times, rows, near = [], [], None
    for block in RecordedMotion(recording).blocks():
        for time, R, r, twist in zip(block.times, block.rotation, block.position, block.twist):
            pose = np.concatenate([R.reshape(len(R), 9), r], axis=1)
            sample = layout.sample(pose, twist, near=near)
            near = sample.angles
            times.append(float(time))
            rows.append([number for pair in sample.joint_coordinates.values() for number in pair])
    names = [f"{joint}.{part}" for joint in layout.coordinates.names for part in PARTS[:2]]
    return _increasing(path, np.array(times)), dict(zip(names, np.array(rows).T))


def _followed(simulation, columns):
    """Independent joints of a simulation with a column."""
    given = [name.removesuffix(".position") for name in columns if name.endswith(".position")]
    probe = Probe(simulation)
    known = joints_of_motions(probe)
    coordinates = Coordinates(probe, preferred=[name for name in given if name in known])
    if not coordinates.names:
        raise StateError("no joint moves freely: `liegroup_sim run --torques` has the efforts of driven joints")
    if set(coordinates.names) <= set(given):
        return coordinates.names
    count = counted(len(coordinates.names), "independent coordinate")
    raise StateError(
        f"the motion has positions of {', '.join(given) or 'no joint'}; the mechanism has {count}: "
        f"it needs those of so many independent ones of {', '.join(known)}"
    )


def _parts(path, times, columns, joints, units, size):
    """Positions, velocities and accelerations (k, m) of joints, and the uncertainty of the last ones.

    Missing ones are those of splines, of angles without jumps; the uncertainty is the difference of two degrees.
    """
    found, lower = [], []
    for joint in joints:
        if f"{joint}.position" not in columns:
            raise StateError(f"{path}: has no column {joint}.position")
        q = columns[f"{joint}.position"]
        v, a = (columns.get(f"{joint}.{part}") for part in PARTS[1:])
        if units.get(joint) == "rad":
            q = _unwrapped(path, times, q, v, joint)
        length = size if units.get(joint) == "m" else 1.0
        _agree(path, times, (q, v, a), joint, length)
        if v is not None and a is not None:
            found.append((q, v, a))
            continue
        if len(times) <= DEGREES[1]:
            least = f"needs at least {DEGREES[1] + 1} times to find the accelerations of {joint}"
            raise StateError(f"{path}: {least}, it has {len(times)}")
        coarse, fine = (_derivatives(times, q, v, degree) for degree in DEGREES)
        found.append((q, fine[0], fine[1] if a is None else a))
        lower.append(np.abs(fine[1] - coarse[1]).max() if a is None else 0.0)
    return np.array(found).transpose(1, 2, 0), float(max(lower, default=0.0))


def _agree(path, times, columns, joint, length):
    """Refuse columns whose integral contradicts the one before, by more than noise: their efforts have no meaning."""
    for low, high, name, derivative in zip(columns, columns[1:], PARTS, PARTS[1:]):
        if low is None or high is None:
            continue
        by_lines = scipy.integrate.cumulative_trapezoid(high, times, initial=0.0)
        by_spline = scipy.interpolate.CubicSpline(times, high).antiderivative()(times)
        ways = [low - low[0] - way for way in (by_lines, by_spline)]
        apart = min(np.abs(way).max() for way in ways)
        if apart > CONTRADICTS * max(np.ptp(low), np.ptp(by_lines)) + NOISE * length:
            raise StateError(
                f"{path}: {joint}.{derivative} is not the derivative of {joint}.{name}: its integral differs by up to "
                f"{apart:.3g}; correct one of the columns, or leave out {joint}.{derivative}"
            )


def _unwrapped(path, times, q, v, joint):
    """Angles without jumps: in the turns that the velocities v expect, or else with the smallest steps."""
    steps = np.diff(q)
    expected = np.zeros_like(steps) if v is None else 0.5 * np.diff(times) * (v[1:] + v[:-1])
    steps -= 2.0 * np.pi * np.round((steps - expected) / (2.0 * np.pi))
    if np.abs(steps - expected).max(initial=0.0) > 0.5 * np.pi:
        row = int(np.abs(steps - expected).argmax()) + 1
        raise StateError(
            f"{path}: {joint} turns too far before {times[row]:.9g} s to know its number of turns: give more times, or "
            f"{joint}.velocity"
        )
    return q[0] + np.concatenate([[0.0], np.cumsum(steps)])


def _derivatives(times, q, v, degree):
    """Velocities, and accelerations, by splines of a degree."""
    rates = scipy.interpolate.make_interp_spline(times, q if v is None else v, k=degree)
    rates = rates.derivative() if v is None else rates
    return rates(times), rates.derivative()(times)


def _write(path, found, names, units):
    with new_file(path, "x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = [f"{name}.{what}" for name in names for what in (f"effort [{units[name]}]", "power [W]")]
        writer.writerow(["time [s]", *columns, "residual"])
        for time, efforts, power, rest in zip(found.times, found.efforts, found.power, found.residual):
            writer.writerow([repr(float(x)) for x in (time, *np.stack([efforts, power], 1).ravel(), rest)])


COLUMNS = {
    "joint": lambda row: row["joint"],
    "peak effort": lambda row: shown(row["peak_effort"], row["unit"]),
    "rms": lambda row: shown(row["rms_effort"], row["unit"]),
    "peak power": lambda row: shown(row["peak_power_W"], "W"),
    "energy": lambda row: shown(row["energy_J"], "J"),
    "": lambda row: "others can take its part" if row["undetermined"] else "",
}


def _print(scene, rows, residual, sampling, times, unit):
    console = Console(file=sys.stdout)
    console.print(Text(f"{scene}: {len(times)} instants from {times[0]:.9g} to {times[-1]:.9g} s", style="bold"))
    console.print(printed(table_of(COLUMNS, rows)))
    console.print(Text(f"uncertainty of accelerations between the samples: {shown(sampling, unit)}", style="dim"))
    console.print(Text(f"largest acceleration that the efforts cannot produce: {shown(residual, unit)}", style="dim"))
