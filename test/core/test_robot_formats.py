# SPDX-License-Identifier: Apache-2.0
"""What each format of robots has of its own: nested models, frames, loops, gears, addresses."""

import numpy as np
import pytest
from robot_texts import ARM_SDF, ARM_URDF, bar
from scipy.integrate import solve_ivp

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.robots.options import Options
from liegroup_core.robots.read import read_robot
from liegroup_core.scene.load import scene_from_robot

INERTIAL = "<inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.2</iyy><izz>0.25</izz></inertia></inertial>"


def freedoms(simulation):
    """Degrees of freedom at the start."""
    return 6 * len(simulation.scene.bodies) - simulation.layout.model.row_residual.size


def sdf(folder, text, version="1.9"):
    """Path of an SDF file."""
    path = folder / "model.sdf"
    path.write_text(f'<sdf version="{version}">{text}</sdf>')
    return path


def test_frames_of_nested_models(tmp_path):
    """Pose by pose: the model is at z = 1, the nested one at x = 2 turned by 90 degrees about z."""
    text = f"""<world name="w"><gravity>0 0 -3.7</gravity><light name="sun"/>
      <model name="outer"><pose>0 0 1 0 0 0</pose>
        <link name="base">{INERTIAL}</link>
        <frame name="mount" attached_to="inner::tip"><pose>0 0.5 0 0 0 0</pose></frame>
        <model name="inner"><pose degrees="true">2 0 0 0 0 90</pose>
          <link name="tip"><pose rotation_format="quat_xyzw">1 0 0  0 0 0 1</pose>{INERTIAL}</link>
        </model>
        <link name="flag"><pose relative_to="mount"/>{INERTIAL}</link>
        <joint name="j" type="revolute"><parent>base</parent><child>mount</child>
          <axis><xyz expressed_in="__model__">0 1 0</xyz></axis></joint>
        <joint name="f" type="fixed"><parent>inner::tip</parent><child>flag</child></joint>
      </model></world>"""
    scene = load_scene(sdf(tmp_path, text))
    assert scene.gravity == (0.0, 0.0, -3.7)
    poses = {body.name: body.pose for body in scene.bodies}
    assert set(poses) == {"base", "inner__tip"}
    assert poses["inner__tip"][:3, 3] == pytest.approx((2, 1, 1), abs=1e-15)
    flag = poses["inner__tip"] @ (0, 0.5, 0, 1)  # y of the nested model is -x of the outer one
    assert flag[:3] == pytest.approx((1.5, 1, 1), abs=1e-15)
    joint = next(joint for joint in scene.joints if joint.name == "j")
    at = poses["inner__tip"] @ joint.child_frame.pose
    assert at[:3, 3] == pytest.approx((1.5, 1, 1), abs=1e-15)
    assert at[:3, 2] == pytest.approx((0, 1, 0), abs=1e-15)
    assert "merged into inner__tip: flag" in scene.notes
    assert any("light of the world (sun)" in note for note in scene.notes)


@pytest.mark.parametrize(
    "version, flag, axis",
    [("1.4", "", (0, 1, 0)), ("1.6", "", (-1, 0, 0)), ("1.6", "1", (0, 1, 0)), ("1.7", "", (-1, 0, 0))],
)
def test_axes_of_older_files(version, flag, axis, tmp_path):
    """The joint is turned by 90 degrees about z: its y axis is -x of the model."""
    flag = f"<use_parent_model_frame>{flag}</use_parent_model_frame>" if flag else ""
    text = f"""<model name="m"><link name="a"><pose>0 0 0 0 0 1.5707963267948966</pose>{INERTIAL}</link>
      <joint name="j" type="revolute"><parent>world</parent><child>a</child>
      <axis><xyz>0 1 0</xyz>{flag}</axis></joint></model>"""
    scene = load_scene(sdf(tmp_path, text, version))
    assert scene.joints[0].parent_frame.pose[:3, 2] == pytest.approx(axis, abs=1e-15)


