# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim compare` and `identify`: bags of MCAP and SQLite, maps, pages, and wrong or damaged input."""

import json
import shutil
import sys
import zlib

import numpy as np
import pytest
from bags import START_NS, TYPES, header, topics_of, write_bag
from machine_logs import DELAY, log_of, machine
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from random_scenes import scene_of
from rosbags.rosbag2 import StoragePlugin
from scene_files import text_of
from scipy.spatial.transform import Rotation
from volume import revision, some

from liegroup_core import Simulation, load_scene
from liegroup_core.identification import compare
from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.logs.bag import BagError, Field, open_bag, recordings
from liegroup_sim_ros.logs.load import load_log
from liegroup_sim_ros.logs.map import Map, load_map
from liegroup_sim_ros.logs.suggest import suggest
from liegroup_sim_ros.view.compared import sources_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with a scene, a bag of its machine with a heavier rod, the same in SQLite, and the suggested map."""
    path = tmp_path_factory.mktemp("bags")
    (path / "furuta.yaml").write_text(machine("furuta").text)
    log = log_of(machine("furuta", **{"mass: 0.15": "mass: 0.165"}), "furuta", 1, seconds=1.2, rate=125.0)
    write_bag(path / "bag", topics_of(log))
    write_bag(path / "sqlite", topics_of(log), StoragePlugin.SQLITE3)
    with open_bag(path / "bag") as bag:
        scene = load_scene(path / "furuta.yaml")
        text, notes = suggest(bag, scene, make_layout(scene))
    assert notes == ["/effort_controller/commands: has no names: check the order of the joints"]
    (path / "map.yaml").write_text(text.replace("clocks: []", f"clocks: [{{topic: /joint_states, delay: {DELAY}}}]"))
    return path


def refused(arguments, capsys):
    """The one line of a command that refuses its input."""
    assert main([str(argument) for argument in arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


@pytest.mark.turn(3)
def test_compare_names_the_rod_and_identify_finds_it(folder, capsys):
    page, figures, out = folder / "page.html", folder / "figures.json", folder / "found.yaml"
    common = [folder / "furuta.yaml", folder / "bag", "--map", folder / "map.yaml", "--workers", 1]
    assert main(["compare", *map(str, common), "--html", str(page), "--json", str(figures)]) == 0
    text = capsys.readouterr().out
    assert "mass of rod" in text.lower() and "one run along the log, in" in " ".join(text.split())
    result = json.loads(figures.read_text())
    assert not result["agrees"] and result["effects"][0]["text"] == "mass of rod"
    html = page.read_text()
    assert "Mass of rod" in html and "two standard deviations of the noise" in html
    arguments = ["identify", *map(str, common), "--vary", "rod.shape.mass=0.05:0.5", "--out", str(out), "--json", "-"]
    assert main(arguments) == 0
    (number,) = json.loads(capsys.readouterr().out)["numbers"]
    assert main([*arguments[:-4], "--html", str(folder / "found.html")]) == 0
    assert "bodies.rod.shape.mass" in (folder / "found.html").read_text() and "0.165" in capsys.readouterr().out
    assert number["interval"][0] - 0.001 < 0.165 < number["interval"][1] + 0.001
    assert number["interval"][1] - number["interval"][0] < 0.002
    again = [*arguments[:2], str(folder / "sqlite"), *arguments[2:-4], *arguments[-2:]]  # the same bag, once more
    assert main([arguments[0], *again[1:]]) == 0
    (twice,) = json.loads(capsys.readouterr().out)["numbers"]
    assert twice["value"] == pytest.approx(number["value"], abs=0.1 * number["deviation"])
    assert twice["deviation"] == pytest.approx(number["deviation"] / np.sqrt(2.0), rel=0.1)
    found = load_scene(out)
    assert found.bodies[1].mass == pytest.approx(number["value"], rel=1e-9)
    assert out.read_text().startswith("# bodies.rod.shape.mass: ") and str(folder / "bag") in out.read_text()
    assert "already exists" in refused(arguments, capsys)


# A cart that moves along, whose effort jumps with that of a law at an instant that is no binary fraction.
JUMP = """
name: jump
bodies: [{name: cart, mass: 2, inertia: [1, 1, 1]}, {name: rod, mass: 1, inertia: [0.1, 0.1, 0.1], com: [0, 0, -0.4]}]
gravity: [0, 0, -9.81]
joints:
  - {name: rail, type: prismatic, parent: world, child: cart, child_frame: {axis: [1, 0, 0]}, driven: true}
  - {name: pin, type: revolute, parent: cart, child: rod, child_frame: {axis: [0, 1, 0]}}
