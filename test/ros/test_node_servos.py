# SPDX-License-Identifier: Apache-2.0
"""Servos of a running node: commands, saturation, resets, recordings in parts and their analysis."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from commanded import STEP, Commanded, coordinates, finished_parts
from node_process import LATCHED, NodeProcess, stamp_ns
from scene_files import text_of
from scipy.linalg import expm
from sensor_msgs.msg import JointState

NODE = "/driven"
# Hinge of 0.5 kg m^2 with a servo, slide of 2 kg with a velocity servo and a limit, a free hinge.
SCENE = text_of("bench_node_servos.yaml")


def hinge_after(state, position, velocity, t):
    """Angle and rate of the hinge after a time with constant targets."""
    matrix = np.zeros((3, 3))
    matrix[0, 1] = 1.0
    matrix[1] = -40 / 0.5, -3 / 0.5, (40 * position + 3 * velocity) / 0.5
    return (expm(matrix * t) @ [*state, 1.0])[:2]


@pytest.fixture(scope="module")
def process(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("driven")
    (folder / "bench.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "bench.yaml",
        "method": "rkmk8",
        "step": STEP,
        "joint_state_rate": 1000.0,
        "record": folder / "run.mcap",
        "record_split_duration": 0.4,
        "start_paused": "true",
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        node = Commanded(client, NODE)
        events = client.events(NODE)
        yield SimpleNamespace(process=process, node=node, events=events, folder=folder)


@pytest.fixture
def node(client, process):
    """At the initial state, at rest."""
    process.node.restart()
    return process.node


def test_a_position_and_velocity_are_targets_from_their_stamp(client, node):
    now = node.now()
    node.command(now + 20_300_000, name=["hinge"], position=[-0.7], velocity=[2.0])
    node.command(now + 70_700_000, name=["slide", "hinge"], position=[math.nan, 0.5])
    state = node.steps(200)
    expected = hinge_after((0.0, 0.0), -0.7, 2.0, 0.0504)
    expected = hinge_after(expected, 0.5, 0.0, 0.2 - 0.0707)
    assert coordinates(state)[0] == pytest.approx(tuple(expected), abs=1e-12)
    torque = 40 * (0.5 - expected[0]) - 3 * expected[1]
    assert state.effort[0] == pytest.approx(torque, abs=1e-10)
    assert state.effort[1] == 0.0 and math.isnan(state.effort[2])
    # A late subscriber gets what all servos want now.
    late = client.listen(f"{NODE}/servo_targets", JointState, LATCHED)
    client.until(lambda: late and list(late[-1].position) == [0.5, 0.0], what="the targets")
    assert late[-1].name == ["hinge", "slide"] and list(late[-1].velocity) == [0.0, 0.0]
    assert stamp_ns(late[-1].header.stamp) == now + 70_700_000


def test_a_velocity_alone_drives_a_servo_without_stiffness_up_to_its_limit(client, process, node):
    """4 N on 2 kg, then it holds 0.1 m/s: 50 N s/m leave exp(-25 t) of the rest."""
    before = node.figure("servo_saturations")
    node.command(name=["slide"], velocity=[0.1])
    state = node.steps(5)
    assert state.velocity[1] == pytest.approx(2.0 * 0.005, abs=1e-13) and state.effort[1] == 4.0
    state = node.steps(995)
    assert state.velocity[1] == pytest.approx(0.1, abs=1e-8) and abs(state.effort[1]) < 1e-6
    assert node.figure("servo_saturations") == before + 1
    (text,) = (event.msg for event in process.events if event.name == "saturated")
    assert text.startswith("4 is the effort limit that the servo of slide has reached")


def test_a_servo_returns_to_the_values_of_the_scene_after_the_timeout(client, node):
    assert client.set(NODE, command_timeout=0.05).successful
    node.command(name=["hinge"], position=[1.0])
    state = node.steps(200)
    expected = hinge_after(hinge_after((0.0, 0.0), 1.0, 0.0, 0.05), 0.0, 0.0, 0.15)
    assert coordinates(state)[0] == pytest.approx(tuple(expected), abs=1e-12)
    assert client.set(NODE, command_timeout=0.0).successful


def test_commands_without_a_servo_are_refused(node):
    node.check_refusals(
        [
            ("no_servo", {"name": ["free", "hinge"], "position": [1.0, 1.0]}),
            ("no_servo", {"name": ["free"], "velocity": [1.0]}),
            ("no_position", {"name": ["hinge"], "velocity": [1.0]}),
            ("not_finite", {"name": ["hinge"], "position": [-math.inf]}),
        ]
    )
    assert not any(node.states[-1].velocity)


def test_a_position_beyond_command_jump_is_refused_and_counted(client, node):
    """The limit is set while the node runs; it holds from the present position, also after a step."""
    too_far = {"name": ["hinge"], "position": [0.3]}
    assert client.set(NODE, command_jump=0.2).successful
    node.check_refusals([("jump_too_large", too_far)])
    assert not any(node.states[-1].velocity)
    taken = node.figure("joint_commands_accepted")
    node.command(name=["hinge"], position=[0.19])
    assert node.steps(300).position[0] > 0.15
    node.command(**too_far)
    node.steps(100)
    assert client.set(NODE, command_jump=0.0).successful
    node.command(name=["hinge"], position=[-9.0])
    node.steps(100)
    assert node.figure("joint_commands_accepted") == taken + 3


@pytest.mark.turn(3)
def test_every_part_of_the_recording_is_repeated_and_analysed(process, node):
    """A part that begins while a command acts has it; the reference integration follows it."""
    node.command(name=["hinge", "slide"], position=[0.3, 0.0], velocity=[0.0, 0.05])
    node.command(node.now() + 300_500_000, name=["hinge"], position=[-0.2])
    node.command(name=["free"], effort=[0.01])
    node.steps(1300)
    acting = 0
    for recording in finished_parts(process):
        targets = recording.servo_targets
        start = recording.initial_state["stamp_ns"]
        if targets is not None and targets.stamp_ns[0] == start:
            acting += 1
            assert targets.names == ("hinge", "slide")
    assert acting >= 3
