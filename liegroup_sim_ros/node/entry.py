# SPDX-License-Identifier: Apache-2.0
"""ROS 2 node: simulates a scene in real time, publishes poses and twists, takes wrenches, records.

Exit code 0 after SIGINT, SIGTERM, SIGHUP or SIGQUIT, 2 with one line on stderr for wrong parameters or a wrong
scene, 1 if a defect ended the simulation thread. The node itself is in node.py. Its import takes a
second and happens after the signal handlers are installed.
"""

import os
import signal
import sys

from liegroup_sim_ros.signals import SIGNALS, Signals

# Before NumPy is loaded, as in commands/main.py: threads make small solves slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

USAGE = (
    "usage: sim_node --ros-args -p scene:=SCENE [-p NAME:=VALUE ...] [-r "
    "__ns:=/NAMESPACE]\n\nSCENE is the path of a scene file, or the name of an "
    "example scene such as heavy_top.\nParameters (step, method, publish_rate, "
    "record, ...): config/default.yaml lists all, or ask a running node:\nros2 param describe "
    "/sim_node NAME"
)


def main(args=None):
    """Run the node; `args` as sys.argv. Returns the exit code."""
    args = sys.argv if args is None else args
    signals = Signals()
    if args[1:] in (["-h"], ["--help"]):
        print(USAGE)
        return 0
    try:
        from .node import run
    except ImportError as error:
        if (error.name or "").startswith("liegroup"):
            raise
        print(
            f"sim_node: ROS 2 is needed: {error}; source a ROS 2 workspace, or pip install "
            "'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces",
            file=sys.stderr,
        )
        return 2
    try:
        return run(args, signals)
    finally:
        # Python's own handlers would interrupt its shutdown.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    sys.exit(main())
