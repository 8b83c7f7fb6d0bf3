# SPDX-License-Identifier: Apache-2.0
"""Sensors of a scene against closed forms, their noise, and scenes that name them wrongly."""

import mechanisms
import numpy as np
import pytest
from scene_files import cases
from scipy.spatial.transform import Rotation

from liegroup_core import Scene, SceneError, Simulation
from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text
from liegroup_core.sensors.kinds import SENSORS

G, LENGTH = 9.81, 0.7
AXIS = {"axis": [0, 1, 0]}


def about_y(angle):
    """Quaternion (x, y, z, w) of a rotation about y."""
    return (0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2))


def pendulum(*sensors, angle=0.4, rate=1.3):
    """Rod that hangs from a hinge at the origin, its mass at LENGTH below."""
    rod = {"name": "rod", "mass": 2.0, "inertia": [0.3, 0.3, 0.1], "com": (0, 0, -LENGTH)}
    rod |= {"quaternion": about_y(angle), "angular_velocity": (0, rate, 0)}
    hinge = {"name": "hinge", "type": "revolute", "parent": "world", "child": "rod"}
    return Scene(
        name="rod",
        gravity=(0, 0, -G),
        bodies=[rod],
        joints=[hinge | {"parent_frame": AXIS, "child_frame": AXIS}],
        sensors=[{"name": f"s{k}", **sensor} for k, sensor in enumerate(sensors)],
    )


def read(scene):
    """{sensor: numbers} at the start."""
    return Engine(scene, quiet=True).sample().sensors


def test_an_imu_at_a_point_of_a_pendulum():
    """Specific force at p below the hinge: theta'' p across and theta'^2 p along, less gravity.

    theta'' = m g l sin(theta) / (J + m l^2) towards the bottom.
    """
    angle, rate, p = 0.4, 1.3, 0.5
    frame = {"position": [0, 0, -p], "rotation_vector": [0, 0, np.pi / 2]}
    scene = pendulum({"type": "imu", "body": "rod", "frame": frame})
    values = read(scene)["s0"]
    turning = -2.0 * G * LENGTH * np.sin(angle) / (0.3 + 2.0 * LENGTH**2)
    # In the axes of the rod, x across and z up: positions (0, 0, -p) turn with rate about y.
    in_rod = np.array([-turning * p, 0, rate**2 * p]) + G * np.array([-np.sin(angle), 0, np.cos(angle)])
    quarter = Rotation.from_euler("z", np.pi / 2)
    assert values[7:] == pytest.approx(quarter.inv().apply(in_rod), abs=1e-13)
    assert values[4:7] == pytest.approx(quarter.inv().apply([0, rate, 0]), abs=1e-15)
    turned = Rotation.from_euler("y", angle) * quarter
    assert np.abs(values[:4] @ turned.as_quat()) == pytest.approx(1.0, abs=1e-15)


def test_an_imu_of_a_body_at_rest_and_of_one_that_falls():
    """At rest it shows g upwards, in free fall nothing; without gravity, nothing and g downwards."""
    fall = mechanisms.one_body(gravity=(0, 0, -G), inertia=(1, 2, 2.5), com=(0.1, 0.2, 0.3))
    imu = {"name": "imu", "type": "imu", "body": "a"}
    falling = fall.remade(sensors=[imu, imu | {"name": "driver", "remove_gravity": True}])
    assert read(falling)["imu"][7:] == pytest.approx([0, 0, 0], abs=1e-14)
    assert read(falling)["driver"][7:] == pytest.approx([0, 0, -G], abs=1e-14)
    kinds = {"type": "imu", "body": "rod"}, {"type": "imu", "body": "rod", "remove_gravity": True}
    hanging = read(pendulum(*kinds, angle=0.0, rate=0.0))
    assert hanging["s0"][7:] == pytest.approx([0, 0, G], abs=1e-14)
    assert hanging["s1"][7:] == pytest.approx([0, 0, 0], abs=1e-14)