def test_screws_gears_and_static_models(tmp_path):
    text = f"""<model name="m"><link name="case">{INERTIAL}</link><link name="nut">{INERTIAL}</link>
      <link name="in">{INERTIAL}</link><link name="out">{INERTIAL}</link>
      <joint name="hold" type="fixed"><parent>world</parent><child>case</child></joint>
      <joint name="thread" type="screw"><parent>case</parent><child>nut</child>
        <axis><xyz>0 0 1</xyz></axis><screw_thread_pitch>0.005</screw_thread_pitch></joint>
      <joint name="shaft" type="revolute"><parent>case</parent><child>in</child></joint>
      <joint name="wheel" type="continuous"><parent>out</parent><child>case</child></joint>
      <joint name="gear" type="gearbox"><parent>in</parent><child>out</child>
        <gearbox_reference_body>case</gearbox_reference_body><gearbox_ratio>4</gearbox_ratio></joint>
      </model>"""
    path = sdf(tmp_path, text)
    scene = load_scene(path)
    screw = next(joint for joint in scene.joints if joint.type == "screw")
    assert screw.pitch == pytest.approx(0.005 / (2 * np.pi), rel=1e-15)
    # The reference body is the child of the second joint: its coordinate has the other sign.
    (gear,) = read_robot(path).couplings
    assert (gear.first, gear.second, gear.ratio) == ("wheel", "shaft", 4.0)
    (coupling,) = scene.couplings
    assert (coupling.joint, coupling.other, coupling.ratio) == ("wheel", "shaft", 4.0)
    # The gear's own axes decide the sign.
    reverse = "<axis><xyz>0 0 -1</xyz></axis></joint></model>"
    turned = text.replace("</gearbox_ratio></joint>", "</gearbox_ratio>" + reverse[:-8])
    assert load_scene(sdf(tmp_path, turned)).couplings[0].ratio == -4.0
    sdf(tmp_path, text)
    # The child of a joint of a scene moves: the ends are exchanged, the coordinate stays.
    locked = scene_from_robot(path, Options(start={"wheel": 0.3}))
    wheel = next(joint for joint in locked.joints if joint.name == "wheel")
    assert (wheel.parent, wheel.child) == ("world", "out")
    found = Simulation(locked, "rkmk4", 1e-3).sample().joint_coordinates
    assert found["wheel"][0] == pytest.approx(0.3, abs=1e-14)
    # A locked shaft holds the wheel that its gear drives.
    held = scene_from_robot(path, Options(lock={"shaft": 0.1}))
    assert [joint.name for joint in held.joints] == ["thread"]
    assert "locked: joint wheel at 0.4, because a locked joint drives it" in held.notes
    static = f'<model name="rock"><static>true</static><link name="r">{INERTIAL}</link></model>'
    both = f'<world name="w">{text}{static}</world>'
    assert "fixed to the world: m::case, rock::r" in load_scene(sdf(tmp_path, both)).notes


def test_included_models_are_local_files(tmp_path, monkeypatch):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "model.sdf").write_text(ARM_SDF)
    world = "<world name='w'><include><uri>model://arm</uri><name>second</name></include></world>"
    path = sdf(tmp_path, world)
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path))
    scene = load_scene(path)
    assert [body.name for body in scene.bodies] == ["upper", "slide"]
    assert [body.name for body in load_scene("model://arm").bodies] == ["upper", "slide"]


def test_package_addresses(tmp_path, monkeypatch):
    share = tmp_path / "share" / "my_robot"
    share.mkdir(parents=True)
    (share / "arm.urdf").write_text(ARM_URDF)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert load_scene("package://my_robot/arm.urdf").bodies[0].name == "upper"


