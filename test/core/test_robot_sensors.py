# SPDX-License-Identifier: Apache-2.0
"""Sensors of robot files, fixed joints that are kept, and sensors that a user adds to a robot."""

import numpy as np
import pytest
from robot_texts import written
from scene_files import cases, filled, text_of

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.lie.groups import SO3
from liegroup_core.robots.options import Options
from liegroup_core.scene.load import scene_of
from liegroup_sim_ros.commands.main import main

G = 9.81
pytestmark = pytest.mark.usefixtures("mjcf_here")
ARM = text_of("arm_robot_sensors.urdf")
MOVING = Options(start={"shoulder": 0.3}, start_velocity={"shoulder": 2.0})


def arm(tmp_path, more="", name="arm.urdf"):
    path = written(tmp_path / name, filled(ARM, more=more))
    return path


def sampled(scene, steps=0):
    simulation = Simulation(scene, "rkmk8", 1e-3, estimate=False, quiet=True)
    simulation.advance(steps)
    return simulation.sample()


def tool_wrench(sample, body="tool"):
    """Wrench (6,) that the tool needs about the origin of its link, axes of the link: Newton and Euler."""
    m, com, inertia = 0.3, np.array([0.05, 0, 0.01]), 0.0004 * np.eye(3)
    w, R = sample.twists[body][:3], sample.poses[body][:3, :3]
    turning, moving = np.split(sample.accelerations[body], 2)
    moving = moving + np.cross(turning, com) + np.cross(w, np.cross(w, com))
    force = m * (moving - R.T @ [0, 0, -G])
    torque = inertia @ turning + np.cross(w, inertia @ w) + np.cross(com, force)
    return np.concatenate([torque, force])


def test_a_fixed_joint_that_is_kept_has_its_reaction_and_changes_no_motion(tmp_path):
    path = arm(tmp_path)
    kept, merged = (
        sampled(scene_of(path, Options(start={"shoulder": 0.3}, start_velocity={"shoulder": 2.0}, keep=k)), 200)
        for k in (["wrist"], [])
    )
    assert set(kept.reactions) == {"shoulder", "wrist"} and set(merged.reactions) == {"shoulder"}
    assert np.abs(kept.poses["upper"] - merged.poses["upper"]).max() <= 1e-13
    assert kept.reactions["wrist"] == pytest.approx(tool_wrench(kept), rel=1e-11, abs=1e-12)
    assert kept.reactions["shoulder"] == pytest.approx(merged.reactions["shoulder"], abs=1e-11)
    assert np.linalg.norm(kept.reactions["wrist"][3:]) > 0.3 * G


def test_a_base_that_is_fixed_to_the_world_shows_what_it_carries(tmp_path):
    text = filled(ARM, more="").replace('<link name="base"/>', '<link name="floor"/><link name="base"/>')
    text = text.replace(
        '<joint name="shoulder"',
        '<joint name="foot" type="fixed"><parent link="floor"/><child link="base"/></joint><joint name="shoulder"',
        1,
    )
    sample = sampled(scene_of(written(tmp_path / "stand.urdf", text), Options(keep=["foot"])))
    pressed = sample.reactions["shoulder"][3:]
    frame = sample.child_frames["shoulder"][:3, :3]
    onto = sample.poses["upper"][:3, :3] @ frame @ pressed
    assert sample.poses["base"][:3, :3] @ sample.reactions["foot"][3:] == pytest.approx(onto, abs=1e-12)


@pytest.mark.parametrize("keep, text", cases("a_joint_that_cannot_be_kept_is_refused"))
def test_a_joint_that_cannot_be_kept_is_refused(tmp_path, keep, text):
    with pytest.raises(SceneError) as error:
        scene_of(arm(tmp_path), Options(keep=[keep]))
    assert text in str(error.value) and "\n" not in str(error.value)


GAZEBO = text_of("wrist_sensors.xml")
NOISE = '<{0}><noise type="gaussian"><mean>{1}</mean><stddev>0.01</stddev></noise></{0}>'


