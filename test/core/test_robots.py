# SPDX-License-Identifier: Apache-2.0
"""Robot files as scenes: the same mechanism in URDF, SDF and MJCF, and random URDF trees."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from engine import engine_accelerations
from robot_texts import (
    ARM_MJCF,
    ARM_SDF,
    ARM_URDF,
    FIVE_BAR_TIP,
    MJCF_WITH_ACTUATORS,
    MJCF_WITH_ALL_JOINTS,
    five_bar_urdf,
    freedoms,
    mimic_urdf,
    random_urdf,
    rotation,
    scissor_lift,
    stewart_sdf,
    written,
)
from scene_files import cases, filled, text_of

from liegroup_core import Scene, SceneError, Simulation, load_scene
from liegroup_core.describe import describe
from liegroup_core.layout import make_layout
from liegroup_core.robots.options import Options
from liegroup_core.robots.starts import Start
from liegroup_core.scene import scene_from_text
from liegroup_core.scene.load import scene_from_robot

pytestmark = pytest.mark.usefixtures("mjcf_here")


def peers():
    """The comparisons of benchmarks/robots.py."""
    sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
    from robots_side import with_mujoco

    return with_mujoco


def arm_in(folder, kind):
    """Path of the arm in a format."""
    if kind == "mjcf":
        R = rotation(0.3, -0.2, 0.5)
        own = np.array([[0.02, 0.001, -0.002], [0.001, 0.03, 0.0015], [-0.002, 0.0015, 0.025]])
        tensor = (R @ own @ R.T)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        text = filled(ARM_MJCF, upper=" ".join(map(repr, tensor.tolist())))
    else:
        text = {"urdf": ARM_URDF, "sdf": ARM_SDF}[kind]
    path = written(folder / f"arm.{'xml' if kind == 'mjcf' else kind}", text)
    return path


def by_hand():
    """The arm as a scene file, unmerged: fixed joints and frames as in the URDF text."""

    def frame(position, rpy, turn=None):
        R = rotation(*rpy)
        R = R if turn is None else R @ turn
        angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
        axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        vector = axis / (2 * np.sin(angle)) * angle if angle > 1e-9 else np.zeros(3)
        return {"position": list(position), "rotation_vector": vector.tolist()}

    def moved(turn):
        return frame((0, 0, 0), (0, 0, 0), turn)

    def body(name, mass, com, rpy, inertia):
        R = rotation(*rpy)
        tensor = R @ np.array(inertia) @ R.T
        moments = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()
        return {"name": name, "mass": mass, "com": list(com), "inertia": moments}

    z = np.array([0.3, -0.5, 1.0]) / np.linalg.norm([0.3, -0.5, 1.0])
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    tilt = np.column_stack([x, np.cross(z, x), z])
    along_y = np.column_stack([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    own = [[0.02, 0.001, -0.002], [0.001, 0.03, 0.0015], [-0.002, 0.0015, 0.025]]
    return Scene(
        name="arm",
        gravity=(0, 0, -9.81),
        assemble=True,
        bodies=[
            body("upper", 2.5, (0.1, 0.02, -0.03), (0.3, -0.2, 0.5), own),
            body("slide", 1.2, (0, 0.05, 0.01), (0, 0, 0.4), np.diag([0.004, 0.005, 0.006])),
            body("tool", 0.4, (0, 0, 0.1), (0, 0, 0), np.diag([0.001, 0.001, 0.0005])),
        ],
        joints=[
            {"name": name, "type": kind, "parent": parent, "child": child, "parent_frame": at, "child_frame": own}
            for name, kind, parent, child, at, own in (
                ("shoulder", "revolute", "world", "upper", frame((0.1, 0.2, 0.3), (0.2, 0.1, -0.3), tilt), moved(tilt)),
                ("extend", "prismatic", "upper", "slide", frame((0.3, 0, 0.05), (0.5, 0, 0), along_y), moved(along_y)),
                ("flange", "fixed", "slide", "tool", frame((0, 0.1, 0), (0, 0.7, 0)), {}),
            )
        ],
    )


@pytest.mark.parametrize("kind", ["urdf", "sdf", "mjcf"])
def test_an_arm_has_the_accelerations_of_the_scene_written_by_hand(kind, tmp_path):
    scene, hand = load_scene(arm_in(tmp_path, kind)), by_hand()
    assert [body.name for body in scene.bodies] == ["upper", "slide"]
    found, expected = engine_accelerations(scene), engine_accelerations(hand)
    # The merged body has another centre of mass: angular accelerations are the same.
    assert np.allclose(found[0], expected[0], rtol=1e-12, atol=1e-12)
    assert np.allclose(found[1, :3], expected[1, :3], rtol=1e-12, atol=1e-12)
    # Without velocity the acceleration of a point is that of the centre plus alpha x r.
    offset = np.array(hand.bodies[1].com) - np.array(scene.bodies[1].com)
    moved = found[1, 3:] + np.cross(found[1, :3], offset)
    assert np.allclose(moved, expected[1, 3:], rtol=1e-12, atol=1e-12)
    assert {(force.joint, force.damping) for force in scene.forces} == {("shoulder", 0.7), ("extend", 4.0)}


def test_notes_name_what_was_merged_and_left_out(tmp_path):
    scene = load_scene(arm_in(tmp_path, "urdf"))
    text = "\n".join(scene.notes)
    assert "merged into slide: tool, tip" in text
    assert "fixed to the world: base" in text
    assert "held in place: tip at the end of joint tip_joint" in text
    assert "without effect 1 collision shape of base" in text
    assert "limits" not in text and "friction" not in text
    assert [(joint.limits.lower, joint.limits.upper) for joint in scene.joints] == [(-1.0, 2.0), (-1.0, 1.0)]
    assert [joint.friction and joint.friction.coulomb for joint in scene.joints] == [0.1, None]
    without = scene_from_robot(arm_in(tmp_path, "urdf"), Options(stops=[], friction=[]))
    text = "\n".join(without.notes)
    assert "changes the motion: joint limits are not enforced: shoulder, extend" in text
    assert "changes the motion: joint friction is not simulated: shoulder" in text
    assert not any(joint.limits or joint.friction for joint in without.joints)
    assert "left out: transmission (drive)" in text
    assert scene.joints[0].data == {"friction": 0.1, "lower": -1.0, "upper": 2.0, "effort": 10.0, "velocity": 3.0}


def test_the_text_of_a_robot_reads_back_bit_identical(tmp_path):
    scene = load_scene(arm_in(tmp_path, "urdf"))
    again = scene_from_text(scene.text)
    assert again.model_dump() == scene.model_dump() and "# line 4" in scene.text
    (tmp_path / "arm.urdf").unlink()
    simulation, copy = (Simulation(each, "rkmk4", 1e-3) for each in (scene, again))
    simulation.advance(50)
    copy.advance(50)
    assert np.array_equal(simulation.state()[0], copy.state()[0])


@pytest.mark.parametrize("seed", range(6))
def test_random_urdf_trees_have_mujocos_accelerations(seed, tmp_path):
    path = written(tmp_path / "random.urdf", random_urdf(np.random.default_rng(seed), 8))
    scene = scene_from_robot(path, Options(stops=[], friction=[]))
    assert peers().against_mujoco(path, scene, 10) < 1e-12


ELBOW = text_of("arm_robots.urdf")
LIGHT = text_of("light_links.xml")


def test_links_without_mass_follow_the_joints_that_theirs_mimic(tmp_path):
    """In a chain, behind a joint that is held; their damping acts by the square of the ratio, as by virtual power.

    Runs to an accuracy of 1e-8 differ by the sum of their errors.
    """
    damped = '<dynamics damping="0.05"/>'
    texts = ELBOW.replace("OF_ELBOW", "") + LIGHT + "</robot>", ELBOW.replace("OF_ELBOW", damped) + "</robot>"
    found = []
    for k, text in enumerate(texts):
        simulation = Simulation(load_scene(written(tmp_path / f"{k}.urdf", text)), quiet=True, accuracy=1e-8)
        simulation.place(joints={"el": (0.8, 0.1)})
        simulation.advance_to(1.0)
        found.append(simulation.sample().joint_coordinates)
    elbow, rate = found[0]["el"]
    assert found[0]["el"] == pytest.approx(found[1]["el"], abs=2e-7)
    assert found[0]["turn"] == pytest.approx((-0.5 * elbow, -0.5 * rate), abs=1e-12)
    assert found[0]["slide"] == pytest.approx((0.3 - elbow, -rate), abs=1e-12)
    robot = load_scene(tmp_path / "0.urdf")
    assert robot.robot.still == {"free": 0.0} and "without mass: tip moved by couplings" in "\n".join(robot.notes)


def test_joints_of_mjcf_have_mujocos_accelerations(tmp_path):
    path = written(tmp_path / "all.xml", MJCF_WITH_ALL_JOINTS)
    scene = scene_from_robot(path, Options(stops=[], friction=[]))
    assert peers().against_mujoco(path, scene, 20) < 1e-12
    assert [joint.name for joint in scene.joints if joint.rotor] == ["wrist"]
    text = "\n".join(scene.notes)
    assert "joint friction is not simulated: twist" in text
    assert "without mass: cart_x between joints" in text


@pytest.mark.parametrize("key", [None, "k"])
def test_actuators_have_mujocos_accelerations(key, tmp_path):
    """Servos and motors with gears, limits and commands; also through tendons, of coupled joints, too."""
    path = written(tmp_path / "driven.xml", MJCF_WITH_ACTUATORS)
    scene = scene_from_robot(path, Options(pose=key))
    assert not [note for note in scene.differences if "collision" not in note]
    assert [note for note in scene.notes if "tendons" in note] == ["left out: tendons (two)"]
    assert peers().against_mujoco(path, scene, 20, key) < 1e-12


def coordinates(scene):
    """{joint: position} at the start."""
    found = Simulation(scene, "rkmk4", 1e-3).sample().joint_coordinates
    return {name: position for name, (position, _) in found.items()}


def test_start_values_poses_and_locked_joints(tmp_path):
    path = written(tmp_path / "all.xml", MJCF_WITH_ALL_JOINTS)
    home = coordinates(scene_from_robot(path, Options(pose="home", start={"turn": 0.7})))
    # Coordinates count from the pose of the file, where the wrist is at 20 degrees.
    expected = {"x": 0.1, "y": 0.2, "turn": 0.7, "wrist": 0.4 - np.radians(20), "twist": 0.5}
    assert {name: home[name] for name in expected} == pytest.approx(expected, abs=1e-14)
    notes = [note for note in load_scene(path).notes if " ref " in note]
    assert notes == ["coordinate of joint wrist is 0 at its ref 0.349066 of the file: qpos = coordinate + ref"]
    urdf = arm_in(tmp_path, "urdf")
    start = coordinates(scene_from_robot(urdf, Options(start={"shoulder": 0.3, "extend": -0.1})))
    assert start == pytest.approx({"shoulder": 0.3, "extend": -0.1}, abs=1e-14)
    locked = scene_from_robot(urdf, Options(lock={"extend": 0.1}))
    assert [joint.name for joint in locked.joints] == ["shoulder"]
    assert "locked: joint extend at 0.1" in locked.notes
    for options, message in (
        (Options(lock={"extend": 0.1}, start={"extend": 0.2}), "is 0.2, but it is locked at 0.1"),
        (Options(only=["upper"], start={"extend": 0.2}), '"extend" is cut'),
    ):
        with pytest.raises(SceneError, match=message):
            scene_from_robot(urdf, options)


def rates(scene):
    """{joint: velocity} at the start."""
    found = Simulation(scene, "rkmk4", 1e-3).sample().joint_coordinates
    return {name: velocity for name, (_, velocity) in found.items()}


def test_start_velocities_of_trees(tmp_path):
    """Velocities of the joints that are not named are 0; locked joints have none."""
    urdf = arm_in(tmp_path, "urdf")
    options = Options(start={"shoulder": 0.3}, start_velocity={"extend": -0.4})
    scene = scene_from_robot(urdf, options)
    assert rates(scene) == pytest.approx({"shoulder": 0.0, "extend": -0.4}, abs=1e-14)
    assert scene_from_text(scene.text).model_dump() == scene.model_dump()
    with pytest.raises(SceneError, match='joint "extend" does not move: unlock it'):
        scene_from_robot(urdf, Options(lock={"extend": 0.1}, start_velocity={"extend": 1.0}))
    with pytest.raises(SceneError, match="start_velocity: joint 'elbow' is not in the robot"):
        scene_from_robot(urdf, Options(start_velocity={"elbow": 1.0}))


def test_a_keyframe_is_mujocos_state(tmp_path):
    """Also ball and free joints."""
    mujoco = pytest.importorskip("mujoco")
    values = "0.5 -0.4 0.9  0.3 -0.2 0.8  1.1 -0.7  0.4 0.5 -0.6 0.7 -0.8 0.9"
    key = f'qvel="{values}" qpos="0.1 0.2 0.3  0.8 0 -0.48 0.36  0.4 0.5  1 2 1 0.6 0.64 0 0.48"'
    text = MJCF_WITH_ALL_JOINTS.replace('qpos="0.1 0.2 0.3  1 0 0 0  0.4 0.5  1 0 1 1 0 0 0"', key)
    assert key in text
    path = written(tmp_path / "all.xml", text)
    scene = scene_from_robot(path, Options(pose="home"))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    for body in scene.bodies:
        name = scene.robot.links[body.name]
        if name in ("cart", "arm", "hand", "ball_free"):
            expected = np.zeros(6)
            number = model.body(name).id
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, number, expected, 1)
            assert body.twist == pytest.approx(expected, abs=1e-14)
            assert body.pose[:3, 3] == pytest.approx(data.xpos[number], abs=1e-14)
            assert body.pose[:3, :3].ravel() == pytest.approx(data.xmat[number], abs=1e-14)


TURN = [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]  # x, y, z, w


def test_starts_of_floating_links_and_of_joints_with_several_coordinates(tmp_path):
    """In a file beside the robot, and with the option --start; keys that are not given stay."""
    (tmp_path / "all.xml").write_text(MJCF_WITH_ALL_JOINTS)
    beside = written(
        tmp_path / "placed.yaml",
        f"robot: all.xml\nstart:\n  ball_free: {{quaternion: {TURN}, linear_velocity: [1, 0, 0]}}\n"
        "  ball: {rotation_vector: [0, 0, 0.3], angular_velocity: [0, 0, 2]}\n  x: 0.5\n",
    )
    scene = load_scene(beside)
    bodies = {body.name: body for body in scene.bodies}
    free = bodies["ball_free"]
    assert free.position == (1.0, 0.0, 1.0) and free.quaternion == pytest.approx(TURN, abs=1e-15)
    assert free.twist.tolist() == [0, 0, 0, 1, 0, 0]
    # The ball is 0.1 m above the origin of the arm, and its axes are those of the cart.
    arm = bodies["arm"]
    assert arm.position == pytest.approx((0.7, 0, 0.1), abs=1e-15)
    assert arm.pose[:2, 0] == pytest.approx((np.cos(0.3), np.sin(0.3)), abs=1e-15)
    assert arm.twist == pytest.approx([0, 0, 2, 0, 0, 0], abs=1e-15)
    urdf = arm_in(tmp_path, "urdf")
    start = Start(position=[0, 0, 2], angular_velocity=[0, 0, 1])
    upper = scene_from_robot(urdf, Options(base="floating", start={"base": start, "shoulder": 0.3})).bodies
    fixed = scene_from_robot(urdf, Options(start={"shoulder": 0.3})).bodies
    for body, other in zip(upper, fixed):
        assert body.pose[:3, :3] == pytest.approx(other.pose[:3, :3], abs=1e-15)
        assert np.subtract(body.position, other.position) == pytest.approx([0, 0, 2], abs=1e-15)
        omega = other.pose[:3, :3].T @ [0, 0, 1]
        v = other.pose[:3, :3].T @ np.cross([0, 0, 1], other.position)
        assert body.twist == pytest.approx([*omega, *v], abs=1e-15)


PLANAR_URDF = text_of("planar.urdf")
UNIVERSAL_SDF = text_of("universal.sdf")


@pytest.mark.parametrize("text, case", [(PLANAR_URDF, "planar"), (UNIVERSAL_SDF, "universal")])
def test_starts_satisfy_the_type_of_their_joint(text, case, tmp_path):
    """A scene that loads satisfies its joints at the start, poses and velocities."""
    good, *bad = cases("starts_satisfy_the_type_of_their_joint")[case]
    path = written(tmp_path / ("r.urdf" if "robot" in text else "r.sdf"), text)
    still = scene_from_robot(path).bodies[0]
    start = Start(**good)
    body = scene_from_robot(path, Options(start={"j": start})).bodies[0]
    assert np.linalg.norm(body.twist) > 2.0
    turn = still.pose[:3, :3].T @ body.pose[:3, :3]
    assert np.trace(turn) == pytest.approx(np.trace(start.rotation), abs=1e-14)
    for wrong in bad:
        with pytest.raises(SceneError, match='joint "j" is (planar|universal) and does not allow this'):
            scene_from_robot(path, Options(start={"j": Start(**wrong)}))


@pytest.mark.parametrize(
    "options, bodies, coordinates",
    [(Options(), 2, 2), (Options(lock={"extend": 0.1}), 1, 1), (Options(only=["upper"]), 1, 1)],
)
def test_describe_says_what_an_import_saved(options, bodies, coordinates, tmp_path):
    """The arm has 5 links and joints of 1 + 1 + 0 + 1 coordinates; the last one holds no mass."""
    urdf = arm_in(tmp_path, "urdf")
    facts = describe(make_layout(scene_from_robot(urdf, options)))
    saved = facts["import"]
    assert (saved["links"], saved["bodies"]) == (5, bodies)
    assert (saved["file_coordinates"], saved["coordinates"]) == (3, coordinates)


@pytest.mark.parametrize(
    "text, options, file, scene",
    [
        # Six legs of 2 + 1 coordinates and a plate on the ball of one of them.
        (stewart_sdf(), Options(), 21, 21),
        # The base and the tip have no mass: their joints are held.
        (ARM_URDF, Options(base="floating"), 9, 7),
        (five_bar_urdf(), Options(joints=[FIVE_BAR_TIP]), 4, 4),
        (five_bar_urdf().replace("continuous", "floating", 1), Options(joints=[FIVE_BAR_TIP]), 9, 4),
    ],
)
@pytest.mark.turn(3)
def test_joint_coordinates_count_what_floats(text, options, file, scene, tmp_path):
    path = written(tmp_path / f"robot.{'sdf' if text.startswith('<sdf') else 'urdf'}", text)
    saved = describe(make_layout(scene_from_robot(path, options)))["import"]
    assert (saved["file_coordinates"], saved["coordinates"]) == (file, scene)


CLOSED_FIVE_BAR = text_of("closed_five_bar.yaml")


def test_start_velocities_of_a_loop(tmp_path):
    """A five-bar has two degrees of freedom: two velocities determine the others."""
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path = tmp_path / "closed.yaml"
    given = {"left_crank": 2.0, "right_crank": -1.0}
    path.write_text(CLOSED_FIVE_BAR.format(velocities=str(given).replace("'", "")))
    scene = load_scene(path)
    found = rates(scene)
    assert {name: found[name] for name in given} == pytest.approx(given, abs=1e-12)
    # The tip is at distances of 1.2 m from both elbows: d . (v_tip - v_elbow) = 0.
    poses = {body.name: body.pose for body in scene.bodies}
    tip = (poses["left_bar"] @ (1.2, 0, 0, 1))[:3]
    elbows = [(poses[name] @ (1, 0, 0, 1))[:3] for name in ("left", "right")]
    feet = (np.zeros(3), np.array([1.0, 0.0, 0.0]))
    speeds = [np.cross((0, 0, rate), elbow - foot) for rate, elbow, foot in zip(given.values(), elbows, feet)]
    arms = np.array([tip - elbow for elbow in elbows])[:, :2]
    velocity = np.linalg.solve(arms, [arm @ speed[:2] for arm, speed in zip(arms, speeds)])
    for name in ("left_bar", "right_bar"):
        w, v = np.split(next(body.twist for body in scene.bodies if body.name == name), 2)
        assert poses[name][:2, :3] @ (v + np.cross(w, (1.2, 0, 0))) == pytest.approx(velocity, abs=1e-12)
    given |= {"left_elbow": 0.0}
    path.write_text(CLOSED_FIVE_BAR.format(velocities=str(given).replace("'", "")))
    with pytest.raises(SceneError, match="contradict each other"):
        load_scene(path)


def test_bases_and_chains(tmp_path):
    urdf = arm_in(tmp_path, "urdf")
    floating = scene_from_robot(urdf, Options(base="floating", lock={"shoulder": 0, "extend": 0}))
    assert [body.name for body in floating.bodies] == ["upper"] and not floating.joints
    assert floating.bodies[0].mass == pytest.approx(4.1, rel=1e-15)
    only = scene_from_robot(urdf, Options(only=["upper"]))
    assert [body.name for body in only.bodies] == ["upper"]
    assert any(note.startswith("changes the motion: cut slide, tool, tip, 1.6 kg") for note in only.notes)


def test_a_yaml_file_closes_a_loop_and_adds_a_spring(tmp_path):
    (tmp_path / "five_bar.urdf").write_text(five_bar_urdf())
    path = written(tmp_path / "closed.yaml", text_of("five_bar_with_forces.yaml"))
    scene = load_scene(path)
    simulation = Simulation(scene, "rkmk4", 1e-3)
    ends = simulation.sample().poses
    tips = [ends[f"{side}_bar"] @ (1.2, 0, 0, 1) for side in ("left", "right")]
    assert np.allclose(*tips, atol=1e-12)
    start = simulation.energy()
    assert simulation.layout.model.row_residual.size == 6 * 4 - 2  # two degrees of freedom
    pull = next(force for force in scene.forces if force.name == "pull")
    assert pull.body == "left_bar" and pull.point == pytest.approx((1.2, 0, 0))
    simulation.advance(200)
    assert np.isfinite(start) and simulation.sample().constraint_residual < 1e-6


def test_laws_beside_a_robot_name_its_links_and_joints(tmp_path):
    """A force at the tool, which is merged into the slide, against the same applied wrench; a point of the tool."""
    arm_in(tmp_path, "urdf")
    path = tmp_path / "laws.yaml"
    law = (
        "robot: arm.urdf\nforces:\n  - name: own\n    type: law\n"
        "    inputs: {{z: {{quantity: {z}, point: [0.1, 0, 0.2]}}, q: {q}}}\n    signals: {{high: z, far: q}}\n"
        "    outputs: [{{body: tool, force: [1, 2*q/q, 3], point: [0.3, 0.1, 0], axes: {axes}}}]\n"
    )
    found = []
    for text in (
        law.format(z="tool.z", q="extend.position", axes="world"),
        "robot: arm.urdf\nforces:\n"
        "  - {name: push, type: applied_wrench, body: tool, force: [1, 2, 3], point: [0.3, 0.1, 0], axes: world}\n",
    ):
        path.write_text(text + "start: {extend: 0.2}\n")
        simulation = Simulation(load_scene(path), "rkmk8", 1e-3)
        simulation.advance(100)
        found.append(simulation.sample())
    sample, pushed = found
    for body, pose in sample.poses.items():
        assert pose == pytest.approx(pushed.poses[body], abs=1e-12)
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = rotation(0, 0.7, 0), (0, 0.1, 0)
    tool = sample.poses["slide"] @ flange
    assert sample.signals["own.high"] == pytest.approx((tool @ (0.1, 0, 0.2, 1))[2], abs=1e-12)
    assert sample.signals["own.far"] == sample.joint_coordinates["extend"][0]
    for keys, line, expected in (
        ({"z": "tool.vz"}, 5, "inputs.z: link tool is part of slide, which has other axes: take slide"),
        ({"z": "base.z"}, 5, "inputs.z: link base does not move"),
        ({"q": "flange.position"}, 5, 'joint "flange" is fixed or locked'),
        ({"q": "extent.velocity"}, 5, "'extent' is not in the robot; did you mean \"extend\""),
        ({"axes": "body"}, 7, "body tool is part of slide, which has other axes"),
    ):
        path.write_text(law.format(**{"z": "tool.z", "q": "extend.position", "axes": "world"} | keys))
        with pytest.raises(SceneError) as caught:
            load_scene(path)
        message = str(caught.value)
        assert message.startswith(f"{path}:{line}: ") and expected in message, message


def test_a_stewart_platform_from_sdf(tmp_path):
    scene = load_scene(written(tmp_path / "stewart.sdf", stewart_sdf()))
    simulation = Simulation(scene, "rkmk4", 1e-3)
    assert len(scene.bodies) == 13 and len(scene.forces) == 6 and freedoms(simulation) == 6
    start = simulation.energy()
    simulation.advance(200)
    assert simulation.energy() < start  # its dampers dissipate
    assert simulation.sample().constraint_residual < 1e-7
    # The legs meet the corners of the plate.
    sample = simulation.sample()
    plate = sample.poses["plate"]
    for k, joint in enumerate(each for each in scene.joints if each.name.startswith("head")):
        corner = plate @ joint.parent_frame.pose[:, 3]
        tip = sample.poses[f"upper{k}"] @ joint.child_frame.pose[:, 3]
        assert np.allclose(corner, tip, atol=1e-7)


def test_a_scissor_lift_from_urdf_and_closing_joints(tmp_path):
    text, closing = scissor_lift(3)
    (tmp_path / "lift.urdf").write_text(text)
    (tmp_path / "lift.yaml").write_text(closing)
    simulation = Simulation(load_scene(tmp_path / "lift.yaml"), "rkmk4", 1e-3)
    assert freedoms(simulation) == 1 and simulation.layout.normal is not None
    start = simulation.energy()
    simulation.advance(100)
    assert simulation.energy() == pytest.approx(start, rel=1e-9)
    poses = simulation.sample().poses
    # All stages have the same angle.
    angles = [np.arctan2(poses[f"left{k}"][1, 0], poses[f"left{k}"][0, 0]) for k in range(3)]
    assert angles == pytest.approx([angles[0]] * 3, abs=1e-8) and angles[0] < 0.5


def test_a_joint_of_a_loop_that_starts_at_its_stop_stays_there():
    """The lift of the docs has rounded numbers: assembly moves the other joints by micrometres."""
    scene = load_scene(Path(__file__).parents[2] / "docs" / "robots" / "scissor_lift.yaml")
    slide = next(joint for joint in scene.joints if joint.name == "slide")
    assert slide.limits.lower == 0.0
    moved = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample().joint_coordinates
    assert abs(moved["slide"][0]) < 1e-12 and 1e-7 < abs(moved["cross0"][0]) < 1e-5


EQUALITY_MJCF = text_of("equality_mjcf.xml")


def test_mimic_joints_are_couplings(tmp_path):
    """A chain of them, from start values of either end, beyond a turn, and locked."""
    path = mimic_urdf(tmp_path)
    scene = load_scene(path)
    assert [(c.joint, c.other, c.ratio, c.offset) for c in scene.couplings] == [
        ("near", "drive", -1.3, 0.2),
        ("far", "near", 0.05, 0.0),
    ]
    assert coordinates(scene) == pytest.approx({"drive": 0, "near": 0.2, "far": 0.01}, abs=1e-14)
    assert not any("mimic" in note or "coupl" in note for note in scene.notes)
    given = coordinates(scene_from_robot(path, Options(start={"far": 0.02})))
    assert given == pytest.approx({"drive": -0.2 / 1.3, "near": 0.4, "far": 0.02}, abs=1e-14)
    # 4 rad of a pose are -2.28 rad: the turn is in the offset of the scene.
    turned = scene_from_robot(path, Options(start={"drive": 4.0}))
    simulation = Simulation(turned, "rkmk4", 1e-3)
    simulation.advance(10)
    far = simulation.sample().joint_coordinates["far"][0]
    near = simulation.sample().joint_coordinates["near"][0]
    wound = 2 * np.pi * round((-5.0 - near) / (2 * np.pi))
    assert far == pytest.approx(0.05 * (near + wound), abs=1e-13)
    # The limits of a follower are those of its leader: far = 0.05 (-1.3 drive + 0.2), and no note denies it.
    limits = {joint.name: joint.limits for joint in load_scene(path).joints}
    assert limits["drive"].upper == pytest.approx((1 / 0.05 + 0.2) / 1.3) and limits["far"] is None
    assert not any("limits are not enforced" in note for note in load_scene(path).notes)
    locked = scene_from_robot(path, Options(lock={"near": 0.5}, base="floating"))
    assert not locked.joints and not locked.couplings


@pytest.mark.parametrize("curve", ["0 0 0", "0.2 0 0", "0.2 -0.05 0.03"])
@pytest.mark.turn(3)
def test_coupled_joints_have_mujocos_accelerations(curve, tmp_path):
    """MuJoCo without its soft equality, with exact rows of the couplings; the start satisfies its own equality."""
    mujoco = pytest.importorskip("mujoco")
    path = written(tmp_path / "geared.xml", EQUALITY_MJCF.replace("0.1 -0.3 0 0 0", f"0.1 -0.3 {curve}"))
    scene = load_scene(path)
    assert len(scene.couplings) == 2
    assert peers().against_mujoco(path, scene, 20) < 1e-12
    moved = scene_from_robot(path, Options(start={"wheel": 0.9}, start_velocity={"turn": -0.7}))
    found = Simulation(moved, "rkmk4", 1e-3, quiet=True).sample().joint_coordinates
    assert found["wheel"][0] == pytest.approx(0.9, abs=1e-12)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + [found[name][0] for name in ("turn", "slip", "wheel")]
    data.qvel[:] = [found[name][1] for name in ("turn", "slip", "wheel")]
    mujoco.mj_forward(model, data)
    assert data.nefc == 2
    assert np.abs(data.efc_pos).max() < 1e-14 and np.abs(data.efc_vel).max() < 1e-14


def test_couplings_beside_a_robot(tmp_path):
    """By names of the robot's joints; without an offset the start values define it."""
    path = arm_in(tmp_path, "urdf")
    beside = written(
        tmp_path / "geared.yaml",
        f"robot: {path.name}\nstart: {{shoulder: 0.3, extend: 0.1}}\n"
        "couplings:\n  - {name: rack, joint: extend, other: shoulder, ratio: 0.5, backlash: {gap: 0.01}}\n",
    )
    scene = load_scene(beside)
    assert scene.couplings[0].backlash.gap == 0.01
    beside.write_text(beside.read_text().replace(", backlash: {gap: 0.01}", ""))
    scene = load_scene(beside)
    assert scene.couplings[0].offset == pytest.approx(0.1 - 0.5 * 0.3, abs=1e-15)
    assert coordinates(scene) == pytest.approx({"shoulder": 0.3, "extend": 0.1}, abs=1e-14)
    for wrong, message in (
        ("joint: extent, other", r"geared.yaml:4: couplings\[0\]: joint 'extent' is not in the robot"),
        ("name: 1a, joint: extend, other", "geared.yaml:4: .*name"),
    ):
        beside.write_text(
            f"robot: {path.name}\n\ncouplings:\n  - {{name: rack, {wrong}: shoulder, ratio: 0.5}}\n".replace(
                "name: rack, name", "name"
            )
        )
        with pytest.raises(SceneError, match=message):
            load_scene(beside)