FOUR_BAR = """<mujoco><option gravity="0 -9.81 0"/><worldbody>
  <body name="crank"><joint name="a" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0 1 0" size="0.02" mass="1"/>
    <body name="coupler" pos="0 1 0"><joint name="b" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 1 0 0" size="0.02" mass="1"/></body></body>
  <body name="rocker" pos="1 0 0"><joint name="c" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0 1 0" size="0.02" mass="1"/></body>
  <body name="weight" pos="0 1.2 0"><freejoint/><geom type="sphere" size="0.1" mass="0.5"/></body>
  </worldbody>
  <equality>
    <connect name="pin" body1="rocker" body2="coupler" anchor="0 1 0"/>
    <weld name="glue" body1="crank" body2="weight"/>
    {more}
  </equality></mujoco>"""


def test_loops_and_welds_of_mjcf(tmp_path):
    path = tmp_path / "four_bar.xml"
    path.write_text(FOUR_BAR.format(more=""))
    simulation = Simulation(load_scene(path), "rkmk4", 1e-3)
    assert freedoms(simulation) == 1
    start = simulation.energy()
    simulation.advance(300)
    assert simulation.energy() == pytest.approx(start, rel=1e-9)
    poses = simulation.sample().poses
    weight = np.linalg.inv(poses["crank"]) @ poses["weight"]
    assert weight[:3, 3] == pytest.approx((0, 1.2, 0), abs=1e-9)
    assert poses["coupler"] @ (1, 0, 0, 1) == pytest.approx(poses["rocker"] @ (0, 1, 0, 1), abs=1e-9)
    # A joint equality without a second joint holds the first one.
    path.write_text(FOUR_BAR.format(more='<joint joint1="a" polycoef="0 0 0 0 0"/>'))
    assert "locked: joint a at 0" in load_scene(path).notes


SRDF = """<robot name="arm"><group name="all"/><group_state name="ready" group="all">
  <joint name="shoulder" value="0.4"/><joint name="extend" value="-0.2"/></group_state></robot>"""


TRAMMEL = """<mujoco><option gravity="0 0 -9.81"/><worldbody><site name="foot" pos="2 0 0"/>
  <body name="across"><joint name="x" type="slide" axis="1 0 0"/>
    <geom type="box" size="0.1 0.1 0.1" mass="1.5"/><site name="a" pos="0.1 0 0.1"/></body>
  <body name="up" pos="0 0 1"><joint name="z" type="slide" axis="0 0 1"/>
    <geom type="box" size="0.1 0.1 0.1" mass="1.5"/><site name="b" pos="0.1 0 0.1"/></body>
  </worldbody>
  <tendon>
    <spatial name="rope" stiffness="7"><site site="a"/><site site="b"/></spatial>
    <spatial name="bent"><site site="a"/><site site="b"/><site site="foot"/></spatial>
  </tendon>
  <equality><tendon name="rod" tendon1="{tendon}" polycoef="{longer} 0 0 0 0"/></equality>
  <keyframe><key name="tilted" qpos="0.6 -0.2"/></keyframe></mujoco>"""


