# SPDX-License-Identifier: Apache-2.0
"""Messages with the modes of joints, and `liegroup_sim run` with joints that have stops or friction."""

import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from scene_files import text_of
from std_msgs.msg import Float64MultiArray

from liegroup_core import Simulation
from liegroup_core.layout import make_layout
from liegroup_core.observables.touching import APART, SLIPS, STICKS
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.messages.codecs import MessageError
from liegroup_sim_ros.messages.joint_modes import JointReports, decode, encoder, switching
from liegroup_sim_ros.messages.matrices import encoder as matrix_encoder
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

SCHEMA = Path(__file__).resolve().parents[2] / "config" / "analysis.schema.json"
# A rod that falls on a compliant stop, with friction that holds it there, and one beside it on a rigid one.
SCENE = text_of("stops.yaml")


# The cushion is entered and left without an event of the simulation.
KINDS = {"block": ("impact", "stop", "leave", "stick", "slip"), "cushion": ("impact", "stick", "slip")}


def test_modes_survive_the_message():
    """All that a sample needs for reactions, in every combination of rest, side and slip."""
    layout = make_layout(scene_from_text(SCENE))
    encode = encoder(layout)
    for held in (0.0, 1.0, 2.0):
        for side in (-1.0, 0.0, 1.0):
            for slip in (-1.0, 0.0, 1.0):
                effort = 0.7 if held == 2.0 else 0.0
                modes = np.array([[held, slip, side, 0.25, effort], [0.0, 0.0, 0.0, -1.5, 0.0]])
                payload = encode(modes)
                names, numbers = decode(payload)
                assert names == ("cushion", "block")
                values = np.array(numbers).reshape(2, 6)
                assert np.array_equal(switching(values), modes)
                message = deserialize_message(bytes(payload), Float64MultiArray)
                assert np.array_equal(message.data, numbers, equal_nan=True)
                assert message.layout.dim[1].label == "mode slip coordinate impulse energy effort"


def test_contacts_report_slip_and_stick():
    """A ball that skids: its point slips once it has moved by the slip length, and sticks where it begins to roll.

    The slip speed is v - 7/2 mu g t, as the force is mu m g all the time. Its events have errors of 1e-9 m over 1 m/s.
    """
    text = text_of("skid.yaml")
    simulation = Simulation(scene_from_text(text), accuracy=1e-9, quiet=True)
    reports = JointReports(simulation)
    assert not reports.begin()
    simulation.advance_to(1.0)
    slows = 3.5 * 0.4 * 9.81
    times = (1.0 - math.sqrt(1.0 - 2.0 * slows * 1e-3)) / slows, 1.0 / slows
    found = reports.drain()
    assert [(report.name, report.line.split(" s: ")[1]) for report in found] == [
        ("contact", "floor slip"),
        ("contact", "floor stick"),
    ]
    assert [1e-9 * report.time_ns for report in found] == pytest.approx(times, abs=2e-9)


def test_a_contact_slips_where_all_points_that_press_do():
    text = text_of("feet.yaml")
    modes = make_layout(scene_from_text(text)).touching.modes
    yes, no = True, False
    cases = {APART: [(no, yes), (no, no)], STICKS: [(yes, yes), (yes, no)], SLIPS: [(yes, yes), (no, no)]}
    for mode, points in cases.items():
        assert modes(np.array(points)).tolist() == [mode]


def test_another_matrix_is_refused():
    payload = matrix_encoder(["a"], ["mode", "slip"])([1.0, 2.0])
    with pytest.raises(MessageError, match="its columns are not mode slip coordinate"):
        decode(payload)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stops")
    (folder / "stops.yaml").write_text(SCENE)
    command = ["run", str(folder / "stops.yaml"), "--duration", "4", "--out", str(folder / "run.mcap")]
    assert main([*command, "--reactions"]) == 0
    return read_recording(folder / "run.mcap")


def test_a_run_records_its_modes_and_is_repeated_bit_by_bit(recording):
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] == 401
    simulation = Simulation(scene_from_text(SCENE), step=0.01, accuracy=1e-4, horizon=60.0)
    simulation.drain_instants()
    simulation.advance(400)
    instants = [entry for entry in simulation.drain_instants() if entry.events]
    modes = recording.joint_modes
    stamps = modes.stamp_ns.tolist()
    assert stamps[0] == 0 and len(instants) > 10
    for instant in instants:
        values = modes.values[stamps.index(round(instant.time * 1e9))]
        assert np.array_equal(switching(values), instant.modes)
        impulse = sum(event.impulse for event in instant.events if event.joint == "block")
        assert values[1, 3] == impulse
    frame = recording.to_pandas("joint_modes")
    assert frame["block", "impulse"].tolist() == modes.values[:, 1, 3].tolist()


