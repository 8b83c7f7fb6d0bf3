# SPDX-License-Identifier: Apache-2.0
"""Trajectories and arrays of commands of a running node, over DDS, and their recording."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from commanded import STEP, Commanded
from node_process import NodeProcess, stamp_ns
from scene_files import text_of
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/led"
# Two links with servos of 70 rad/s and more, overdamped.
SCENE = text_of("arm_node_trajectory.yaml")


@pytest.fixture(scope="module")
def process(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("led")
    (folder / "arm.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "arm.yaml",
        "method": "rkmk4",
        "step": STEP,
        "joint_state_rate": 1000.0,
        "record": folder / "run.mcap",
        "command_joints": "elbow,shoulder",
        "trajectory_period": 0.001,
        "start_paused": "true",
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        node = Commanded(client, NODE)
        lead = client.publisher(f"{NODE}/joint_trajectory", JointTrajectory)
        array = client.publisher(f"{NODE}/commands", Float64MultiArray)
        yield SimpleNamespace(process=process, node=node, lead=lead, array=array, folder=folder)


@pytest.fixture
def node(client, process):
    process.node.restart()
    del process.node.states[:-1]
    return process.node


def trajectory(names, *points, stamp=0):
    found = JointTrajectory(joint_names=names)
    found.header.stamp.sec, found.header.stamp.nanosec = divmod(stamp, 10**9)
    for seconds, *numbers in points:
        fields = zip(("positions", "velocities", "accelerations"), numbers)
        point = JointTrajectoryPoint(**dict(fields))
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(seconds * 1e9), 10**9)
        found.points.append(point)
    return found


def motion(node, start):
    """(times since a stamp in s, positions (k, 2)) of all joint states since then."""
    found = [(stamp_ns(s.header.stamp) - start, s.position) for s in node.states]
    return np.array([t for t, _ in found]) * 1e-9, np.array([p for _, p in found])


def test_servos_follow_a_trajectory_from_its_stamp(process, node):
    """Two segments: a cubic from the present state, then a quintic; the servo lags by a part of its inertia."""
    node.steps(10)
    start = node.now() + 50_300_000
    message = trajectory(
        ["elbow", "shoulder"],
        (0.5, [0.4, -0.3], [0.6, -0.2], [0.0, 0.0]),
        (1.0, [0.2, 0.5], [0.0, 0.0], [0.0, 0.0]),
        stamp=start,
    )
    process.lead(message)
    node.steps(1200)
    times, found = motion(node, start)
    t = np.clip(times, 0.0, 0.5)[:, None]
    first = np.array([[3.0 * -0.3 + 0.2 * 0.5, 3.0 * 0.4 - 0.6 * 0.5]]) / 0.5**2 * t**2
    first += np.array([[0.6 - 0.2 * 0.5, -0.8 + 0.6 * 0.5]]) / 0.5**3 * t**3
    early = times <= 0.5
    assert np.abs(found - first)[early].max() < 1e-2 and np.abs(found[early]).max() > 0.3
    assert found[-1] == pytest.approx([0.5, 0.2], abs=1e-4)
    assert np.abs(found[times < -1e-4]).max() == 0.0


def test_a_restored_snapshot_continues_its_trajectory(client, process, node):
    """Bit for bit, both one that is followed and one that waits."""
    start = node.now() + 50_300_000
    process.lead(trajectory(["elbow", "shoulder"], (0.5, [0.4, -0.3]), stamp=start))
    for steps in (20, 200):  # before it starts, and within
        node.steps(steps)
        assert client.call(f"{NODE}/save_snapshot").success
        found = []
        for _ in range(2):
            begin = node.now()
            node.steps(300)
            since = ((stamp_ns(s.header.stamp) - begin, s) for s in node.states)
            found.append({ns: (*s.position, *s.velocity) for ns, s in since if ns > 0})
            assert client.call(f"{NODE}/restore_snapshot").success
            client.until(lambda: node.now() > begin + 300_000_000)
        both = found[0].keys() & found[1].keys()  # a burst of messages may have gaps
        assert 300_000_000 in both and len(both) > 20
        assert all(found[0][ns] == found[1][ns] for ns in both)
        assert np.ptp([found[0][ns][:2] for ns in both], axis=0).min() > 0.05


def test_a_position_command_takes_its_joint_from_the_trajectory(process, node):
    process.lead(trajectory(["elbow", "shoulder"], (1.0, [0.5, 0.5], [0.0, 0.0])))
    node.steps(200)
    node.command(name=["elbow"], position=[-0.2])
    node.steps(1200)
    assert list(node.states[-1].position) == pytest.approx([0.5, -0.2], abs=1e-4)


def test_an_array_commands_the_joints_of_the_parameter(process, node):
    process.array(Float64MultiArray(data=[0.3, math.nan]))
    state = node.steps(500)
    assert list(state.position) == pytest.approx([0.0, 0.3], abs=1e-4)
    process.array(Float64MultiArray(data=[0.1, -0.2]))
    state = node.steps(500)
    assert list(state.position) == pytest.approx([-0.2, 0.1], abs=1e-4)


def test_wrong_trajectories_are_counted_and_change_nothing(process, node):
    cases = (
        ("moving_at_end", trajectory(["elbow"], (1.0, [1.0], [1.0]))),
        ("wrong_times", trajectory(["elbow"], (1.0, [1.0]), (1.0, [2.0]))),
        ("unknown_joint", trajectory(["wrist"], (1.0, [1.0]))),
        ("not_finite", trajectory(["elbow"], (1.0, [math.nan]))),
        ("wrong_length", trajectory(["elbow"], (1.0, [1.0, 2.0]))),
    )
    given = [(reason, {"message": message}) for reason, message in cases]
    node.check_refusals(given, "joint_trajectories", process.lead)
    node.check_refusals([("wrong_length", {"message": Float64MultiArray(data=[0.3])})], "joint_commands", process.array)
    assert not any(node.states[-1].velocity)


def test_a_reset_ends_a_trajectory(process, client, node):
    process.lead(trajectory(["elbow"], (1.0, [1.0], [0.0])))
    node.steps(100)
    assert client.call(f"{NODE}/reset").success
    assert list(node.steps(300).position) == [0.0, 0.0]


def test_the_recording_is_repeated_bit_by_bit(process):
    log = process.process.end()
    assert log.count("joint trajectory refused") == 5, log
    recording = read_recording(process.folder / "run.mcap")
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 300 and figures["must_be_equal"]
    assert len(recording.servo_targets.stamp_ns) > 2000