@pytest.mark.parametrize("longer", [0.0, 0.25])
def test_a_tendon_of_fixed_length_is_a_rod(longer, tmp_path):
    """Slides across and upwards with a rod of length L between them: a trammel.

    x = L cos(q), z = L sin(q). With equal masses the kinetic energy is m L^2 q'^2 / 2, so that
    q'' = -g / L cos(q), the equation of a pendulum.
    """
    path = tmp_path / "trammel.xml"
    path.write_text(TRAMMEL.format(tendon="rope", longer=longer))
    scene = scene_from_robot(path, Options(pose="tilted"))
    (rod,) = [joint for joint in scene.joints if joint.type == "distance"]
    assert rod.name == "rod" and rod.length == 1.0 + longer
    assert not any("rope" in note for note in scene.notes)
    assert "left out: 1 tendons (bent)" in scene.notes
    simulation = Simulation(scene, "rkmk8", 2e-3, stabilisation="projection")

    def angle():
        across, up = (simulation.sample().positions[name] for name in ("across", "up"))
        return np.arctan2(up[2], across[0]), np.hypot(up[2], across[0])

    start, length = angle()
    assert length == pytest.approx(rod.length, rel=1e-12)
    simulation.advance(250)
    exact = solve_ivp(
        lambda t, y: (y[1], -9.81 / rod.length * np.cos(y[0])),
        (0.0, 0.5),
        (start, 0.0),
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    # The reference keeps 1e-11. A step is 0.006 of the unit of time sqrt(L / g): 0.006^8 is 2e-18.
    assert angle()[0] == pytest.approx(exact.y[0, -1], abs=1e-10)


def test_a_bent_tendon_of_fixed_length_is_left_out(tmp_path):
    path = tmp_path / "bent.xml"
    path.write_text(TRAMMEL.format(tendon="bent", longer=0.0))
    scene = load_scene(path)
    assert [joint.type for joint in scene.joints] == ["prismatic", "prismatic"]
    assert "changes the motion: equality constraints of tendons, left out: rod" in scene.notes


def test_group_states_of_srdf(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    (tmp_path / "arm.srdf").write_text(SRDF)
    path = tmp_path / "ready.yaml"
    path.write_text("robot: arm.urdf\nsrdf: arm.srdf\npose: ready\nname: ready_arm\n")
    scene = load_scene(path)
    found = Simulation(scene, "rkmk4", 1e-3).sample().joint_coordinates
    assert found["shoulder"][0] == pytest.approx(0.4, abs=1e-14)
    assert found["extend"][0] == pytest.approx(-0.2, abs=1e-14) and scene.name == "ready_arm"


@pytest.mark.parametrize("virtual", [True, False])
def test_a_group_state_has_the_pose_of_a_floating_root_link(virtual, tmp_path):
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    (tmp_path / "two.urdf").write_text(
        f'<robot name="two"><link name="leg">{inertial}</link><link name="root">{inertial}</link>'
        '<joint name="hip" type="continuous"><parent link="root"/><child link="leg"/></joint></robot>'
    )
    held = '<virtual_joint name="top" type="floating" parent_frame="world" child_link="root"/>'
    (tmp_path / "two.srdf").write_text(
        f'<robot name="two">{held if virtual else ""}<group_state name="up" group="all">'
        '<joint name="top" value="1 2 3 0 0 0.6 0.8"/><joint name="hip" value="0.5"/>'
        "</group_state></robot>"
    )
    path = tmp_path / "up.yaml"
    path.write_text("robot: two.urdf\nsrdf: two.srdf\npose: up\nbase: floating\n")
    scene = load_scene(path)
    root = next(body for body in scene.bodies if body.name == "root")
    assert root.position == pytest.approx((1, 2, 3), abs=1e-15)
    assert root.quaternion == pytest.approx((0, 0, 0.6, 0.8), abs=1e-15)
    path.write_text("robot: two.urdf\nsrdf: two.srdf\npose: up\n")
    note = 'left out: pose of the root link in group state "up", because this link does not float'
    assert note in load_scene(path).notes


def test_names_that_are_no_names_of_a_scene(tmp_path):
    path = tmp_path / "odd.urdf"
    path.write_text(
        f'<robot name="my robot"><link name="base"/>{bar("left-arm", 1.0)}{bar("left_arm", 1.0)}'
        f"{bar('true', 1.0)}"
        + "".join(
            f'<joint name="{name}" type="continuous"><parent link="base"/><child link="{child}"/></joint>'
            for name, child in (("1", "left-arm"), ("j", "left_arm"), ("null", "true"))
        )
        + "</robot>"
    )
    scene = load_scene(path)
    assert scene.name == "my_robot"
    assert [body.name for body in scene.bodies] == ["left_arm_2", "left_arm", "true"]
    assert [joint.name for joint in scene.joints] == ["n1", "j", "null"]
    assert scene.robot.links["left_arm_2"] == "left-arm" and scene.robot.joints["n1"] == "1"
    assert "renamed bodies: left-arm is left_arm_2" in scene.notes


def world(models):
    """Text of a world with a frame 2 m above its origin, and models."""
    return f'<world name="w"><frame name="F"><pose>0 0 2 0 0 0</pose></frame>{models}</world>'


def model(name, pose):
    return f'<model name="{name}">{pose}<link name="a">{INERTIAL}</link></model>'


def test_models_of_a_world_have_poses_relative_to_each_other(tmp_path):
    text = model("n", '<pose relative_to="m">0 3 0 0 0 0</pose>')
    text += model("m", '<pose relative_to="F">1 0 0 0 0 0</pose>')
    scene = load_scene(sdf(tmp_path, world(text)))
    found = {body.name: body.position for body in scene.bodies}
    assert found == {"m__a": (1.0, 0.0, 2.0), "n__a": (1.0, 3.0, 2.0)}
    with pytest.raises(SceneError, match=r"\.sdf:\d+: frame 'nope' does not exist"):
        load_scene(sdf(tmp_path, world(text + model("o", '<pose relative_to="nope">0 0 0 0 0 0</pose>'))))
    # The links of the only model of a world have no prefix.
    scene = load_scene(sdf(tmp_path, world(model("m", '<pose relative_to="F">1 0 0 0 0 0</pose>'))))
    assert scene.bodies[0].name == "a" and scene.bodies[0].position == (1.0, 0.0, 2.0)


def test_joints_of_a_world_connect_its_models(tmp_path):
    text = model("m", "") + model("n", "<pose>2 0 0 0 0 0</pose>")
    text += '<joint name="across" type="ball"><parent>m::a</parent><child>n::a</child></joint>'
    text += '<joint name="hold" type="revolute"><parent>F</parent><child>m</child></joint>'
    scene = load_scene(sdf(tmp_path, world(text)))
    across, hold = sorted(scene.joints, key=lambda joint: joint.name)
    assert (across.type, across.parent, across.child) == ("spherical", "m__a", "n__a")
    assert across.parent_frame.position == (2.0, 0.0, 0.0)
    assert (hold.parent, hold.child) == ("world", "m__a")
    assert not [note for note in scene.notes if "joint of the world" in note]


SHAPES = {
    "<box><size>0.1 0.2 0.4</size></box>": (0.008, (0.2 / 12, 0.17 / 12, 0.05 / 12)),
    "<sphere><radius>0.2</radius></sphere>": (4 / 3 * np.pi * 0.008, (0.016,) * 3),
    "<cylinder><radius>0.2</radius><length>0.6</length></cylinder>": (np.pi * 0.04 * 0.6, (0.04, 0.04, 0.02)),
    "<ellipsoid><radii>0.1 0.2 0.4</radii></ellipsoid>": (4 / 3 * np.pi * 0.008, (0.04, 0.034, 0.01)),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_automatic_inertias_follow_from_the_collision_shapes(shape, tmp_path):
    volume, moments = SHAPES[shape]
    text = (
        '<model name="m"><link name="a"><inertial auto="true"><density>500</density></inertial>'
        f'<collision name="c"><pose>1 0 0 0 0 0</pose><geometry>{shape}</geometry></collision>'
        "</link></model>"
    )
    scene = load_scene(sdf(tmp_path, text, "1.11"))
    body = scene.bodies[0]
    assert "inertia computed from the collision shapes: a" in scene.notes
    assert body.mass == pytest.approx(500 * volume, rel=1e-14)
    assert body.com == (1.0, 0.0, 0.0)
    assert body.inertia[:3] == pytest.approx(500 * volume * np.array(moments), rel=1e-13)
    # Two shapes in the same place, one with a density of its own, scaled to a given mass.
    second = f'<collision name="d"><density>1500</density><geometry>{shape}</geometry></collision>'
    text = text.replace("</link>", f"{second}</link>").replace("<density>500", "<mass>8</mass><density>500")
    body = load_scene(sdf(tmp_path, text, "1.11")).bodies[0]
    assert (body.mass, body.com) == (pytest.approx(8, rel=1e-14), pytest.approx((0.25, 0, 0)))
    assert body.inertia[1] == pytest.approx(8 * moments[1] + 8 * 0.25 * 0.75, rel=1e-13)
    mesh = text.replace(shape, "<mesh><uri>a.stl</uri></mesh>")
    with pytest.raises(SceneError, match='inertia of link "a" is automatic, which is not supported for this'):
        load_scene(sdf(tmp_path, mesh, "1.11"))


def test_a_capsule_is_a_tube_with_round_ends(tmp_path):
    """Against a sum over thin discs."""
    shape = "<capsule><radius>0.2</radius><length>0.6</length></capsule>"
    text = (
        '<model name="m"><link name="a"><inertial auto="true"/><collision name="c"><geometry>'
        f"{shape}</geometry></collision></link></model>"
    )
    body = load_scene(sdf(tmp_path, text, "1.11")).bodies[0]
    z, width = np.linspace(-0.5, 0.5, 200001, retstep=True)
    r2 = 0.04 - np.maximum(np.abs(z) - 0.3, 0.0) ** 2
    m = 1000 * np.pi * r2 * width
    across = (m * (r2 / 4 + z * z)).sum()
    assert body.mass == pytest.approx(m.sum(), rel=1e-8)
    assert body.inertia[:3] == pytest.approx((across, across, (m * r2 / 2).sum()), rel=1e-8)


UNUSUAL = """<sdf version="1.9"><model name="m"><self_collide>true</self_collide>
<link name="a"><inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia><orgin/>
<fluid_added_mass><xx>1</xx></fluid_added_mass></inertial><kinematic>true</kinematic>
<velocity_decay><linear>0.1</linear></velocity_decay>
<visual name="ground"><geometry><plane/></geometry></visual></link>
<joint name="j" type="revolute"><parent>world</parent><child>a</child><physics/><origin/>
<sensor name="touch" type="contact"/>
<axis><xyz>0 1 0</xyz><initial_position>0.4</initial_position><dynamics dampin="1"/></axis></joint>
</model></sdf>"""


def test_what_sdf_has_and_a_scene_has_not_is_noted(tmp_path):
    path = tmp_path / "unusual.sdf"
    path.write_text(UNUSUAL)
    notes = load_scene(path).notes
    for what in (
        "changes the motion: fluid_added_mass, left out: a",
        "changes the motion: kinematic links, left out: a",
        "changes the motion: velocity_decay of links, left out: a",
        "changes the motion: initial_position of joints, left out: j",
        "left out: 1 visuals that are not drawn (ground)",
        "left out: 1 sensor of joints (touch)",
        "left out: 1 physics of joints (j)",
        "left out: 1 self_collide (m)",
        "changes the motion: unknown parts of the SDF file, left out: <orgin> in <inertial> of line 2, "
        "<origin> in <joint> of line 6, dampin in <dynamics> of line 8",
    ):
        assert what in notes, (what, notes)


def test_a_servo_of_mjcf_changes_the_motion(tmp_path):
    path = tmp_path / "servo.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
        '<actuator><position name="servo" joint="j" kp="100"/><motor name="free" joint="j"/>'
        "</actuator></mujoco>"
    )
    notes = load_scene(path).notes
    assert "left out: 1 actuators (free)" in notes
    assert any(note.startswith("changes the motion") and "servo" in note for note in notes)


@pytest.mark.parametrize(("version", "noted"), [("1.12", False), ("1.13", True), ("2.0", True)])
def test_newer_versions_of_sdf_are_noted(version, noted, tmp_path):
    text = '<model name="m"><link name="a"><inertial><mass>1</mass></inertial></link></model>'
    note = f"SDF version above 1.12, read by the rules of 1.12: {version}"
    assert (note in load_scene(sdf(tmp_path, text, version)).notes) == noted


@pytest.mark.parametrize(("version", "noted"), [("1.5", True), ("1.6", True), ("1.7", False)])
def test_older_versions_of_sdf_are_noted(version, noted, tmp_path):
    text = '<model name="m"><link name="a"><inertial><mass>1</mass></inertial></link></model>'
    note = f"SDF version before 1.7, read by the rules of 1.7, except for the axes of its joints: {version}"
    assert (note in load_scene(sdf(tmp_path, text, version)).notes) == noted


def test_model_config_names_the_file_of_a_model(tmp_path, monkeypatch):
    """The latest version that is known; without it model.sdf. Merged includes are refused by name."""
    folder = tmp_path / "arm"
    folder.mkdir()
    (folder / "old.sdf").write_text("<sdf version='1.4'><model name='none'/></sdf>")
    (folder / "arm_1_9.sdf").write_text(ARM_SDF)
    (folder / "model.config").write_text(
        "<model><name>arm</name><sdf version='1.4'>old.sdf</sdf><sdf version='1.9'>arm_1_9.sdf</sdf>"
        "<sdf version='3.0'>none.sdf</sdf></model>"
    )
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path))
    assert [body.name for body in load_scene("model://arm").bodies] == ["upper", "slide"]
    world = "<world name='w'><include{}><uri>model://arm</uri></include></world>"
    assert len(load_scene(sdf(tmp_path, world.format(""))).bodies) == 2
    with pytest.raises(SceneError, match="merge"):
        load_scene(sdf(tmp_path, world.format(" merge='true'")))


