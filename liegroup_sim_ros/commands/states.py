# SPDX-License-Identifier: Apache-2.0
"""Argument of subcommands that analyse states: a scene or a recording, and times."""

import json
import math
import sys
from pathlib import Path

from liegroup_core import Simulation
from liegroup_core.engine import METHOD
from liegroup_core.errors import LieGroupSimError
from liegroup_core.forces.instants import LATEST
from liegroup_sim_ros.playback.branch import Branches
from liegroup_sim_ros.recording.read import read_recording

from .robot_options import add_robot_options, refuse_robot_options, robot_scene

EXIT_STOPPED = 1


class StateError(LieGroupSimError):
    """The states are not available; one line of text, exit code 2."""


def refuse_repeated(option, names):
    """Raise StateError for a name that an option has twice."""
    if twice := [name for name in names if names.count(name) > 1]:
        raise StateError(f"{option}: {twice[0]} is given twice")


def add_states(parser):
    """Add the positional argument and the times."""
    parser.add_argument(
        "scene",
        metavar="SCENE",
        help="path of a scene or robot file, name of an example scene, or recording (*.mcap), whose inputs act",
    )
    parser.add_argument(
        "--at",
        type=float,
        nargs="+",
        default=[],
        metavar="T",
        help="simulated times in s, of a recording time stamps in s, in their order (default: the start)",
    )
    add_robot_options(parser)


def print_json(args, found):
    """Print the entries of all times, of one time without a list, if JSON is wanted; returns the exit code."""
    if args.json:
        print(json.dumps(found if len(found) > 1 else found[0], allow_nan=False))
    return 0


def stopped(error):
    """Print the line of an analysis that cannot continue; returns its exit code."""
    print(f"liegroup_sim: {error}", file=sys.stderr)
    return EXIT_STOPPED


def states(args, running=False):
    """Generator of (time of the user, Simulation, time in s within its present step).

    running : whether they will run on, to an accuracy
    Raises StateError, SceneError, RecordingError, ReplayError, SimulationError.
    """
    for time in args.at:
        if not math.isfinite(time):
            raise StateError(f"--at must be times in s, got {time:g}")
    if sorted(args.at) != args.at:
        raise StateError("--at: the times must be in their order")
    if Path(args.scene).suffix == ".mcap":
        refuse_robot_options(args)
        yield from _of_recording(args)
        return
    scene = robot_scene(args.scene, args)
    for time in (min(args.at, default=0.0), max(args.at, default=0.0)):
        if not 0.0 <= time <= LATEST:
            raise StateError(f"--at must be times from 0 to {LATEST:g} s, got {time:g}")
    if not any(args.at) and not running:
        yield 0.0, Simulation(scene, METHOD, estimate=False, quiet=True), None
        return
    simulation = Simulation(scene)
    for time in args.at or [0.0]:
        simulation.advance_to(time)
        yield time, simulation, time


def _of_recording(args):
    branches = Branches(read_recording(args.scene))
    for time in args.at or [branches.first_ns * 1e-9]:
        simulation, _ = branches.at(time, inputs=True)
        yield time, simulation, simulation.time
