# SPDX-License-Identifier: Apache-2.0
"""Efforts, servo targets and driven joints of a running node: stamps, timeout, refusals, parts of a recording."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from commanded import STEP, Commanded, finished_parts
from node_process import LATCHED, NodeProcess, output_of, python, stamp_ns
from scene_files import text_of
from scipy.linalg import expm
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from liegroup_core.joints.motion import at, through
from liegroup_sim_ros.playback.branch import Branches

NODE = "/bench"
MOTION_TIME = 0.04
DRIVEN = "axle", "track"
STORM = """
import sys, time, rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("storm")
publisher = node.create_publisher(JointState, "/bench/joint_commands", 10_000)
while not publisher.get_subscription_count():
    time.sleep(0.01)
good = serialize_message(JointState(name=["hinge", "rail"], effort=[0.5, -1.0]))
wrong = serialize_message(JointState(name=["hinge", "rail"], effort=[0.5]))
start, sent, count = time.monotonic(), 0, int(sys.argv[1])
while sent < count:
    while sent < min(count, (time.monotonic() - start) * 10_000):
        publisher.publish(wrong if sent % 2 else good)
        sent += 1
    time.sleep(0.0005)
print(sent)
"""


@pytest.fixture(scope="module")
def process(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    (folder / "bench.yaml").write_text(text_of("bench.yaml"))
    parameters = {
        "scene": folder / "bench.yaml",
        "method": "rkmk8",
        "stabilisation": "projection",
        "step": STEP,
        "joint_state_rate": 1000.0,
        "motion_time": MOTION_TIME,
        "record": folder / "run.mcap",
        "record_split_duration": 1.0,
        "start_paused": "true",
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        node = Commanded(client, NODE)
        lead = client.publisher(f"{NODE}/joint_trajectory", JointTrajectory)
        yield SimpleNamespace(process=process, node=node, events=client.events(NODE), lead=lead, folder=folder)


@pytest.fixture
def node(client, process):
    """At the initial state."""
    process.node.restart()
    return process.node


def of(state, joint):
    """(position, velocity) of a joint."""
    k = state.name.index(joint)
    return state.position[k], state.velocity[k]


def effort_of(state, joint):
    return state.effort[state.name.index(joint)]


def elbow_after(state, position, velocity, t):
    """Angle and rate of the elbow after a time with constant targets of its servo."""
    matrix = np.zeros((3, 3))
    matrix[0, 1] = 1.0
    matrix[1] = -40 / 0.5, -3 / 0.5, (40 * position + 3 * velocity) / 0.5
    return (expm(matrix * t) @ [*state, 1.0])[:2]


def test_a_constant_effort_gives_the_known_accelerations(node):
    """tau / I = 3 rad/s^2, f / m = -2 m/s^2; round-off of 100 steps."""
    node.command(name=["rail", "hinge"], effort=[-4.0, 1.5])
    state = node.steps(100)
    assert state.name[:4] == ["hinge", "rail", "elbow", "slide"] and list(state.effort[:2]) == [1.5, -4.0]
    for joint, acceleration in (("hinge", 3.0), ("rail", -2.0)):
        assert of(state, joint) == pytest.approx((acceleration * 0.005, acceleration * 0.1), abs=1e-13)
    # A subset, and one without a command of this kind.
    node.command(name=["hinge", "rail"], effort=[0.0, math.nan])
    after = node.steps(100)
    assert after.velocity[:2] == pytest.approx([0.3, -0.4], abs=1e-13)
    assert math.isnan(after.effort[0]) and after.effort[1] == -4.0


def test_an_effort_acts_from_its_stamp(node):
    """In the middle of a step: 20.3 ms, and the next one replaces it at 70.7 ms."""
    now = node.now()
    node.command(now + 20_300_000, name=["hinge"], effort=[1.5])
    node.command(now + 70_700_000, name=["hinge"], effort=[-1.0])
    state = node.steps(100)
    rate = 3.0 * 0.0504 - 2.0 * 0.0293
    angle = 3.0 * 0.0504 * (0.0252 + 0.0293) - 0.0293**2
    assert of(state, "hinge") == pytest.approx((angle, rate), abs=1e-13)
    assert [order.start - now for order in node.given] == [20_300_000, 70_700_000]


def test_after_the_timeout_efforts_end_servos_return_and_driven_joints_come_to_rest(client, node):
    assert client.set(NODE, command_timeout=0.05).successful
    node.command(name=["hinge"], effort=[1.0])
    node.command(name=["elbow"], position=[1.0])
    node.command(name=["axle"], velocity=[2.0])
    assert of(node.steps(45), "axle")[1] == pytest.approx(2.0, abs=1e-12)
    state = node.steps(155)
    assert of(state, "hinge")[1] == pytest.approx(2.0 * 0.05, abs=1e-13)
    expected = elbow_after(elbow_after((0.0, 0.0), 1.0, 0.0, 0.05), 0.0, 0.0, 0.15)
    assert of(state, "elbow") == pytest.approx(tuple(expected), abs=1e-12)
    assert of(state, "axle")[1] == pytest.approx(0.0, abs=1e-12)
    assert client.set(NODE, command_timeout=0.0).successful


def test_wrong_commands_are_counted_and_change_nothing(node):
    good = {"name": ["hinge"], "effort": [1.0]}
    node.check_refusals(
        [
            ("unknown_joint", {"name": ["wheel"], "effort": [1.0]}),
            ("no_coordinate", {"name": ["ball"], "effort": [1.0]}),
            ("wrong_length", {"name": ["hinge"], "effort": [1.0, 2.0]}),
            ("not_finite", {"name": ["hinge"], "effort": [math.inf]}),
            ("not_finite", {"name": ["elbow"], "position": [-math.inf]}),
            ("not_finite", {"name": ["axle"], "position": [math.inf]}),
            ("no_servo", {"name": ["hinge"], "position": [1.0]}),
            ("no_servo", {"name": ["hinge", "elbow"], "position": [1.0, 1.0]}),
            ("no_servo", {"name": ["hook"], "velocity": [1.0]}),
            ("no_position", {"name": ["elbow"], "velocity": [1.0]}),
            ("beyond_limits", {"name": ["track"], "velocity": [1e12]}),
            ("beyond_limits", {"name": [*DRIVEN], "position": [0.1, 1.3], "velocity": [0.0, 0.0]}),
            ("beyond_limits", {"name": ["axle"], "position": [1e12]}),
            ("repeated_joint", {"name": ["hinge"] * 2, "effort": [1.0, 2.0]}),
            ("stamp_too_old", good | {"stamp": -(10**9)}),
            ("stamp_too_far", good | {"stamp": node.now() + 3601 * 10**9}),
        ]
    )
    assert not node.given and not any(node.states[-1].velocity[:4])
    assert of(node.states[-1], "axle")[1] == pytest.approx(1.5, abs=1e-12)


def test_a_storm_of_commands_is_accepted_or_refused_one_by_one(client, node):
    """10 kHz, half of them wrong, while the node runs."""
    accepted, refused = "joint_commands_accepted", "joint_commands_refused_wrong_length"
    before = [node.figure(name) for name in (accepted, refused)]
    assert client.call(f"{NODE}/resume").success
    storm = python(STORM, 10_000)
    client.until(lambda: storm.poll() is not None, "the end of the storm")
    assert int(output_of(storm)) == 10_000
    assert client.call(f"{NODE}/pause").success
    state = node.steps(1)
    taken, wrong = (node.figure(name) - known for name, known in zip((accepted, refused), before))
    # A busy machine loses some in DDS, of both kinds.
    assert 0 < taken <= 5000 and 0 < wrong <= 5000
    assert node.figure("wrenches_held") == 2 and list(state.effort[:2]) == [0.5, -1.0]


def test_positions_and_velocities_are_targets_of_servos_from_their_stamp(client, node):
    now = node.now()
    node.command(now + 20_300_000, name=["elbow"], position=[-0.7], velocity=[2.0])
    node.command(now + 70_700_000, name=["slide", "elbow"], position=[math.nan, 0.5])
    state = node.steps(200)
    expected = elbow_after((0.0, 0.0), -0.7, 2.0, 0.0504)
    expected = elbow_after(expected, 0.5, 0.0, 0.2 - 0.0707)
    assert of(state, "elbow") == pytest.approx(tuple(expected), abs=1e-12)
    torque = 40 * (0.5 - expected[0]) - 3 * expected[1]
    assert effort_of(state, "elbow") == pytest.approx(torque, abs=1e-10)
    assert effort_of(state, "slide") == 0.0 and math.isnan(effort_of(state, "hinge"))
    # A late subscriber gets what all servos want now.
    late = client.listen(f"{NODE}/servo_targets", JointState, LATCHED)
    client.until(lambda: late and list(late[-1].position) == [0.5, 0.0], what="the targets")
    assert late[-1].name == ["elbow", "slide"] and list(late[-1].velocity) == [0.0, 0.0]
    assert stamp_ns(late[-1].header.stamp) == now + 70_700_000


def test_a_velocity_alone_drives_a_servo_without_stiffness_up_to_its_limit(process, node):
    """4 N on 2 kg, then it holds 0.1 m/s: 50 N s/m leave exp(-25 t) of the rest."""
    before = node.figure("servo_saturations")
    node.command(name=["slide"], velocity=[0.1])
    state = node.steps(5)
    assert of(state, "slide")[1] == pytest.approx(2.0 * 0.005, abs=1e-13) and effort_of(state, "slide") == 4.0
    state = node.steps(995)
    assert of(state, "slide")[1] == pytest.approx(0.1, abs=1e-8) and abs(effort_of(state, "slide")) < 1e-6
    assert node.figure("servo_saturations") == before + 1
    (text,) = (event.msg for event in process.events if event.name == "saturated")
    assert text.startswith("4 is the effort limit that the servo of slide has reached")


def test_a_position_beyond_command_jump_is_refused_and_counted(client, node):
    """The limit is set while the node runs; it holds from the present position, also after a step."""
    too_far = {"name": ["elbow"], "position": [0.3]}
    assert client.set(NODE, command_jump=0.2).successful
    node.check_refusals([("jump_too_large", too_far), ("jump_too_large", {"name": ["track"], "position": [1.0]})])
    assert of(node.states[-1], "elbow")[1] == 0.0
    taken = node.figure("joint_commands_accepted")
    node.command(name=["elbow"], position=[0.19])
    assert of(node.steps(300), "elbow")[0] > 0.15
    node.command(**too_far)
    node.steps(100)
    assert client.set(NODE, command_jump=0.0).successful
    node.command(name=["elbow"], position=[-9.0])
    node.steps(100)
    assert node.figure("joint_commands_accepted") == taken + 3


def test_a_driven_joint_reaches_its_position_in_the_motion_time_and_reports_its_effort(client, node):
    """At its stamp inside a step; then the wheel goes on at the commanded velocity."""
    now = node.now()
    node.command(now + 20_300_000, name=["axle"], position=[0.5], velocity=[3.0])
    state = node.steps(50)
    motion, rest = through((1.5 * 0.0203, 1.5, 0.0), [0.0203, 0.0603], [0.5], [3.0])
    position, velocity, acceleration = at(motion, 0.05)
    assert of(state, "axle") == pytest.approx((position, velocity), abs=1e-12)
    assert effort_of(state, "axle") == pytest.approx(0.5 * acceleration, abs=1e-10)
    assert of(node.steps(150), "axle") == pytest.approx(at(rest, 0.2)[:2], abs=1e-12)
    late = client.listen(f"{NODE}/motions", Float64MultiArray, LATCHED)
    client.until(lambda: late and abs(late[-1].data[0] - 0.0603) < 1e-9, what="the motions")
    assert late[-1].layout.dim[0].label == "axle track"
    assert list(late[-1].data[:7]) == pytest.approx(rest, abs=1e-12)
    assert late[-1].data[7] == math.inf  # the track has the motion of the scene


def test_a_driven_joint_reaches_a_velocity_and_a_reset_returns_to_the_motion_of_the_scene(node):
    node.command(name=["track"], velocity=[-0.4])
    reached, rate = of(node.steps(100), "track")
    assert rate == pytest.approx(-0.4, abs=1e-12)
    assert of(node.steps(100), "track")[0] == pytest.approx(reached - 0.04, abs=1e-12)
    node.restart()
    state = node.steps(600)
    assert of(state, "axle") == pytest.approx((0.9, 1.5), abs=1e-12)
    assert of(state, "track")[0] == pytest.approx(0.2, abs=1e-12)


def trajectory(names, *points):
    """JointTrajectory of points (time in s, positions, velocities)."""
    message = JointTrajectory(joint_names=names)
    for time, positions, velocities in points:
        point = JointTrajectoryPoint(positions=positions, velocities=velocities)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(1e9 * time), 10**9)
        message.points.append(point)
    return message


def test_driven_joints_follow_a_trajectory_exactly_and_refuse_one_that_they_cannot(process, node):
    process.lead(trajectory(["track"], (0.2, [0.1], [0.5]), (0.5, [0.3], [0.0])))
    assert of(node.steps(200), "track") == pytest.approx((0.1, 0.5), abs=1e-12)
    before = node.steps(400)
    assert of(before, "track") == pytest.approx((0.3, 0.0), abs=1e-12)
    far = trajectory(["track", "axle"], (0.2, [0.1, 1e12], []))
    node.check_refusals([("beyond_limits", {"message": far})], "joint_trajectories", process.lead)
    assert of(node.steps(99), "axle")[0] - of(before, "axle")[0] == pytest.approx(0.15, abs=1e-12)


@pytest.mark.turn(3)
def test_every_part_of_the_recording_is_repeated_and_analysed(process, node):
    """A part that begins while a command acts has it; the reference integration follows it."""
    node.command(name=["elbow", "slide", *DRIVEN], position=[0.3, 0.0, 0.3, 0.0], velocity=[0.0, 0.05, 0.0, 0.05])
    node.command(node.now() + 300_500_000, name=["elbow", "axle"], position=[-0.2, -0.2])
    node.command(name=["hinge"], effort=[0.01])
    node.steps(4300)
    acting = []
    recordings = finished_parts(process)
    for recording in recordings:
        assert {command.kind for command in recording.inputs} <= {"effort"}
        for track, names in ((recording.servo_targets, ("elbow", "slide")), (recording.motions, DRIVEN)):
            if track is not None and track.stamp_ns[0] == recording.initial_state["stamp_ns"]:
                acting.append(names)
                assert track.names == names
        motions = recording.motions
        if motions is not None:
            frame = recording.to_pandas("motions")
            assert frame["axle"].c0.to_numpy().tobytes() == motions.motion[:, 0, 1].tobytes()
    assert acting.count(DRIVEN) >= 3 and acting.count(("elbow", "slide")) >= 3
    # A branch of the last part without inputs: what was commanded comes to rest.
    branches = Branches(recordings[-1])
    simulation, _ = branches.at(0.5e-9 * (branches.first_ns + branches.last_ns))
    commanded = set(simulation.commanded_motions)
    simulation.advance(30)
    rates = {joint: motion[1] for joint, motion in simulation.sample().prescribed.items()}
    assert commanded and all((rates[joint] == 0.0) == (joint in commanded) for joint in DRIVEN)
