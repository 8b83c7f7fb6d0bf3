# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim sensitivities`: derivatives of a run's outputs by numbers of the scene. No ROS."""

import json
import math
import sys

import numpy as np
from rich.console import Console
from rich.text import Text

from liegroup_core import SimulationError
from liegroup_core.linear import sensitivities
from liegroup_sim_ros.numbers import shown
from liegroup_sim_ros.report.tables import TextTable
from liegroup_sim_ros.report.terminal import printed, working

from .robot_options import add_robot_options, robot_scene
from .states import StateError, stopped


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Derivatives of a run's outputs with respect to masses, lengths, stiffnesses, start values and other numbers "
        "of the scene, impacts and friction included."
    )
    parser.add_argument("scene", metavar="SCENE", help="path of a scene or robot file, or name of an example scene")
    parser.add_argument(
        "--by", nargs="+", required=True, metavar="NAME", help="numbers of the scene, as of `liegroup_sim sweep --vary`"
    )
    parser.add_argument(
        "--of", nargs="+", metavar="OUTPUT", help="names as of `liegroup_sim run --columns` (default: joints)"
    )
    parser.add_argument("--at", type=float, nargs="+", required=True, metavar="T", help="simulated times in s")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_robot_options(parser)


def run(args):
    """Run the subcommand; returns the exit code."""
    if not all(math.isfinite(time) and time >= 0.0 for time in args.at) or sorted(args.at) != args.at:
        raise StateError("--at must be times in s from 0 on, in their order")
    try:
        scene = robot_scene(args.scene, args)
        with working("sensitivities") as tell:
            found = sensitivities(scene, args.by, args.at, args.of, tell)
    except SimulationError as error:
        return stopped(error)
    if args.json:
        arrays = (getattr(found, name) for name in ("times", "values", "derivatives", "errors"))
        entries = [np.where(np.isnan(array), None, array).tolist() for array in arrays]  # JSON has no NaN
        names = {name: list(getattr(found, name)) for name in ("outputs", "parameters", "rough")}
        entries = dict(zip(("times", "values", "derivatives", "errors"), entries))
        print(json.dumps(names | entries, allow_nan=False))
        return 0
    console = Console(file=sys.stdout)
    for k, time in enumerate(found.times):
        rows, heads = [], ("output", "value", *found.parameters)
        for p, name in enumerate(found.outputs):
            cells = (f"{x:.6g} ± {shown(e)}" for x, e in zip(found.derivatives[k, p], found.errors[k, p]))
            rows.append((name, f"{found.values[k, p]:.6g}", *cells))
        console.print(printed(TextTable(f"at {time:.9g} s", heads, rows, len(heads))))
    if found.rough:
        names = ", ".join(found.rough)
        console.print(Text(f"no derivative, because runs to both sides behave differently: {names}", style="yellow"))
    return 0
