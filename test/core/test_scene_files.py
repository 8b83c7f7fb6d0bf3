# SPDX-License-Identifier: Apache-2.0
"""Example scenes, the JSON schema of scene files, numbers of forces in them, and docs/reference/python.md."""

import json
import math
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from scene_files import ROOT, cases, each_scene, text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.errors import SceneError
from liegroup_core.forces.joint_law import LAW
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.body_model import build_model
from liegroup_core.scene import check_consistency, scene_from_text
from liegroup_core.scene.description import FORCES, JOINTS, SENSORS
from liegroup_core.scene.library import chain, four_bar_windows
from liegroup_core.scene.schema import scene_schema, scene_schema_text
from liegroup_core.scene.shapes import SHAPES
from liegroup_core.scene.yaml_text import read_yaml

# Steps for which the error of order 4 of each scene is small, s; the rest take 1 ms.
STEPS = {"four_bar": 1e-4, "lagrangian_top": 2e-4, "andrews_squeezer": 2e-6, "flyball_governor": 5e-5}


@each_scene
@pytest.mark.turn(3)
def test_an_example_scene_satisfies_constraints_and_conserves_energy(path):
    scene = load_scene(path)
    check_consistency(scene)
    simulation = Simulation(scene, method="rkmk4", step=STEPS.get(path.stem, 1e-3))
    first = simulation.sample()
    # poses and frames of size 1 with a few round-offs each
    assert first.constraint_residual <= 1e-14
    simulation.advance(200)
    last = simulation.sample()
    assert last.constraint_residual <= 1e-7
    fed = any(joint.driven or joint.friction for joint in scene.joints)
    fed = fed or any(force.type == "motor" or getattr(force, "damping", 0.0) for force in scene.forces)
    if not fed:
        masses = np.array([body.mass for body in scene.bodies])
        # of what the scene has of energy: its motion, or the fall through its own size
        moving = max(abs(first.energy), abs(last.energy), masses.sum() * 9.81 * 0.1)
        assert abs(last.energy - first.energy) <= 1e-6 * moving
    assert simulation.singular_solves == 0


@pytest.mark.parametrize(
    "name, made",
    [("ball_chain", chain(10)), ("hinge_chain", chain(10, "revolute")), ("n_four_bar", four_bar_windows(2))],
)
def test_example_files_equal_the_library_scenes(name, made):
    scene = load_scene(name)
    for mine, theirs in zip(made.bodies, scene.bodies):
        assert (mine.name, mine.mass, mine.inertia, mine.com) == (theirs.name, theirs.mass, theirs.inertia, theirs.com)
        np.testing.assert_allclose(mine.pose, theirs.pose, atol=1e-15)
        np.testing.assert_allclose(mine.twist, theirs.twist, atol=1e-15)
    assert [(j.name, j.type, j.parent, j.child) for j in made.joints] == [
        (j.name, j.type, j.parent, j.child) for j in scene.joints
    ]


@pytest.mark.parametrize("kind", ["spherical", "revolute"])
@pytest.mark.parametrize("n", [1, 3, 30])
def test_initial_acceleration_of_a_chain_has_the_closed_form(kind, n):
    """One rod released from rest: theta'' = m g (l / 2) / (m r^2 / 4 + m l^2 / 3)."""
    simulation = Simulation(chain(n, kind), method="rkmk4", step=1e-4)
    start = simulation.sample()
    simulation.advance(10)
    sample = simulation.sample()
    if n == 1:
        acceleration = 9.81 * 0.05 / (0.005**2 / 4 + 0.1**2 / 3)
        assert sample.twists["rod0"][1] == pytest.approx(1e-3 * acceleration, rel=1e-5)
    # both kinds of joint move in the plane alike, and none of the energy is lost
    assert np.abs(sample.pose[:, 10]).max() <= 1e-15
    assert sample.energy == pytest.approx(start.energy, abs=1e-12)


def test_chains_of_spherical_and_of_revolute_joints_fall_alike():
    """In the plane a revolute joint adds only constraints that are satisfied anyway."""
    ball, hinge = (Simulation(chain(5, kind), method="rkmk4") for kind in ("spherical", "revolute"))
    ball.advance(200)
    hinge.advance(200)
    np.testing.assert_allclose(ball.sample().pose, hinge.sample().pose, atol=1e-10)


GOOD = (ROOT / "test" / "core" / "rig.yaml").read_text(encoding="utf-8")
VALIDATOR = jsonschema.Draft202012Validator(scene_schema())


def accepts(text):
    return VALIDATOR.is_valid(read_yaml(text, "x.yaml").value)


def test_the_schema_file_is_up_to_date():
    """python -m liegroup_core.scene.schema > docs/scene.schema.json"""
    assert (ROOT / "docs" / "scene.schema.json").read_text(encoding="utf-8") == scene_schema_text()


