# SPDX-License-Identifier: Apache-2.0
"""`describe` against counts by hand, and masses against those of MuJoCo."""

import mechanisms
import mujoco
import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.describe import describe, solve_structure
from liegroup_core.layout import make_layout
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.library import chain
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.chapter.joint_runs import four_bar
from liegroup_sim_ros.commands.describe import sections


def test_a_motion_of_the_scene_beyond_the_limits_of_its_joint_is_a_note():
    """It acts; the same command is refused. 1.875 rad/s is the peak of a quintic over 1 rad in 1 s."""

    def notes(motion, data):
        joint = f"{{name: j, type: revolute, parent: world, child: b, child_frame: {{}}, driven: true{motion}"
        text = (
            "{name: s, gravity: [0, 0, 0], bodies: [{name: b, mass: 1, inertia: [1, 1, 1]}], "
            f"joints: [{joint}, data: {data}}}]}}"
        )
        return describe(make_layout(scene_from_text(text)))["notes"]

    turn = ", motion: {times: [0, 1], positions: [0, 1], velocities: [0, 0]}"
    for data, text in (
        ("{lower: -1, upper: 0.9}", "position 1 rad of joint 'j' is beyond its limits, -1 to 0.9"),
        ("{velocity: 1.8}", "joint 'j' would need 1.875 rad/s"),
    ):
        (note,) = notes(turn, data)
        assert note.startswith("motion beyond the joint limits") and text in note
    assert notes(turn, "{lower: -1, upper: 1, velocity: 1.9}") == []
    assert notes("", "{lower: 0.5, upper: 1, velocity: 0.1}") == []


def test_a_motion_that_leaves_the_range_of_its_points_is_a_note(caplog):
    """The cubic spline with rates 0 at the ends has the rates 1 and -1 at 1 s and 2 s by symmetry: 4 v1 + v2 = 3.

    Its accelerations there are -2 from both sides, so that its middle is at 1 + 1/4.
    """
    text = (
        "{name: s, gravity: [0, 0, 0], bodies: [{name: b, mass: 1, inertia: [1, 1, 1]}], joints: [{name: j, type: "
        "prismatic, parent: world, child: b, child_frame: {}, driven: true, motion: {times: [0, 1, 2, 3], MORE}}]}"
    )
    ways = {
        "positions: [0, 1, 1, 0]": "overshoots its points: that of joint 'j' by 0.25 m between 1 and 1 from t = 1 s",
        "positions: [0, 1, 1, 0], monotone: true": "",
        "positions: [0, 1, 1, 0], velocities: [0, 0, 0, 0], accelerations: [0, 0, 0, 0]": "",
        "positions: [0, 1, 2, 1]": "",
    }
    for more, words in ways.items():
        scene = scene_from_text(text.replace("MORE", more))
        notes = describe(make_layout(scene))["notes"]
        assert len(notes) == bool(words) and all(words in note for note in notes)
        caplog.clear()
        Simulation(scene, method="rkmk4", step=0.1).advance(2)
        assert [record.getMessage() for record in caplog.records if "overshoots" in record.getMessage()] == notes


LINKS = text_of("floating_links.xml")


def test_total_mass_centre_of_mass_and_extents(tmp_path):
    """MuJoCo's subtree of the world; a box of equal inertia is the box itself, with the corners by hand.

    Numbers in the texts of scenes are exact; centres of several solids are sums of some terms: 1e-12.
    """
    path = tmp_path / "links.xml"
    path.write_text(LINKS)
    model = mujoco.MjModel.from_xml_string(LINKS)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    facts = describe(make_layout(load_scene(path)))
    assert facts["masses"]["mass"] == pytest.approx(model.body_subtreemass[0], rel=1e-12)
    assert facts["masses"]["centre_of_mass"] == pytest.approx(data.subtree_com[0], abs=1e-12)
    for body, number in zip(facts["bodies"], (1, 2)):
        moments = np.linalg.eigvalsh(np.append(body["inertia"], [0.0] * 3)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]])
        assert moments == pytest.approx(np.sort(model.body_inertia[number]), rel=1e-9)
        assert body["com"] == pytest.approx(model.body_ipos[number], abs=1e-12)
    box = LINKS[: LINKS.index('    <body name="arm"')] + "</body></worldbody></mujoco>"
    path.write_text(box)
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3) * model.geom_size[0]
    corners = data.geom_xpos[0] + corners @ data.geom_xmat[0].reshape(3, 3).T
    extents = describe(make_layout(load_scene(path)))["masses"]["extents"]
    assert np.array(extents) == pytest.approx(np.array([corners.min(axis=0), corners.max(axis=0)]), abs=1e-9)


