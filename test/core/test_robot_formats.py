# SPDX-License-Identifier: Apache-2.0
"""What each format of robots has of its own: nested models, frames, loops, gears, addresses."""

import math

import numpy as np
import pytest
from robot_texts import ARM_SDF, ARM_URDF, bar, freedoms, written
from scene_files import cases, filled, text_of
from scipy.integrate import solve_ivp

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.robots.ground import Ground
from liegroup_core.robots.omitted import passive
from liegroup_core.robots.options import Options
from liegroup_core.robots.read import read_robot
from liegroup_core.robots.resources import find_resource
from liegroup_core.scene.load import scene_from_robot

pytestmark = pytest.mark.usefixtures("mjcf_here")
INERTIAL = "<inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.2</iyy><izz>0.25</izz></inertia></inertial>"


def sdf(folder, text, version="1.9"):
    """Path of an SDF file."""
    return written(folder / "model.sdf", f'<sdf version="{version}">{text}</sdf>')


def test_frames_of_nested_models(tmp_path):
    """Pose by pose: the model is at z = 1, the nested one at x = 2 turned by 90 degrees about z."""
    text = filled(text_of("nested.sdf"), inertial=INERTIAL)
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
    text = filled(text_of("screws_and_gears.sdf"), inertial=INERTIAL)
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
    # Joints in series to the reference body: the angle relative to it is their sum.
    series = text.replace("<parent>case</parent><child>in</child>", "<parent>world</parent><child>in</child>")
    series = series.replace('"hold" type="fixed"', '"hold" type="revolute"')
    (relation,) = load_scene(sdf(tmp_path, series)).couplings
    # -wheel = -4 (shaft - hold)
    assert (relation.joint, relation.other, relation.ratio, relation.terms) == ("wheel", "hold", -4.0, {"shaft": 4.0})
    sdf(tmp_path, text)
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
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    other = tmp_path / "share" / "other_src"
    other.mkdir()
    for folder, name in ((share, "robot"), (other, "other")):
        (folder / "package.xml").write_text(f"<package><name> {name} </name></package>")
        (folder / "part.stl").write_text("")
    for name, folder in (("my_robot", share), ("robot", share), ("other", other), ("other_src", other), ("none", None)):
        found = find_resource(f"package://{name}/part.stl", share / "arm.urdf")
        assert found == (folder and folder / "part.stl")


FOUR_BAR = text_of("four_bar.xml")


@pytest.mark.turn(3)
def test_loops_and_welds_of_mjcf(tmp_path):
    path = written(tmp_path / "four_bar.xml", filled(FOUR_BAR, more=""))
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
    path.write_text(filled(FOUR_BAR, more='<joint joint1="a" polycoef="0 0 0 0 0"/>'))
    assert "locked: joint a at 0" in load_scene(path).notes


SRDF = """<robot name="arm"><group name="all"/><group_state name="ready" group="all">
  <joint name="shoulder" value="0.4"/><joint name="extend" value="-0.2"/></group_state></robot>"""


TRAMMEL = text_of("trammel.xml")


@pytest.mark.parametrize("longer", [0.0, 0.25])
def test_a_tendon_of_fixed_length_is_a_rod(longer, tmp_path):
    """Slides across and upwards with a rod of length L between them: a trammel.

    x = L cos(q), z = L sin(q). With equal masses the kinetic energy is m L^2 q'^2 / 2, so that
    q'' = -g / L cos(q), the equation of a pendulum.
    """
    path = written(tmp_path / "trammel.xml", filled(TRAMMEL, tendon="rope", longer=longer))
    scene = scene_from_robot(path, Options(pose="tilted"))
    (rod,) = [joint for joint in scene.joints if joint.type == "distance"]
    assert rod.name == "rod" and rod.length == 1.0 + longer
    assert not any("rope" in note for note in scene.notes)
    assert "left out: tendons (bent)" in scene.notes
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
    scene = load_scene(written(tmp_path / "bent.xml", filled(TRAMMEL, tendon="bent", longer=0.0)))
    assert [joint.type for joint in scene.joints] == ["prismatic", "prismatic"]
    assert "changes the motion: equality constraints of tendons, left out: rod" in scene.notes


