# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim view`: a scene, a running node or a recording in the browser, live."""

import time
import webbrowser

from rich.console import Console

from liegroup_core import Simulation
from liegroup_sim_ros.recording.addresses import is_remote
from liegroup_sim_ros.signals import Signals
from liegroup_sim_ros.view.local import Local
from liegroup_sim_ros.view.page import Page
from liegroup_sim_ros.view.recorded import Recorded
from liegroup_sim_ros.view.server import LOOPBACK, ViewError

from .arguments import has_display
from .robot_options import add_robot_options, robot_scene
from .setting_options import add_settings, given

PORT = 8090
LOOK = 0.2  # s between two looks for Ctrl-C


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Show a simulation in the browser while it runs: pull at bodies with the mouse, command joints, pause, go "
        "back. Ctrl-C ends it."
    )
    parser.add_argument(
        "what",
        nargs="*",
        metavar="WHAT",
        help="a scene or robot file, the name of an example scene, or a recording (*.mcap); a second recording of the "
        "same scene is drawn beside it",
    )
    parser.add_argument("--node", metavar="NAME", help="a running node instead, such as /sim_node")
    parser.add_argument(
        "--robot", metavar="FILE", help="robot file (URDF, SDF, MJCF) of a recording or a node: its visuals are drawn"
    )
    parser.add_argument("--out", metavar="FILE", default="", help="record the simulation to FILE (*.mcap)")
    parser.add_argument("--paused", action="store_true", help="start paused")
    parser.add_argument(
        "--host", default=LOOPBACK[0], metavar="ADDRESS", help="address to serve (default: this machine only)"
    )
    parser.add_argument(
        "--port", type=int, default=PORT, metavar="N", help=f"port, or the next free one (default: {PORT})"
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only print the address")
    add_settings(parser)
    add_robot_options(parser)


def run(args):
    """Run the subcommand; returns the exit code. Raises LieGroupSimError."""
    with Signals() as signals:
        source, beside = _sources(args)
        show(source, signals, args.browser, beside, args.robot, args.host, args.port)


def show(source, signals, browser=True, beside=None, robot=None, host=LOOPBACK[0], port=PORT):
    """Show a Source in the browser, until a signal."""
    try:
        page = Page(source, host, port, beside, robot)
        page.start()
        try:
            Console(stderr=True).print(
                f"{source.title}: {page.address} (Ctrl-C ends it)", highlight=False, markup=False
            )
            if browser and has_display():
                webbrowser.open(page.address)
            while True:
                signals.check()
                time.sleep(LOOK)
        finally:
            source = page.source
            page.stop()
    finally:
        source.close()


def _sources(args):
    """(Source, Source beside it or None) of the arguments. Raises LieGroupSimError."""
    recordings = [what for what in args.what if what.endswith(".mcap") or is_remote(what)]
    settings = given(args)
    of_scene = [*settings, *(name for name in ("out", "paused") if getattr(args, name))]
    if of_scene and (recordings or args.node is not None):
        raise ViewError(f"--{of_scene[0].replace('_', '-')} is for a scene, not for recordings and nodes")
    if args.robot is not None and not recordings and args.node is None:
        raise ViewError("--robot is for recordings and nodes: give the robot file as WHAT")
    if args.node is not None:
        if args.what:
            raise ViewError("give --node or WHAT, not both")
        from liegroup_sim_ros.view.remote import Remote

        return Remote(args.node), None
    if not args.what or len(args.what) > (2 if recordings else 1) or len(recordings) not in (0, len(args.what)):
        raise ViewError("give one scene, or one or two recordings, or --node NAME")
    if recordings:
        shown = [Recorded(path) for path in recordings]
        for path, source in zip(recordings, shown):
            if source.recording.problem:
                Console(stderr=True).print(f"{path}: {source.recording.problem}", highlight=False, markup=False)
        if len(shown) > 1 and shown[1].layout.body_names != shown[0].layout.body_names:
            raise ViewError(f"{recordings[1]}: its bodies are not those of {recordings[0]}")
        return (*shown, None)[:2]
    scene = robot_scene(args.what[0], args)
    console = Console(stderr=True)
    try:
        with console.status("starting"):
            simulation = Simulation(scene, **settings)
    except ValueError as error:  # includes SceneError
        raise ViewError(str(error)) from None
    return Local(simulation, scene.name, args.out, paused=args.paused), None
