# SPDX-License-Identifier: Apache-2.0
"""A controller as ros2_control runs it, in a process of its own, drives an arm and a four-bar linkage.

The stand-in takes topics, joints and gains from docs/how-to/ros2_control.md.
"""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from node_process import NodeProcess, output_of, python

from liegroup_core import load_scene
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

DOCS = Path(__file__).resolve().parents[2] / "docs" / "how-to"
PAGE = (DOCS / "ros2_control.md").read_text()
BLOCK = re.search(r"^```xml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
CONTROLLERS, SERVOS = re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
CONTROLLERS = yaml.safe_load(CONTROLLERS)
ARM = re.search(r"^```xml\n(.*?)^```$", (DOCS / "robot.md").read_text(), re.MULTILINE | re.DOTALL)[1].replace(
    "</robot>", BLOCK + "</robot>"
)

# JointStateTopicSystem: topics, quality of service, names, NaN before a controller is active, stamps of
# a wall clock. JointTrajectoryController: from the present position to the goal on a cubic spline, as
# positions, or as efforts by PID with a clamped integral. Both are called with every message of /clock.
STAND_IN = """
import json, math, sys, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

task = json.loads(sys.argv[1])
names, gains, goal = task["joints"], task["gains"], task["goal"]
rclpy.init()
node = rclpy.create_node("stand_in")
publisher = node.create_publisher(JointState, task["commands"], 1)
latest, position, velocity = [], {}, {}
integral = dict.fromkeys(names, 0.0)
start, last, errors, stamps = None, None, [], []


def read():
    state = latest[-1]
    for name, angle, rate in zip(state.name, state.position, state.velocity):
        before = position.get(name, angle)
        position[name] = before + math.remainder(angle - before, 2.0 * math.pi)
        velocity[name] = rate


def write(commands):
    message = JointState(name=names, **{task["interface"]: commands})
    message.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(message)


def update(message):
    global start, last
    now = message.clock.sec + 1e-9 * message.clock.nanosec
    if not latest or now == last:
        write([math.nan] * len(names))
        return
    read()
    if start is None:
        start = now, dict(position)
    period, last = (now - last if last is not None else 0.0), now
    s = min(1.0, (now - start[0]) / task["seconds"])
    efforts, positions, error = [], [], 0.0
    for name in names:
        way, gain = goal[name] - start[1][name], gains[name]
        wanted = start[1][name] + way * s * s * (3.0 - 2.0 * s)
        rate = way * 6.0 * s * (1.0 - s) / task["seconds"] if s < 1.0 else 0.0
        off = wanted - position[name]
        integral[name] += off * period
        most = gain["i_clamp"]
        part = max(-most, min(most, gain["i"] * integral[name]))
        efforts.append(gain["p"] * off + part + gain["d"] * (rate - velocity[name]))
        positions.append(wanted)
        error = max(error, abs(off))
    write({"effort": efforts, "position": positions}[task["interface"]])
    errors.append(error)
    stamps.append(now)


node.create_subscription(JointState, task["states"], latest.append, qos_profile_sensor_data)
node.create_subscription(Clock, "/clock", update, QoSProfile(depth=1))
step = node.create_client(Trigger, "/sim_node/step")
executor = SingleThreadedExecutor()
executor.add_node(node)
step.wait_for_service()
while not publisher.get_subscription_count():
    executor.spin_once(timeout_sec=0.1)
while not stamps or stamps[-1] - start[0] < 2.0 * task["seconds"]:
    count, stepped = len(stamps), step.call_async(Trigger.Request())
    # Without an update, a message on its way was lost, or the clock was faster than the states.
    end = time.monotonic() + 1.0
    while not stepped.done() or len(stamps) == count and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
gaps = sorted(b - a for a, b in zip(stamps, stamps[1:]))
print(json.dumps({
    "median": sorted(errors)[len(errors) // 2], "largest": max(errors), "final": max(errors[-50:]),
    "updates": len(stamps), "median_s": gaps[len(gaps) // 2], "longest_s": gaps[-1],
}), flush=True)
"""


def drive(tmp_path, scene, task):
    """(figures of the stand-in, recording) of a closed loop that ends at twice its seconds.

    The stand-in asks for each step of 2 ms after its update, so that no machine delays it.
    """
    path = tmp_path / "run.mcap"
    parameters = {
        "scene": scene,
        "method": "rkmk8",
        "step": 2e-3,
        "joint_state_rate": 500.0,
        "clock_rate": 500.0,
        "command_timeout": 0.5,
        "command_stamps": "false",
        "start_paused": "true",
        "record": path,
    }
    with NodeProcess(parameters) as process:
        output = output_of(python(STAND_IN, json.dumps(task)))
        log = process.end()
        assert "refused" not in log, log
    return json.loads(output), read_recording(path)


def check_repeated(recording, joints):
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 300 and figures["must_be_equal"]
    assert {command.name for command in recording.inputs} == joints
    assert recording.complete and not recording.lost


def test_the_page_names_the_topics_and_joints_of_the_node(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    scene = load_scene(tmp_path / "arm.urdf")
    block = ElementTree.fromstring(BLOCK)
    found = {each.get("name"): each.text for each in block.iter("param")}
    assert found["joint_states_topic"] == "/sim_node/joint_states"
    assert found["joint_commands_topic"] == "/sim_node/joint_commands"
    joints = [joint.get("name") for joint in block.iter("joint")]
    controller = CONTROLLERS["arm_controller"]["ros__parameters"]
    assert joints == [joint.name for joint in scene.joints] == controller["joints"]
    assert set(controller["gains"]) == set(joints)
    for joint in block.iter("joint"):
        commands, states = (
            [each.get("name") for each in joint.iter(f"{kind}_interface")] for kind in ("command", "state")
        )
        assert commands == controller["command_interfaces"] == ["effort"]
        assert set(states) >= {*controller["state_interfaces"], "effort"}


@pytest.mark.parametrize("interface", ["effort", "position"])
@pytest.mark.volume(1)
def test_a_trajectory_controller_drives_the_arm(tmp_path, interface):
    (tmp_path / "arm.urdf").write_text(ARM)
    found = {each.get("name"): each.text for each in ElementTree.fromstring(BLOCK).iter("param")}
    controller = CONTROLLERS["arm_controller"]["ros__parameters"]
    task = {
        "states": found["joint_states_topic"],
        "commands": found["joint_commands_topic"],
        "joints": controller["joints"],
        "gains": controller["gains"],
        "goal": {"shoulder": 0.8, "elbow": -1.2},
        "seconds": 2.0,
        "interface": interface,
    }
    (tmp_path / "servos.yaml").write_text(SERVOS)
    scene = tmp_path / ("arm.urdf" if interface == "effort" else "servos.yaml")
    figures, recording = drive(tmp_path, scene, task)
    # Gravity pulls 14.4 N m at the start, before the integral holds it: 0.036 rad at rest. Servos
    # have no integral, and lag by damping / stiffness times 1 rad/s: 0.035 s. Delays add to it.
    assert figures["median"] < 0.04 and figures["largest"] < 0.3, figures
    assert figures["final"] < (5e-3 if interface == "effort" else 0.01), figures
    assert figures["updates"] > 1900 and figures["median_s"] == pytest.approx(0.002, abs=1e-6)
    check_repeated(recording, {"shoulder", "elbow"} if interface == "effort" else set())
    assert (recording.servo_targets is None) == (interface == "effort")


@pytest.mark.turn(3)
def test_a_trajectory_controller_turns_the_crank_of_a_loop(tmp_path):
    """One turn, past the wrap of the angle at pi."""
    text = load_scene("four_bar").text
    assert text.count("rate: 31.41592653589793") == 1
    (tmp_path / "slow.yaml").write_text(text.replace("rate: 31.41592653589793", "rate: 0.0"))
    task = {
        "states": "/sim_node/joint_states",
        "commands": "/sim_node/joint_commands",
        "joints": ["ground_crank"],
        "gains": {"ground_crank": {"p": 200.0, "i": 0.0, "d": 20.0, "i_clamp": 0.0}},
        "goal": {"ground_crank": 8.0},
        "seconds": 2.0,
        "interface": "effort",
    }
    figures, recording = drive(tmp_path, tmp_path / "slow.yaml", task)
    assert figures["median"] < 0.1 and figures["largest"] < 0.5, figures
    assert figures["final"] < 5e-3, figures
    assert figures["updates"] > 1900
    check_repeated(recording, {"ground_crank"})