def test_group_states_of_srdf(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    (tmp_path / "arm.srdf").write_text(SRDF)
    path = written(tmp_path / "ready.yaml", "robot: arm.urdf\nsrdf: arm.srdf\npose: ready\nname: ready_arm\n")
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
    path = written(tmp_path / "up.yaml", "robot: two.urdf\nsrdf: two.srdf\npose: up\nbase: floating\n")
    scene = load_scene(path)
    root = next(body for body in scene.bodies if body.name == "root")
    assert root.position == pytest.approx((1, 2, 3), abs=1e-15)
    assert root.quaternion == pytest.approx((0, 0, 0.6, 0.8), abs=1e-15)
    path.write_text("robot: two.urdf\nsrdf: two.srdf\npose: up\n")
    note = 'changes the motion: pose of the root link in "up" left out, because it does not float'
    assert note in load_scene(path).notes


def test_names_that_are_no_names_of_a_scene(tmp_path):
    path = written(
        tmp_path / "odd.urdf",
        f'<robot name="my robot"><link name="base"/>{bar("left-arm", 1.0)}{bar("left_arm", 1.0)}'
        f"{bar('true', 1.0)}"
        + "".join(
            f'<joint name="{name}" type="continuous"><parent link="base"/><child link="{child}"/></joint>'
            for name, child in (("1", "left-arm"), ("j", "left_arm"), ("null", "true"))
        )
        + "</robot>",
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


UNUSUAL = text_of("unusual.sdf")


def test_what_sdf_has_and_a_scene_has_not_is_noted(tmp_path):
    notes = load_scene(written(tmp_path / "unusual.sdf", UNUSUAL)).notes
    for what in (
        "changes the motion: fluid_added_mass of links, left out: a",
        "changes the motion: kinematic of links, left out: a",
        "changes the motion: velocity_decay of links, left out: a",
        "start values of the file: j = 0.4",
        "left out: visuals that are not drawn (ground)",
        "left out: sensor of joints (touch)",
        "left out: physics of joints (j)",
        "left out: self_collide (m)",
        "changes the motion: unknown parts of the SDF file, left out: <orgin> in <inertial> of line 2, "
        "<origin> in <joint> of line 6, dampin in <dynamics> of line 8",
    ):
        assert what in notes, (what, notes)


ACTING = text_of("acting.sdf")
ON_GAZEBO = """<gazebo><plugin filename="libgazebo_ros2_control.so" name="ros"/><static>0</static>
<plugin filename="libhydrodynamics.so" name="water"/></gazebo>
<gazebo reference="a"><mu1>1</mu1><dampingFactor>0.1</dampingFactor><selfCollide>1</selfCollide></gazebo>"""


def test_what_acts_is_noted_as_a_change_of_the_motion_in_each_format(tmp_path):
    assert [*load_scene(sdf(tmp_path, ACTING.format(INERTIAL))).notes] == [
        "changes the motion: wind of the world, left out: unnamed",
        "changes the motion: plugins that may act on bodies or joints, left out: gz::sim::systems::Buoyancy, hold",
        "changes the motion: enable_wind, left out: w",
        "left out: plugin (gz::sim::systems::Physics)",
        "left out: scene of the world (unnamed)",
    ]
    path = tmp_path / "swing.urdf"
    in_link = '<link name="a"><kinematic>1</kinematic><gravity>0</gravity>'  # of no reader of URDF
    path.write_text(filled(SWING, more=ON_GAZEBO).replace('<link name="a">', in_link))
    assert [*load_scene(path).notes] == [
        "fixed to the world: base",
        "merged into a: b",
        "changes the motion: kinematic of links, left out: a",
        "changes the motion: gravity of links, left out: a",
        "changes the motion: plugins that may act on bodies or joints, left out: water",
        "changes the motion: dampingFactor of <gazebo>, left out: a",
        "left out: plugin (ros)",
        "left out: gazebo (a)",
    ]


HOLD = """<plugin filename="gz-sim-joint-position-controller-system" name="gz::sim::systems::JointPositionController">
<joint_name>j</joint_name><p_gain>10</p_gain><d_gain>0.5</d_gain>{}</plugin>"""
HELD = """<model name="m">{}<link name="a"><inertial><mass>2</mass><inertia><ixx>0.3</ixx></inertia></inertial></link>
<joint name="j" type="revolute"><parent>world</parent><child>a</child><axis><xyz>1 0 0</xyz></axis></joint></model>"""


@pytest.mark.parametrize(
    "more, effort",
    [
        ("<i_gain>0</i_gain>", 10.0 * (0.0 - 0.4) - 0.5 * 1.5),
        ("<i_gain>0</i_gain><initial_position>1</initial_position>", 10.0 * (1.0 - 0.4) - 0.5 * 1.5),
        ("<i_gain>0</i_gain><cmd_max>2</cmd_max><cmd_min>-2</cmd_min>", -2.0),
        ("", None),  # the default integral gain is 0.1
        ("<i_gain>0</i_gain><cmd_max>2</cmd_max>", None),
        ("<i_gain>0</i_gain><use_velocity_commands>true</use_velocity_commands>", None),
    ],
)
@pytest.mark.parametrize("kind", ["sdf", "urdf"])
def test_a_position_controller_of_gazebo_is_a_servo_if_it_equals_one(kind, more, effort, tmp_path):
    path = sdf(tmp_path, HELD.format(HOLD.format(more)))
    if kind == "urdf":
        path = written(
            tmp_path / "hold.urdf",
            f"""<robot name="m"><link name="base"/><link name="a"><inertial><mass value="2"/>
<inertia ixx="0.3" iyy="1" izz="1"/></inertial></link><joint name="j" type="continuous"><parent link="base"/>
<child link="a"/></joint><gazebo>{HOLD.format(more)}</gazebo></robot>""",
        )
    at = {"start": {"j": 0.4}, "start_velocity": {"j": 1.5}}
    scene = scene_from_robot(path, Options(**at))
    noted = [note for note in scene.notes if note.startswith("changes the motion: plugins")]
    assert len(noted) == (effort is None) and len(scene.forces) == (effort is not None)
    sample = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample()
    # The axis passes through the centre of mass.
    assert sample.accelerations["a"][0] == pytest.approx((effort or 0.0) / 0.3, rel=1e-12)
    assert not scene_from_robot(path, Options(driven={"j": None})).forces


@pytest.mark.parametrize("file, acts", cases("a_plugin_acts_unless_its_name_says_that_it_measures_or_waits"))
def test_a_plugin_acts_unless_its_name_says_that_it_measures_or_waits(file, acts):
    assert passive(file) is not acts


SWING = text_of("swing.urdf")


@pytest.mark.parametrize("off", [(), ("a",), ("b",), ("a", "b"), ("c",), ("a", "b", "c")])
def test_links_without_gravity_and_springs_of_gazebo_have_mujocos_accelerations(off, tmp_path):
    """MuJoCo has the same as gravcomp and stiffness; `b` is merged into `a` here, and a body of its own there."""
    mujoco = pytest.importorskip("mujoco")
    tags = ("<turnGravityOff>true</turnGravityOff>", "<gravity>0</gravity>", "<turnGravityOff>1</turnGravityOff>")
    more = "".join(f'<gazebo reference="{name}">{tag}</gazebo>' for name, tag in zip(off, tags))
    more += """<gazebo reference="k"><springStiffness>4</springStiffness><springReference>0.2</springReference>
<implicitSpringDamper>1</implicitSpringDamper></gazebo><ros2_control name="hw" type="system">
<joint name="j"><state_interface name="position"><param name="initial_value">0.4</param></state_interface>
<state_interface name="velocity"><param name="initial_value">-1.5</param></state_interface></joint></ros2_control>"""
    scene = load_scene(written(tmp_path / "swing.urdf", filled(SWING, more=more)))
    assert "start values of the file: j = 0.4" in scene.notes
    assert not any("changes the motion" in note for note in scene.notes)
    sample = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample()
    head = '<robot name="swing">'
    whole = f'{head}<mujoco><compiler fusestatic="false"/></mujoco>'
    spec = mujoco.MjSpec.from_string(filled(SWING, more="").replace(head, whole))
    for body in spec.bodies:
        body.gravcomp = body.name in off
    model = spec.compile()
    model.jnt_stiffness[1], model.qpos_spring[1] = 4.0, 0.2
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.4, 0.0), (-1.5, 0.0)
    mujoco.mj_forward(model, data)
    turns = [sample.accelerations[name][:3] for name in ("a", "c")]
    # The second axis is x of both links, the first one is fixed in the world.
    axis = np.array([1.0, 0.2, 0.0]) / np.hypot(1.0, 0.2)
    assert turns[0] @ axis == pytest.approx(data.qacc[0], rel=1e-9)
    assert turns[1][0] - turns[0][0] == pytest.approx(data.qacc[1], rel=1e-9)


DRAKE = text_of("drake_joint.urdf")
IN_MUJOCO = {
    "ball": '<joint type="ball"/>',
    "universal": '<joint axis="1 0 0"/><joint axis="0 1 0"/>',
    # The x and y axes of the plane may be any: these are perpendicular to its normal.
    "planar": '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0.8 -0.6"/><joint axis="0 0.6 0.8"/>',
}


def acceleration_of_mujoco(model, data, pose):
    """(6,) angular acceleration and that of the origin of the body `a` in MuJoCo, body axes, with gravity."""
    mujoco = pytest.importorskip("mujoco")
    mujoco.mj_forward(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    found = np.zeros(6)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, 1, found, 1)
    found[3:] += pose[:3, :3].T @ [0, 0, -9.81]
    return found


@pytest.mark.parametrize("kind", IN_MUJOCO)
def test_joints_of_drake_have_mujocos_accelerations(kind, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    path = written(
        tmp_path / "drake.urdf", DRAKE.format(kind, "<dynamics damping='0 0 0'/>" if kind == "planar" else "")
    )
    sample = Simulation(load_scene(path), "rkmk4", 1e-3, estimate=False, quiet=True).sample()
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><compiler angle="radian" eulerseq="XYZ"/><worldbody>
<body name="a" pos="0 0 1" euler="0.3 0.2 0.1">{IN_MUJOCO[kind]}<inertial pos="0.1 0 -0.2" mass="1"
diaginertia="0.01 0.02 0.025"/></body></worldbody></mujoco>""")
    found = acceleration_of_mujoco(model, mujoco.MjData(model), sample.poses["a"])
    assert sample.accelerations["a"] == pytest.approx(found, rel=1e-9, abs=1e-9)


def test_a_screw_of_drake_has_its_pitch_in_m_per_turn(tmp_path):
    path = written(tmp_path / "drake.urdf", DRAKE.format("screw", '<drake:screw_thread_pitch value="0.005"/>'))
    (joint,) = load_scene(path).joints
    assert (joint.type, joint.pitch) == ("screw", pytest.approx(0.005 / (2 * np.pi), rel=1e-15))
    path.write_text(DRAKE.format("screw", ""))
    with pytest.raises(SceneError, match=r'drake.urdf:4: joint "j" has no <drake:screw_thread_pitch>'):
        load_scene(path)
    path.write_text(DRAKE.format("curvilinear", ""))
    with pytest.raises(
        SceneError, match=r"drake.urdf:4: .*'curvilinear'; choose one of: ball, universal, planar, screw"
    ):
        load_scene(path)


def test_what_drake_has_and_a_scene_has_not_is_noted(tmp_path):
    """Transmissions whose rotor acts are not left out."""
    path = tmp_path / "drake.urdf"
    more = """<drake:linear_bushing_rpy name="bush"/><drake:collision_filter_group name="g"/>
<joint name="k" type="continuous"><parent link="a"/><child link="b"/></joint>{}</robot>""".format(
        "".join(
            f'<transmission name="{name}"><joint name="k"/><actuator name="m">{part}</actuator></transmission>'
            for name, part in (
                ("plain", ""),
                ("geared", '<drake:rotor_inertia value="0.1"/><drake:gearratio value="10"/>'),
                ("reduced", '<drake:rotor_inertia value="0.1"/><mechanicalReduction>10</mechanicalReduction>'),
            )
        )
    )
    text = DRAKE.format("ball", '<dynamics damping="0.1"/><drake:damping value="0.1"/>')
    text = text.replace(
        "<drake:joint",
        text[text.index('<link name="a"') : text.index("<drake:joint")].replace('name="a"', 'name="b"')
        + "<drake:joint",
    )
    path.write_text(text.replace("</robot>", more))
    scene = load_scene(path)
    assert scene.joints[1].rotor.inertia == 0.1
    assert [note for note in scene.notes if "left out" in note] == [
        "changes the motion: drake:linear_bushing_rpy, left out: bush",
        "changes the motion: unknown parts of the URDF file, left out: <damping> in <drake:joint> of line 7, "
        "<drake:gearratio> in <actuator> of line 8 (did you mean gear_ratio?)",
        "changes the motion: mechanicalReduction beside a rotor without <drake:gear_ratio>, left out: reduced",
        "changes the motion: springs and damping of spherical joints, left out: j",
        "left out: drake:collision_filter_group (g)",
        "left out: transmission (plain)",
    ]


def test_gravity_of_links_of_sdf(tmp_path):
    """A free link without gravity keeps its velocity; the other one falls."""
    links = "".join(
        f'<link name="{name}"><pose>{x} 0 0 0 0 0</pose>{INERTIAL}<gravity>{on}</gravity></link>'
        for name, x, on in (("a", 0, "false"), ("b", 1, "true"))
    )
    scene = load_scene(sdf(tmp_path, f'<model name="m">{links}</model>'))
    assert "without gravity: a" in scene.notes
    accelerations = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample().accelerations
    assert accelerations["a"] == pytest.approx(np.zeros(6), abs=1e-14)
    assert accelerations["b"] == pytest.approx([0, 0, 0, 0, 0, -9.81], abs=1e-14)


DRIVEN = text_of("driven_actuators.xml")


@pytest.mark.parametrize("actuators, forces, data, notes", cases("actuators_of_mjcf"))
@pytest.mark.volume(3)
def test_actuators_of_mjcf(actuators, forces, data, notes, tmp_path):
    """(stiffness, damping, limit) of servos, the range of commands, and what is said."""
    path = written(tmp_path / "driven.xml", filled(DRIVEN, flag="", actuators=actuators, key=""))
    scene = load_scene(path)
    assert [[each.name, each.stiffness, each.damping, each.effort_limit] for each in scene.forces] == forces
    assert scene.joints[0].data == data
    assert set(notes) <= set(scene.notes) and bool(scene.differences) == any("changes" in note for note in notes)
    path.write_text(filled(DRIVEN, flag='actuation="disable"', actuators=actuators, key=""))
    off = load_scene(path)
    assert not off.forces and not off.differences


@pytest.mark.parametrize("control, range_, effort, details", cases("a_command_adds_to_the_control_of_the_keyframe"))
def test_a_command_adds_to_the_control_of_the_keyframe(control, range_, effort, details, tmp_path):
    """Gear 4: the sum of both stays within 4 times the range of the control."""
    path, beside = tmp_path / "driven.xml", tmp_path / "own.yaml"
    motor = f'<motor name="p" joint="j" gear="4" ctrlrange="{range_}"/>'
    path.write_text(filled(DRIVEN, flag="", actuators=motor, key=f'ctrl="{control}"'))
    beside.write_text("robot: driven.xml\npose: k\n")
    scene = load_scene(beside)
    assert [each.torque for each in scene.forces] == [4.0 * control] and scene.joints[0].data == {"effort": effort}
    acts = f"{4 * control} N m of the file's control keep acting, and commands add to them{details}"
    assert f"actuators whose commands are efforts of joints: p of j ({acts})" in scene.notes


def test_a_servo_of_the_user_replaces_that_of_the_file(tmp_path):
    """Also a prescribed motion; and an activation that a keyframe moves is said."""
    path, beside = tmp_path / "driven.xml", tmp_path / "own.yaml"
    servo = '<position name="p" joint="j" kp="100"/><intvelocity name="v" joint="i"/>'
    path.write_text(filled(DRIVEN, flag="", actuators=servo, key='ctrl="0.1 0.2"'))
    beside.write_text("robot: driven.xml\npose: k\nforces:\n  - {name: p, type: servo, joint: j, stiffness: 2}\n")
    scene = load_scene(beside)
    assert [(each.name, each.stiffness) for each in scene.forces] == [("p", 2.0)]
    assert "actuators replaced by a servo or a motion that you gave: p" in scene.notes
    what = "changes the motion: actuators whose activation changes at the start, left out: v"
    assert scene.differences == [what]
    beside.write_text("robot: driven.xml\nactuators: false\n")
    assert load_scene(beside).differences == ["changes the motion: actuators, left out: p, v"]
    beside.write_text("robot: driven.xml\ndriven: {j: }\n")
    scene = load_scene(beside)
    assert [each.joint for each in scene.forces] == ["i"] and not scene.differences


NEW = "SDF version above 1.12, read by the rules of 1.12: {}"
OLD = "SDF version before 1.7, read by the rules of 1.7, except for the axes of its joints: {}"


@pytest.mark.parametrize(
    "version, note", [("1.5", OLD), ("1.6", OLD), ("1.7", ""), ("1.12", ""), ("1.13", NEW), ("2.0", NEW)]
)
def test_other_versions_of_sdf_are_noted(version, note, tmp_path):
    text = '<model name="m"><link name="a"><inertial><mass>1</mass></inertial></link></model>'
    notes = load_scene(sdf(tmp_path, text, version)).notes
    assert [each for each in notes if "version" in each] == [note.format(version)] * bool(note)


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


@pytest.mark.parametrize("stop, expected", cases("stops_of_sdf_are_compliant_if_they_are_not_its_defaults"))
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
    assert [limits.stiffness, limits.damping] == expected
    assert load_scene(path).joints[0].limits == limits


CARDAN = """<model name="m"><link name="a"><inertial><pose>0.1 0 -0.3 0 0 0</pose><mass>1</mass>
<inertia><ixx>.01</ixx><iyy>.02</iyy><izz>.025</izz></inertia></inertial></link>
<joint name="uj" type="{type}"><parent>world</parent><child>a</child>
<axis><xyz>1 0 0</xyz>{first}</axis><axis2><xyz>{second} 1 0</xyz>{last}</axis2></joint></model>"""
SPRING = "<dynamics><damping>0.3</damping><spring_stiffness>2</spring_stiffness></dynamics>"


@pytest.mark.parametrize("kind, second", [("universal", 0.0), ("revolute2", 0.0), ("universal", 0.4)])
def test_axes_of_a_universal_joint_have_laws_of_their_own(kind, second, tmp_path):
    """MuJoCo has two hinges of one body."""
    mujoco = pytest.importorskip("mujoco")
    last = "<dynamics><damping>0.1</damping><friction>0.05</friction></dynamics><limit><lower>-0.2</lower></limit>"
    text = CARDAN.format(type=kind, first=SPRING, second=second, last=last)
    options = Options(start={"uj::axis": 0.5, "uj::axis2": 0.3}, start_velocity={"uj::axis": 1.0, "uj::axis2": -2.0})
    scene = scene_from_robot(sdf(tmp_path, text), options)
    first, other = scene.joints
    assert (first.limits, first.friction) == (None, None)
    assert (other.limits.lower, other.limits.upper, other.friction.coulomb) == (-0.2, None, 0.05)
    sample = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample()
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><body name="a"><joint axis="1 0 0" stiffness="2"
damping="0.3"/><joint axis="{second} 1 0" damping="0.1"/><inertial pos="0.1 0 -0.3" mass="1"
diaginertia=".01 .02 .025"/></body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[1] = (0.5, 0.3), (1.0, -2.0), 0.05  # sliding friction
    found = acceleration_of_mujoco(model, data, sample.poses["a"])
    # MuJoCo's linear acceleration is that of the origin, which is on both axes: 0.
    assert sample.accelerations["a"] == pytest.approx(found, rel=1e-9, abs=1e-9)


def test_a_universal_joint_stays_within_its_limits(tmp_path):
    """It moves as with far limits until it is at a stop, and passes none."""
    start = {"start_velocity": {"uj::axis": 2.0, "uj::axis2": 1.0}}
    turned = []
    for most in ((0.3, 0.2), (3.0, 3.0)):
        first, last = (f"<limit><lower>-{each}</lower><upper>{each}</upper></limit>" for each in most)
        path = sdf(tmp_path, CARDAN.format(type="universal", first=first, second=0, last=last))
        simulation = Simulation(scene_from_robot(path, Options(**start)), "rkmk4", 1e-3, estimate=False, quiet=True)
        turned.append([])
        for _ in range(100):
            simulation.advance(10)
            coordinates = simulation.sample().joint_coordinates
            turned[-1].append([coordinates[f"uj__{key}"][0] for key in ("axis", "axis2")])
    turned, free = map(np.abs, turned)
    # Steps of 1 ms are accurate to 1e-9.
    assert (free.max(axis=0) > [0.3, 0.2]).all() and (turned.max(axis=0) < np.array([0.3, 0.2]) + 1e-9).all()
    before = np.argmax((free > [0.3, 0.2]).any(axis=1))
    assert before > 5 and turned[:before] == pytest.approx(free[:before], abs=1e-9)


def test_axes_that_a_joint_cannot_use_are_refused_or_noted(tmp_path):
    text = CARDAN.format(type="universal", first="", second=0, last="").replace("0 1 0", "1 0 0")
    with pytest.raises(SceneError, match=r'model.sdf:3: joint "uj" has parallel axes'):
        load_scene(sdf(tmp_path, text))
    usual = "<initial_position>0</initial_position><limit><lower>-1e16</lower></limit><dynamics/>"
    (joint,) = load_scene(sdf(tmp_path, CARDAN.format(type="universal", first=usual, second=0, last=""))).joints
    assert (joint.name, joint.type) == ("uj", "universal")
    notes = load_scene(sdf(tmp_path, CARDAN.format(type="ball", first=SPRING, second=0, last=""))).notes
    assert "changes the motion: limits and dynamics of ball joints, left out: uj" in notes


def test_a_limit_of_a_ball_joint_of_mjcf_is_no_cone(tmp_path):
    """MuJoCo limits the angle of the rotation about any axis, also about the bone."""
    path = written(
        tmp_path / "ball.xml",
        """<mujoco><compiler angle="radian"/><worldbody><body pos="0 0 1">
        <joint name="s" type="ball" range="0 0.7"/><geom size="0.1" mass="1" pos="0 0 -0.4"/>
        </body></worldbody></mujoco>""",
    )
    scene = scene_from_robot(path, Options(stops=["all"]))
    assert scene.joints[0].limits is None
    assert (
        "changes the motion: limits of the rotation angle of ball joints, which differs from the angle of a "
        "cone, left out: s" in scene.notes
    )


def test_springs_and_servos_act_from_the_start_of_a_joint_beyond_half_a_turn(tmp_path):
    """A scene counts their angle from (-pi, pi]: 4 rad are 4 - 2 pi."""
    path = written(
        tmp_path / "wound.xml",
        """<mujoco><compiler angle="radian"/><worldbody><body><joint name="j" stiffness="2" springref="0.5"/>
        <geom size="0.1" pos="0.3 0 0"/></body></worldbody><actuator><position joint="j" kp="3"/></actuator>
        <keyframe><key name="k" qpos="4" ctrl="5"/></keyframe></mujoco>""",
    )
    spring, servo = scene_from_robot(path, Options(pose="k")).forces
    angle = 4.0 - 2.0 * np.pi
    assert spring.stiffness * (spring.rest_angle - angle) == pytest.approx(2.0 * (0.5 - 4.0), rel=1e-14)
    assert servo.stiffness * (servo.position - angle) == pytest.approx(3.0 * (5.0 - 4.0), rel=1e-14)


TENDONS = text_of("tendons.xml")


PULLED = (
    '<spatial name="ja" stiffness="30" damping="2" springlength="0.9"><site site="sa"/><site site="w"/></spatial>'
    '<spatial stiffness="50" damping="1" springlength="0 0.95"><site site="sb"/><site site="sc"/></spatial>'
    '<spatial stiffness="40" springlength="1.037 1.05"><site site="sa"/><site site="sc"/></spatial>'
)
# Their springs start stretched, by 1.17 of the length of jc alone, and in a dead band.
FIXED = (
    '<fixed damping="2"><joint joint="jc" coef="-0.3"/><joint joint="ja" coef="1"/></fixed>'
    '<fixed stiffness="30" damping="2" springlength="0.4"><joint joint="ja" coef="-2"/><joint joint="jb" coef="1.5"/>'
    '<joint joint="jc" coef="0.7"/></fixed>'
    '<fixed stiffness="60" springlength="0.2 0.3"><joint joint="ja" coef="1"/><joint joint="jb" coef="2"/>'
    '<joint joint="jc" coef="0.7"/></fixed>'
    '<fixed stiffness="0.2" springlength="-12"><joint joint="jc" coef="-3"/></fixed>'
)


@pytest.mark.parametrize(
    "tendons, joint, types, crossed",
    [
        (PULLED, 'name="jb"', ["cable", "cable", "strut"], {1: (0.95, 0.95), 2: (1.037, 1.05)}),
        (FIXED, 'name="jb" type="slide" range="-9 9"', [], {2: (0.2, 0.3)}),
    ],
    ids=["straight", "fixed"],
)
def test_tendons_move_as_in_mujoco(tendons, joint, types, crossed, tmp_path):
    """Springs, springs that act beyond a range of lengths only, dampers; 1 s with rkmk4.

    MuJoCo's RK4 with 2e-5 s crosses the kinks of the laws inside a step: errors of about stiffness speed step^3 /
    inertia, 1e-11.
    """
    mujoco = pytest.importorskip("mujoco")
    path = written(tmp_path / "pulled.xml", TENDONS.format(tendons, "").replace('name="jb"', joint))
    scene = load_scene(path)
    assert [joint.type for joint in scene.joints[3:]] == types
    assert not [note for note in scene.differences if "collision" not in note]
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 2e-5
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data, simulation, lengths = mujoco.MjData(model), Simulation(scene, "rkmk4", 2e-4), []
    for _ in range(10):
        simulation.advance(500)
        for _ in range(5000):
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        lengths.append(data.ten_length.copy())
        for name, pose in simulation.sample().poses.items():
            assert pose[:3, 3] == pytest.approx(data.body(name).xpos, abs=1e-9)
            assert pose[:3, :3].ravel() == pytest.approx(data.body(name).xmat, abs=1e-9)
    for k, (low, high) in crossed.items():
        assert min(each[k] for each in lengths) < low and high < max(each[k] for each in lengths)


@pytest.mark.parametrize("lock", [{}, {"jb": 0.2}])
def test_an_equality_of_three_joints_moves_as_rigid_rows_say(lock, tmp_path):
    """Gauss' principle: with M and the bias of MuJoCo, a = M^-1 (k lambda - bias) with k a = 0; first accelerations.

    A locked joint has no row and column. A motor whose length is constant does no work.
    """
    mujoco = pytest.importorskip("mujoco")
    text = TENDONS.format(
        '<fixed name="x"><joint joint="ja" coef="1"/><joint joint="jb" coef="1.5"/>'
        '<joint joint="jc" coef="-2"/></fixed>',
        '<tendon name="three" tendon1="x" polycoef="0.1 0 0 0 0"/>',
    )
    path = written(
        tmp_path / "three.xml", text.replace("</mujoco>", '<actuator><motor tendon="x"/></actuator></mujoco>')
    )
    scene = scene_from_robot(path, Options(lock=lock))
    assert bool(lock) or not scene.forces
    simulation = Simulation(scene, "rkmk4", 1e-5)
    at = lock | {name: q for name, (q, _) in simulation.sample().joint_coordinates.items()}
    assert at["ja"] + 1.5 * at["jb"] - 2.0 * at["jc"] == pytest.approx(0.1, abs=1e-15)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, mass = mujoco.MjData(model), np.zeros((3, 3))
    data.qpos[:] = model.qpos0 + [at[name] for name in ("ja", "jb", "jc")]
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    free = [0, 2] if lock else [0, 1, 2]
    mass, k, bias = mass[np.ix_(free, free)], np.array([1.0, 1.5, -2.0])[free], data.qfrc_bias[free]
    free = -np.linalg.solve(mass, bias)
    wanted = free - np.linalg.solve(mass, k) * (k @ free) / (k @ np.linalg.solve(mass, k))
    simulation.advance(1)
    # From rest: the rate after a step h is a h (1 + O(h^2)).
    rates = [rate for _, rate in simulation.sample().joint_coordinates.values()]
    assert np.array(rates) / 1e-5 == pytest.approx(wanted, abs=1e-8)


def test_a_fixed_tendon_hits_its_limit(tmp_path):
    """Slides of 1, 2, 3 kg at constant speeds v; L = c x; plastic: v+ = v - M^-1 c (c v) / (c M^-1 c)."""
    bodies = "".join(
        f'<body><joint name="j{k}" type="slide" axis="1 0 0"/><geom size="0.1" mass="{k}"/></body>' for k in (1, 2, 3)
    )
    text = f"""<mujoco><option gravity="0 0 0"/><worldbody>{bodies}</worldbody><tendon><fixed range="-1 0.5">
      <joint joint="j1" coef="-1"/><joint joint="j2" coef="2"/><joint joint="j3" coef="0.5"/></fixed></tendon>
      </mujoco>"""
    path, c, v = written(tmp_path / "limited.xml", text), np.array([-1.0, 2.0, 0.5]), np.array([-0.3, 0.4, 0.6])
    start = {f"j{k}": speed for k, speed in zip((1, 2, 3), v)}
    engine = Simulation(scene_from_robot(path, Options(start_velocity=start)), "rkmk4", 1e-2)
    engine.advance(100)
    hit, inverse = 0.5 / (c @ v), 1.0 / np.array([1.0, 2.0, 3.0])
    after = v - inverse * c * (c @ v) / (c @ (inverse * c))
    found = np.array(list(engine.sample().joint_coordinates.values()))
    # Sums of 100 steps of numbers below 1: 100 EPS.
    assert found[:, 1] == pytest.approx(after, abs=1e-13)
    assert found[:, 0] == pytest.approx(v * hit + after * (1.0 - hit), abs=1e-13)
    beyond = scene_from_robot(path, Options(start={"j1": 1.5}))
    assert "changes the motion: limits of tendons that start outside of them, left out: tendon_0" in beyond.notes


def test_limits_and_equalities_of_tendons(tmp_path):
    """Limits are a cable and a strut. Lengths count from the pose of the file."""
    path = written(
        tmp_path / "coupled.xml",
        TENDONS.format(
            '<spatial name="l" range="0.3 3"><site site="sa"/><site site="sc"/></spatial>'
            '<fixed name="t"><joint joint="ja" coef="1"/><joint joint="jc" coef="-2"/></fixed>'
            '<fixed name="u"><joint joint="jb" coef="2"/></fixed><fixed name="v"><joint joint="jc" coef="3"/></fixed>'
            '<fixed name="x"><joint joint="ja" coef="1"/><joint joint="jb" coef="1"/><joint joint="jc" coef="-2"/>'
            '</fixed><fixed name="idle"><joint joint="ja" coef="1"/></fixed>',
            '<tendon tendon1="t" polycoef="0.3 0 0 0 0"/><tendon tendon1="u" tendon2="v" polycoef="0.1 0.5 0 0 0"/>'
            '<tendon name="three" tendon1="x"/>',
        ),
    )
    scene = load_scene(path)
    # ja - 2 jc = 0.3 ,   2 jb = 0.1 + 0.5 * 3 jc
    found = [(each.joint, each.other, each.ratio, each.offset) for each in scene.couplings]
    assert found == [("ja", "jc", 2.0, 0.3), ("jb", "jc", 0.75, 0.05), ("ja", "jb", -1.0, 0.0)]
    assert scene.couplings[2].terms == {"jc": 2.0}
    assert [note for note in scene.notes if "tendons" in note] == ["left out: tendons (idle)"]
    assert [(joint.type, joint.length) for joint in scene.joints[3:]] == [("cable", 3.0), ("strut", 0.3)]
    without = scene_from_robot(path, Options(stops=[]))
    assert len(without.joints) == 3 and "changes the motion: limits of tendons, left out: l" in without.notes


HINGE = text_of("hinge.xml")


@pytest.mark.parametrize("flag, height, changes, acting", cases("flags_and_contact_pairs_of_mjcf"))
@pytest.mark.turn(3)
def test_flags_and_contact_pairs_of_mjcf(flag, height, changes, acting, tmp_path):
    """What a flag switches off has no effect and no note; a contact pair acts on shapes that collide with no other."""
    path = written(tmp_path / "flags.xml", filled(HINGE, flag=flag, height=height, solid='contype="0" conaffinity="0"'))
    scene = load_scene(path)
    assert len(scene.differences) == len(changes)
    assert all(what in note for what, note in zip(changes, scene.differences))
    (joint,), springs = scene.joints, scene.forces
    found = [key for key in ("limits", "friction") if getattr(joint, key)]
    found += [key for key in ("stiffness", "damping") if any(getattr(spring, key) for spring in springs)]
    assert found == acting


def test_a_weld_of_mjcf_may_close_a_loop_of_joints_with_rotors(tmp_path):
    """A scene cuts one of them, which loses its rotor: the smallest, with a note."""
    joint = '<joint name="j_{0}" axis="0 1 0" armature="{2}" range="-170 170"/><geom size="0.05"/>'
    bar = f'<body name="{{0}}" pos="{{1}}">{joint}'
    bars = bar.format("a", "0 0 0", 0.3) + bar.format("b", "0.4 0 0", 0.1) + bar.format("c", "0 0 0.4", 0.2)
    path = written(
        tmp_path / "welded.xml",
        f"""<mujoco><worldbody><body name="target" mocap="true" pos="0.2 0 0.4"/>{bars}
        {bar.format("d", "-0.2 0 0", 0.2)}</body></body></body></body></worldbody>
        <equality><weld body1="target" body2="d"/></equality></mujoco>""",
    )
    scene = load_scene(path)
    assert [joint.name for joint in scene.joints if joint.rotor] == ["j_a", "j_c", "j_d"]
    assert "changes the motion: rotors of loops in which all joints have one, left out: j_b" in scene.notes
    simulation = Simulation(scene, "rkmk4", 1e-3)
    start = simulation.energy()
    simulation.advance(100)
    assert simulation.energy() == pytest.approx(start, abs=1e-9)


def test_gravity_compensation_of_mjcf(tmp_path):
    """A part of the weight, none of it, and more than all: MuJoCo's accelerations, to round-off."""
    mujoco = pytest.importorskip("mujoco")
    path = written(
        tmp_path / "lifted.xml",
        """<mujoco><worldbody><body name="a" gravcomp="0.3"><joint axis="0 1 0"/>
<geom size="0.1" pos="0.2 0 0"/><body name="b" pos="0.5 0 0" gravcomp="1"><joint axis="0 1 0.2"/>
<geom size="0.1" pos="0.2 0 0.1"/></body></body><body name="c" gravcomp="1.5"><freejoint/><geom size="0.1"/></body>
</worldbody></mujoco>""",
    )
    scene = load_scene(path)
    assert {"without gravity: b", "with a part of its weight: a, c"} <= set(scene.notes)
    found = Simulation(scene, "rkmk4", 1e-3, estimate=False, quiet=True).sample().accelerations
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert found["a"][1] == pytest.approx(data.qacc[0], rel=1e-12)
    assert found["c"][3:] == pytest.approx(data.qacc[2:5], rel=1e-12, abs=1e-12)
    assert found["b"][:3] - found["a"][:3] == pytest.approx(data.qacc[1] * np.array([0, 1, 0.2]) / np.hypot(1, 0.2))


def test_numbers_of_contacts_that_are_not_mapped_are_noted(tmp_path):
    """Restitution and a second friction of SDF; the floor of a world of MJCF, which `ground` without a height takes."""
    text = (
        '<model name="m"><link name="a"><inertial auto="true"/><collision name="c"><geometry><sphere><radius>1</radius>'
        "</sphere></geometry><surface><friction><ode><mu>0.4</mu></ode></friction>{}</surface></collision></link></model>"
    )
    bounce = "<bounce><restitution_coefficient>0.6</restitution_coefficient></bounce>"
    for more in ("", bounce):
        notes = load_scene(sdf(tmp_path, text.format(more), "1.11")).notes
        assert ("numbers of contacts in <surface>, but for mu (a)" in "\n".join(notes)) == bool(more)
    path = written(
        tmp_path / "floor.xml",
        '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1" pos="0 0 -.5" euler="0 30 0" friction="2"/>'
        '<body><freejoint/><geom type="sphere" size=".1"/></body></worldbody></mujoco>',
    )
    pytest.importorskip("mujoco")
    left = "planes that touch: those of --ground if it has no height (plane floor of world)"
    assert left in "\n".join(load_scene(path).notes)
    for ground, point, normal, friction in (
        (Ground(), (0.0, 0.0, -0.5), (0.5, 0.0, math.sqrt(0.75)), 2.0),
        (Ground(height=-1.0), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 1.0),
    ):
        scene = scene_from_robot(path, Options(ground=ground))
        (contact,) = scene.forces
        assert contact.plane.point == point and contact.friction == friction
        np.testing.assert_allclose(contact.plane.normal, normal, atol=1e-12)
        notes = "\n".join(scene.notes)
        assert (left in notes) == (ground.height is not None) and ("ground: plane floor of world" in notes) != (
            left in notes
        )