forces: [{name: late, type: law, outputs: [{joint: pin, effort: 1 if t > 0.05 else 0}]}]
"""
SKID = """
name: skid
gravity: [0, 0, -9.81]
bodies: [{name: ball, shape: {type: sphere, radius: 0.1, mass: 2}, position: [0, 0, 0.12], linear_velocity: [1, 0, 0]}]
forces: [{name: floor, type: contact, body: ball, sinks: 1.0e-3, restitution: 0.5, friction: 0.3}]
"""
RECORDED = {"skid": SKID, "jump": JUMP, "random": None} | dict.fromkeys(
    "bicycle bricard cable diff_drive double_pendulum flyball_governor four_bar free_body heavy_top "
    "lagrangian_top n_four_bar slider_crank stick_slip".split()
)


@pytest.mark.parametrize("name", some(RECORDED, 2))
def test_a_recording_agrees_with_its_scene(name, tmp_path, capsys):
    """It has no noise; efforts of servos and laws act once; some starts hide coordinates, or have a taut cable."""
    scene, record, seconds, text = name, str(tmp_path / "run.mcap"), 1.0, RECORDED[name]
    if name == "random":
        rng, seconds = np.random.default_rng([zlib.crc32(revision().encode()), 3]), 0.5
        while "period" in (text := scene_of(rng)) or "contact" in text:
            pass
    if text is not None:
        scene = str(tmp_path / "scene.yaml")
        (tmp_path / "scene.yaml").write_text(text)
    assert main(["run", scene, "--duration", str(seconds), "--rate", "200", "--out", record]) == 0
    assert main(["compare", scene, record, "--workers", "1", "--json", str(tmp_path / "found.json")]) == 0
    told, found = capsys.readouterr().out, json.loads((tmp_path / "found.json").read_text())
    assert found["agrees"], told
    ahead = min(each["ahead"][-1] for each in found["horizons"] if each["ahead"])
    assert ahead > seconds - 0.011, told  # a late clock takes away its first or last message


def test_targets_of_servos_act_and_their_efforts_do_not_act_twice(tmp_path, capsys):
    record = str(tmp_path / "run.mcap")
    assert main(["run", "gripper", "--duration", "0.02", "--out", record]) == 0
    capsys.readouterr()
    assert main(["compare", "gripper", record, "--suggest"]) == 0
    text = capsys.readouterr().out
    assert 'input: "left_slide.target", topic: "/sim_node/servo_targets", field: "position[left_slide]"' in text
    assert "left_slide.effort" not in text and "effort of left_slide: a servo or law of the scene makes it" in text


def test_suggested_maps_and_formats_give_equal_logs(folder, capsys):
    assert main(["compare", str(folder / "furuta.yaml"), str(folder / "bag"), "--suggest"]) == 0
    text = capsys.readouterr().out
    assert '{input: "motor.effort", topic: "/effort_controller/commands", field: "data[0]"}' in text
    (folder / "suggested.yaml").write_text(text)
    scene, logs = load_scene(folder / "furuta.yaml"), []
    for name in ("bag", "sqlite", next((folder / "bag").glob("*.mcap"))):
        with open_bag(folder / name) as bag:
            logs.append(load_log(bag, load_map(folder / "suggested.yaml"), scene, {}))
    first = logs[0]
    assert first.notes == ("/effort_controller/commands: without stamps; times are those of recording",)
    for log in logs[1:]:
        assert log.inputs[0].values.tobytes() == first.inputs[0].values.tobytes()
        for one, other in zip(log.measured, first.measured):
            assert one.times.tobytes() == other.times.tobytes() and one.values.tobytes() == other.values.tobytes()


def test_a_suggested_map_has_only_numbers_of_the_bag(folder, tmp_path, capsys):
    """NaN stands for none, as efforts of a joint without one, or commands to other interfaces; the map can be read."""
    state, array = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
    layout = TYPES["std_msgs/msg/MultiArrayLayout"]([], 0)
    states, commands = [], []
    for k in range(9):
        stamp, nan = START_NS + k * 10_000_000, np.full(2, np.nan)
        velocity = np.array([np.nan, np.nan if k < 8 else 0.1])
        states.append((stamp, TYPES[state](header(stamp), ["motor", "hinge"], 0.1 * np.ones(2), velocity, nan)))
        commands.append((stamp, TYPES[array](layout, np.full(1, np.nan))))
    write_bag(tmp_path / "bag", {"/joint_states": (state, states), "/commands": (array, commands)})
    assert main(["compare", str(folder / "furuta.yaml"), str(tmp_path / "bag"), "--suggest"]) == 0
    text = capsys.readouterr().out
    assert "# /commands: no message has a number data[0]: without motor.effort" in text
    (tmp_path / "map.yaml").write_text(text)
    given = load_map(tmp_path / "map.yaml")
    assert not given.inputs
    assert [each.output for each in given.measurements] == ["motor.position", "hinge.position", "hinge.velocity"]
    with open_bag(tmp_path / "bag") as bag:
        load_log(bag, given, load_scene(folder / "furuta.yaml"), {})


@pytest.mark.parametrize(("first", "kept"), [(0, 3), (START_NS, 2)])
def test_a_stamp_of_zero_is_a_time_of_clocks_that_begin_there(first, kept, tmp_path):
    """Of simulated time; beside stamps of the wall clock it is none."""
    kind, none = "sensor_msgs/msg/JointState", np.zeros(0)
    messages = [
        (first + k, TYPES[kind](header(stamp), ["motor"], np.full(1, 0.1 * k), none, none))
        for k, stamp in enumerate((0, first + 10_000_000, first + 20_000_000))
    ]
    write_bag(tmp_path / "bag", {"/joint_states": (kind, messages)})
    given = Map.model_validate(
        {"measurements": [{"output": "motor.position", "topic": "/joint_states", "field": "position[motor]"}]}
    )
    with open_bag(tmp_path / "bag") as bag:
        (measured,) = load_log(bag, given, machine("furuta"), {}).measured
    assert measured.times.tolist() == [0.0, 0.01, 0.02][:kept] and len(measured.values) == kept


@pytest.mark.parametrize("steady", [True, False])
def test_clocks_that_differ_by_a_constant_are_moved(steady, tmp_path):
    """A robot's clock 7.3 s behind, by the times of recording; not if it was set while the bag was recorded."""
    log = log_of(machine("furuta"), "furuta", 1, seconds=1.0, rate=125.0)
    topics = topics_of(log)
    kind, states = topics["/joint_states"]
    for k, (_, message) in enumerate(states):
        stamp, late = message.header.stamp, 7_300_000_000 if steady or k < len(states) // 2 else 0
        stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec - late, 10**9)
    write_bag(tmp_path / "bag", topics)
    with open_bag(tmp_path / "bag") as bag:
        text, _ = suggest(bag, machine("furuta"), make_layout(machine("furuta")))
        (tmp_path / "map.yaml").write_text(text)
        found = load_log(bag, load_map(tmp_path / "map.yaml"), machine("furuta"), {})
    (measured,) = found.measured
    if steady:  # messages are recorded 1 ms after their stamps, within the ns of those
        assert measured.moved == pytest.approx(7.301, abs=2e-9)
        assert measured.times == pytest.approx(log.measured[0].times + 0.001, abs=2e-9)
        assert any("7.301 s behind that of /effort_controller/commands" in note for note in found.notes)
    else:
        assert measured.moved == 0.0 and any("0.001 s to 7.301 s after the stamps" in note for note in found.notes)