def test_sensors_in_a_urdf_file_are_those_of_the_scene(tmp_path):
    noise = "".join(NOISE.format(axis, mean) for axis, mean in zip("xyz", (0.1, 0.2, 0.3)))
    path = arm(tmp_path, GAZEBO.format(cell="", noise=noise))
    scene = scene_of(path, MOVING)
    assert [sensor.name for sensor in scene.sensors] == ["cell", "imu", "drive"]
    imu = scene.sensors[1]
    assert imu.body == "tool" and imu.angular_velocity_noise == 0.01
    assert imu.angular_velocity_bias == (0.1, 0.2, 0.3)
    assert imu.frame.pose[:3, 3] == pytest.approx([0, 0.1, 0.12], abs=1e-15)
    assert imu.frame.pose[:3, :3] == pytest.approx(SO3.exp([0, 0, 1.0]), abs=1e-15)
    assert "left out: sensor of links (eye)" in scene.notes
    assert "left out: gazebo (upper)" in scene.notes
    sample = sampled(scene, 100)
    assert -sample.sensors["cell"] == pytest.approx(tool_wrench(sample), rel=1e-11, abs=1e-12)
    # The drive's sensor is in the axes of the child and shows the damper, too.
    (damper,) = sample.force_efforts.values()
    R = sample.child_frames["shoulder"][:3, :3]
    shown = np.concatenate([R.T @ sample.sensors["drive"][:3], R.T @ sample.sensors["drive"][3:]])
    expected = sample.reactions["shoulder"] + [0, 0, damper, 0, 0, 0]
    assert abs(damper) > 0.1 and shown == pytest.approx(expected, abs=1e-12)


SDF = text_of("arm_robot_sensors.sdf")
OF_CELL = {"base": "", "frame": "child", "direction": "child_to_parent", "more": "", "turn": 0.9}
# {attribute of the sensor's <pose>: (rotation (3, 3), position (3,)) in the tool of the frame that it names}
JOINT_IN_TOOL = SO3.exp([0.5, 0, 0]), np.array([0.01, 0.02, 0.03])
BASES = {
    "": JOINT_IN_TOOL,
    ' relative_to="wrist"': JOINT_IN_TOOL,
    ' relative_to="tool"': (np.eye(3), np.zeros(3)),
    ' relative_to="mark"': (SO3.exp([0.9, 0, 0]), np.array([0.2, 0, 0])),
}


@pytest.mark.parametrize("frame", ["child", "parent", "sensor"])
@pytest.mark.parametrize("direction, sign", [("child_to_parent", -1.0), ("parent_to_child", 1.0)])
@pytest.mark.parametrize("base", BASES)
def test_a_force_torque_sensor_of_sdf_has_its_axes_its_point_and_its_sign(tmp_path, base, frame, direction, sign):
    """The torque is about the origin of the sensor, in all axes."""
    path = written(
        tmp_path / "arm.sdf", filled(SDF, **OF_CELL | {"base": base, "frame": frame, "direction": direction})
    )
    sample = sampled(load_scene(path))
    wrench = tool_wrench(sample)
    R, p = BASES[base]
    torque = wrench[:3] - np.cross(p + R @ [0.04, -0.05, 0.06], wrench[3:])
    to_child = {
        "child": np.eye(3),
        "parent": sample.poses["tool"][:3, :3].T @ sample.poses["upper"][:3, :3],
        "sensor": R @ SO3.exp([0, 0.7, 0]),
    }[frame]
    expected = sign * np.concatenate([to_child.T @ torque, to_child.T @ wrench[3:]])
    assert sample.sensors["cell"] == pytest.approx(expected, rel=1e-11, abs=1e-12)


