# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim trim`: equilibria and steady motions near a state, and the inputs that hold a pose. No ROS."""

import math
import sys

import numpy as np
from rich.console import Console
from rich.text import Text

from liegroup_core.linear import TrimError, modes_of, trim
from liegroup_sim_ros.numbers import shown

from .linearise import STEADY, add_out, check_out, print_system, save
from .states import StateError, add_states, print_json, refuse_repeated, states, stopped

RESTING = 1e-9  # rad/s or m/s


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Find the equilibrium, or the steady motion with given rates, that is near a state, with its stability. "
        "With inputs: those of the smallest sum of squares that hold it; with dry friction or stops also the interval "
        "of each one in which it rests."
    )
    parser.add_argument(
        "--rates", nargs="+", default=[], metavar="NAME=RATE", help="rates that stay constant, rad/s or m/s"
    )
    parser.add_argument("--hold", nargs="+", default=[], metavar="NAME", help="coordinates that keep their positions")
    parser.add_argument(
        "--inputs", nargs="+", default=[], metavar="NAME", help="inputs to find, as of `liegroup_sim linearise`"
    )
    add_out(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_states(parser)


def run(args):
    """Run the subcommand; returns the exit code."""
    check_out(args)
    refuse_repeated("--hold", args.hold)
    refuse_repeated("--inputs", args.inputs)
    rates, console, found = _rates(args.rates), Console(file=sys.stdout), []
    for time, simulation, inside in states(args):
        try:
            result = trim(simulation, rates, args.hold, args.inputs, inside)
        except TrimError as error:
            return stopped(error)
        found.append(_entries(result, time))
        if args.out is not None:
            save(result.system, args.out)
        if not args.json:
            _print(result, time, console)
    return print_json(args, found)


def _rates(given):
    found = {}
    for text in given:
        name, _, number = text.partition("=")
        try:
            rate = float(number)
        except ValueError:
            rate = math.nan
        if not math.isfinite(rate) or name in found:
            raise StateError(f"--rates: expected NAME=RATE with a finite number, each once, got {text!r}")
        found[name] = rate
    return found


def _entries(result, time):
    stable = {None: "marginal", True: "stable", False: "unstable"}[result.is_stable] if _has_poles(result) else None
    return {
        "time": time,
        "joints": result.joints,
        "inputs": result.inputs,
        "intervals": {
            # An end that was not found is null; JSON has no number for one that does not exist.
            name: [None if math.isnan(end) else end if math.isfinite(end) else str(end) for end in ends]
            for name, ends in result.intervals.items()
        },
        "undetermined": list(result.undetermined),
        "undetermined_coordinates": list(result.loose),
        "stability": stable,
        "residual": result.residual,
        "steady": result.is_steady,
        "poses": dict(zip(result.bodies, result.pose.tolist())),
        "modes": [[mode.pole.real, mode.pole.imag] for mode in modes_of(result.system)],
    }


def _has_poles(result):
    """Whether the poles are those of the motion, and not of one instant."""
    return result.is_steady and result.change <= STEADY


def _print(result, time, console):
    entries = _entries(result, time)
    moving = np.abs(result.system.slope[: result.system.coordinates]).max(initial=0.0) > RESTING
    kind = ", ".join(filter(None, ("steady motion" if moving else "equilibrium", entries["stability"])))
    if not result.is_steady:
        kind = "this is one instant: accelerations arise as it moves, or driven joints move on"
    console.print(Text(f"{result.system.scene}: {kind}", style="bold" if result.is_steady else "bold yellow"))
    for joint, position in result.joints.items():
        remark = "  (others are possible too)" if joint in result.loose else ""
        console.print(Text(f"  {joint} = {position:.9g}{remark}"))
    for name, value in result.inputs.items():
        idle = not result.system.B[:, result.system.inputs.index(name)].any()
        remark = " (others can take its part)" if name in result.undetermined else ""
        remark = " (it has no effect here)" if idle else remark
        ends = "rests from {:.9g} to {:.9g}".format(*result.intervals[name]) if result.intervals else ""
        console.print(Text(f"  {name} = {value:.9g}  {ends}{remark}".rstrip()))
    console.print(Text(f"remaining acceleration: {shown(result.residual)}", style="dim"))
    print_system(result.system, time, console, change=result.change)
