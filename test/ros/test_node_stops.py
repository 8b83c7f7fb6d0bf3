# SPDX-License-Identifier: Apache-2.0
"""Joints with stops and friction in a running node: events, modes, faults, recordings and their analysis."""

import json
import math
import signal
from pathlib import Path
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from commanded import STEP, Commanded
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from node_process import LATCHED, NodeProcess, stamp_of
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from scene_files import text_of
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages.joint_modes import FREE, IMPULSE, LOWER, STICK, UPPER
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.motion import RecordedMotion
from liegroup_sim_ros.recording.read import read_recording

NODE = "/bouncing"
SCHEMA = Path(__file__).resolve().parents[2] / "config" / "analysis.schema.json"
G, E = 9.81, 0.8
# A ball that bounces on the ground, and two rods with friction, the first with a stop.
SCENE = text_of("bounces.yaml")
# More than a thousand impacts in a step of 1 s: a rebound of 1 um takes 0.9 ms.
RATTLE = text_of("rattle.yaml")


@pytest.fixture(scope="module")
def process(client, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bouncing")
    (folder / "bounces.yaml").write_text(SCENE)
    parameters = {
        "scene": folder / "bounces.yaml",
        "method": "rkmk8",
        "step": STEP,
        "joint_state_rate": 1000.0,
        "reaction_rate": 100.0,
        "record": folder / "run.mcap",
        "record_split_duration": 2.0,
        "start_paused": "true",
    }
    with NodeProcess(parameters, remap=[f"__node:={NODE[1:]}"]) as process:
        events = client.events(NODE)
        modes = client.listen(f"{NODE}/joint_modes", Float64MultiArray, LATCHED)
        impulses = client.listen(f"{NODE}/track/impulse", WrenchStamped)
        node = Commanded(client, NODE)
        yield SimpleNamespace(process=process, node=node, events=events, modes=modes, impulses=impulses, folder=folder)


@pytest.fixture
def node(client, process):
    """At the initial state."""
    process.node.restart()
    client.until(
        lambda: (
            [each.name for each in process.events[-1:]] == ["reset"]
            and stamp_of(process.events[-1]) == process.node.now()
        )
    )
    # The ball is at its height of 1 m at the start only.
    client.until(lambda: process.modes and matrix(process.modes[-1])["track"]["coordinate"] == 1.0, "modes")
    process.events.clear()
    process.modes.clear()
    return process.node


def matrix(message):
    """{joint: {column: number}} of a message of ~/joint_modes."""
    joints, columns = (dimension.label.split(" ") for dimension in message.layout.dim)
    values = np.array(message.data).reshape(len(joints), len(columns))
    return {joint: dict(zip(columns, row)) for joint, row in zip(joints, values.tolist())}


def joint_modes(process):
    """{joint: mode} of the last message."""
    return {joint: row["mode"] for joint, row in matrix(process.modes[-1]).items()}


def joint_lines(process):
    return [event for event in process.events if event.name == "joint"]


def test_the_modes_after_a_reset_are_those_of_the_first_step(client, process, node):
    late = client.listen(f"{NODE}/joint_modes", Float64MultiArray, LATCHED)
    client.until(lambda: late, what="modes")
    found = matrix(late[-1])
    assert {joint: row["mode"] for joint, row in found.items()} == {
        "track": FREE,
        "shoulder": FREE,
        "elbow": STICK,  # both rods fall as one
    }
    assert found["track"]["coordinate"] == 1.0
    assert found["shoulder"]["slip"] == 1.0


def test_an_impact_is_an_event_with_its_time_impulse_and_energy(client, process, node):
    """The ball falls 1 m: v = sqrt(2 g), impulse m v (1 + e), energy (1 - e^2) m v^2 / 2."""
    start = node.now()
    node.steps(500)
    speed = math.sqrt(2.0 * G)
    lines = [event for event in joint_lines(process) if "track" in event.msg]
    assert len(lines) == 1
    assert lines[0].msg == (
        f"{speed / G:.9f} s: track impact, impulse {2 * speed * (1 + E):.6g} N s, "
        f"energy {-(1 - E * E) * speed**2:.6g} J"
    )
    assert stamp_of(lines[0]) == start + round(speed / G * 1e9)
    rows = [row for row in map(matrix, process.modes) if row["track"]["impulse"]]
    assert len(rows) == 1
    assert rows[0]["track"]["mode"] == FREE
    assert rows[0]["track"]["impulse"] == pytest.approx(2 * speed * (1 + E), abs=1e-10)
    assert rows[0]["track"]["energy"] == pytest.approx(-(1 - E * E) * speed**2, abs=1e-10)


def test_a_state_beyond_a_stop_is_refused_and_nothing_changes(client, process, node):
    node.steps(100)
    before = list(node.states[-1].position)
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=-0.5)
    request = SetParametersAtomically.Request(parameters=[Parameter(name="track/position", value=value)])
    answer = client.call(f"{NODE}/set_state", SetParametersAtomically, request).result
    assert not answer.successful
    assert "joint track would be beyond its stop: its position -0.5 m" in answer.reason
    assert "\n" not in answer.reason
    assert not any(event.name == "state" for event in process.events)
    state = node.steps(1)
    assert state.position[0] == pytest.approx(1.0 - 0.5 * G * 0.101**2, abs=1e-12)
    assert before[0] == pytest.approx(1.0 - 0.5 * G * 0.1**2, abs=1e-12)


