# SPDX-License-Identifier: Apache-2.0
"""The command `liegroup_sim`: its subcommands, and the exit codes for their errors.

A subcommand is a module of this folder with the same name and with

    add_arguments(parser)   sets the description and the arguments of an argparse parser
    run(args)               runs it and returns the exit code

and a line in COMMANDS. Only the module of the chosen subcommand is imported.

Exit code 0 on success, 2 and one line on stderr for wrong input or an output that cannot be written, 1 if a
simulation had to stop, 130 after Ctrl-C, SIGTERM, SIGHUP or SIGQUIT, 141 if the reader of stdout has ended.
"""

import errno
import os
import sys
from contextlib import suppress
from importlib import import_module

from liegroup_core.errors import LieGroupSimError
from liegroup_core.robots.access import anywhere
from liegroup_sim_ros.signals import end_as_by_ctrl_c, halt_on_signals, ignore
from liegroup_sim_ros.version import __version__

from .arguments import Parser

# Set before NumPy is imported. Threads slow down small solves, on a busy machine by large factors.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMANDS = {
    "demo": "simulate a heavy top in real time, push it, and analyse the recording",
    "import": "write the scene file of a robot: URDF, xacro, SDF or MJCF",
    "keys": "print the keys of a scene file",
    "describe": "summarise a scene: bodies, joints, degrees of freedom, cost per step",
    "trade": "measure accuracy against cost for a scene on this machine",
    "extremes": "stress-test the methods and report where they fail",
    "sweep": "run a scene with many sampled parameters, into Parquet",
    "linearise": "A, B, C, D of a scene or along a recording, with poles and zeros",
    "modes": "frequencies, damping and shapes of the modes of a scene, with loops",
    "trim": "find equilibria, steady motions, and the inputs that hold a pose",
    "inverse": "the efforts that a motion needs, with energy and power",
    "sensitivities": "derivatives of a run by numbers of the scene",
    "compare": "compare a bag of a real machine with a scene: noise, numerics, and what the model lacks",
    "identify": "find numbers of a scene from a bag, with intervals",
    "run": "simulate offline and write the trajectory to a file (no ROS needed)",
    "analyze": "report the numerical error of recordings",
    "replay": "publish a recording again, or simulate it again and compare",
    "info": "show the contents of a recording and whether it is complete",
    "recover": "repair a truncated or damaged recording",
    "push": "apply a wrench to a body of a running simulation",
    "view": "show a scene, a running node or a recording in the browser, live",
    "figures": "draw Figs. 6.2 and 6.4 to 6.9 of the chapter",
}
# Subcommands that read scenes and robots.
READERS = ("import", "describe", "trade", "extremes", "sweep", "run", "view", "analyze")
ANALYSES = (
    "linearise",
    "modes",
    "trim",
    "inverse",
    "sensitivities",
    "compare",
    "identify",
)  # of states and runs; they read scenes, too
FULL = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)  # stdout is redirected to a file that cannot grow
EXIT_WRONG_INPUT, EXIT_INTERRUPTED, EXIT_UNREAD = 2, 130, 141


def make_parser(chosen=None):
    """Parser of the command line; only the subcommand `chosen` gets its arguments."""
    parser = Parser(
        prog="liegroup_sim",
        description="Multibody dynamics on Lie groups for ROS 2.",
        epilog="The simulation node is a separate program: sim_node --ros-args -p "
        "scene:=heavy_top, or with a ROS installation: ros2 run liegroup_sim_ros sim_node "
        "--ros-args -p scene:=heavy_top",
    )
    parser.add_argument("--version", action="version", version=f"liegroup_sim {__version__}")
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=text)
        if name == chosen:
            module = import_module(f"liegroup_sim_ros.commands.{name}")
            module.add_arguments(subparser)
            if name in READERS + ANALYSES:
                subparser.add_argument(
                    "--allow-files",
                    action="store_true",
                    help="robot files may refer to files outside of their own folder trees",
                )
            subparser.set_defaults(run=module.run)
    return parser


def _drop_output():
    """Redirect stdout to /dev/null, so that flushing its buffer at exit raises no error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(args=None):
    """Run the command; returns the exit code."""
    is_program, args = args is None, sys.argv[1:] if args is None else args
    end_as_by_ctrl_c()
    if is_program:
        halt_on_signals()
    try:
        arguments = make_parser(args[0] if args else None).parse_args(args)
        with anywhere(getattr(arguments, "allow_files", False)):
            code = arguments.run(arguments)
        sys.stdout.flush()
        return code
    except LieGroupSimError as error:
        print(f"liegroup_sim: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except BrokenPipeError:  # the reader, such as head, has ended
        _drop_output()
        return EXIT_UNREAD
    except OSError as error:
        if error.errno not in FULL or error.filename is not None:
            raise
        _drop_output()
        print(f"liegroup_sim: the output cannot be written: {error.strerror}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    except KeyboardInterrupt:
        if is_program:
            ignore()  # another one, as `timeout` sends, would interrupt the end
        print("liegroup_sim: interrupted", file=sys.stderr, flush=True)
        if is_program:
            with suppress(OSError):
                sys.stdout.flush()
            os._exit(EXIT_INTERRUPTED)  # Python would wait for runs of other threads
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