def test_sensors_of_the_scene_are_read_as_they_measure(tmp_path):
    """Quaternions of zeros are unknown orientations; encoders round down by half a step in the mean."""
    joints = "[{name: turn, type: revolute, parent: world, child: box, parent_frame: {axis: [0, 0, 1]}}]"
    encoder = "{name: encoder, type: encoder, joint: turn, resolution: 0.1}"
    scene = scene_from_text(
        "name: s\ngravity: [0, 0, 0]\nbodies: [{name: box, mass: 1, inertia: [1, 1, 1]}]\n"
        f"joints: {joints}\nsensors: [{encoder}, {{name: imu, type: imu, body: box}}]\n"
    )
    vector, none = TYPES["geometry_msgs/msg/Vector3"], np.zeros(0)
    imu, turn = [], []
    for k, w in enumerate((1.0, 0.0)):
        ns = START_NS + 10_000_000 * k
        quaternion, zeros = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, w), np.zeros(9)
        parts = quaternion, zeros, vector(0.0, 0.0, 1.0), zeros, vector(0.0, 0.0, 0.0), zeros
        imu.append((ns, TYPES["sensor_msgs/msg/Imu"](header(ns, "imu"), *parts)))
        turn.append((ns, TYPES["sensor_msgs/msg/JointState"](header(ns), ["turn"], np.full(1, 0.1 * k), none, none)))
    write_bag(tmp_path / "bag", {"/imu": ("sensor_msgs/msg/Imu", imu), "/turn": ("sensor_msgs/msg/JointState", turn)})
    given = Map(
        measurements=[
            {"output": "imu", "topic": "/imu"},
            {"output": "encoder", "topic": "/turn", "field": "position[turn]"},
        ]
    )
    with open_bag(tmp_path / "bag") as bag:
        found, turned = load_log(bag, given, scene, {}).measured
    assert np.isfinite(found.values).sum(axis=1).tolist() == [10, 6] and np.isnan(found.values[1, :4]).all()
    assert turned.values[:, 0] == pytest.approx([0.05, 0.15])


