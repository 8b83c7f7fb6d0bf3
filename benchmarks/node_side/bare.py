# SPDX-License-Identifier: Apache-2.0
"""Bare rclpy processes that measure the cost of the same messages without a simulation. Run as

    python bare.py paced SECONDS             ready bytes of pose, twist and clock at 1 kHz
    python bare.py objects|bytes SECONDS     the same as fast as possible: message objects or ready bytes
    python bare.py echo                      a WrenchStamped in, a TwistStamped out; JointState both ways
    python bare.py storm RATE SECONDS        wrenches, every second one wrong, at a rate

and each prints one line of JSON, `echo` none.
"""

import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from liegroup_core.pacing import Pacer


def build(step):
    """Pose, twist and clock messages of a step, as message objects."""
    pose, twist, clock = PoseStamped(), TwistStamped(), Clock()
    sec, nanosec = divmod(step * 1_000_000, 1_000_000_000)
    for message, frame in ((pose, "world"), (twist, "top")):
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        message.header.frame_id = frame
    clock.clock.sec, clock.clock.nanosec = sec, nanosec
    p, q, v, w = (pose.pose.position, pose.pose.orientation, twist.twist.linear, twist.twist.angular)
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0
    v.x, v.y, v.z, w.x, w.y, w.z = 0.1, 0.2, 0.3, 0.4, 0.5, 0.6
    return pose, twist, clock


def publishers(node):
    return [node.create_publisher(kind, f"bare/{kind.__name__}", 10) for kind in (PoseStamped, TwistStamped, Clock)]


def paced(node, seconds):
    streams, ready = publishers(node), [serialize_message(m) for m in build(0)]
    pacer, cpu = Pacer(), time.process_time()
    pacer.start(0.0)
    for tick in range(1, round(1000 * seconds) + 1):
        while not pacer.wait(tick * 1e-3):
            pass
        for stream, data in zip(streams, ready):
            stream.publish(data)
    return {**pacer.report(), "cpu": (time.process_time() - cpu) / seconds}


def flat_out(node, seconds, objects):
    streams, ready = publishers(node), [serialize_message(m) for m in build(0)]
    count, cpu, end = 0, time.process_time(), time.monotonic() + seconds
    while time.monotonic() < end:
        for _ in range(100):
            for stream, message in zip(streams, build(count) if objects else ready):
                stream.publish(message)
            count += 1
    return {"cpu_us_per_message": 1e6 * (time.process_time() - cpu) / (3 * count)}


def echo(node):
    twists = node.create_publisher(TwistStamped, "echo/puck/twist", 10)
    states = node.create_publisher(JointState, "echo/joint_states", 10)
    twist, state = TwistStamped(), JointState(position=[0.0], velocity=[0.0])

    def take_wrench(message):
        twist.twist.linear.x = message.wrench.force.x
        twists.publish(twist)

    def take_command(message):
        state.name, state.effort = message.name, message.effort
        states.publish(state)

    node.create_subscription(WrenchStamped, "echo/wrench", take_wrench, 100)
    node.create_subscription(JointState, "echo/joint_commands", take_command, 100)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except KeyboardInterrupt:
        pass


def storm(node, rate, seconds):
    """Alternate valid wrenches and wrenches with one of four errors."""
    stream = node.create_publisher(WrenchStamped, "/sim_node/wrench", 1000)
    messages = []
    for frame, force, sec in (("nobody", 1.0, 0), ("top", math.nan, 0), ("", 1.0, 0), ("top", 1.0, 2_000_000_000)):
        for wrong in (False, True):
            message = WrenchStamped()
            message.header.frame_id = frame if wrong else "top"
            message.header.stamp.sec = sec if wrong else 0
            message.wrench.force.x = force if wrong else 1e-3
            messages.append(serialize_message(message))
    while not stream.get_subscription_count():
        time.sleep(0.05)
    stream.publish(messages[0])  # not counted; acknowledged once publisher and subscriber are connected
    if not stream.wait_for_all_acked(Duration(seconds=30.0)):
        sys.exit("bare.py: the simulation node does not listen")
    sent, start = 0, time.monotonic()
    while (elapsed := time.monotonic() - start) < seconds:
        while sent < rate * elapsed:
            stream.publish(messages[sent % 8])
            sent += 1
        time.sleep(1e-3)
    stream.wait_for_all_acked(Duration(seconds=10.0))
    time.sleep(1.0)
    return {"sent": sent, "wrong": sent // 2}


def main(role, *numbers):
    """Run the process of the given kind to its end."""
    rclpy.init()
    node = rclpy.create_node(f"bare_{role}")
    numbers = [float(number) for number in numbers]
    if role == "echo":
        echo(node)
    elif role in ("objects", "bytes"):
        print(json.dumps(flat_out(node, *numbers, role == "objects")))
    else:
        print(json.dumps({"paced": paced, "storm": storm}[role](node, *numbers)))


if __name__ == "__main__":
    main(*sys.argv[1:])
