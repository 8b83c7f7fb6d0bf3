# SPDX-License-Identifier: Apache-2.0
"""Collision shapes of robots that touch a ground: the same contacts from each format, hulls of meshes, standing."""

import math
import re

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose
from robot_texts import written
from scene_files import cases, text_of

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.robots.ground import Ground
from liegroup_core.robots.options import Options
from liegroup_core.robots.starts import Start
from liegroup_core.scene.load import scene_from_robot

pytestmark = pytest.mark.usefixtures("mjcf_here")
FILES = {kind: text_of(f"legs.{kind}") for kind in ("urdf", "sdf", "xml")}


def contacts(scene):
    return [force for force in scene.forces if force.type == "contact"]


def on_ground(path, **keys):
    return scene_from_robot(path, Options(base="floating", ground=Ground(**keys)))


@pytest.mark.parametrize("kind", FILES)
def test_collision_shapes_of_each_format_become_the_same_contacts(kind, tmp_path):
    """Sizes and places written out; the shank leans by 0.3 about y, the foot is fixed to its end."""
    path = written(tmp_path / f"legs.{kind}", FILES[kind])
    found = contacts(on_ground(path, height=0.1))
    assert [(each.name, each.body, each.shape.type) for each in found] == [
        ("trunk_ground", "trunk", "box"),
        ("shank_ground", "shank", "capsule"),
        ("shank_ground_2", "shank", "cylinder"),
        ("foot_ground", "shank", "sphere"),
    ]
    box, capsule, cylinder, sphere = (each.shape for each in found)
    assert_allclose(box.size, (0.4, 0.3, 0.1), rtol=1e-15)
    assert_allclose(box.position, (0.02, 0, 0.01), rtol=1e-15)
    # Axes of MJCF's fromto follow from differences of numbers of size 1.
    assert_allclose((capsule.radius, capsule.length), (0.03, 0.2), rtol=1e-14)
    assert_allclose(capsule.position, (0, 0, -0.1), atol=1e-16)
    assert_allclose(np.abs(capsule.rotation[:, 2]), (0, 0, 1), atol=1e-15)
    assert_allclose((cylinder.radius, cylinder.length), (0.05, 0.04), rtol=1e-15)
    assert_allclose(np.abs(cylinder.rotation[:, 2]), (0, 1, 0), atol=1e-15)
    assert_allclose((sphere.radius, *sphere.position), (0.04, 0, 0, -0.25), atol=1e-15)
    assert [each.friction for each in found] == [0.6, 1.0, 1.0, 0.8]
    assert {(each.plane.point, each.sinks, each.restitution) for each in found} == {((0.0, 0.0, 0.1), 1e-3, 0.1)}
    notes = "\n".join(on_ground(path, height=0.1).notes)
    assert "collision shapes that do not touch the ground: ellipsoid of trunk" in notes
    # The foot is 0.25 below a knee at -0.05, its leg leans; its ball has a radius of 0.04.
    deep = 0.1 + 0.05 + 0.25 * math.cos(0.3) + 0.04
    made = on_ground(path, height=0.1)
    if kind == "urdf":  # its file does not say at which height it starts
        assert f"foot touches it, the origin of the root link is at {deep:.3g} m" in notes
        assert made.bodies[0].position == pytest.approx((0.0, 0.0, deep), abs=1e-15)
        lifted = np.subtract(
            made.bodies[1].position, scene_from_robot(path, Options(base="floating")).bodies[1].position
        )
        assert_allclose(lifted, (0.0, 0.0, deep), atol=1e-15)
        given = {"base": "floating", "ground": Ground(height=0.1), "start": {"trunk": Start(position=(0, 0, 0.1))}}
        notes = "\n".join(scene_from_robot(path, Options(**given)).notes)
        deep -= 0.1
    assert re.search(f"start inside a plane, .*: {deep:.3g} m deep in contact foot_ground .and 3 more", notes)
    (only,) = contacts(on_ground(path, links=["foot"], friction=0.3))
    assert (only.name, only.friction, only.plane.point) == ("foot_ground", 0.3, (0.0, 0.0, 0.0))
    without = load_scene(path)
    assert not contacts(without)
    assert ": without effect 5 collision shapes of trunk, shank, foot" in "\n".join(without.notes)


