# SPDX-License-Identifier: Apache-2.0
"""A robot's URDF file in a running node: what RViz and robot_state_publisher take from it."""

import numpy as np
import pytest
from node_process import LATCHED, NodeProcess
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from robot_texts import ARM_SDF, ARM_URDF, five_bar_urdf, scissor_lift, stewart_sdf
from rosbags.typesys import Stores, get_typestore
from scene_files import text_of
from scene_runs import Run
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from liegroup_core import Simulation, load_scene
from liegroup_core.joints.linkage import inverse
from liegroup_core.robots.description import rpy_of_rotation
from liegroup_core.robots.read import read_robot
from liegroup_sim_ros.messages.description import robot_description
from liegroup_sim_ros.messages.markers import CUBE, MESH, Markers
from liegroup_sim_ros.messages.samples import joint_states, transforms


def moved(states):
    """True if a joint has moved, in any of the messages."""
    return any(np.abs(state.velocity).max() > 1e-3 for state in states)


@pytest.mark.turn(3)
def test_a_node_serves_a_urdf_file_whose_links_and_joints_are_named_in_wrenches_and_states(client, tmp_path):
    """The tool is merged into the slide: a wrench on it acts at its origin, in its axes."""
    path = tmp_path / "arm.urdf"
    path.write_text(ARM_URDF)
    parameters = {"scene": path, "joint_state_rate": 100.0, "start_paused": True, "method": "rkmk4"}
    parameters["record"] = tmp_path / "a.mcap"
    body, place = load_scene(path).robot.frames["tool"]
    assert body == "slide" and np.abs(place - np.eye(4)).max() > 0.1

    def ask(service, **given):
        named = [Parameter(n, value=v).to_parameter_msg() for n, v in given.items()]
        request = SetParametersAtomically.Request(parameters=named)
        return client.call(f"/links/{service}", SetParametersAtomically, request).result

    def moved_to_body(torque, force):
        torque, force = place[:3, :3] @ torque, place[:3, :3] @ force
        return [*(torque + np.cross(place[:3, 3], force)), *force]

    def total(order):
        """Torque about the origin of the body, and force, of an Order in body axes."""
        torque, force = np.split(np.array(order.values), 2)
        return [*(torque + np.cross(order.point or (0, 0, 0), force)), *force]

    with NodeProcess(parameters, remap=["__node:=links"]):
        states = client.listen("/links/joint_states", JointState)
        given = client.given("/links", LATCHED)
        client.until_stamp(client.command("/links/step"), states)
        # A late subscriber still gets the description.
        texts = client.listen("/links/robot_description", String, LATCHED)
        client.until(lambda: texts, "the description")
        assert texts[0].data == ARM_URDF and moved(states)
        assert states[-1].name == ["shoulder", "extend", "tip_joint"]
        assert states[-1].position[2] == states[-1].velocity[2] == 0.0
        assert ask("set_state", **{"shoulder/position": 0.4, "extend/velocity": -0.3}).successful
        client.until(lambda: states[-1].velocity[1] == pytest.approx(-0.3, abs=1e-12))
        assert states[-1].position[0] == pytest.approx(0.4, abs=1e-12)
        done = ask("apply_wrench", body="tool", force=[1.0, 2.0, 3.0], point=[0.0, 0.0, 0.1], duration=1.0)
        assert done.successful, done.reason
        client.call("/links/step")
        client.until(lambda: given)
        expected = moved_to_body(np.cross([0, 0, 0.1], [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0])
        assert given[-1].name == "slide" and total(given[-1]) == pytest.approx(expected, abs=1e-14)
        push, count = client.pusher("/links"), len(given)
        push("tool", torque=(0.5, 0.0, 0.0), force=(0.0, 7.0, 0.0))
        client.call("/links/step")
        client.until(lambda: len(given) > count)
        expected = moved_to_body([0.5, 0.0, 0.0], [0.0, 7.0, 0.0])
        assert total(given[-1]) == pytest.approx(expected, abs=1e-14)


def test_a_fixed_joint_that_is_kept_is_fixed_for_robot_state_publisher(tmp_path):
    path = tmp_path / "arm.sdf"
    sensor = '<sensor name="cell" type="force_torque"/></joint>'
    path.write_text(ARM_SDF.replace("<child>tool</child></joint>", f"<child>tool</child>{sensor}"))
    scene = load_scene(path)
    assert [joint.type for joint in scene.joints] == ["revolute", "prismatic", "fixed"]
    path = tmp_path / "again.urdf"
    path.write_text(robot_description(scene))
    again = read_robot(path)
    (flange,) = [joint for joint in again.joints if joint.name == "flange"]
    assert (flange.type, flange.parent, flange.child) == ("fixed", "slide", "tool")
    assert not any(joint.type == "floating" for joint in again.joints)
    place = flange.parent_frame @ inverse(flange.child_frame)
    expected = inverse(scene.bodies[1].pose) @ scene.bodies[2].pose
    assert place == pytest.approx(expected, abs=1e-12)


def test_tf_has_the_frames_of_all_links(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM_URDF)
    simulation = Simulation(load_scene(path), "rkmk4", 1e-3)
    simulation.advance(100)
    sample = simulation.sample()
    ((_, message_type, encode),) = transforms(simulation.layout, "world", "a/")
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(encode(5_000_000_000, sample), message_type)
    found = {}
    for each in message.transforms:
        t = each.transform.translation
        found[each.child_frame_id] = np.array([t.x, t.y, t.z])
        assert each.header.frame_id == "world" and each.header.stamp.sec == 5
    assert set(found) == {"a/base", "a/upper", "a/slide", "a/tool", "a/tip"}
    slide = sample.poses["slide"]
    assert found["a/tool"] == pytest.approx((slide @ (0, 0.1, 0, 1))[:3], abs=1e-14)
    assert found["a/upper"] == pytest.approx(sample.positions["upper"], abs=1e-14)
    assert not found["a/base"].any()


def transforms_of(simulation, which="all"):
    """{frame: (4, 4)} of /tf, and {joint: coordinate} of ~/joint_states, of the present state."""
    store, sample = get_typestore(Stores.ROS2_JAZZY), simulation.sample()

    def message(topic, **options):
        ((_, message_type, encode),) = topic(simulation.layout, "world", **options)
        return store.deserialize_cdr(encode(0, sample), message_type)

    found = {"world": np.eye(4)}
    if not transforms(simulation.layout, "world", which=which):  # all hang from the world
        return found, {}
    for each in message(transforms, which=which).transforms:
        t, q = each.transform.translation, each.transform.rotation
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        pose[:3, 3] = t.x, t.y, t.z
        found[each.child_frame_id] = pose
    if not simulation.layout.coordinates.names:  # no message: rosbags refuses empty sequences
        return found, {}
    states = message(joint_states)
    return found, dict(zip(states.name, states.position))


HYPHENS = ARM_URDF.replace('"slide"', '"slide-1"')


@pytest.mark.parametrize(
    "name, text, roots",
    [
        ("arm.urdf", HYPHENS, {"base"}),
        ("stewart.sdf", stewart_sdf(), None),
        ("four_bar", None, None),
        ("heavy_top", None, {"top"}),
    ],
)
@pytest.mark.turn(3)
def test_robot_state_publisher_and_the_roots_are_one_tree(name, text, roots, tmp_path):
    """What robot_state_publisher makes of description and joint states, and /tf with the roots.

    It publishes child in parent for all joints that are not floating. A body whose link has another
    name has a frame of its own.
    """
    path = name if text is None else tmp_path / name
    if text is not None:
        path.write_text(text)
    simulation = Simulation(load_scene(path))
    simulation.advance(100)
    written = tmp_path / "description.urdf"
    written.write_text(robot_description(simulation.scene))
    robot = read_robot(written)
    everything, values = transforms_of(simulation)
    ours, _ = transforms_of(simulation, "roots")
    del ours["world"]
    parents = dict.fromkeys(ours, "world")
    poses = {"world": np.eye(4)} | ours
    for joint in robot.joints:
        if joint.type != "floating":
            assert joint.child not in parents  # a frame has one parent
            parents[joint.child] = joint.parent
    own = {"slide_1"} if name == "arm.urdf" else set()
    assert set(parents) == set(everything) - {"world"} and own <= set(ours)
    assert roots is None or set(ours) == roots | own
    left = [joint for joint in robot.joints if joint.type != "floating"]
    while left:
        ready = [joint for joint in left if joint.parent in poses]
        assert ready, [joint.child for joint in left]  # everything hangs from the world
        for joint in ready:
            pose = poses[joint.parent] @ joint.parent_frame @ joint.motion(values.get(joint.name, 0.0))
            poses[joint.child] = pose @ inverse(joint.child_frame)
        left = [joint for joint in left if joint.child not in poses]
    for frame, pose in everything.items():
        assert np.abs(poses[frame] - pose).max() < 1e-12
    if name == "arm.urdf":
        assert np.array_equal(everything["slide_1"], everything["slide-1"])


@pytest.mark.parametrize(
    "name", ["arm.sdf", "stewart.sdf", "apart.xml", "four_bar", "slider_crank", "bricard", "ball_chain"]
)
@pytest.mark.turn(3)
def test_the_generated_urdf_moves_with_the_joint_states(name, tmp_path):
    """Poses of all links from the joints of the URDF and ~/joint_states are those of /tf.

    Tolerance: round-off, for up to ten joints between a link and the world.
    """
    texts = {
        "arm.sdf": ARM_SDF.replace("</link>", VISUAL + "</link>", 1),
        "stewart.sdf": stewart_sdf(),
        "apart.xml": APART_XML,
    }
    path = name
    if name == "apart.xml":
        pytest.importorskip("mujoco")
    if name in texts:
        path = tmp_path / name
        path.write_text(texts[name])
    simulation = Simulation(load_scene(path))
    scene = simulation.scene
    written = tmp_path / "generated.urdf"
    written.write_text(robot_description(scene))
    robot = read_robot(written)  # a URDF with one root, every link once
    assert robot.roots == ["world"]
    simulation.advance(200)
    frames, values = transforms_of(simulation)
    assert set(robot.links) == set(frames) and {body.name for body in scene.bodies} <= set(frames)
    moving = {joint.name for joint in robot.joints if joint.type not in ("fixed", "floating")}
    loose = [joint for joint in robot.joints if joint.type == "floating"]
    assert moving <= set(values) and len(loose) == LOOSE.get(name, 0)
    for joint in robot.joints:
        if joint.type == "floating":
            continue
        moved = joint.motion(values[joint.name]) if joint.name in moving else np.eye(4)
        pose = frames[joint.parent] @ joint.parent_frame @ moved @ inverse(joint.child_frame)
        assert np.abs(pose - frames[joint.child]).max() < 1e-12
    if name == "arm.sdf":
        (box,) = robot.links["upper"].visuals
        assert box.kind == "box" and box.size == pytest.approx((0.2, 0.1, 0.3))
        assert box.pose[:3, 3] == pytest.approx((0.1, 0, 0))
    elif name not in texts:
        assert all(len(robot.links[body.name].visuals) == 1 for body in scene.bodies)


@pytest.mark.parametrize("name", ["five_bar", "lift", "platform", "apart", "slider_crank"])
@pytest.mark.turn(3)
def test_other_parsers_place_the_links_as_tf_does(name, tmp_path):
    """urdfdom's Python port and yourdfpy, in place of RViz and robot_state_publisher."""
    urdfdom, yourdfpy = (pytest.importorskip(each) for each in ("urdf_parser_py.urdf", "yourdfpy"))
    path, make = name, {"five_bar": five_bar, "lift": lift, "platform": platform}.get(name)
    if name == "apart":
        pytest.importorskip("mujoco")
        path = tmp_path / "apart.xml"
        path.write_text(APART_XML)
    simulation = Simulation(load_scene(make(tmp_path) if make else path))
    if name == "apart":  # it falls freely, so that its joints rest, and yourdfpy ignores coordinates near 0
        simulation.place(joints={"a": (0.5, 1.0), "b": (-0.4, 0.0), "c": (0.1, 0.0)})
    simulation.advance(200)
    written = tmp_path / "description.urdf"
    written.write_text(robot_description(simulation.scene))
    frames, values = transforms_of(simulation)
    described = urdfdom.URDF.from_xml_file(str(written))
    other = yourdfpy.URDF.load(written, load_meshes=False)
    other.update_cfg({each: values[each] for each in other.actuated_joint_names if each in values})
    assert {link.name for link in described.links} | {"world"} == set(frames)
    held = [joint for joint in described.joints if joint.type != "floating"]
    for joint in held:
        assert joint.type == "fixed" or joint.name in values
        pose = frames[joint.parent] @ other.get_transform(joint.child, joint.parent)
        assert np.abs(pose - frames[joint.child]).max() < 1e-12
    assert len(held) >= 2


LOOSE = {"stewart.sdf": 7, "ball_chain": 10, "apart.xml": 1, "slider_crank": 1}  # links that are floating


APART_XML = text_of("apart.xml")


VISUAL = """<visual name="v"><pose>0.1 0 0 0 0.5 0</pose>
<geometry><box><size>0.2 0.1 0.3</size></box></geometry></visual>"""


TETRAHEDRON = """solid t
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid t
"""


def test_markers_have_the_visuals_and_meshes_of_the_file(tmp_path):
    """A mesh that is there, one that is missing, and a body without visuals."""
    (tmp_path / "tool.stl").write_text(TETRAHEDRON)
    mesh = '<visual><origin xyz="0 0 0.2"/><geometry><mesh filename="{}" scale="2 1 1"/></geometry></visual>'
    text = ARM_URDF.replace('<link name="tool">', '<link name="tool">' + mesh.format("tool.stl"))
    text = text.replace('<link name="tip"/>', f'<link name="tip">{mesh.format("none.stl")}</link>')
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    simulation = Simulation(load_scene(path), "rkmk4", 1e-3)
    simulation.advance(30)
    sample = simulation.sample()
    encoder = Markers(simulation.layout, "world", 1.0)
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(encoder.encode(0, sample), "visualization_msgs/msg/MarkerArray")
    bodies = [marker for marker in message.markers if marker.ns == "bodies"]
    assert [marker.type for marker in bodies] == [CUBE, MESH]
    box, tool = bodies
    assert (box.scale.x, box.scale.y, box.scale.z) == (0.2, 0.05, 0.04)
    at = sample.poses["upper"] @ (0.1, 0, 0, 1)
    assert (box.pose.position.x, box.pose.position.z) == pytest.approx((at[0], at[2]), abs=1e-14)
    assert tool.mesh_resource == (tmp_path / "tool.stl").as_uri() and tool.mesh_use_embedded_materials
    assert tool.scale.x == 2.0 and box.mesh_resource == ""
    link, place = simulation.scene.robot.frames["tool"]
    at = sample.poses[link] @ place @ (0, 0, 0.2, 1)
    assert tool.pose.position.z == pytest.approx(at[2], abs=1e-14)


def five_bar(folder):
    (folder / "five_bar.urdf").write_text(five_bar_urdf())
    path = folder / "five_bar.yaml"
    path.write_text(
        "robot: five_bar.urdf\ngravity: [0, -9.81, 0]\njoints:\n  - {name: tip, type: revolute, parent: left_end,"
        " child: right_end, parent_frame: {}, child_frame: {}}\n"
    )
    return path


def lift(folder):
    text, closing = scissor_lift(2)
    (folder / "lift.urdf").write_text(text)
    path = folder / "lift.yaml"
    path.write_text(closing)
    return path


def platform(folder):
    path = folder / "stewart.sdf"
    path.write_text(stewart_sdf())
    return path


@pytest.mark.parametrize(
    "make, joints",
    [
        (five_bar, ["left_crank", "right_crank", "left_elbow", "right_elbow", "tip"]),
        (lift, ["slide", "lift0", "cross0", "lift1", "cross1", "pin0", "pin1"]),
        (platform, [f"leg{k}" for k in range(6)]),
    ],
)
@pytest.mark.turn(3)
def test_the_node_runs_closed_loops(make, joints, client, ros_node, tmp_path):
    path = make(tmp_path)
    states = client.listen("/sim_node/joint_states", JointState)
    texts = client.listen("/sim_node/robot_description", String, LATCHED)
    with Run(ros_node, path, joint_state_rate=50.0):
        client.until(lambda: texts and states, "the description and states")
        start, count = np.array(states[0].position), len(states)
        client.until(lambda: np.abs(np.array(states[-1].position) - start).max() > 1e-3, "motion")
    assert len(states) > count and states[-1].name == joints
    # The joints of the description are those of the joint states, or its frames come from /tf.
    described = tmp_path / "described.urdf"
    described.write_text(texts[0].data)
    robot = read_robot(described)
    if make is platform:
        assert set(robot.links) == {"world", "plate"} | {f"{p}{k}" for p in ("lower", "upper") for k in range(6)}
    else:
        own = {joint.name for joint in robot.joints if joint.type != "fixed"}
        assert own <= set(joints) and set(joints) - own <= {"tip", "pin0", "pin1"}


WRONG_ADDITIONS = [
    ("forces:\n  - {name: pull, type: applied_wrench, body: left_bar, force: [0, 0]}", 6, "3 numbers"),
    ("forces:\n  - {name: pull, type: applied_wrench, body: left_bar, force: [.nan, 0, 0]}", 6, "finite"),
    ("forces:\n  - {name: s, type: spring_damper, parent: left, stiffness: 1}", 6, "_point is missing"),
    ("forces:\n  - {name: s, type: drag, body: [left], linear: 1}", 6, "body must be text"),
    ("start: {left_cranc: 0.1}", 5, 'did you mean "left_crank"'),
    ("start: {left_crank: 0.1, left_elbow: 0.5, right_elbow: 1}", 5, "no pose near the start"),
    ("robot: gone.urdf", 5, "is given twice"),
    ("forces: [{", 5, "YAML"),
]  # fmt: skip


@pytest.mark.turn(3)
def test_a_wrong_file_beside_the_robot_keeps_the_scene_that_runs(client, tmp_path):
    path = five_bar(tmp_path)
    right = path.read_text()
    with NodeProcess({"scene": path, "joint_state_rate": 50.0}, remap=["__node:=reloaded"]) as node:
        states = client.listen("/reloaded/joint_states", JointState)
        client.until(lambda: moved(states), "motion")
        for text, line, expected in WRONG_ADDITIONS:
            path.write_text(f"{right}{text}\n")
            answer = client.call("/reloaded/reload")
            assert not answer.success and "\n" not in answer.message
            assert f"{path}:{line}: " in answer.message and expected in answer.message, (text, answer.message)
        (tmp_path / "five_bar.urdf").write_text("<robot><link/>")
        path.write_text(right)
        answer = client.call("/reloaded/reload")
        assert not answer.success and f"{tmp_path / 'five_bar.urdf'}:1: is not XML" in answer.message
        # The previous scene goes on: its time does not start again.
        before, count = states[-1].header.stamp, len(states)
        client.until(lambda: len(states) > count + 10, what="more joint states")
        after = states[-1].header.stamp
        assert (after.sec, after.nanosec) > (before.sec, before.nanosec)
        (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
        path.write_text(f"{right}start: {{left_crank: 0.1}}\n")
        assert client.call("/reloaded/reload").success
        node.end()


@pytest.mark.parametrize("angles", [(0.3, -1.2, 2.9), (0.7, np.pi / 2, 0.0), (-2.0, -np.pi / 2, 0.0)])
def test_roll_pitch_yaw_give_the_rotation_again(angles):
    """Also where they are not unique. Tolerance: the round-off of a level below 1e-9."""
    R = Rotation.from_euler("xyz", angles).as_matrix()
    again = Rotation.from_euler("xyz", rpy_of_rotation(R)).as_matrix()
    assert np.abs(again - R).max() < 1e-9


def test_relative_meshes_of_a_urdf_have_addresses(tmp_path):
    """Viewers know no folder that a name could be relative to; everything else stays as it is."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.stl").write_text("solid a\nendsolid a\n")
    mesh = '<visual><geometry><mesh filename="{}"/></geometry></visual></link>'
    text = ARM_URDF
    for name in ("parts/a.stl", "missing.stl", "package://nowhere/b.stl"):
        at = text.rindex("</link>") if "a.stl" not in text else text.index("</link>")
        text = text[:at] + mesh.format(name) + text[at + len("</link>") :]
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    address = (tmp_path / "parts" / "a.stl").as_uri()
    assert robot_description(load_scene(path)) == text.replace("parts/a.stl", address)


def test_bodies_without_visuals_are_boxes_in_the_generated_urdf(tmp_path):
    path = tmp_path / "arm.sdf"
    path.write_text(ARM_SDF.replace("</link>", VISUAL + "</link>", 1))
    scene = load_scene(path)
    written = tmp_path / "generated.urdf"
    written.write_text(robot_description(scene))
    links = read_robot(written).links
    drawn = {
        body.name: sum(
            len(links[link].visuals) for link, (owner, _) in scene.robot.frames.items() if owner == body.name
        )
        for body in scene.bodies
    }
    assert min(drawn.values()) >= 1 and len(drawn) == 2