@pytest.mark.turn(3)
def test_many_events_are_summed_up_but_all_modes_are_sent(client, process, node):
    """The ball comes to rest after sqrt(2 / g) (1 + e) / (1 - e) = 4.06 s, by ever more impacts."""
    for _ in range(6):
        node.steps(1000)
    at_rest = {"track": LOWER, "shoulder": UPPER, "elbow": STICK}
    # What is lost of a burst is sent again seconds later.
    client.until(lambda: joint_modes(process) == at_rest, what="the rest of all joints")
    lines = [event.msg for event in joint_lines(process)]
    single = [float(line.split(" ")[0]) for line in lines if "more instants" not in line]
    sums = [line for line in lines if "more instants" in line]
    assert max(np.bincount(np.array(single, dtype=int))) == 20
    more = sum(int(line.split(" ")[2]) for line in sums)
    rows = [matrix(message) for message in process.modes]
    # Friction that turns round without sticking has a message, but is no event.
    assert len(rows) >= len(single) + more
    energy = math.fsum(row["track"]["energy"] for row in rows)
    assert energy == pytest.approx(-2.0 * G, rel=1e-9)  # all of its potential energy


@pytest.mark.turn(3)
def test_bouncing_without_end_is_a_fault_with_the_last_good_state(client, tmp_path):
    (tmp_path / "rattle.yaml").write_text(RATTLE)
    parameters = {
        "scene": tmp_path / "rattle.yaml",
        "method": "rkmk4",
        "step": 1.0,
        "publish_rate": 1.0,
        "clock_rate": 0.0,
        "state_rate": 0.0,
        "start_paused": "true",
    }
    with NodeProcess(parameters, remap=["__node:=rattle"]) as process:
        events = client.events("/rattle")
        diagnostics = client.listen("/diagnostics", DiagnosticArray)
        answer = client.call("/rattle/step", Trigger)
        assert not answer.success
        client.until(lambda: any(e.name == "fault" for e in events), "the fault")
        (fault,) = (event for event in events if event.name == "fault")
        assert "more than 1000 impacts or changes of friction or" in fault.msg
        assert "the last valid state is kept" in fault.msg and "\n" not in fault.msg
        # Nothing of the step that was not taken is reported.
        assert not any(event.name == "joint" for event in events)

        def faulted():
            found = [m.status[0] for m in diagnostics if m.status[0].name.startswith("/rattle")]
            last = {v.key: v.value for v in found[-1].values} if found else {}
            return last.get("state") == "faulted" and last

        assert client.until(faulted, what="the diagnostics")["steps"] == "0"
        assert client.call("/rattle/reset", Trigger).success
        process.end(signal.SIGTERM)