def test_the_schema_is_a_valid_json_schema():
    jsonschema.Draft202012Validator.check_schema(json.loads(scene_schema_text()))


@each_scene
def test_every_example_scene_validates(path):
    values = read_yaml(path.read_text(encoding="utf-8"), str(path)).value
    assert [error.message for error in VALIDATOR.iter_errors(values)] == []


def test_every_key_has_a_description():
    """Every key of every model has a description, which editors show."""
    schema = scene_schema()
    for model in ("Body", "Frame", *(kind.__name__ for kind in (*JOINTS, *FORCES, *SENSORS, *SHAPES))):
        for key, part in schema["$defs"][model]["properties"].items():
            assert part["description"], (model, key)


def test_the_schema_refuses_what_the_loader_refuses():
    """The cases of wrong_scenes.yaml that a schema can express."""
    table = yaml.safe_load((ROOT / "test" / "core" / "wrong_scenes.yaml").read_text(encoding="utf-8"))
    accepted = [row for row in table["rig.yaml, by the schema too"] if accepts(GOOD.replace(*row[:2], 1))]
    assert accepted == []


@pytest.mark.parametrize("old, new", cases("the_schema_accepts_what_the_loader_accepts"))
def test_the_schema_accepts_what_the_loader_accepts(old, new):
    text = GOOD.replace(old, new, 1)
    if new.startswith("#"):
        text = GOOD[: GOOD.index("forces:")] + "forces:\n"
    scene_from_text(text)
    assert accepts(text)


HEAD = text_of("rig_force_scenes.yaml")
SPRING = "type: torsional_spring_damper, joint: hinge, stiffness: 5, damping: 1, rest_angle: -20"
MOTOR = "type: motor, joint: hinge, torque: -5, rate_limit: 100"
SERVO = "type: servo, joint: hinge, stiffness: 5, damping: 1, position: -20, velocity: 3, effort_limit: 7"
DRAG = "type: drag, body: a, linear: 1, quadratic: 2, angular: 3, angular_quadratic: 4"
PUSH = (
    "type: applied_wrench, body: b, force: [1, 2, 3], torque: [4, 5, 6], point: [7, 8, 9], "
    "axes: world, start: 0.25, end: 0.75"
)


def scene_with(force):
    return scene_from_text(HEAD + f"  - {{name: it, {force}}}\n", source="x.yaml")


def test_every_number_of_a_force_reaches_the_model():
    def row(force):
        scene = scene_with(force)
        again = scene_from_text(scene.model_copy(update={}).text)
        assert again.model_dump() == scene.model_dump()
        forces = build_model(scene)[0].forces
        (found,) = (rows[0] for rows in (forces.joint_law, forces.drag) if len(rows))
        return found

    keys = ("slides", "parent", "child", "group", "angle", "target", *LAW)
    for force, (group, angle, target), law in (
        (SPRING, (0, 0, -1), (0, 5, 1, -20, 0, math.inf)),
        (MOTOR, (1, -1, -1), (-5, 0, 0.05, 0, 0, math.inf)),
        (MOTOR.replace(", rate_limit: 100", ""), (1, -1, -1), (-5, 0, 0, 0, 0, math.inf)),
        (SERVO, (2, 0, 0), (0, 5, 1, -20, 3, 7)),
    ):
        assert [row(force)[key] for key in keys] == [0, 0, 1, group, angle, target, *law]
    assert row(DRAG).tolist() == (0, 1, 2, 3, 4)
    ((start, end, push),) = make_layout(scene_with(PUSH)).commands
    assert (push.axes, push.name, start, end) == ("world", "b", 0.25, 0.75)
    assert (push.values, push.point) == ((4.0, 5.0, 6.0, 1.0, 2.0, 3.0), (7.0, 8.0, 9.0))
    ((start, end, push),) = make_layout(scene_with("type: applied_wrench, body: b")).commands
    assert (push.axes, push.point, start, end) == ("body", None, 0.0, math.inf)


def test_a_joint_force_in_a_scene_without_joints_is_refused():
    text = HEAD[: HEAD.index("joints:")] + f"forces:\n  - {{name: it, {MOTOR}}}\n"
    with pytest.raises(SceneError, match="joint 'hinge' is not a joint; the scene has no joints"):
        scene_from_text(text)


PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "python.md"


def test_all_code_blocks_of_the_python_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pieces = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(pieces) == 11
    names = {}
    for piece in pieces:
        exec(compile(piece, str(PAGE), "exec"), names)
    said = capsys.readouterr().out
    assert "no_such_scene" in said and "smaller step" in said
    # The same second of the same pendulum: rkmk4 at 1 ms is off by 1e-9 or so.
    runs = [names[name].sample().positions["arm"] for name in ("exact", "adaptive", "product")]
    assert np.ptp(runs, axis=0).max() < 1e-7
    assert load_scene("rod.yaml").bodies == names["pendulum"].bodies
    assert names["facts"]["degrees_of_freedom"] == 3