@pytest.mark.parametrize(
    "of_gazebo, expected",
    [
        ("", 0.9),
        ("<mu1>0.7</mu1><kp>1e6</kp>", 0.7),
        ('<mu1 value="0.7"/><kp>1e6</kp>', 0.7),
        ("<mu1>1e14</mu1><kp>1e6</kp>", 100.0),
    ],
)
def test_friction_of_a_contact_element(of_gazebo, expected, tmp_path):
    """Bullet's lateral_friction, and mu1 of Gazebo as a text or as an attribute; a note names what is not mapped."""
    contact = '<contact><lateral_friction value="0.9"/><stiffness value="3e4"/></contact>'
    text = FILES["urdf"].replace('<link name="foot">', f'<link name="foot">{contact}')
    text = text.replace("<mu1>0.8</mu1>", of_gazebo).replace("</geometry></collision>", "</geometry>{}</collision>", 1)
    path = written(tmp_path / "legs.urdf", text.format('<contact_coefficients mu="0"/>'))
    scene = on_ground(path)
    assert {each.name: each.friction for each in contacts(scene)}["foot_ground"] == expected
    left = "\n".join(note for note in scene.notes if note.startswith("left out"))
    assert "stiffness in <contact> of links (foot)" in left
    assert "contact_coefficients of links (trunk)" in left
    assert ("numbers of contacts in <gazebo>, but for mu1 (foot)" in left) == bool(of_gazebo)
    assert ("friction of contacts above 100, taken as that: 1e+14 of foot" in scene.notes) == (expected == 100.0)
    assert "contact of links" not in left and "gazebo (trunk)" not in left


def test_a_box_with_legs_is_dropped_and_stands(tmp_path):
    """Four equal feet bear the weight: they sink a quarter of `sinks` in the mean. Friction holds them apart."""
    foot = '<collision><origin xyz="{} {} -0.3"/><geometry><sphere radius="0.05"/></geometry></collision>'
    feet = "".join(foot.format(x, y) for x in (-0.2, 0.2) for y in (-0.1, 0.1))
    inertial = '<inertial><mass value="4"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
    written(tmp_path / "table.urdf", f'<robot name="t"><link name="top">{inertial}{feet}</link></robot>')
    more = "start: {top: {position: [0, 0, 0.36], rotation_vector: [0.02, 0.03, 0]}}\nground: {sinks: 2e-3}\n"
    scene = load_scene(written(tmp_path / "drop.yaml", f"robot: table.urdf\nbase: floating\n{more}"))
    simulation = Simulation(scene, accuracy=1e-6, quiet=True)
    simulation.advance_to(2.0)
    sample = simulation.sample()
    forces = [sample.signals[f"{each.name}.normal_force"] for each in contacts(scene)]
    # At rest within the accuracy, which is this fraction of the depth.
    assert sum(forces) == pytest.approx(4 * 9.81, rel=1e-6 / 5e-4)
    assert sample.pose[0, 11] == pytest.approx(0.35 - 5e-4, abs=1e-6)


@pytest.mark.parametrize("ground, text", cases("wrong_grounds_are_refused_in_one_line"))
def test_wrong_grounds_are_refused_in_one_line(ground, text, tmp_path):
    written(tmp_path / "legs.urdf", FILES["urdf"])
    with pytest.raises(SceneError) as refused:
        load_scene(written(tmp_path / "drop.yaml", f"robot: legs.urdf\nbase: floating\nground: {ground}\n"))
    assert text in str(refused.value) and "\n" not in str(refused.value)


def test_collision_meshes_are_hulls(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box(extents=(0.2, 0.1, 0.4)).subdivide().export(tmp_path / "block.stl")
    trimesh.creation.icosphere(radius=0.3).export(tmp_path / "ball.obj")
    mesh = '<geometry><mesh filename="{}" scale="1 2 0.5"/></geometry></collision>'
    shapes = '<collision><origin xyz="0 0 0.5"/>' + mesh.format("block.stl")
    shapes += "".join("<collision>" + mesh.format(name) for name in ("gone.obj", "ball.obj"))
    inertial = '<inertial><mass value="4"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
    text = f'<robot name="t"><link name="top">{inertial}{shapes}</link></robot>'
    scene = on_ground(written(tmp_path / "block.urdf", text))
    contact, ball = contacts(scene)
    corners = [[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
    # The file has numbers of single precision.
    assert_allclose(sorted(np.round(contact.shape.points, 6).tolist()), corners, atol=1e-12)
    assert contact.shape.position == (0.0, 0.0, 0.5)
    assert len(ball.shape.points) == 64
    assert any("ball.obj of top by 64 points, up to 0." in note for note in scene.notes)
    Simulation(scene, quiet=True)  # the largest hull fits into a law
    assert any("do not touch the ground: gone.obj (it does not exist) of top" in note for note in scene.notes)


def test_the_loss_of_a_hull_is_that_of_its_facets():
    """Of points of a unit sphere: 1 - the least distance of a facet from the centre, and at least that of 64 caps."""
    pytest.importorskip("trimesh")
    from liegroup_core.robots.meshes import hull_of

    points = np.random.default_rng(3).normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    chosen, loss = hull_of(points, 64, 1e-3)
    assert len(chosen) == 64
    facets = scipy.spatial.ConvexHull(chosen).equations
    lost = 1.0 + facets[:, 3].max()
    # 64 caps that cover the sphere have 1 - cos >= 2 / 64. The support of a facet changes by the sine of its cap
    # per rad of the direction; a direction has another one within 0.05.
    assert 2.0 / 64.0 <= lost
    assert abs(loss - lost) <= 0.05 * math.sqrt(1.0 - (1.0 - lost) ** 2)
    few, loss = hull_of(points, 64, 0.2)
    assert len(few) < 64 and loss <= 0.2