@pytest.mark.turn(3)
def test_every_part_of_the_recording_is_repeated_and_analysed(client, process, node):
    """With a push while a joint sticks, a reset, a snapshot, and parts that begin in between."""
    node.steps(700)
    assert client.call(f"{NODE}/save_snapshot").success
    node.command(node.now() + 300_500_000, name=["elbow"], effort=[4.0])
    node.steps(4000)  # the ball comes to rest
    assert client.call(f"{NODE}/restore_snapshot").success
    node.steps(1500)
    assert client.call(f"{NODE}/reset").success
    assert client.call(f"{NODE}/resume").success
    client.pass_time(node.states, 1.5)
    assert client.call(f"{NODE}/pause").success
    node.steps(100)
    process.process.end()
    paths = sorted(process.folder.glob("*.mcap"))
    assert len(paths) > 3
    compared = compared_impulses = 0
    for path in paths:
        recording = read_recording(path)
        figures = resimulate(recording)
        assert figures["identical"] == figures["samples"] > 0 and figures["must_be_equal"], path
        modes = recording.joint_modes
        assert modes.names == ("track", "shoulder", "elbow")
        assert modes.stamp_ns[0] == recording.initial_state["stamp_ns"]
        compared += check_reactions(recording)
        compared_impulses += check_impulses(recording)
    assert compared > 1000 and compared_impulses > 50
    assert len(process.impulses) > 50 and process.impulses[0].header.frame_id == "track_reaction"
    assert process.impulses[0].wrench.force.z == pytest.approx(2.0 * math.sqrt(2.0 * G) * (1.0 + E))
    out = process.folder / "out.json"
    assert main(["analyze", *map(str, paths), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    jsonschema.validate(found, json.loads(SCHEMA.read_text()))
    events = [log["joint_events"] for log in found["logs"]]
    assert sum(entry["joints"]["track"]["impact"] for entry in events) > 50
    assert sum(entry["joints"]["elbow"]["stick"] for entry in events) >= 2
    assert sum(entry["joints"]["elbow"]["slip"] for entry in events) >= 1
    assert sum(entry["joints"]["track"]["stop"] for entry in events) >= 1
    assert all(entry["impact_energy_J"] <= 0.0 for entry in events)


def check_impulses(recording):
    """Impulses of the ball's track are those of the modes, at the same stamps; others have them, too."""
    modes = recording.joint_modes
    hits = modes.values[:, :, IMPULSE].any(axis=1)
    if not hits.any():
        return 0
    assert set(recording.impulses) == {"track", "shoulder", "elbow"}
    track = recording.impulses["track"]
    assert track.stamp_ns.tolist() == modes.stamp_ns[hits].tolist()
    # In the scene's plane none is undetermined; z is the axis of the track.
    expected = modes.values[hits, 0, IMPULSE]
    np.testing.assert_allclose(track.impulse[:, 5], expected, rtol=0, atol=1e-12)
    return len(expected)


def check_reactions(recording):
    """Reactions of samples made from a recording are those that the node published."""
    layout = make_layout(scene_from_text(recording.scene_text))
    motion = RecordedMotion(recording)
    compared = 0
    for block in motion.blocks():
        for k, step in enumerate(block.steps.tolist()):
            stamp = block.stretch.base_ns + round(step * STEP * 1e9)
            sample = layout.sample(block.pose[k], block.twist[k], step * STEP)
            sample.switching = recording.joint_modes.switching(stamp)
            if len(block.stretch.inputs):
                continue  # efforts of commands are no part of it
            for joint, track in recording.reactions.items():
                at = np.flatnonzero(track.stamp_ns == stamp)
                if len(at):
                    assert sample.reactions[joint] == pytest.approx(track.wrench[at[0]], abs=1e-8)
                    compared += 1
    return compared
