# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim modes`: frequencies, damping and shapes of the modes of a scene. No ROS."""

import sys

import numpy as np
from rich.console import Console
from rich.text import Text

from liegroup_core import Simulation, SimulationError
from liegroup_core.engine import METHOD
from liegroup_core.linear import linearise, modes_of, transition, trim
from liegroup_sim_ros.numbers import shown
from liegroup_sim_ros.report.tables import TextTable
from liegroup_sim_ros.report.terminal import printed
from liegroup_sim_ros.signals import Signals

from .linearise import damping_text, pole_text
from .states import StateError, add_states, print_json, states, stopped

GROWS = 1e-6  # of a magnitude: that of a double multiplier 1 has the root of round-off
LARGEST = 4  # freedoms of a shape that are printed


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Modes of the motion about a state, with loops: undamped ones leave out all forces that depend on velocities."
    )
    parser.add_argument("--trim", action="store_true", help="first go to the equilibrium near the state")
    parser.add_argument("--undamped", action="store_true", help="undamped modes")
    parser.add_argument(
        "--period",
        type=float,
        metavar="T",
        help="of a periodic motion, s: multipliers of Floquet of the motion over this time instead of modes",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--view", action="store_true", help="show the shapes in the browser, of one time")
    parser.add_argument(
        "--no-browser", dest="browser", action="store_false", help="with --view: only print the address"
    )
    add_states(parser)


def run(args):
    """Run the subcommand; returns the exit code."""
    console, found = Console(file=sys.stdout), []
    if args.period is not None:
        return _multipliers(args, console)
    for time, simulation, inside in states(args):
        if args.trim:
            found_trim = trim(simulation, time=inside)
            system, simulation, inside = found_trim.system, _at(simulation, found_trim), None
        else:
            system = linearise(simulation, [], [], time=inside)
        modes = modes_of(system, not args.undamped)
        found.append({"time": time, "freedoms": list(system.freedoms), "modes": [_entries(mode) for mode in modes]})
        if not args.json:
            _print(system, modes, time, console)
        if args.view and len(found) == 1:
            from liegroup_sim_ros.view.shapes_of_modes import Modes

            from .view import show

            shown = [mode for mode in modes if mode.pole != 0.0]
            source = Modes(simulation, shown, [_title(mode) for mode in shown], inside)
            with Signals() as signals:
                show(source, signals, args.browser)
    return print_json(args, found)


def _multipliers(args, console):
    if not 0.0 < args.period < np.inf or args.trim or args.undamped or args.view:
        raise StateError("--period takes a time greater than 0 s, without --trim, --undamped and --view")
    found = []
    for time, simulation, _ in states(args, running=True):
        try:
            result = transition(simulation, args.period)
        except SimulationError as error:
            return stopped(error)
        values = result.multipliers.tolist()
        largest = max(map(abs, values), default=0.0)
        found.append(
            {"time": time, "period": args.period, "states": list(result.states), "transition": result.phi.tolist()}
            | {"multipliers": [[x.real, x.imag] for x in map(complex, values)], "error": result.error}
        )
        if not args.json:
            kind = "differences grow" if largest > 1.0 + GROWS else "differences do not grow"
            text = f"{simulation.scene.name} from {time:.9g} s, over {args.period:.9g} s: {kind}"
            console.print(Text(text, style="bold"))
            rows = [(pole_text(value), f"{abs(value):.9g}") for value in map(complex, values) if value.imag >= 0.0]
            console.print(printed(TextTable(None, ("multiplier", "magnitude"), rows, 2)))
            console.print(Text(f"relative error of the state transition: {shown(result.error)}", style="dim"))
    return print_json(args, found)


def _at(simulation, found):
    """Simulation at the state of a Trim."""
    there = Simulation(simulation.scene, METHOD, simulation.step, estimate=False, quiet=True)
    there.set_state(*simulation.layout.offsets.to_centres(found.pose.copy(), found.twist.copy()), simulation.steps)
    return there


def _title(mode):
    frequency = f"{mode.frequency:.6g} Hz, " if mode.frequency else ""
    return f"{frequency}damping {damping_text(mode.damping)}, pole {pole_text(mode.pole)}"


def _entries(mode):
    return {
        "pole": [mode.pole.real, mode.pole.imag],
        "frequency": mode.frequency,
        "damping": mode.damping,
        "shape": [[x.real, x.imag] for x in mode.shape.tolist()],
    }


def _print(system, modes, time, console):
    console.print(Text(f"{system.scene} at {time:.9g} s", style="bold"))
    m = system.coordinates
    if np.abs(system.slope[m:]).max(initial=0.0) > 1e-6:
        console.print(
            Text(
                f"not an equilibrium: accelerations up to {shown(np.abs(system.slope[m:]).max())}; --trim finds one",
                style="yellow",
            )
        )
    rows = []
    for mode in modes:
        order = np.argsort(-np.abs(mode.shape), kind="stable")[:LARGEST]
        shape = ", ".join(f"{system.freedoms[k]} {_part(mode.shape[k])}" for k in order if abs(mode.shape[k]) > 1e-3)
        frequency = f"{mode.frequency:.6g} Hz" if mode.frequency else "-"
        rows.append((frequency, damping_text(mode.damping), pole_text(mode.pole), shape))
    console.print(printed(TextTable(None, ("frequency", "damping", "pole, 1/s and rad/s", "shape"), rows, 4)))


def _part(value):
    """Part of a freedom in a shape: magnitude, with its phase if it is not 0 or 180 degrees."""
    if abs(value.imag) <= 1e-3 * abs(value):
        return f"{value.real:.3g}"
    return f"{abs(value):.3g} at {np.degrees(np.angle(value)):.0f}°"