def test_an_impact_at_the_start_is_recorded(tmp_path):
    """The joint starts at its stop with 2 rad/s: J = 0.02 + 0.25 kg m2, loss J (1 - 0.36) w^2 / 2."""
    moving = "position: [0, 1, 0], angular_velocity: [0, 2, 0], linear_velocity: [0, 0, 0]"
    text = SCENE.replace("position: [0, 1, 0]}\n  - {name: free", moving + "}\n  - {name: free")
    text = text.replace("{upper: 0.5, restitution: 0.6}", "{upper: 0, restitution: 0.6}")
    (tmp_path / "stops.yaml").write_text(text)
    out = str(tmp_path / "run.mcap")
    assert main(["run", str(tmp_path / "stops.yaml"), "--duration", "0.05", "--out", out]) == 0
    recording = read_recording(out)
    events = [event.text for event in recording.events if "block impact" in event.text]
    assert len(events) == 1 and events[0].startswith("0.000000000 s: block impact, impulse -0.864 ")
    found = tmp_path / "figures.json"
    assert main(["analyze", out, "--no-reference", "--json", str(found)]) == 0
    (log,) = json.loads(found.read_text())["logs"]
    figures = log["joint_events"]["joints"]["block"]
    assert figures["impact"] == 1
    assert figures["impact_energy_J"] == pytest.approx(-0.27 * 0.64 * 2.0)
    assert resimulate(recording)["identical"] == 6


def test_reactions_of_recorded_poses_are_those_of_the_run(recording):
    layout = make_layout(scene_from_text(SCENE))
    poses, stamps = recording.pose, recording.pose["soft"].stamp_ns
    for row in range(0, len(stamps), 7):
        sample = recorded_sample(layout, recording, row)
        assert sample.switching is not None
        for joint in ("cushion", "block"):
            track = recording.reactions[joint]
            assert track.stamp_ns[row] == stamps[row]
            assert sample.reactions[joint] == pytest.approx(track.wrench[row], abs=1e-9)
    assert len(poses) == 3
    # Without the modes the joints would be free.
    sample.switching = None
    last = recorded_sample(layout, recording, row)
    last.switching = None
    assert abs(last.reactions["block"][2]) < 1e-9 < 1.0 < abs(recording.reactions["block"].wrench[row, 2])


def recorded_sample(layout, recording, row):
    from scipy.spatial.transform import Rotation

    pose, twist = [], []
    for body in recording.bodies:
        rotation = Rotation.from_quat(recording.pose[body].quaternion[row]).as_matrix()
        pose.append([*rotation.ravel(), *recording.pose[body].position[row]])
        twist.append(recording.twist[body].twist[row])
    stamp = recording.pose["soft"].stamp_ns[row]
    sample = layout.sample(pose, twist, stamp * 1e-9)
    sample.switching = recording.joint_modes.switching(stamp)
    return sample


def test_the_analysis_counts_the_events_of_the_run(recording, tmp_path, capsys):
    out, page = tmp_path / "out.json", tmp_path / "page.html"
    assert main(["analyze", str(recording.path), "--json", str(out), "--html", str(page)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    document = json.loads(out.read_text())
    jsonschema.validate(document, json.loads(SCHEMA.read_text()))
    found = document["logs"][0]["joint_events"]
    simulation = Simulation(scene_from_text(SCENE), step=0.01, accuracy=1e-4, horizon=60.0)
    simulation.advance(400)
    events = simulation.drain_events()
    for joint, entry in found["joints"].items():
        for kind in KINDS[joint]:
            count = sum(event.joint == joint and event.kind == kind for event in events)
            assert entry[kind] == count, (joint, kind)
        assert entry["impact_energy_J"] == pytest.approx(
            sum(event.energy for event in events if event.joint == joint), abs=1e-14
        )
    assert found["joints"]["block"]["impact"] > 5
    assert found["joints"]["cushion"]["stop"] >= 1
    assert "events at joints" in page.read_text()
    assert "has no stops and no friction" in shown and "no error above" not in shown