def test_an_imported_coupling_is_written_with_its_line(tmp_path):
    path = mimic_urdf(tmp_path)
    assert "couplings:\n  - name: near_mimic  # line" in load_scene(path).text
    again = scene_from_text(load_scene(path).text)
    assert again.couplings == load_scene(path).couplings


def test_joints_of_a_robot_are_driven(tmp_path):
    """With a motion, or at the start velocity; the keys are those of a scene, errors name the file."""
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    beside = tmp_path / "beside.yaml"
    text = "robot: arm.urdf\nstart: {shoulder: 0.3}\nstart_velocity: {extend: 0.2}\n"
    beside.write_text(text + "driven:\n  extend:\n  shoulder: {times: [0, 1], positions: [0.3, -0.4]}\n")
    scene = load_scene(beside)
    joints = {joint.name: joint for joint in scene.joints}
    assert joints["extend"].driven and joints["extend"].motion is None
    assert joints["shoulder"].motion.positions == (0.3, -0.4)
    for wrong, words in (
        ("driven: {extend: {times: [0, 1], positions: [0.7, 1]}}", "starts at 0.7 m"),
        ("driven: {knee: }", "knee"),
        ("driven: {extend: {times: [0]}}", "positions"),
        ("driven: [extend]", "mapping"),
    ):
        beside.write_text(text + wrong)
        with pytest.raises(SceneError, match=words) as error:
            Simulation(load_scene(beside))
        assert "beside.yaml:4" in str(error.value)