def test_accelerations_are_the_rates_of_the_twists():
    """Of bodies with an offset centre of mass, against central differences of 1e-4 s: h^2 = 1e-8."""
    scene = pendulum()
    engine, h = Engine(scene, "rkmk8", 1e-4, quiet=True), 1e-4
    samples = []
    for steps in (100, 1, 1):
        engine.advance(steps)
        samples.append(engine.sample())
    before, middle, after = (sample.twists["rod"] for sample in samples)
    found, w, v = samples[1].accelerations["rod"], middle[:3], middle[3:]
    rate = (after - before) / (2 * h)
    assert found[:3] == pytest.approx(rate[:3], abs=1e-6)
    assert found[3:] == pytest.approx(rate[3:] + np.cross(w, v), abs=1e-6)


def test_a_force_torque_sensor_in_its_own_frame_and_on_the_parent():
    """The same wrench about another point, in other axes; a drive is measured on request."""
    frame = {"position": [0.1, -0.2, 0.3], "rotation_vector": [0.2, 0.5, -0.4]}
    at_joint = {"type": "force_torque", "joint": "hinge"}
    moved = at_joint | {"frame": frame, "acts_on": "parent"}
    drive = {"name": "drive", "type": "motor", "joint": "hinge", "torque": 3.0}
    scene = pendulum(at_joint, moved, at_joint | {"measures": "transmitted"})
    scene = Scene(**scene.model_dump(exclude_unset=True) | {"forces": [drive]})
    values = read(scene)
    R = Rotation.from_rotvec([0.2, 0.5, -0.4])
    axes = scene.joints[0].child_frame.pose[:3, :3]
    torque, force = axes @ values["s0"][:3], axes @ values["s0"][3:]  # axes of the rod
    assert np.linalg.norm(force) > 1.0
    expected = [*R.inv().apply(torque - np.cross([0.1, -0.2, 0.3], force)), *R.inv().apply(force)]
    assert -values["s1"] == pytest.approx(expected, abs=1e-13)
    assert values["s2"] - values["s0"] == pytest.approx([0, 0, 3.0, 0, 0, 0], abs=1e-13)


def test_a_sensor_with_a_frame_keeps_what_is_determined():
    """Two coaxial hinges share the force along their axis: it is unknown in the axes that it enters."""
    body = {"name": "door", "mass": 1.0, "inertia": [1, 1, 1], "com": (0.4, 0, 0)}
    joints = [
        {
            "name": f"h{k}",
            "type": "revolute",
            "parent": "world",
            "child": "door",
            "child_frame": {"position": (0, 0, k)},
        }
        for k in (0, 1)
    ]
    turned = {"rotation_vector": [0, 0, 0.5]}
    sensors = [
        {"name": "plain", "type": "force_torque", "joint": "h0"},
        {"name": "turned", "type": "force_torque", "joint": "h0", "frame": turned},
    ]
    scene = Scene(name="d", gravity=(0, 0, -G), bodies=[body], joints=joints, sensors=sensors)
    values = read(scene)
    assert np.isnan(values["plain"]).any() and not np.isnan(values["plain"]).all()
    assert np.array_equal(np.isnan(values["plain"]), np.isnan(values["turned"]))


def test_force_torque_encoder_pose_and_distance():
    angle, rate = -0.4, 1.3
    scene = pendulum(
        {"type": "force_torque", "joint": "hinge"},
        {"type": "encoder", "joint": "hinge", "resolution": 0.25},
        {"type": "encoder", "joint": "hinge"},
        {"type": "pose", "body": "rod", "frame": {"position": [0, 0, -1], "axis": [1, 0, 0]}},
        {"type": "distance", "parent": "world", "child": "rod", "parent_point": [1, 0, 0],
         "child_point": [0, 0, -1]},
        angle=angle, rate=rate,
    )  # fmt: skip
    sample = Engine(scene, quiet=True).sample()
    found = list(sample.sensors.values())
    assert np.array_equal(found[0], sample.reactions["hinge"])
    assert found[1] == [-0.5] and found[2] == pytest.approx([angle], abs=1e-15)
    tip = np.array([-np.sin(angle), 0, -np.cos(angle)])
    speed = rate * np.array([-np.cos(angle), 0, np.sin(angle)])
    position, quaternion, v, w = np.split(found[3], [3, 7, 10])
    R = Rotation.from_quat(quaternion)
    assert position == pytest.approx(tip, abs=1e-15)
    assert R.apply(v) == pytest.approx(speed, abs=1e-15)
    assert R.apply(w) == pytest.approx([0, rate, 0], abs=1e-15)
    assert R.apply([0, 0, 1]) == pytest.approx([np.cos(angle), 0, -np.sin(angle)], abs=1e-15)
    line = tip - [1, 0, 0]
    length = np.linalg.norm(line)
    assert found[4] == pytest.approx([length, line @ speed / length], abs=1e-15)


