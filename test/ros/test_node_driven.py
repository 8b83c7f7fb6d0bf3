# SPDX-License-Identifier: Apache-2.0
"""Driven joints of a running node: commands, trajectories, resets, recordings and their analysis."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from commanded import STEP, Commanded, coordinates, finished_parts
from node_process import LATCHED, NodeProcess
from scene_files import text_of
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from liegroup_core.joints.motion import at, through
from liegroup_sim_ros.playback.branch import Branches

NODE = "/prescribed"
MOTION_TIME = 0.04
# Wheel of 0.5 kg m^2 that turns at 1.5 rad/s, cart with a motion of its own and a pendulum.
SCENE = text_of("bench_node_driven.yaml")


@pytest.fixture(scope="module")
def process(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("prescribed")
    (folder / "bench.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "bench.yaml",
        "method": "rkmk8",
        "stabilisation": "projection",
        "step": STEP,
        "joint_state_rate": 1000.0,
        "motion_time": MOTION_TIME,
        "record": folder / "run.mcap",
        "record_split_duration": 0.4,
        "start_paused": "true",
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        yield SimpleNamespace(process=process, node=Commanded(client, NODE), folder=folder)


@pytest.fixture
def node(client, process):
    """At the initial state."""
    process.node.restart()
    return process.node


def test_a_position_is_reached_in_the_motion_time_and_its_effort_reported(client, node):
    """At its stamp inside a step; then the wheel goes on at the commanded velocity."""
    now = node.now()
    node.command(now + 20_300_000, name=["hinge"], position=[0.5], velocity=[3.0])
    state = node.steps(50)
    motion, rest = through((1.5 * 0.0203, 1.5, 0.0), [0.0203, 0.0603], [0.5], [3.0])
    position, velocity, acceleration = at(motion, 0.05)
    assert coordinates(state)[0] == pytest.approx((position, velocity), abs=1e-12)
    assert state.effort[0] == pytest.approx(0.5 * acceleration, abs=1e-10)
    state = node.steps(150)
    assert coordinates(state)[0] == pytest.approx(at(rest, 0.2)[:2], abs=1e-12)
    late = client.listen(f"{NODE}/motions", Float64MultiArray, LATCHED)
    client.until(lambda: late and 0.06 < late[-1].data[0] < 1.0, what="the motions")
    assert late[-1].layout.dim[0].label == "hinge slide"
    assert list(late[-1].data[:7]) == pytest.approx(rest, abs=1e-12)
    assert late[-1].data[7] == math.inf  # the slide has the motion of the scene


def test_a_velocity_alone_is_reached_in_the_motion_time(client, node):
    node.command(name=["slide"], velocity=[-0.4])
    state = node.steps(100)
    assert state.velocity[1] == pytest.approx(-0.4, abs=1e-12)
    reached = state.position[1]
    assert node.steps(100).position[1] == pytest.approx(reached - 0.04, abs=1e-12)


def test_after_the_timeout_a_joint_comes_to_rest(client, node):
    assert client.set(NODE, command_timeout=0.1).successful
    node.command(name=["hinge"], velocity=[2.0])
    assert node.steps(90).velocity[0] == pytest.approx(2.0, abs=1e-12)
    assert node.steps(100).velocity[0] == pytest.approx(0.0, abs=1e-12)
    assert client.set(NODE, command_timeout=0.0).successful


def test_a_reset_returns_to_the_motion_of_the_scene(client, node):
    node.command(name=["slide", "hinge"], position=[0.3, 0.0])
    node.steps(300)
    node.restart()
    state = node.steps(600)
    assert coordinates(state)[0] == pytest.approx((0.9, 1.5), abs=1e-12)
    assert state.position[1] == pytest.approx(0.2, abs=1e-12)


def trajectory(names, *points):
    """JointTrajectory of points (time in s, positions, velocities)."""
    message = JointTrajectory(joint_names=names)
    for time, positions, velocities in points:
        point = JointTrajectoryPoint(positions=positions, velocities=velocities)
        point.time_from_start.sec = int(time)
        point.time_from_start.nanosec = round(1e9 * (time % 1.0))
        message.points.append(point)
    return message


def test_a_trajectory_is_followed_exactly(client, node):
    lead = client.publisher(f"{NODE}/joint_trajectory", JointTrajectory)
    lead(trajectory(["slide"], (0.2, [0.1], [0.5]), (0.5, [0.3], [0.0])))
    state = node.steps(200)
    assert coordinates(state)[1] == pytest.approx((0.1, 0.5), abs=1e-12)
    state = node.steps(400)
    assert coordinates(state)[1] == pytest.approx((0.3, 0.0), abs=1e-12)


def test_what_a_driven_joint_cannot_do_is_refused(client, node):
    assert client.set(NODE, command_jump=0.5).successful
    node.check_refusals(
        [
            ("no_servo", {"name": ["hook"], "position": [1.0]}),
            ("not_finite", {"name": ["hinge"], "position": [math.inf]}),
            ("jump_too_large", {"name": ["slide"], "position": [1.0]}),
            ("beyond_limits", {"name": ["slide"], "velocity": [1e12]}),
            ("beyond_limits", {"name": ["hinge", "slide"], "position": [0.1, 1.3], "velocity": [0.0, 0.0]}),
        ]
    )
    assert client.set(NODE, command_jump=0.0).successful
    assert node.states[-1].velocity[0] == pytest.approx(1.5, abs=1e-12)


def test_a_far_position_is_refused_without_any_parameter(client, node):
    """Of a trajectory, too; the joint goes on as before."""
    lead = client.publisher(f"{NODE}/joint_trajectory", JointTrajectory)
    before = node.steps(100)
    node.check_refusals([("beyond_limits", {"name": ["hinge"], "position": [1e12]})])
    far = trajectory(["slide", "hinge"], (0.2, [0.1, 1e12], []))
    node.check_refusals([("beyond_limits", {"message": far})], "joint_trajectories", lead)
    after = node.steps(98)
    assert after.velocity[0] == pytest.approx(1.5, abs=1e-12)
    assert after.position[0] - before.position[0] == pytest.approx(0.15, abs=1e-12)


@pytest.mark.turn(3)
def test_every_part_of_the_recording_is_repeated_and_analysed(process, node):
    """A part that begins in a commanded motion has it; the reference integration follows it."""
    node.command(name=["hinge", "slide"], position=[0.3, 0.0], velocity=[0.0, 0.05])
    node.command(node.now() + 300_500_000, name=["hinge"], position=[-0.2])
    node.steps(1300)
    acting = 0
    for recording in finished_parts(process):
        motions = recording.motions
        if motions is not None and motions.stamp_ns[0] == recording.initial_state["stamp_ns"]:
            acting += 1
            frame = recording.to_pandas("motions")
            assert frame["hinge"].c0.to_numpy().tobytes() == motions.motion[:, 0, 1].tobytes()
            assert motions.names == ("hinge", "slide") and np.isfinite(motions.motion[0, :, 0]).any()
        # A branch without inputs: what was commanded comes to rest.
        branches = Branches(recording)
        simulation, _ = branches.at(0.5e-9 * (branches.first_ns + branches.last_ns))
        commanded = set(simulation.commanded_motions)
        simulation.advance(30)
        rates = {joint: motion[1] for joint, motion in simulation.sample().prescribed.items()}
        assert all((rates[joint] == 0.0) == (joint in commanded) for joint in ("hinge", "slide"))
    assert acting >= 3