def placed_links(scene):
    """{link: (4, 4) pose at the start}, {link: (6,) twist of its body}."""
    poses, twists = {}, {}
    bodies = {body.name: body for body in scene.bodies}
    for link, (name, frame) in scene._robot.frames.items():
        body = bodies[name]
        poses[link] = body.pose @ frame
        twists[link] = np.concatenate([body.angular_velocity, body.linear_velocity])
    return poses, twists


LINKS = {
    name: f'<link name="{name}"><inertial><origin xyz=".5 0 0"/><mass value="2"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    for name in "abc"
}
CHAIN = """<joint name="j" type="continuous"><parent link="a"/><child link="b"/>
<origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint>
<joint name="k" type="continuous"><parent link="b"/><child link="c"/>
<origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint>"""


@pytest.mark.parametrize("order", ["abc", "bac", "cba"])
@pytest.mark.parametrize("lock", [{}, {"k": 0.3}, {"j": 0.4}])
def test_the_root_link_of_a_floating_robot_stays_whatever_the_order(order, lock, tmp_path):
    path = written(tmp_path / "chain.urdf", f'<robot name="r">{"".join(LINKS[name] for name in order)}{CHAIN}</robot>')
    start = {name: value for name, value in {"j": 0.4, "k": 0.3}.items() if name not in lock}
    options = Options(base="floating", start=start, start_velocity=dict.fromkeys(start, 2.0), lock=lock)
    poses, twists = placed_links(scene_from_robot(path, options))
    assert np.allclose(poses["a"], np.eye(4), atol=1e-15) and not twists["a"].any()
    up = rotation(0, 0.4, 0) @ [0, 0, 1]
    assert np.allclose(poses["c"][:3, 3], [0, 0, 1] + up, atol=1e-15)
    assert np.allclose(poses["c"][:3, :3], rotation(0, 0.7, 0), atol=1e-15)