@pytest.mark.parametrize(
    "stop, expected",
    [
        ("<stiffness>1000</stiffness><dissipation>2</dissipation>", (1000.0, 2.0)),
        ("<stiffness>1000</stiffness>", (1000.0, 1.0)),
        ("<stiffness>1e8</stiffness><dissipation>1</dissipation>", (None, None)),
        ("<stiffness>1000</stiffness><dissipation>inf</dissipation>", (None, None)),
        ("<stiffness>inf</stiffness>", (None, None)),
        ("", (None, None)),
    ],
)
def test_stops_of_sdf_are_compliant_if_they_are_not_its_defaults(stop, expected, tmp_path):
    """1e8 N m/rad and 1 N m s/rad are the defaults of <limit>."""
    axis = f"<axis><xyz>0 1 0</xyz><limit><lower>-0.3</lower><upper>0.6</upper>{stop}</limit></axis>"
    text = (
        f'<model name="m"><link name="l">{INERTIAL}</link><joint name="w" type="revolute">'
        f"<parent>world</parent><child>l</child>{axis}</joint></model>"
    )
    path = sdf(tmp_path, text)
    (joint,) = scene_from_robot(path, Options(stops=["all"])).joints
    limits = joint.limits
    assert (limits.lower, limits.upper) == (-0.3, 0.6)
    assert (limits.stiffness, limits.damping) == expected
    assert load_scene(path).joints[0].limits is None


def test_a_limit_of_a_ball_joint_of_mjcf_is_no_cone(tmp_path):
    """MuJoCo limits the angle of the rotation about any axis, also about the bone."""
    path = tmp_path / "ball.xml"
    path.write_text(
        """<mujoco><compiler angle="radian"/><worldbody><body pos="0 0 1">
        <joint name="s" type="ball" range="0 0.7"/><geom size="0.1" mass="1" pos="0 0 -0.4"/>
        </body></worldbody></mujoco>"""
    )
    scene = scene_from_robot(path, Options(stops=["all"]))
    assert scene.joints[0].limits is None
    assert (
        "changes the motion: limits of the rotation angle of ball joints, which differs from the angle of a "
        "cone, left out: s" in scene.notes
    )
