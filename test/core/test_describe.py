# SPDX-License-Identifier: Apache-2.0
"""`describe` against counts by hand."""

import mechanisms
import pytest

from liegroup_core import load_scene
from liegroup_core.describe import describe, solve_structure
from liegroup_core.layout import make_layout
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.library import chain
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.chapter.joint_runs import four_bar


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
    assert facts["kept_momentum"] is None


@pytest.mark.parametrize("links", [2, 40])
def test_the_factor_of_a_chain_of_cut_hinges_grows_with_its_length(links):
    """Five rows each, a triangle of 15 numbers, and 25 that couple them to those of the next hinge."""
    found = solve_structure(make_layout(chain(links, "revolute")).floating("se3"))
    rows, numbers = 5 * links, 15 * links + 25 * (links - 1)
    assert (found["rows"], found["numbers"]) == (rows, numbers)
    assert found["dense_share"] == numbers / (rows * (rows + 1) / 2)
