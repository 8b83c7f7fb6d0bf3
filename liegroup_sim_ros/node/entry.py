# SPDX-License-Identifier: Apache-2.0
"""ROS 2 node: simulates a scene in real time, publishes poses and twists, takes wrenches, records.

Exit code 0 after SIGINT or SIGTERM, 2 with one line on stderr for wrong parameters or a wrong
scene, 1 when the simulation thread was ended by a defect. The node itself is in node.py, which is
imported when the signals are caught already: that takes a second.
"""

import signal
import sys

USAGE = (
    "usage: sim_node --ros-args -p scene:=SCENE [-p NAME:=VALUE ...] [-r "
    "__ns:=/NAMESPACE]\n\nSCENE is the path of a scene file, or the name of an "
    "example scene such as heavy_top.\nParameters (step, method, publish_rate, "
    "record, ...): see docs/reference/node.md, or ask a running node:\nros2 param list "
    "/sim_node"
)


class Signals:
    """Notes SIGINT and SIGTERM, as often as they come; `received` is looked at, nothing is raised.

    rclpy's own handlers would shut its context down at once, with messages still to be published;
    and `ros2 launch` sends a second SIGINT, which must not interrupt the clean-up.
    """

    def __init__(self):
        self.received = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, *_):
        self.received = True


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
        # A signal that comes now would meet Python's own handlers, in the middle of its end.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    sys.exit(main())
