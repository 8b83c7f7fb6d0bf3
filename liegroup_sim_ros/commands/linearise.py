# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim linearise`: A, B, C, D of a scene or along a recording, its poles and zeros. No ROS."""

import math
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from liegroup_core.linear import change_along, linearise, pole_errors
from liegroup_core.linear.channels import INPUTS
from liegroup_sim_ros.numbers import counted, shown
from liegroup_sim_ros.report.tables import TextTable
from liegroup_sim_ros.report.terminal import printed

from .states import StateError, add_states, print_json, states

ENDINGS = (".json", ".npz", ".mat")
MOST_ROWS = 40  # printed poles
ROUND_OFF = 1e-10  # relative
STEADY = 1e-6  # 1/s, relative change of A


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Linearise the equations of motion at a state: d/dt dx = A dx + B du, dy = C dx + D du, with loops in "
        "independent coordinates. Stops and friction keep their modes."
    )
    add_out(parser)
    parser.add_argument(
        "--inputs",
        nargs="*",
        metavar="NAME",
        help=f"{', '.join(INPUTS)}, or single ones: JOINT.effort, JOINT.target, JOINT.target_velocity, BODY.force_x, "
        "BODY.torque_x (default: targets of servos and efforts)",
    )
    parser.add_argument(
        "--outputs", nargs="*", metavar="NAME", help="names as of `liegroup_sim run --columns` (default: joints)"
    )
    parser.add_argument("--independent", nargs="+", metavar="NAME", help="independent coordinates of the state")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_states(parser)


def add_out(parser):
    """Argument of a file for a LinearSystem."""
    parser.add_argument("--out", metavar="FILE", help="file (*.json, *.npz or *.mat) of the system; of one time")


def check_out(args):
    """Raise StateError if the file cannot take the system."""
    if args.out is not None:
        if Path(args.out).suffix not in ENDINGS:
            raise StateError(f"{args.out}: the name must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
        if len(args.at) > 1:
            raise StateError("--out takes the system of one time: give one --at, or --json")
        if Path(args.out).exists():
            raise StateError(f"{args.out}: exists already; choose another name")


def run(args):
    """Run the subcommand; returns the exit code."""
    check_out(args)
    console, found = Console(file=sys.stdout), []
    for time, simulation, inside in states(args):
        system = linearise(simulation, args.inputs, args.outputs, args.independent, inside)
        errors, change = pole_errors(simulation, system, inside), change_along(simulation, system, inside)
        known = [x if x == x else None for x in errors.tolist()]
        found.append({**system.as_dict(), "time": time, "pole_errors": known, "change": change})
        if args.out is not None:
            save(system, args.out)
        if not args.json:
            print_system(system, time, console, errors, change)
    return print_json(args, found)


def save(system, path):
    """Write a LinearSystem. Raises StateError."""
    try:
        system.save(path)
    except OSError as error:
        raise StateError(f"{path}: cannot be written: {error.strerror}") from None


def print_system(system, time, console, errors=None, change=0.0):
    """Print the sizes, poles and zeros of a LinearSystem.

    errors : of its poles, NaN if they are not known;  change : of A along the motion, 1/s
    """
    sizes = [counted(len(names), what) for names, what in ((system.inputs, "input"), (system.outputs, "output"))]
    states_text = counted(system.coordinates, "coordinate")
    console.print(Text(f"{system.scene} at {time:.9g} s: {states_text}, {', '.join(sizes)}", style="bold"))
    console.print(Text(f"states: {', '.join(system.states)}"))
    console.print(Text(f"inputs: {', '.join(system.inputs) or 'none'}"))
    largest = max(map(abs, system.slope.tolist()), default=0.0)
    console.print(
        Text(f"largest slope of the state: {shown(largest)}; largest relative error of an entry: {shown(system.error)}")
    )
    known = errors is not None and not any(x != x for x in errors)
    if change > STEADY:
        console.print(
            Text(f"A changes along the motion, by {shown(change)} 1/s: its poles are those of this instant", "yellow")
        )
    lacking = {"not controllable": system.uncontrollable(), "not observable": system.unobservable()}
    poles, resting = [], system.round_off
    for k, pole in enumerate(system.poles.tolist()):
        if pole.imag >= 0.0 and abs(pole) > resting:
            poles.append((k, pole, lambda each, pole=pole: np.abs(each - pole) <= 1e-9 * abs(pole), 1))
    zeros = np.flatnonzero(np.abs(system.poles) <= resting)
    if len(zeros):
        poles.insert(0, (zeros[0], 0j, lambda each: np.abs(each) <= resting, len(zeros)))
    rows = []
    for k, pole, is_of, count in poles[:MOST_ROWS]:
        marks = []
        for text, of in lacking.items():
            if is_of(of).any():
                marks.append(text if count == 1 else f"some {text}")
        size = abs(pole)
        rows.append(
            (
                pole_text(pole) + (f" ({count} times)" if count > 1 else ""),
                *([shown(errors[k])] if known else []),
                f"{size / (2.0 * math.pi):.6g} Hz" if pole.imag else "",
                damping_text(0.0 - pole.real / size) if size else "",
                Text(", ".join(marks), style="dim"),
            )
        )
    heads = ("pole, 1/s and rad/s", *(["error of the pole"] if known else []), "frequency", "damping", "")
    console.print(printed(TextTable(None, heads, rows, len(heads))))
    if len(poles) > MOST_ROWS:
        console.print(Text(f"and {len(poles) - MOST_ROWS} more: --json prints all", style="dim"))
    zeros = system.zeros
    if zeros is not None and len(zeros):
        console.print(Text("zeros: " + ", ".join(pole_text(z) for z in zeros.tolist() if z.imag >= 0.0)))


def damping_text(damping):
    """Damping ratio; 0 for round-off."""
    return shown(damping if abs(damping) > ROUND_OFF else 0.0)


def pole_text(pole):
    """A pole with six digits, of a pair both; parts that are round-off are zero."""
    if pole.imag and abs(pole.real) <= ROUND_OFF * abs(pole):
        return f"± {pole.imag:.6g}i"
    if pole.imag:
        return f"{pole.real:.6g} ± {pole.imag:.6g}i"
    return f"{pole.real:.6g}"
