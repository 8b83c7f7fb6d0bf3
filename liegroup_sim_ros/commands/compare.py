# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim compare`: a bag of a real machine against a scene. No ROS."""

import json
import sys
from dataclasses import replace

from rich.console import Console

from liegroup_core import SimulationError
from liegroup_core.errors import LieGroupSimError
from liegroup_core.identification import compare
from liegroup_core.identification.log import joined
from liegroup_core.layout import make_layout
from liegroup_core.scene.yaml_text import read_yaml
from liegroup_sim_ros.logs.bag import open_bag, recordings
from liegroup_sim_ros.logs.load import load_log
from liegroup_sim_ros.logs.map import Map, load_map
from liegroup_sim_ros.logs.suggest import suggest
from liegroup_sim_ros.report.compare_page import document, make_page, print_comparison
from liegroup_sim_ros.report.files import check_files, write_text
from liegroup_sim_ros.report.terminal import working
from liegroup_sim_ros.signals import Signals

from .arguments import count
from .robot_options import add_robot_options, robot_scene
from .states import stopped


class LogError(LieGroupSimError):
    """Arguments do not fit a log; one line of text, exit code 2."""


def add_log(parser, least="+"):
    """Add the arguments that name a scene and bags; least: "+", or "*" if there may be no bag."""
    parser.add_argument("scene", metavar="SCENE", help="path of a scene or robot file, or name of an example scene")
    parser.add_argument(
        "bag", nargs=least, metavar="BAG", help="MCAP or SQLite files, or folders of `ros2 bag record`, of one machine"
    )
    parser.add_argument(
        "--map", metavar="FILE", help="what the topics are in the scene (*.yaml; default: that of --suggest)"
    )
    parser.add_argument("--workers", type=count, metavar="N", help="number of threads (default: one per core)")
    parser.add_argument("--json", metavar="FILE", help="write all figures as JSON; - prints it")
    parser.add_argument("--html", metavar="PAGE", help="write a self-contained HTML page")
    add_robot_options(parser)


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Compare a bag with the simulation of its inputs: residuals against noise, errors of the integration, delays "
        "of the clocks, and which effects (friction, inertia, mass, scales, offsets) would explain what is left."
    )
    parser.add_argument("--suggest", action="store_true", help="only print a map of the bag, found by types and names")
    parser.add_argument("--view", action="store_true", help="show the machine in the browser, and the model as a ghost")
    parser.add_argument(
        "--no-browser", dest="browser", action="store_false", help="with --view: only print the address"
    )
    add_log(parser)


def run(args):
    """Run the subcommand; returns the exit code."""
    check_log(args)
    scene = robot_scene(args.scene, args)
    if args.suggest:
        with open_bag(*recordings(args.bag)[0]) as bag:
            text, notes = suggest(bag, scene, make_layout(scene))
        print(text, end="")
        for note in notes:
            print(f"# {note}")
        return 0
    log = log_of(args, scene)
    try:
        with working("comparing") as tell:
            found = compare(scene, log, args.workers, tell)
    except SimulationError as error:
        return stopped(error)
    show(found, args, scene)
    if args.view:
        from liegroup_sim_ros.view.compared import sources_of

        from .view import show as show_page

        with Signals() as signals:
            machine, model = sources_of(found)
            show_page(machine, signals, args.browser, model)
    return 0


def check_log(args):
    """Raise LogError or ReportError for wrong arguments, before the work."""
    check_files(None if args.json == "-" else args.json, args.html)


def log_of(args, scene):
    """Log of the arguments. Raises BagError, SceneError."""
    layout = make_layout(scene)
    turns = {body.name: body.pose[:3, :3] for body in scene.bodies}
    given, logs = None if args.map is None else load_map(args.map), []
    groups = recordings(args.bag, given and {entry.topic for entry in (*given.inputs, *given.measurements)})
    for paths in groups:
        path = ", ".join(paths)
        with open_bag(*paths) as bag:
            if given is None:
                text, notes = suggest(bag, scene, layout)
                root = read_yaml(text, "suggested map")
                if not root.value["measurements"]:
                    why = "; ".join(notes[:2])
                    raise LogError(f"{path}: no topic fits the names of {scene.name}: write a map, see --map. {why}")
                given = Map(**root.value)
            log = load_log(bag, given, scene, turns)
            several = len(groups) > 1
            logs.append(replace(log, notes=tuple(f"{path}: {note}" for note in log.notes)) if several else log)
    return joined(logs)


def show(found, args, scene, more=None):
    """Write and print a Comparison, with the figures `more` of an identification."""
    result = document(found, {"scene": scene.name, "log": ", ".join(args.bag)}) | (more or {})
    if args.json and args.json != "-":
        write_text(args.json, json.dumps(result, indent=1, allow_nan=False) + "\n")
    if args.html:
        write_text(args.html, make_page(found, result))
    if args.json == "-":
        print(json.dumps(result, allow_nan=False))
    else:
        print_comparison(result, Console(file=sys.stdout))
