# SPDX-License-Identifier: Apache-2.0
"""The command `liegroup_sim`: describe, measure and run scenes, analyse recordings, push, demo.

Exit code 0 when it is done, 2 and one line on stderr when something given to it is wrong, 1 when a
simulation had to stop, 130 after Ctrl-C, 141 when nobody reads what it says.
"""

import argparse
import os
import sys

# Before NumPy is loaded: threads make small solves slower, on a busy machine many times.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from liegroup_core.errors import LieGroupSimError
from liegroup_sim_ros import __version__
from liegroup_sim_ros.playback.player_file import PlayError
from liegroup_sim_ros.playback.repeat import ReplayError
from liegroup_sim_ros.recording.read import RecordingError
from liegroup_sim_ros.recording.write_run import OutputError

from . import analyze as analyze_logs
from . import demo, describe, extremes, figures, info, push, recover, replay, sweep, trade
from . import run as offline
from .analyze import AnalysisError
from .demo import DemoError
from .extremes import ExtremesError
from .figures import FiguresError
from .push import PushError
from .run import RunError
from .trade import TradeError

WRONG_INPUT = (
    LieGroupSimError,
    RecordingError,
    AnalysisError,
    DemoError,
    ExtremesError,
    FiguresError,
    OutputError,
    PlayError,
    PushError,
    ReplayError,
    RunError,
    TradeError,
)
EXIT_WRONG_INPUT, EXIT_INTERRUPTED, EXIT_UNREAD = 2, 130, 141


def make_parser():
    """The command line; ROS is imported by the subcommands that need it, when they run."""
    parser = argparse.ArgumentParser(
        prog="liegroup_sim",
        description="Multibody dynamics on Lie groups for ROS 2.",
        epilog="The simulation itself is a node: sim_node --ros-args -p scene:=heavy_top, or with "
        "a ROS installation: ros2 run liegroup_sim_ros sim_node --ros-args -p scene:=heavy_top",
    )
    parser.add_argument("--version", action="version", version=f"liegroup_sim {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (
        demo,
        describe,
        trade,
        extremes,
        sweep,
        offline,
        analyze_logs,
        replay,
        info,
        recover,
        push,
        figures,
    ):
        command.add_parser(subparsers)
    return parser


def main(args=None):
    """Run the command; returns the exit code."""
    arguments = make_parser().parse_args(args)
    try:
        code = arguments.run(arguments)
        sys.stdout.flush()
        return code
    except WRONG_INPUT as error:
        print(f"liegroup_sim: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except BrokenPipeError:  # whoever reads, as head does, has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_UNREAD
    except KeyboardInterrupt:
        print("liegroup_sim: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
