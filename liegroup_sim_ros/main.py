# SPDX-License-Identifier: Apache-2.0
"""The command `liegroup_sim`: analyse recordings, push a running simulation, show a demo.

Exit code 0 when it is done, 2 and one line on stderr when something given to it is wrong, 130
after Ctrl-C.
"""
import argparse
import sys

from liegroup_core.errors import LieGroupSimError

from . import __version__, analyze, demo, push
from .analyze import AnalysisError
from .demo import DemoError
from .recording import RecordingError

WRONG_INPUT = (LieGroupSimError, RecordingError, AnalysisError, DemoError)
EXIT_WRONG_INPUT, EXIT_INTERRUPTED = 2, 130


def make_parser():
    """The command line; ROS is imported by the subcommands that need it, when they run."""
    parser = argparse.ArgumentParser(
        prog="liegroup_sim", description="Multibody dynamics on Lie groups for ROS 2.",
        epilog="The simulation itself is a node: sim_node --ros-args -p scene:=heavy_top, or with "
        "a ROS installation: ros2 run liegroup_sim_ros sim_node --ros-args -p scene:=heavy_top")
    parser.add_argument("--version", action="version", version=f"liegroup_sim {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (demo, analyze, push):
        command.add_parser(subparsers)
    return parser


def main(args=None):
    """Run the command; returns the exit code."""
    arguments = make_parser().parse_args(args)
    try:
        return arguments.run(arguments)
    except WRONG_INPUT as error:
        print(f"liegroup_sim: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except KeyboardInterrupt:
        print("liegroup_sim: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
