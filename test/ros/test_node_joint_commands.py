# SPDX-License-Identifier: Apache-2.0
"""Joint commands of a running node: closed forms, stamps, timeout, refusals, storms, recordings."""

import math

import pytest
from commanded import STEP, Commanded, coordinates
from node_process import NodeProcess, output_of, python
from scene_files import text_of

from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/commanded"
# Hinge of inertia 0.5 kg m^2 and slide of 2 kg, each alone on the ground; a free ball joint.
SCENE = text_of("bench_node_joint_commands.yaml")
STORM = """
import sys, time, rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("storm")
publisher = node.create_publisher(JointState, "/commanded/joint_commands", 10_000)
while not publisher.get_subscription_count():
    time.sleep(0.01)
good = serialize_message(JointState(name=["hinge", "slide"], effort=[0.5, -1.0]))
wrong = serialize_message(JointState(name=["hinge", "slide"], effort=[0.5]))
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
    folder = tmp_path_factory.mktemp("commanded")
    (folder / "bench.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "bench.yaml",
        "method": "rkmk4",
        "step": STEP,
        "joint_state_rate": 1000.0,
        "record": folder / "run.mcap",
        "real_time_factor": 1.0,
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        yield process, Commanded(client, NODE), folder / "run.mcap"


@pytest.fixture
def node(client, process):
    """Paused at the initial state, at rest."""
    node = process[1]
    assert client.call(f"{NODE}/pause").success
    assert client.set(NODE, command_timeout=0.0).successful
    node.restart()
    return node


def test_a_constant_effort_gives_the_known_accelerations(node):
    """tau / I = 3 rad/s^2, f / m = -2 m/s^2; round-off of 100 steps."""
    node.command(name=["slide", "hinge"], effort=[-4.0, 1.5])
    state = node.steps(100)
    assert state.name == ["hinge", "slide"] and list(state.effort) == [1.5, -4.0]
    for found, acceleration in zip(coordinates(state), (3.0, -2.0)):
        assert found == pytest.approx((acceleration * 0.005, acceleration * 0.1), abs=1e-13)
    # A subset, and one without a command of this kind.
    node.command(name=["hinge", "slide"], effort=[0.0, math.nan])
    after = node.steps(100)
    assert after.velocity == pytest.approx([0.3, -0.4], abs=1e-13)
    assert math.isnan(after.effort[0]) and after.effort[1] == -4.0


def test_a_command_acts_from_its_stamp(node):
    """In the middle of a step: 20.3 ms, and the next one replaces it at 70.7 ms."""
    now = node.now()
    node.command(now + 20_300_000, name=["hinge"], effort=[1.5])
    node.command(now + 70_700_000, name=["hinge"], effort=[-1.0])
    state = node.steps(100)
    rate = 3.0 * 0.0504 - 2.0 * 0.0293
    angle = 3.0 * 0.0504 * (0.0252 + 0.0293) - 0.0293**2
    assert coordinates(state)[0] == pytest.approx((angle, rate), abs=1e-13)
    assert [order.start - now for order in node.given] == [20_300_000, 70_700_000]


def test_a_command_ends_after_the_timeout(client, node):
    assert client.set(NODE, command_timeout=0.05).successful
    node.command(name=["hinge"], effort=[1.0])
    assert node.steps(200).velocity[0] == pytest.approx(2.0 * 0.05, abs=1e-13)


def test_wrong_commands_are_counted_and_change_nothing(node):
    good = {"name": ["hinge"], "effort": [1.0]}
    node.check_refusals(
        [
            ("unknown_joint", {"name": ["wheel"], "effort": [1.0]}),
            ("no_coordinate", {"name": ["ball"], "effort": [1.0]}),
            ("wrong_length", {"name": ["hinge"], "effort": [1.0, 2.0]}),
            ("not_finite", {"name": ["hinge"], "effort": [math.inf]}),
            ("no_servo", {"name": ["hinge"], "position": [1.0]}),
            ("repeated_joint", {"name": ["hinge"] * 2, "effort": [1.0, 2.0]}),
            ("stamp_too_old", good | {"stamp": -(10**9)}),
            ("stamp_too_far", good | {"stamp": node.now() + 3601 * 10**9}),
        ]
    )
    assert not node.given and not any(node.states[-1].velocity)


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
    assert node.figure("wrenches_held") == 2 and list(state.effort) == [0.5, -1.0]


def test_the_recording_of_it_all_is_repeated_bit_by_bit(client, process):
    server, _, path = process
    log = server.end()
    # Each refusal once in the log, in one line; two of them have the same reason.
    refused = [line.partition("refused: ")[2] for line in log.splitlines() if "joint command refused" in line]
    assert len(refused) == len(set(refused)) == 9, log
    recording = read_recording(path)
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] > 100 and figures["must_be_equal"]
    assert {command.kind for command in recording.inputs} == {"effort"}
    assert path.parent.joinpath("run.mcap").exists()
