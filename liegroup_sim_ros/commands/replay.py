# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim replay`: publish a recording again, or simulate it again and compare."""

import json
import math
import sys

from rich.console import Console

from liegroup_sim_ros.playback.player_file import PlayError, PlayFile
from liegroup_sim_ros.playback.rerun import ReplayError
from liegroup_sim_ros.playback.resimulate import report, resimulate
from liegroup_sim_ros.recording.read import read_recording

from .arguments import not_negative
from .setting_options import add_settings, given

EXIT_DIFFERENT = 1
OTHER = ("method", "step", "group", "stabilisation")  # settings that may replace recorded ones


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Publish the topics of a recording with their own time stamps and /clock. Keys on a "
        "terminal: space pauses and resumes, up and down change the rate, right publishes the "
        "next sample while paused, left goes back 5 s. With --resimulate nothing is "
        "published: the run is simulated again from its recorded initial state and wrenches, "
        "and compared bit for bit. With --from, a simulation node continues the run from an "
        "instant of the recording, for example with other wrenches."
    )
    parser.epilog = (
        "Exit code: 0; 1 if --resimulate finds a difference where results must be identical, or a "
        "difference above --bound; 2 if a file cannot be read."
    )
    parser.add_argument("file", metavar="FILE", help="recording (*.mcap): a path or URL")
    parser.add_argument(
        "--rate",
        type=float,
        default=1.0,
        metavar="X",
        help="simulated seconds per second; 0: as fast as possible (default: 1)",
    )
    parser.add_argument(
        "--start", type=float, default=0.0, metavar="S", help="start time, s after the first message (default: 0)"
    )
    parser.add_argument("--loop", action="store_true", help="start again at the end")
    parser.add_argument("--start-paused", action="store_true", help="start paused, until ~/resume is called")
    parser.add_argument(
        "--clock-rate",
        type=float,
        default=100.0,
        metavar="HZ",
        help="rate of /clock if it was not recorded (default: %(default)g)",
    )
    parser.add_argument(
        "--from",
        dest="instant",
        type=float,
        metavar="T",
        help="continue the run in a simulation node from this time stamp of the recording, s",
    )
    parser.add_argument(
        "--inputs",
        action="store_true",
        help="with --from: also apply the wrenches recorded after this time (default: all wrenches end)",
    )
    parser.add_argument("--record", metavar="OUT", help="with --from: record the new run to this file (*.mcap)")
    parser.add_argument("--resimulate", action="store_true", help="simulate the run again and compare; publish nothing")
    add_settings(parser, OTHER, "with --resimulate: ", "recorded")
    parser.add_argument(
        "--bound", type=not_negative, metavar="X", help="with --resimulate: largest accepted difference, m and rad"
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises RecordingError, SceneError and others."""
    other = given(args, OTHER)
    if args.instant is not None:
        if args.resimulate or other or args.bound is not None:
            raise ReplayError("--from cannot be combined with --resimulate and its options")
        return _continue(args)
    if args.inputs or args.record:
        raise ReplayError("--inputs and --record require --from")
    if args.resimulate:
        return _resimulate(args.file, other, args.bound)
    if other or args.bound is not None:
        raise ReplayError(f"--{', --'.join(OTHER)} and --bound require --resimulate")
    for name in ("rate", "start", "clock_rate"):
        value = getattr(args, name)
        if not (math.isfinite(value) and value >= 0.0):
            raise PlayError(f"--{name.replace('_', '-')} must be a number, at least 0, got {value:g}")
    file = PlayFile(read_recording(args.file))
    if args.start > file.seconds:
        raise PlayError(f"--start {args.start:g}: the recording has {file.seconds:.6g} s; start earlier")
    try:
        from liegroup_sim_ros.playback.player import play
    except ImportError as error:
        if (error.name or "").startswith("liegroup"):
            raise
        raise PlayError(f"publishing requires ROS 2: {error}; --resimulate works without it") from None
    return play(file, args)


def _continue(args):
    """Run a simulation node that continues from an instant of a recording; returns its exit code."""
    from liegroup_sim_ros.node.entry import main

    if not (math.isfinite(args.instant) and args.instant >= 0.0):
        raise ReplayError(f"--from must be a number, at least 0, got {args.instant:g}")
    parameters = {
        "continue_from": json.dumps(args.file),
        "continue_at": f"{args.instant:.9f}",
        "continue_inputs": str(args.inputs).lower(),
        "real_time_factor": f"{args.rate:.9f}",
        "start_paused": str(args.start_paused).lower(),
        **({"record": json.dumps(args.record)} if args.record else {}),
    }
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    return main(["sim_node", "--ros-args", *given])


def _resimulate(path, other, bound):
    with Console(stderr=True).status("simulating again") as status:
        figures = resimulate(read_recording(path), status.update, **other)
    lines, failure = report(figures, bound)
    print("\n".join(lines))
    if failure:
        print(f"liegroup_sim: {failure}", file=sys.stderr)
        return EXIT_DIFFERENT
    return 0