BODY = text_of("thrown_compare.yaml")


@pytest.mark.turn(3)
def test_poses_odometry_imu_and_tf_of_a_thrown_body_agree(tmp_path):
    """A turned frame of the tracker, quaternions of either sign, and an accelerometer with gravity."""
    scene, rng = scene_from_text(BODY), np.random.default_rng(0)
    simulation, topics = Simulation(scene, accuracy=1e-9, quiet=True), {}
    turn = Rotation.from_rotvec([0.3, -0.2, 1.1])
    shift = np.array([0.5, -1.0, 0.2])
    vector, quaternion = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/Quaternion"]
    point = TYPES["geometry_msgs/msg/Point"]
    poses, odometry, frames, imu = [], [], [], []
    for k, sample in enumerate(simulation.samples(np.arange(0.05, 0.5, 0.01))):
        ns = START_NS + sample.time_ns
        body = sample.poses["box"]
        r = turn.inv().apply(body[:3, 3] - shift) + 1e-3 * rng.standard_normal(3)
        noisy = Rotation.from_matrix(body[:3, :3]) * Rotation.from_rotvec(1e-3 * rng.standard_normal(3))
        q = (turn.inv() * noisy).as_quat() * (-1) ** k
        pose = TYPES["geometry_msgs/msg/Pose"](point(*r), quaternion(*q))
        poses.append((ns, TYPES["geometry_msgs/msg/PoseStamped"](header(ns, "tracker"), pose)))
        world = body[:3, 3] + 1e-3 * rng.standard_normal(3)
        pose = TYPES["geometry_msgs/msg/Pose"](point(*world), quaternion(*noisy.as_quat()))
        w, v = np.split(sample.twists["box"] + 1e-3 * rng.standard_normal(6), 2)
        twist = TYPES["geometry_msgs/msg/Twist"](vector(*v), vector(*w))
        parts = (
            TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
        odometry.append((ns, TYPES["nav_msgs/msg/Odometry"](header(ns, "world"), "box", *parts)))
        transform = TYPES["geometry_msgs/msg/Transform"](vector(*world), quaternion(*noisy.as_quat()))
        stamped = TYPES["geometry_msgs/msg/TransformStamped"](header(ns, "world"), "box", transform)
        frames.append((ns, TYPES["tf2_msgs/msg/TFMessage"]([stamped])))
        m = scene.sensors[0].measure(sample) + 1e-3 * rng.standard_normal(10)
        m[:4] /= np.linalg.norm(m[:4])
        message = TYPES["sensor_msgs/msg/Imu"](
            header(ns, "imu"),
            quaternion(*m[:4]),
            np.zeros(9),
            vector(*m[4:7]),
            np.zeros(9),
            vector(*m[7:]),
            np.zeros(9),
        )
        imu.append((ns, message))
    topics = {
        "/box": ("geometry_msgs/msg/PoseStamped", poses),
        "/odom": ("nav_msgs/msg/Odometry", odometry),
        "/tf": ("tf2_msgs/msg/TFMessage", frames),
        "/imu": ("sensor_msgs/msg/Imu", imu),
    }
    write_bag(tmp_path / "bag", topics)
    with open_bag(tmp_path / "bag") as bag:
        text, notes = suggest(bag, scene, make_layout(scene))
        (note,) = notes  # it is known from /box
        assert note == "/tf (tf2_msgs/msg/TFMessage): nothing more of the scene found in it; its names: box"
        entries = Map(
            measurements=[
                {
                    "output": "box.pose",
                    "topic": "/box",
                    "field": "pose",
                    "world": {"position": shift.tolist(), "rotation_vector": turn.as_rotvec().tolist()},
                },
                {"output": "box.twist", "topic": "/odom", "field": "twist.twist"},
                {"output": "box.x", "topic": "/tf", "field": "transforms[box].transform.translation.x"},
                {"output": "imu", "topic": "/imu"},
            ],
            clocks=[{"topic": topic, "delay": 0.0} for topic in topics],
        )
        log = load_log(bag, entries, scene, {"box": np.eye(3)})
    found = compare(scene, log, workers=1)
    assert found.agrees, found.verdict
    assert {channel.count for channel in found.channels} == {len(poses)}
    machine, model = sources_of(found)
    assert len(machine.history.frames) == len(model.history.frames) == len(poses)
    for frame, values in zip(machine.history.frames, log.measured[0].values):
        assert frame.sample.poses["box"][1:3, 3] == pytest.approx(values[1:3], abs=1e-12)
        assert frame.sample.poses["box"][:3, :3] == pytest.approx(
            Rotation.from_rotvec(values[3:6]).as_matrix(), abs=1e-12
        )


def test_notes_tell_of_lost_doubled_and_disordered_messages(tmp_path):
    log = log_of(machine("furuta"), "furuta", 1, seconds=0.6, rate=125.0)
    topics = topics_of(log)
    kind, states = topics["/joint_states"]
    topics["/joint_states"] = kind, [*states[:20], *states[40:], states[5], states[5]]
    states[3], states[4] = (states[4][0], states[3][1]), (states[3][0], states[4][1])
    write_bag(tmp_path / "bag", topics)
    scene = machine("furuta")
    with open_bag(tmp_path / "bag") as bag:
        text, _ = suggest(bag, scene, make_layout(scene))
        (tmp_path / "map.yaml").write_text(text)
        notes = load_log(bag, load_map(tmp_path / "map.yaml"), scene, {}).notes
    assert any("2 messages have the stamp of another one" in note for note in notes)
    assert any("gaps, the longest 0.1" in note for note in notes)


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        (
            "{output: motor.position, topic: /joint_states, field: 'position[motr]'}",
            "has a number position[motr]; its names: ",
        ),
        ("{output: motor.position, topic: /nothing, field: a}", "no topic /nothing; its topics: /"),
        ("{output: motr.position, topic: /joint_states, field: 'position[motor]'}", "unknown output 'motr.position'"),
        ("{output: motor.position, topic: /joint_states}", "add the field of sensor_msgs/msg/JointState"),
        ("{output: motor.position, topic: /joint_states, field: 'a[', noise: 1}", "give names with dots and brackets"),
        ("{output: motor.position, topic: /joint_states, field: 'position[motor]', noise: -1}", "map.yaml:2: "),
        ("{output: motor.position, topic: /joint_states, feld: a}", 'did you mean "field"'),
        ("{output: motor.position, topic: /joint_states, field: 'position[motor]', scale: 0}", "leaves nothing"),
        ("{output: motor.position, topic: /joint_states, field: 'position[motor]', noise: 1e-300}", "is round-off"),
        ("{output: motor.position, topic: /joint_states, field: 'position[motor]', world: {}}", "is no pose"),
        (
            "{output: motor.position, topic: /joint_states, field: 'position[motor]'}\nclocks: [{topic: /a, delay: 0}]",
            "/a has no measurements",
        ),
        ("{output: box.pose, topic: /joint_states, field: pose}", "no message on /joint_states"),
        ("{input: motor.motion, topic: /joint_states, field: 'position[motor]', hold: linear}", "remove hold"),
        ("{input: motor.effort, topic: /joint_states, field: 'effort[motor]', noise: 1}", "needs hold: spline"),
        (
            "{input: motor.motion, topic: /joint_states, field: 'position[motor]'}, "
            "{input: motor.effort, topic: /joint_states, field: 'velocity[motor]'}",
            "motor.effort and motor.motion are both inputs",
        ),
        ("{input: motr.motion, topic: /joint_states, field: 'position[motor]'}", "no joint motr that can be driven"),
    ],
)
def test_wrong_maps_have_one_line(folder, entry, text, tmp_path, capsys):
    measured = "{output: hinge.position, topic: /joint_states, field: 'position[hinge]'}"
    inputs, measurements = (f"inputs: [{entry}]\n", measured) if entry.startswith("{input") else ("", entry)
    (tmp_path / "map.yaml").write_text(f"{inputs}measurements:\n  - {measurements}\n")
    line = refused(["compare", folder / "furuta.yaml", folder / "bag", "--map", tmp_path / "map.yaml"], capsys)
    assert text in line