@pytest.mark.parametrize(("canonical", "still"), [("", "b"), ('canonical_link="a"', "a")])
def test_the_canonical_link_of_a_floating_model_stays(canonical, still, tmp_path):
    path = written(tmp_path / "two.sdf", filled(text_of("canonical_link.sdf"), canonical=canonical))
    options = Options(start={"j": 0.5}, start_velocity={"j": 1.0})
    poses, twists = placed_links(scene_from_robot(path, options))
    expected = {"a": [1, 0, 0], "b": [0, 0, 1]}[still]
    assert np.allclose(poses[still][:3, 3], expected, atol=1e-15)
    assert np.allclose(poses[still][:3, :3], np.eye(3), atol=1e-15) and not twists[still].any()


def test_a_root_link_called_world_does_not_float(tmp_path):
    path = tmp_path / "held.urdf"
    links = "".join(LINKS.values())
    anchor = '<joint name="h" type="continuous"><parent link="world"/><child link="a"/></joint>'
    path.write_text(f'<robot name="r"><link name="world"/>{links}{anchor}{CHAIN}</robot>')
    notes = [note for note in scene_from_robot(path, Options(base="floating")).notes if "base" in note]
    assert len(notes) == 1 and "the root link is called world" in notes[0]
    assert not any("base" in note for note in load_scene(path).notes)