@pytest.mark.parametrize(
    "length, mass, inertia, word",
    [(1.0, 1.0, 1.0, ""), (1e3, 1e3, 1e9, "mm"), (1e3, 1.0, 1e6, "mm"), (1e3, 1.0, 1.0, "mm"), (1.0, 1e3, 1.0, "in g")]
    + [(1.0, 1e3, 1e3, "in g"), (1.0, 1.0, 1e9, "mm^2"), (1.0, 1.0, 1e6, "mm^2"), (1.0, 1e3, 1e9, "mm^2")],
)
def test_masses_in_g_and_sizes_in_mm_are_a_note(length, mass, inertia, word):
    """A rod of aluminium, 0.3 m, 0.02 m in diameter and 0.25 kg, as numbers of a file with other units."""
    across = inertia * 0.25 * (0.3**2 / 12.0 + 0.01**2 / 4.0)
    along = inertia * 0.25 * 0.01**2 / 2.0
    scene = scene_from_text(
        f"{{name: s, gravity: [0, 0, 0], bodies: [{{name: rod, mass: {0.25 * mass}, inertia: [{along}, {across}, "
        f"{across}]}}], joints: [{{name: j, type: revolute, parent: world, child: rod, "
        f"child_frame: {{position: [{0.15 * length}, 0, 0]}}}}]}}"
    )
    notes = describe(make_layout(scene))["notes"]
    assert len(notes) == bool(word) and all(word in note for note in notes)


def test_heavy_top():
    facts = describe(make_layout(load_scene("heavy_top")))
    assert facts["degrees_of_freedom"] == 3 and facts["dropped_rows"] == []
    assert facts["joints"] == [
        {
            "name": "pivot",
            "type": "spherical",
            "parent": "world",
            "child": "top",
            "rows": ["vx", "vy", "vz"],
            "dropped": [],
            "driven": False,
            "rotor": 0.0,
            "switches": [],
        }
    ]
    assert facts["forces"] == [{"name": "spring", "type": "spring_damper", "on": ["world", "top"]}]
    assert facts["solve"] == {"rows": 0, "numbers": 0, "dense_share": 0.0, "refinements": 0}
    assert len(facts["kept_momentum"]) == 1 and facts["methods"] == list(METHODS)


def test_laws_and_contacts_name_what_they_act_on_and_their_numbers():
    text = text_of("sized.yaml")
    facts = describe(make_layout(scene_from_text(text)))
    assert facts["forces"][:2] == [
        {"name": "own", "type": "law", "on": ["j", "b"], "signals": ["f", "g"]},
        {"name": "plan", "type": "law", "on": [], "signals": ["x", "h"]},
    ]
    (rows,) = [rows for title, rows in sections(facts | {"cost": {}}) if title == "Forces"]
    # settles is sqrt(m slip / (friction load)); the hinge is the only coordinate, states of laws are none.
    contact = (
        "sphere of b - plane through 0 0 -1, normal 0 0 1; stiffness 8 N/m, damping 0.5 s/m, friction 0.2, slip 0.1 m, "
        "settles 0.3536 s"
    )
    assert rows == [
        ("own", "law", "on j, b; signals f, g"),
        ("plan", "law", "signals x, h"),
        ("floor", "contact", contact),
    ]
    assert facts["formulation"]["coordinates"] == 1


def test_a_loop_names_its_redundant_constraint_row():
    """Four-bar with three revolute joints and a spherical one: 18 rows of rank 17."""
    facts = describe(make_layout(four_bar()))
    assert (facts["rows"], facts["solved_rows"], facts["degrees_of_freedom"]) == (18, 17, 1)
    assert facts["dropped_rows"] == [["coupler_rocker", "vz"]]
    assert facts["joints"][2]["dropped"] == ["vz"] and facts["joints"][1]["dropped"] == []
    assert facts["groups"] == [["crank", "coupler", "rocker"]]
    assert "rkmk4" in facts["methods"] and "stoermer_verlet" not in facts["methods"]


def test_friction_by_load_can_stick():
    """The gripper holds its part by friction by load alone."""
    facts = describe(make_layout(load_scene("gripper")))
    modes = {entry["joint"]: entry["modes"] for entry in facts["stops_and_friction"]}
    by_load = [
        entry["joint"]
        for entry in facts["stops_and_friction"]
        if entry["friction"] and not entry["friction"].get("coulomb")
    ]
    assert by_load and all("stick" in modes[joint] for joint in by_load)


def test_row_counts_of_all_joint_kinds_without_conserved_momentum():
    layout = make_layout(mechanisms.named("every kind"))
    facts = describe(layout)
    rows = {joint["type"]: joint["rows"] for joint in facts["joints"]}
    assert rows["universal"] == ["vx", "vy", "vz", "wn"] and rows["distance"] == ["length"]
    assert sum(len(joint["rows"]) for joint in facts["joints"]) == facts["rows"]
    assert facts["kept_momentum"] == []


@pytest.mark.parametrize("links", [2, 40])
def test_the_factor_of_a_chain_of_cut_hinges_grows_with_its_length(links):
    """Five rows each, a triangle of 15 numbers, and 25 that couple them to those of the next hinge."""
    found = solve_structure(make_layout(chain(links, "revolute")).floating("se3"))
    rows, numbers = 5 * links, 15 * links + 25 * (links - 1)
    assert (found["rows"], found["numbers"]) == (rows, numbers)
    assert found["dense_share"] == numbers / (rows * (rows + 1) / 2)