NOISY = [
    {"type": "imu", "body": "rod", "angular_velocity_noise": 0.01, "acceleration_noise": 0.2,
     "angular_velocity_bias": [0.1, 0, 0], "acceleration_bias": [0, 0, -0.5]},
    {"type": "force_torque", "joint": "hinge", "torque_noise": 0.3, "force_noise": 2.0},
    {"type": "pose", "body": "rod", "frame": {}, "position_noise": 0.05},
    {"type": "distance", "parent": "world", "child": "rod", "child_point": [0, 0, -1],
     "distance_noise": 0.01},
]  # fmt: skip


@pytest.mark.turn(3)
def test_noise_has_the_stated_size_and_is_white():
    """4000 samples: standard deviations within five of their own, 1 / sqrt(2 k), and no correlation."""
    scene, count = pendulum(*NOISY), 4000
    exact = scene.remade(
        sensors=[
            {key: value for key, value in sensor.items() if "noise" not in key} | {"name": f"s{k}"}
            for k, sensor in enumerate(NOISY)
        ]
    )
    engine, plain = (Engine(each, "rkmk4", 1e-3, quiet=True) for each in (scene, exact))
    gaps = []
    for _ in range(count):
        engine.advance(1)
        plain.advance(1)
        pair = engine.sample().sensors, plain.sample().sensors
        gaps.append(np.concatenate([pair[0][name] - pair[1][name] for name in pair[0]]))
    gaps = np.array(gaps)
    expected = np.concatenate([sensor.noise for sensor in scene.sensors])
    tolerance = 5.0 / np.sqrt(2 * count)
    assert np.abs(gaps.std(axis=0) - expected).max() <= tolerance * expected.max()
    noisy = expected > 0.0
    assert (np.abs(gaps.std(axis=0) / np.where(noisy, expected, 1.0) - noisy) <= tolerance).all()
    unit = gaps[:, noisy] / expected[noisy]
    assert np.abs(unit.T @ unit / count - np.eye(noisy.sum())).max() < 2 * tolerance * np.sqrt(2)
    assert np.abs((unit[1:] * unit[:-1]).mean(axis=0)).max() < tolerance * np.sqrt(2)


def test_noise_depends_on_seed_sensor_and_step_only():
    scene = pendulum(*NOISY)
    first, second = (Simulation(scene, "rkmk4", 1e-3, estimate=False) for _ in range(2))
    first.advance(7)
    for _ in range(7):
        second.advance(1)
        assert second.sample().sensors["s0"][9] != first.sample().sensors["s0"][9] or (second.steps == 7)
    for name, values in first.sample().sensors.items():
        assert np.array_equal(values, second.sample().sensors[name])
    other = pendulum({**NOISY[0], "seed": 1})
    assert read(other)["s0"][4] != read(scene)["s0"][4]
    # Written out and read again: the same scene.
    again = scene_from_text(scene.text)
    assert again.model_dump() == scene.model_dump()
    assert np.array_equal(read(again)["s1"], read(scene)["s1"])


@pytest.mark.parametrize("sensor, message", cases("wrong_sensors_have_one_line"))
def test_wrong_sensors_have_one_line(sensor, message):
    with pytest.raises(SceneError) as caught:
        pendulum(sensor)
    text = str(caught.value)
    assert message in text and "\n" not in text and text.count("got ") <= 1


def test_an_encoder_needs_a_joint_with_one_coordinate():
    ball = dict(
        name="ball",
        gravity=(0, 0, 0),
        bodies=[{"name": "b", "mass": 1.0, "inertia": [1, 1, 1]}],
        joints=[{"name": "j", "type": "spherical", "parent": "world", "child": "b", "child_frame": {}}],
    )
    with pytest.raises(SceneError, match="no single angle or displacement: use a pose sensor"):
        Scene(**ball, sensors=[{"name": "e", "type": "encoder", "joint": "j"}])


def test_every_kind_is_in_these_tests():
    kinds = {cls.model_fields["type"].default for cls in SENSORS}
    assert kinds == {"imu", "force_torque", "encoder", "pose", "distance"}
