# SPDX-License-Identifier: Apache-2.0
"""Sides of benchmarks/lockstep.py in processes of their own: python lockstep.py SIDE JSON, one of

controller   PD of joints (effort), or an effort that depends on the first joint, with random delays
bare         states without a simulation: publishes a JointState as soon as the last one is answered
"""

import json
import random
import sys
import time

import rclpy
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState

from liegroup_sim_ros.controller import Controller


def spin(node):
    executor = EventsExecutor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=1.0)


def controller(node, topic, rate, gains, joints, chance, longest):
    random.seed(None)

    def compute(state):
        if chance and random.random() < chance:
            time.sleep(longest * random.random())
        places = [state.name.index(joint) for joint in joints]
        efforts = [-gains[0] * state.position[k] - gains[1] * state.velocity[k] for k in places]
        return JointState(name=joints, effort=efforts)

    Controller(node, rate, [("/sim_node/joint_states", JointState)], (f"/sim_node/{topic}", JointState), compute)
    spin(node)


def bare(node, joints, seconds):
    publisher = node.create_publisher(JointState, "/sim_node/joint_states", 10)
    numbers = [0.1] * len(joints)
    state = JointState(name=joints, position=numbers, velocity=numbers, effort=numbers)
    count, start = -1, 0.0

    def send():
        nonlocal count, start
        count += 1
        if count == 0:
            start = time.monotonic()
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(count * 10**6, 10**9)
        publisher.publish(state)

    def receive(answer):
        if answer.header.stamp == state.header.stamp:
            if time.monotonic() - start > seconds:
                print(count / (time.monotonic() - start), flush=True)
                rclpy.shutdown()
            else:
                send()

    node.create_subscription(JointState, "/sim_node/joint_commands", receive, 10)
    time.sleep(3.0)  # discovery
    send()
    spin(node)


if __name__ == "__main__":
    rclpy.init()
    {"controller": controller, "bare": bare}[sys.argv[1]](
        rclpy.create_node(f"{sys.argv[1]}_{random.randrange(10**6)}"), **json.loads(sys.argv[2])
    )