def with_checksums(path, copy):
    """Copy an MCAP file with the writer of mcap, which adds checksums."""
    with open(path, "rb") as file, open(copy, "wb") as out:
        writer, channels = Writer(out, compression=CompressionType.NONE), {}
        writer.start(profile="ros2")
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic not in channels:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", own, channel.metadata)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()


@pytest.mark.parametrize("kind", ["missing", "empty", "text", "cut", "bits", "sqlite"])
def test_damaged_bags_have_one_line(folder, kind, tmp_path, capsys):
    path = tmp_path / ("bag.db3" if kind == "sqlite" else "bag.mcap")
    whole = next((folder / "bag").glob("*.mcap"))
    if kind == "bits":  # rosbags writes no checksums
        with_checksums(whole, path)
        damaged = bytearray(path.read_bytes())
        damaged[len(damaged) // 2] ^= 1
        path.write_bytes(damaged)
    elif kind != "missing":
        half = whole.read_bytes()[: whole.stat().st_size // 2]
        path.write_bytes({"empty": b"", "text": b"hello\n", "cut": half, "sqlite": b"x" * 5000}[kind])
    line = refused(["compare", folder / "furuta.yaml", path, "--map", folder / "map.yaml"], capsys)
    assert str(path) in line
    assert kind != "cut" or f"`liegroup_sim recover {path}`" in line


def of_two_drivers(states, rename=str, later=0):
    """Messages of one joint each, such as of a base and of an arm; later: ns between their stamps."""
    found, kind = [], TYPES["sensor_msgs/msg/JointState"]
    for time_ns, message in states:
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        for k, name in enumerate(message.name):
            values = message.position[k : k + 1].copy(), message.velocity[k : k + 1].copy(), np.zeros(0)
            found.append((time_ns + k * later, kind(header(stamp + k * later), [rename(name)], *values)))
    return found


@pytest.mark.parametrize("later", [0, 300_000])
def test_two_drivers_on_one_topic_and_files_of_one_recording_are_one_log(folder, later, tmp_path, capsys):
    """Also if the second one begins after a second, with prefixed names, or in files that follow one another."""
    scene, topics = load_scene(folder / "furuta.yaml"), topics_of(log_of(machine("furuta"), "furuta", 1, seconds=1.2))
    kind, states = topics["/joint_states"]
    both = of_two_drivers(states, "r1/{}".format, later)
    begin, middle = states[0][0] + 500_000_000, both[len(both) // 2][0]
    late = [each for each in both if each[1].name == ["r1/hinge"] or each[0] > begin]
    commands = topics["/effort_controller/commands"]
    for name, keep in (("a", lambda time: time < middle), ("b", lambda time: time >= middle)):
        parts = {"/joint_states": (kind, late), "/effort_controller/commands": commands}
        write_bag(tmp_path / name, {of: (k, [m for m in all_ if keep(m[0])]) for of, (k, all_) in parts.items()})
    (paths,) = recordings([tmp_path / "b", tmp_path / "a"])
    assert paths == [tmp_path / "a", tmp_path / "b"]
    assert recordings([tmp_path / "a", tmp_path / "a"]) == [[tmp_path / "a"], [tmp_path / "a"]]
    with open_bag(*paths) as bag:
        text, notes = suggest(bag, scene, make_layout(scene))
        (tmp_path / "map.yaml").write_text(text)
        (measured,) = load_log(bag, load_map(tmp_path / "map.yaml"), scene, {}).measured
    assert len(notes) == 1 and sorted(measured.channels) == sorted(
        f"{joint}.{part}" for joint in ("motor", "hinge") for part in ("position", "velocity")
    )
    counts = dict(zip(measured.channels, np.isfinite(measured.values).sum(axis=0)))
    assert counts["hinge.position"] == len(states) and 0 < counts["motor.position"] < len(states)
    assert len(measured.times) == (len(states) if later == 0 else len(late))
    write_bag(tmp_path / "other", {"/joint_states": (kind, of_two_drivers(states, "wheel_{}".format))})
    line = refused(["compare", folder / "furuta.yaml", tmp_path / "other"], capsys)
    assert "not in the scene: wheel_hinge, wheel_motor; not in the bag: motor, hinge" in line
    (tmp_path / "b" / "metadata.yaml").unlink()
    assert "give its files (b.mcap)" in refused(["compare", folder / "furuta.yaml", tmp_path / "b"], capsys)


def test_definitions_of_a_bag_are_not_executed(folder, tmp_path):
    """A hostile definition is refused or read as data: no file appears."""
    evil = b"float64 x\n#" + b'";__import__("os").system("touch EVIL");"'
    whole = next((folder / "bag").glob("*.mcap")).read_bytes()
    place = whole.index(b"float64[] position")
    hostile = whole[:place] + evil.ljust(len(evil), b" ") + whole[place + len(evil) :]
    (tmp_path / "bag.mcap").write_bytes(hostile)
    try:
        with open_bag(tmp_path / "bag.mcap") as bag:
            next(bag.messages("/joint_states"))
    except BagError as error:
        assert "\n" not in str(error)
    assert not list(tmp_path.glob("EVIL"))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [(["--html", "/nowhere/page.html"], "existing folder"), (["--json", "a.mcap"], "choose another name")],
)
def test_wrong_arguments_have_one_line(folder, arguments, text, capsys):
    assert text in refused(["compare", folder / "furuta.yaml", folder / "bag", *arguments], capsys)
    if arguments[0] == "--html":
        line = refused(["identify", folder / "furuta.yaml", folder / "bag", "--vary", "rod.shape.mass=1,2"], capsys)
        assert "NAME=LOW:HIGH" in line


def test_fields_of_messages():
    message = {
        "joint_names": ["a", "b"],
        "interface_values": [
            {"interface_names": ["effort"], "values": (1.0,)},
            {"interface_names": ["position", "effort"], "values": (2.0, 3.0)},
        ],
        "transforms": [{"child_frame_id": "tool.v2", "transform": {"x": 4.0}}],
    }
    for text, value in (
        ("interface_values[b].values[effort]", 3.0),
        ("interface_values[0].values[0]", 1.0),
        ("transforms[tool.v2].transform.x", 4.0),
        ("interface_values[c].values[effort]", None),
        ("transforms[7].transform.x", None),
        ("transform.x", None),
    ):
        assert Field(text)(message) == value


@pytest.fixture(scope="module", autouse=True)
def _clean(folder):
    yield
    shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.turn(3)
def test_a_plan_is_a_motion_that_inverse_dynamics_takes(tmp_path, monkeypatch, capsys):
    """Of an arm; its table has the efforts that inverse dynamics finds for its positions."""
    planning = sys.modules["liegroup_core.identification.plan"]
    monkeypatch.setattr(planning, "TRIES", 2)
    monkeypatch.setattr(planning, "STEPS", 2)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.yaml").write_text(machine("arm").text)
    joints = ["motor", "hinge", "wrist"]
    moves = [f"{joint}=-0.5:0.5:3" for joint in joints]
    command = ["identify", "arm.yaml", "--vary", "hand.shape.mass", "lower.shape.mass", "--duration", "1"]
    assert main([*command, "--plan", "plan.csv", "--move", *moves]) == 0
    assert "motor alone" in capsys.readouterr().out
    assert main(["inverse", "arm.yaml", "--motion", "plan.csv", "--joints", *joints, "--out", "efforts.csv"]) == 0
    planned, efforts = (np.genfromtxt(name, delimiter=",", names=True) for name in ("plan.csv", "efforts.csv"))
    for joint, column in zip(joints, (1, 3, 5)):
        own, other = planned[f"{joint}effort"], efforts[efforts.dtype.names[column]]
        assert np.abs(own - other).max() < 0.02 * np.abs(own).max()
    capsys.readouterr()
    for wrong, text in (
        ([*command, "--plan", "plan.csv", "--move", *moves], "the file already exists"),
        ([*command, "--plan", "a.csv"], "--plan takes no bag, and --move JOINT=LOW:HIGH"),
        ([*command, "--plan", "a.csv", "--move", "motor=1"], "--move motor=1: give JOINT=LOW:HIGH"),
        ([*command, "--plan", "a.csv", "--move", "motor=1:2"], "motor starts at 0: its limits must include that"),
        ([*command, "--plan", "a.csv", "--move", "moter=-1:2"], "moter is no joint with one coordinate"),
        ([*command, "--plan", "a.csv", "--move", "motor=-1:1", "motor=-1:1"], "motor is given twice"),
        ([*command, "--plan", "a.txt", "--move", "motor=-1:1"], "the name must end in .csv"),
        (command, "give a bag, or --plan FILE"),
    ):
        assert text in refused(wrong, capsys)
