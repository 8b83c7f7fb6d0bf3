# SPDX-License-Identifier: Apache-2.0
"""`describe` against counts by hand and the dense matrix."""

import mechanisms
import numpy as np
import pytest

from liegroup_core import load_scene
from liegroup_core.describe import describe, solve_structure
from liegroup_core.formulations.absolute.constraints import assemble
from liegroup_core.integrators.methods import METHODS
from liegroup_core.layout import make_layout
from liegroup_core.model.arrays import VERTEX, make_work
from liegroup_core.model.build import initial_state
from liegroup_core.model.sparsity import block_layout, operations
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
            "switches": [],
        }
    ]
    assert facts["forces"] == [{"name": "spring", "type": "spring_damper", "on": ["world", "top"]}]
    assert facts["solve"]["constant"] and facts["solve"]["unknowns"] == 9
    # One block of 6, one of 3, and the 3 x 6 between them.
    assert facts["solve"]["numbers"] == 36 + 9 + 18 and facts["solve"]["blocks"] == 1
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


@pytest.mark.parametrize("name", ["net", "every kind", "chain of hinges"])
def test_block_counts_equal_those_of_the_assembled_matrix(name):
    """Blocks before fill-in are those that `assemble` writes; a chain has no fill-in."""
    layout = make_layout(mechanisms.named(name))
    model = layout.model
    found = solve_structure(model)
    work = make_work(model, 1)
    size = len(model.constant)
    work.matrix[: model.fresh] = np.nan
    work.matrix[model.fresh : size] = model.constant[model.fresh :]
    assemble(model.replace(matrix=model.constant), work, *initial_state(layout.scene))
    written = 0
    for vertex in model.vertices:
        for below, place, _ in model.columns[vertex["column_start"] : vertex["column_end"]]:
            block = work.matrix[place : place + model.vertices[below]["size"] * vertex["size"]]
            assert np.isfinite(block).all()
            written += bool(block.any())
    assert found["blocks"] - found["fill"] == written
    if name == "chain of hinges":
        assert found["fill"] == 0


def test_operation_count_is_that_of_a_dense_factorisation():
    """Body and spherical joint with changing blocks: about those of a dense Cholesky of size 9."""
    *_, ranges, columns, updates = block_layout(np.array([6, 3]), [[1], []], [(0, 0)])
    vertices = np.array([(0, k, 0, *each) for k, each in zip((6, 3), ranges)], dtype=VERTEX)
    factor, solve = operations(vertices, columns, updates)
    assert factor == pytest.approx(9**3 / 3, rel=0.01) and solve == 2 * 9**2


# Twice M^-1 of 18; and for the ball two triangles of 9, and the 3 x 6 below the body twice.
@pytest.mark.parametrize("name, flops", [("free_body", 36), ("heavy_top", 36 + 18 + 2 * 36)])
def test_a_constant_K_is_not_factorised_in_each_step(name, flops):
    found = solve_structure(make_layout(load_scene(name)).model)
    assert found["constant"] and found["factor_flops"] == 0 and found["solve_flops"] == flops
