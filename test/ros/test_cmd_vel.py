# SPDX-License-Identifier: Apache-2.0
"""A mobile robot that is driven by ~/cmd_vel, over DDS: its path, its stop, and the repetition of its recording."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from node_process import NodeProcess, stamp_of
from scene_files import cases, text_of

from liegroup_core import SceneError, Simulation
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import load_scene, scene_from_text
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

NODE = "/rover"


def test_rates_of_wheels_follow_from_the_scene():
    """Radius 0.1 m and track 0.34 m; an axis that points to the right turns the other way."""
    scene = load_scene("diff_drive")
    found = make_layout(scene).wheels.at(0.5, 2.0)
    assert found["left"] == pytest.approx((0.5 - 2.0 * 0.17) / 0.1) and found["right"] == pytest.approx(8.4)
    name = "name: right\n    type: revolute\n    parent: base\n    child: right_wheel\n    child_frame: "
    turned = scene.text.replace(f"{name}*lateral", f"{name}{{rotation_vector: [1.5707963267948966, 0, 0]}}")
    assert turned != scene.text
    assert make_layout(scene_from_text(turned, source="t")).wheels.at(0.5, 2.0)["right"] == pytest.approx(-8.4)


@pytest.mark.parametrize("drive, text", cases("wrong_drives_are_refused"))
def test_wrong_drives_are_refused(drive, text):
    with pytest.raises(SceneError, match=text.replace("?", r"\?")):
        scene_from_text(load_scene("diff_drive").text.replace("{left: left, right: right}", drive), source="t")


@pytest.mark.turn(3)
def test_a_robot_drives_a_circle_and_stops_without_commands(client, tmp_path):
    poses = client.listen(f"{NODE}/base/pose", PoseStamped)
    twists = client.listen(f"{NODE}/base/twist", TwistStamped)
    given = {"scene": "diff_drive", "record": tmp_path / "run.mcap", "publish_rate": 60.0, "start_paused": True}

    def step(count):
        assert client.set(NODE, step_count=count).successful
        client.until_stamp(client.command(f"{NODE}/step"), poses, twists)

    with NodeProcess(given | {"step": 0.01}, remap=[f"__node:={NODE[1:]}"]) as process:
        drive = client.publisher(f"{NODE}/cmd_vel", TwistStamped)
        message = TwistStamped()
        message.twist.linear.x, message.twist.angular.z = 0.5, 1.0
        for _ in range(30):
            drive(message)
            step(10)
        moving, end = twists[-1].twist, stamp_of(poses[-1])
        places = np.array([(m.pose.position.x, m.pose.position.y) for m in poses if stamp_of(m) > end - 10**9])
        step(200)
        message.twist.linear.x = float("nan")
        drive(message)
        errors = process.end()
    assert "the velocity of left is not finite" in errors, errors
    assert len(places) > 10
    # Radius v / w of the middle between the wheels, to the slip of the servos' speed.
    assert moving.linear.x == pytest.approx(0.5, rel=0.02) and moving.angular.z == pytest.approx(1.0, rel=0.02)
    rows = np.column_stack([2.0 * places, np.ones(len(places))])
    x, y, rest = np.linalg.lstsq(rows, (places**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(rest + x * x + y * y) == pytest.approx(0.5, rel=0.02)
    stopped = twists[-1].twist
    assert abs(stopped.linear.x) < 1e-3 and abs(stopped.angular.z) < 1e-3
    same = resimulate(read_recording(tmp_path / "run.mcap"))
    assert same["identical"] == same["samples"] > 100


ROVER = text_of("rover.urdf")
BESIDE = text_of("rover.yaml")


@pytest.mark.turn(3)
def test_a_robot_file_rolls_on_its_wheels_and_names_its_drive(tmp_path):
    """The start is moved until the wheels touch; names of joints are those of the file; axes on both sides differ."""
    (tmp_path / "rover.urdf").write_text(ROVER)
    (tmp_path / "rover.yaml").write_text(BESIDE)
    simulation = Simulation(load_scene(tmp_path / "rover.yaml"), quiet=True)
    sample = simulation.sample()
    assert sample.positions["base_link"][2] == pytest.approx(0.08, abs=1e-9)
    normal = [force for force, _ in sample.contacts.values()]
    assert sum(normal) == pytest.approx(6.1 * 9.81, rel=1e-9) and min(normal) > 0.0
    for joint, rate in simulation.layout.wheels.at(0.4, 1.0).items():
        simulation.command_motion(joint, [0.2], None, [rate])
    simulation.advance_to(1.0)
    w, v = np.split(simulation.sample(1.0).twists["base_link"], 2)
    assert v[0] == pytest.approx(0.4, rel=1e-9) and w[2] == pytest.approx(1.0, rel=1e-9) and abs(v[1]) < 1e-9
    # In the other direction, from the command line; the text of the scene has all of it.
    assert main(["import", str(tmp_path / "rover.yaml"), "--out", str(tmp_path / "scene.yaml")]) == 0
    assert load_scene(tmp_path / "scene.yaml").drive == load_scene(tmp_path / "rover.yaml").drive
    options = ["--base", "floating", "--roll", "left-wheel=0.08", "right-wheel=0.08"]
    assert main(["describe", str(tmp_path / "rover.urdf"), "--json", *options]) == 0
