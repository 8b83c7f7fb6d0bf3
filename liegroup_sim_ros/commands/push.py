# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim push`: apply a wrench to a body of a running simulation from another process, or pull at it.

It publishes the wrench at a fixed rate, and a zero wrench at the end, also after Ctrl-C; a pull ends by itself. It
reports when the simulation applied it. The duration is wall time.
"""

import json
import math
import sys
import time

from liegroup_core.errors import LieGroupSimError

DISCOVERY = 10.0  # s; processes discover each other within 0.05 to 2.5 s
UNKNOWN = 1.0  # s, after which a name that is no body is refused if nothing has acted
ANSWER = 2.0  # s: longest response time of a running simulation


class PushError(LieGroupSimError):
    """The wrench cannot be applied; one line of text, exit code 2."""


def add_arguments(parser):
    """Arguments of the subcommand."""
    parser.description = (
        "Apply a wrench to a body of a running simulation node, or pull at it. Force and torque are in body "
        "axes, the torque is about the origin of the body frame."
    )
    parser.add_argument("body", metavar="BODY", help="name of the body")
    for name, unit in (("force", "N"), ("torque", "N m")):
        parser.add_argument(
            f"--{name}",
            nargs=3,
            type=float,
            metavar=("X", "Y", "Z"),
            default=(0.0, 0.0, 0.0),
            help=f"{unit}, body axes (default: 0 0 0)",
        )
    parser.add_argument(
        "--to",
        nargs=3,
        type=float,
        metavar=("X", "Y", "Z"),
        help="m, world axes: pull the origin of the body there with a spring of 1 Hz, instead of a wrench",
    )
    parser.add_argument(
        "--duration", type=float, default=1.0, metavar="S", help="duration in s of wall time (default: %(default)s)"
    )
    parser.add_argument(
        "--rate", type=float, default=50.0, metavar="HZ", help="messages per second (default: %(default)s)"
    )
    parser.add_argument(
        "--node", default="/sim_node", metavar="NAME", help="name of the simulation node (default: %(default)s)"
    )


def run(args):
    """Run the subcommand; returns the exit code. Raises PushError."""
    _check(args)
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise PushError(f"ROS 2 is needed to push: {error}") from None
    try:
        # Ctrl-C must leave the context alive for the zero wrench.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        print(_push(args))
        return 0
    except KeyboardInterrupt:
        print("liegroup_sim: interrupted; a zero wrench was sent", file=sys.stderr)
        return 130
    finally:
        rclpy.try_shutdown()


def _check(args):
    numbers = (*args.force, *args.torque, *(args.to or ()), args.duration, args.rate)
    if not all(map(math.isfinite, numbers)):
        raise PushError("all numbers must be finite")
    if args.to is not None and any((*args.force, *args.torque)):
        raise PushError("give either --to, or --force and --torque")
    if args.to is None and not any((*args.force, *args.torque)):
        raise PushError("the wrench is zero: give --force X Y Z, --torque X Y Z or --to X Y Z")
    if args.duration <= 0.0 or args.rate <= 0.0:
        raise PushError("--duration and --rate must be greater than 0")


def _push(args):
    """Apply the wrench; returns a line for the user."""
    import rclpy
    from geometry_msgs.msg import PointStamped, WrenchStamped
    from rclpy.duration import Duration
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter_client import AsyncParameterClient
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import String

    name = "/" + args.node.strip("/")
    node = rclpy.create_node("liegroup_sim_push")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    kind, topic = (WrenchStamped, "wrench") if args.to is None else (PointStamped, "pull")
    publisher = node.create_publisher(kind, f"{name}/{topic}", 10)
    applied = []  # (start in s, command) on this body

    def listen(message):
        entries = json.loads(message.data)
        base_ns, merged = entries["base_ns"], f"({args.body})"  # in the source: a link that is part of a body
        own = [c for c in entries["commands"] if c.get("name") == args.body or merged in c.get("source", "")]
        if not entries["all"]:
            applied.extend(((base_ns + command["start_ns"]) * 1e-9, command) for command in own)

    node.create_subscription(String, f"{name}/inputs", listen, 100)
    bodies = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(String, f"{name}/bodies", lambda message: bodies.extend(message.data.split()), latched)

    def spin_until(done, seconds):
        """Spin until done() is true; returns False after the given number of seconds."""
        end = time.monotonic() + seconds
        while not done():
            if (left := end - time.monotonic()) <= 0.0:
                return False
            executor.spin_once(timeout_sec=min(left, 0.02))
        return True

    # Wait for both directions, because otherwise the response would be missed.
    if not spin_until(
        lambda: publisher.get_subscription_count() and node.count_publishers(f"{name}/inputs"), DISCOVERY
    ):
        raise PushError(
            f"no simulation node {name} found within {DISCOVERY:g} s: check that it is "
            "running (a first start compiles for half a minute) with the same "
            "ROS_DOMAIN_ID, and give its name with --node"
        )
    if not spin_until(lambda: bodies, DISCOVERY):
        raise PushError(f"{name} does not answer: it may be shutting down")

    def refuse_unknown():
        if args.body not in bodies and not applied:
            raise PushError(f"{name} has no body or link {args.body!r}; its bodies: {', '.join(sorted(bodies))}")

    parameters, answers = AsyncParameterClient(node, name), []

    def answered():
        answers.append(parameters.get_parameters(["frame_prefix"]))
        return spin_until(answers[-1].done, ANSWER)

    # The answer is lost if the node has not yet discovered the client.
    if not any(answered() for _ in range(round(DISCOVERY / ANSWER))):
        raise PushError(f"{name} does not answer: it may be shutting down")
    frame = answers[-1].result().values[0].string_value + args.body
    message = kind()
    message.header.frame_id = frame
    vectors = [(message.wrench.force, args.force), (message.wrench.torque, args.torque)] if args.to is None else []
    for vector, values in vectors or [(message.point, args.to)]:
        vector.x, vector.y, vector.z = values
    start, sent = time.monotonic(), 0
    try:
        # A simulation that is behind real time must take the wrench before its end arrives.
        while sent / args.rate < args.duration or not applied and time.monotonic() - start < ANSWER:
            publisher.publish(message)
            sent += 1
            planned = sent / args.rate
            due = start + (planned if planned - args.duration > 1.0 / args.rate else min(planned, args.duration))
            spin_until(lambda: False, due - time.monotonic())
            if time.monotonic() - start > UNKNOWN:
                refuse_unknown()
    finally:
        if args.to is None:
            publisher.publish(WrenchStamped(header=message.header))
        seconds = time.monotonic() - start
        publisher.wait_for_all_acked(Duration(seconds=ANSWER))

    def vanished():
        return args.to is None and len(applied) > 1 and not any(applied[-1][1]["values"])

    if args.to is None:
        spin_until(vanished, ANSWER)
    refuse_unknown()
    what = f"applied force {list(args.force)} N and torque {list(args.torque)} N m to {args.body}"
    what, then = (what, ", then a zero wrench") if args.to is None else (f"pulled {args.body} to {args.to} m", "")
    text = f"{what} of {name} for {seconds:.2f} s: {sent} messages{then}\n"
    if not applied:
        return text + "the simulation has not applied it: it may be paused; see its log"
    return text + (
        f"applied from {applied[0][0]:.9g} s to {applied[-1][0]:.9g} s of simulated time"
        if vanished()
        else f"applied from {applied[0][0]:.9g} s of simulated time on"
    )