def test_placed_sensors_of_sdf_and_urdf_show_what_mujoco_shows(tmp_path):
    """An arm that turns at 2 rad/s: the accelerometer has centripetal and Euler terms."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text_of("placed_sensors.xml"))
    data = mujoco.MjData(model)
    data.qvel[:] = 2.0
    mujoco.mj_forward(model, data)
    # The cell is a site of the mark, which carries nothing: the wrench moves from the tool's origin to it.
    gyro, acceleration, torque, force = data.sensordata.reshape(4, 3)
    tool = data.body("tool").xmat.reshape(3, 3)
    cell = tool.T @ (data.site("cell").xpos - data.body("tool").xpos)
    to_cell = data.site("cell").xmat.reshape(3, 3).T @ tool
    expected = {"imu": [*gyro, *acceleration], "cell": [*to_cell @ (torque - np.cross(cell, force)), *to_cell @ force]}
    sensors = """<sensor name="imu" type="imu"><pose relative_to="mark">0 0 0.1 0 0 0</pose></sensor>"""
    urdf = filled(text_of("placed_sensors.urdf"), sensors=sensors)
    of_cell = {"base": ' relative_to="mark"', "frame": "sensor", "direction": "parent_to_child"}
    for name, text in (("arm.sdf", filled(SDF, **OF_CELL | of_cell)), ("arm.urdf", urdf)):
        path = written(tmp_path / name, text)
        values = sampled(scene_of(path, Options(start_velocity={"shoulder": 2.0}))).sensors
        assert values["imu"][4:] == pytest.approx(expected["imu"], rel=1e-10, abs=1e-10), name
        assert values["cell"] == pytest.approx(expected["cell"], rel=1e-10, abs=1e-10), name
    path.write_text(urdf.replace('relative_to="marked"', 'relative_to="markd"'))
    with pytest.raises(SceneError, match="arm.urdf:10: frame 'markd' does not exist; did you mean"):
        load_scene(path)


def test_what_a_sensor_of_sdf_has_and_a_scene_has_not_is_noted(tmp_path):
    path = tmp_path / "arm.sdf"
    quantized = '<force><x><noise type="gaussian_quantized"><stddev>1</stddev></noise></x></force>'
    path.write_text(filled(SDF, **OF_CELL | {"more": quantized}))
    scene = load_scene(path)
    assert "left out: noise of sensors that a scene does not have (cell)" in scene.notes
    path.write_text(filled(SDF, **OF_CELL | {"frame": "moon"}))
    scene = load_scene(path)
    assert [sensor.name for sensor in scene.sensors] == ["imu"]
    assert any("force_torque sensors with moon axes" in note for note in scene.notes)
    # Nothing measures the joint: it is merged.
    assert [joint.name for joint in scene.joints] == ["shoulder"]


MJCF = text_of("sensors.xml")


def test_sensors_of_mjcf_show_what_mujoco_shows(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    path = written(tmp_path / "arm.xml", MJCF)
    start, rates = {"swing": 0.3, "lift": -0.2}, {"swing": 2.0, "lift": 0.7}
    scene = scene_of(path, Options(start=start, start_velocity=rates))
    assert [(sensor.name, sensor.type) for sensor in scene.sensors] == [
        ("acc", "imu"),
        ("end_force", "force_torque"),
        ("mid_torque", "force_torque"),
        ("spot", "pose"),
        ("angle", "encoder"),
    ]
    assert "left out: sensors (rate, clipped, touch)" in scene.notes
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = list(start.values()), list(rates.values())
    mujoco.mj_forward(model, data)
    w, *v = data.sensor("turn").data
    shown = {name: data.sensor(name).data for name in ("acc", "gyro", "spot", "speed")}
    values = sampled(scene).sensors
    expected = {
        "acc": [*v, w, *shown["gyro"], *shown["acc"]],
        "end_force": [*data.sensor("end_torque").data, *data.sensor("end_force").data],
        "mid_torque": [*data.sensor("mid_torque").data, *data.sensor("mid_force").data],
        "angle": [0.3],
    }
    for name, numbers in expected.items():
        assert values[name] == pytest.approx(numbers, rel=1e-10, abs=1e-10), name
    assert values["spot"][:3] == pytest.approx(shown["spot"], abs=1e-14)
    assert values["spot"][7:10] == pytest.approx(shown["speed"], abs=1e-13)
    path.write_text(MJCF.replace('<joint name="swing"', '<joint ref="20" name="swing"'))
    assert "angle, whose angle MuJoCo counts from another zero, by ref" in "".join(load_scene(path).notes)


ADDED = text_of("arm_with_sensors.yaml")


def test_sensors_beside_a_robot_name_its_links_and_joints(tmp_path, capsys):
    arm(tmp_path)
    path = written(tmp_path / "sensed.yaml", ADDED)
    scene = load_scene(path)
    sample = sampled(scene)
    wrench = tool_wrench(sample)
    moved = wrench[:3] - np.cross([0, 0, 0.1], wrench[3:])
    assert sample.sensors["cell"] == pytest.approx([*moved, *wrench[3:]], abs=1e-12)
    tip = sample.poses["tool"] @ [0, 0, 0.2, 1.0]
    assert sample.sensors["tip"][:3] == pytest.approx(tip[:3], abs=1e-15)
    assert sample.sensors["disc"] == pytest.approx([0.3], abs=1e-15)
    assert sample.sensors["rope"][0] == pytest.approx(np.linalg.norm(tip[:3] - [1, 0, 0]), abs=1e-14)
    assert scene.sensors[2].seed == 4 and scene.sensors[2].body == "upper"
    # The scene that is written is the same.
    assert main(["import", str(path), "--out", str(tmp_path / "all.yaml")]) == 0
    capsys.readouterr()
    again = sampled(load_scene(tmp_path / "all.yaml"))
    assert all(np.array_equal(again.sensors[name], sample.sensors[name]) for name in again.sensors)


@pytest.mark.parametrize("entry, text", cases("a_sensor_that_does_not_fit_the_robot_is_refused_with_its_line"))
def test_a_sensor_that_does_not_fit_the_robot_is_refused_with_its_line(tmp_path, entry, text):
    arm(tmp_path)
    path = written(tmp_path / "sensed.yaml", f"robot: arm.urdf\nsensors:\n  - {entry}\n")
    with pytest.raises(SceneError) as error:
        load_scene(path)
    assert text in str(error.value) and ":3: " in str(error.value)