@pytest.mark.turn(3)
def test_a_keyframe_that_violates_couplings_yields_to_them(tmp_path):
    """Numbers of a keyframe are rounded, or come from MuJoCo's soft constraints; start values are kept."""
    path = tmp_path / "geared.xml"
    key = '<keyframe><key name="k" qpos="0.2 0.03 0.5" qvel="1 2 3"/></keyframe></mujoco>'
    path.write_text(EQUALITY_MJCF.replace("</mujoco>", key))
    ref = np.radians(10)
    for start, turn in (({}, 0.2 - ref), ({"turn": 0.4}, 0.4), ({"wheel": 0.8}, (0.1 - 0.2) / 0.3)):
        scene = scene_from_robot(path, Options(pose="k", start=start))
        slip = 0.1 - 0.3 * turn
        expected = {"turn": turn, "slip": slip, "wheel": 4 * slip}
        assert coordinates(scene) == pytest.approx(expected, abs=1e-14)
        assert rates(scene) == pytest.approx({"turn": 1.0, "slip": -0.3, "wheel": -1.2}, abs=1e-14)
        note = 'coordinates that a coupling moves in the pose "k": '
        assert any(each.startswith(note) and "slip" in each for each in scene.notes)


def test_assembly_keeps_the_start_of_a_floating_link(tmp_path):
    """A rod of 1 m from the world to the thigh closes a loop: only the hip moves."""
    (tmp_path / "leg.xml").write_text(
        """<mujoco><worldbody><body name="trunk" pos="0 0 0.4"><freejoint/><geom size="0.1"/>
        <body name="thigh" pos="0.2 0 0"><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.1"/></body></body>
        </worldbody><keyframe><key name="k" qpos="0 0 1 1 0 0 0 0.5" qvel="1 0 0 0 0 0 2"/></keyframe></mujoco>"""
    )
    beside = written(
        tmp_path / "held.yaml",
        "robot: leg.xml\npose: k\nstart: {trunk: {position: [0, 0, 1.1], linear_velocity: [0, 0, 0]}}\njoints:\n"
        "  - {name: rod, type: distance, parent: world, child: thigh, parent_frame: {},\n"
        "     child_frame: {position: [0, 0, -0.3]}, length: 1.0}\n",
    )
    trunk, thigh = load_scene(beside).bodies
    assert trunk.position == (0.0, 0.0, 1.1) and not trunk.twist.any()
    tip = thigh.pose @ [0, 0, -0.3, 1]
    assert np.linalg.norm(tip[:3]) == pytest.approx(1.0, abs=1e-12) and thigh.twist == pytest.approx(0.0, abs=1e-12)
