# SPDX-License-Identifier: Apache-2.0
"""`liegroup_sim linearise`, `modes`, `trim` and `inverse`: the commands of docs/how-to/linear.md, and wrong input."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from liegroup_core import Simulation
from liegroup_core.linear import linearise, modes_of
from liegroup_core.scene.load import load_scene
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.view.shapes_of_modes import COUNT, PERIODS, Modes

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "linear.md"


def answer(capsys, *arguments):
    """JSON that a command prints."""
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.turn(2)
def test_all_commands_of_the_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    commands = [
        shlex.split(line)
        for block in re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.S)
        for line in block.splitlines()
    ]
    assert len(commands) == 7
    for command in commands:
        assert command[0] == "liegroup_sim" and main(command[1:]) == 0, capsys.readouterr().err
    printed = capsys.readouterr().out
    assert "72.4404" in printed and "bearing" in printed
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    exec(program.replace("plant = system.to_control()", "plant = system"), {})  # python-control may be missing
    assert json.loads((tmp_path / "four_bar.json").read_text())["states"] == ["crank_coupler", "crank_coupler.rate"]


def test_a_recording_gives_the_states_of_its_run(tmp_path, capsys):
    """At a step and between two steps, with the error of the poles; and again from the scene."""
    path = tmp_path / "run.mcap"
    assert main(["run", "four_bar", "--duration", "0.2", "--rate", "300", "--out", str(path)]) == 0
    capsys.readouterr()
    recorded = answer(capsys, "linearise", str(path), "--at", "0.1", "0.1234", "--independent", "ground_crank")
    direct = answer(capsys, "linearise", "four_bar", "--at", "0.1", "0.1234", "--independent", "ground_crank")
    for one, other in zip(recorded, direct):
        np.testing.assert_allclose(one["A"], other["A"], rtol=1e-7)
        assert all(0.0 < error < 1e-4 for error in one["pole_errors"])
    simulation = Simulation(load_scene("four_bar"), accuracy=1e-12, quiet=True)
    simulation.advance_to(0.1234)
    exact = linearise(simulation, independent=["ground_crank"], time=0.1234)
    poles = np.array([complex(*pole) for pole in recorded[1]["poles"]])
    assert (np.abs(poles - exact.poles) <= recorded[1]["pole_errors"]).all()


@pytest.mark.turn(3)
def test_free_motion_needs_no_efforts_and_coarse_samples_say_so(tmp_path, capsys):
    for rate in (3000, 100):
        path = tmp_path / f"{rate}.mcap"
        assert main(["run", "four_bar", "--duration", "0.5", "--rate", str(rate), "--out", str(path)]) == 0
    capsys.readouterr()
    assert main(["inverse", "four_bar", "--motion", str(tmp_path / "100.mcap")]) == 0
    assert "the times are too far apart for accelerations" in capsys.readouterr().err
    fine = answer(capsys, "inverse", "four_bar", "--motion", str(tmp_path / "3000.mcap"))
    coarse = answer(capsys, "inverse", "four_bar", "--motion", str(tmp_path / "100.mcap"))
    assert fine["joints"][0]["peak_effort"] < 1e-3 < coarse["joints"][0]["peak_effort"]
    assert fine["sampling"] < 1.0 < coarse["sampling"]


def test_the_energy_of_efforts_is_that_of_the_mechanism(tmp_path, capsys):
    """A pendulum that is turned up by half a turn and stopped gains 2 m g l."""
    scene = tmp_path / "arm.yaml"
    scene.write_text(
        "name: arm\ngravity: [0, 0, -9.81]\nbodies: [{name: rod, mass: 2.0, inertia: [0.1, 0.1, 0.01], "
        "position: [0, 0, -0.5]}]\njoints: [{name: pin, type: revolute, parent: world, child: rod, child_frame: "
        "{position: [0, 0, 0.5], rotation_vector: [-1.5707963267948966, 0, 0]}}]\n"
    )
    times = np.linspace(0.0, 2.0, 401)
    s = times / 2.0
    angle = np.pi * (10 * s**3 - 15 * s**4 + 6 * s**5)
    table = tmp_path / "motion.csv"
    rows = "".join(f"{t!r},{q!r}\n" for t, q in zip(times.tolist(), angle.tolist()))
    table.write_text("time [s],pin.position [rad]\n" + rows)
    out = tmp_path / "efforts.csv"
    found = answer(capsys, "inverse", str(scene), "--motion", str(table), "--out", str(out))
    assert found["joints"][0]["energy_J"] == pytest.approx(2.0 * 2.0 * 9.81 * 0.5, rel=1e-6)
    efforts = np.genfromtxt(out, delimiter=",", skip_header=1)
    accelerations = np.pi / 4.0 * (60 * s - 180 * s**2 + 120 * s**3)
    expected = (0.1 + 2.0 * 0.25) * accelerations + 2.0 * 9.81 * 0.5 * np.sin(angle)
    assert np.abs(efforts[5:-5, 1] - expected[5:-5]).max() < 1e-5
    assert main(["inverse", str(scene), "--motion", str(table), "--out", str(out)]) == 2


def test_trim_writes_the_system_of_the_equilibrium(tmp_path, capsys):
    held = ["--hold", "shoulder", "elbow", "--inputs", "shoulder.effort", "elbow.effort"]
    answer(capsys, "trim", "double_pendulum", *held, "--out", str(tmp_path / "held.json"))
    system = json.loads((tmp_path / "held.json").read_text())
    assert system["inputs"] == ["shoulder.effort", "elbow.effort"]
    assert np.abs(system["slope"]).max() < 1e-8


def test_a_motion_that_the_inputs_cannot_make_is_no_success(tmp_path, capsys):
    """A double pendulum at rest, level: a shoulder without an elbow cannot hold it."""
    path = tmp_path / "rest.csv"
    path.write_text("time,shoulder.position,elbow.position\n" + "".join(f"{k},0,0\n" for k in range(8)))
    command = ["inverse", "double_pendulum", "--motion", str(path)]
    assert main(command) == 0 and capsys.readouterr().err == ""
    assert main([*command, "--inputs", "shoulder.effort"]) == 1
    assert capsys.readouterr().err.startswith("double_pendulum: these inputs cannot make this motion")


def test_multipliers_of_a_run(capsys):
    """The product of the multipliers is the change of volume; a door that starts at its stop has none."""
    found = answer(capsys, "modes", "double_pendulum", "--period", "0.5")
    product = np.prod([complex(*pair) for pair in found["multipliers"]])
    assert product.real == pytest.approx(np.linalg.det(found["transition"]), rel=1e-9) and found["error"] < 1e-9
    assert main(["modes", "door", "--period", "5"]) == 1
    assert "runs to both sides behave differently" in capsys.readouterr().err


def test_friction_gives_intervals_of_inputs(capsys):
    """A block on a belt: 3 N of friction at rest."""
    found = answer(capsys, "trim", "stick_slip", "--inputs", "contact.effort")
    assert found["intervals"]["contact.effort"] == pytest.approx([-3.0, 3.0], abs=1e-9)
    assert found["stability"] is None and not found["steady"]  # the belt moves
    assert main(["trim", "stick_slip", "--inputs", "contact.effort"]) == 0
    text = capsys.readouterr().out
    assert "contact.effort = 0  rests from -3 to 3" in text and "stable" not in text


def test_an_interval_without_an_end_is_told_from_one_that_was_not_found(tmp_path, capsys):
    """A horizontal rod on its stop: any effort downwards, and up to its weight."""
    scene = tmp_path / "stop.yaml"
    scene.write_text(
        "name: stop\ngravity: [0, 0, -9.81]\nbodies: [{name: rod, mass: 1.5, inertia: [0.1, 0.2, 0.1], "
        "position: [0.6, 0, 0]}]\njoints: [{name: hinge, type: revolute, parent: world, child: rod, "
        "parent_frame: {axis: [0, 1, 0]}, limits: {upper: 0}}]\n"
    )
    found = answer(capsys, "trim", str(scene), "--inputs", "hinge.effort")
    assert found["intervals"]["hinge.effort"] == [pytest.approx(-1.5 * 9.81 * 0.6, rel=1e-12), "inf"]


def test_servos_drive_a_robot_steadily_from_rest(capsys):
    """Their targets start at the given rates, at which they do not saturate. Positions cannot be found like that."""
    wheels = ["trim", "diff_drive", "--rates", "left=5", "right=3", "--inputs"]
    found = answer(capsys, *wheels, "left.target_velocity", "right.target_velocity")
    assert found["steady"] and list(found["inputs"].values()) == pytest.approx([5.0, 3.0], abs=0.05)
    assert main([*wheels, "left.target", "right.target"]) == 1
    assert "left.target, right.target have no effect there, as with a servo at its limit" in capsys.readouterr().err


def test_a_falling_body_has_no_equilibrium(tmp_path, capsys):
    scene = tmp_path / "falling.yaml"
    scene.write_text("name: f\ngravity: [0, 0, -9.81]\nbodies: [{name: b, mass: 1.0, inertia: [1, 1, 1]}]\n")
    assert main(["trim", str(scene)]) == 1
    error = capsys.readouterr().err
    assert "no equilibrium near the state" in error and "rates" not in error
    scene.write_text(scene.read_text().replace("inertia: [1, 1, 1]", "inertia: [1, 1, 1], linear_velocity: [1, 0, 0]"))
    assert main(["trim", str(scene)]) == 1
    assert "the state moves: name rates that stay constant" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["four_bar", "double_pendulum", "bicycle"])
def test_shapes_of_modes_move_and_stay_closed(name):
    """The frames of the page: half a period later the shape is on the other side, to second order."""
    simulation = Simulation(load_scene(name), "rkmk4", 1e-3, estimate=False, quiet=True)
    simulation.advance(20)
    shown = [mode for mode in modes_of(linearise(simulation, [], [])) if mode.pole != 0.0]
    source = Modes(simulation, shown, [f"mode {k}" for k in range(len(shown))])
    frames = source.history.frames
    assert len(frames) == len(shown) * PERIODS * COUNT and [text for *_, text in source.events()][0] == "mode 0"
    middle = simulation.sample().pose
    for k in range(len(shown)):
        one, other = (frames[k * PERIODS * COUNT + at].sample for at in (0, COUNT // 2))
        moved = [each.pose - middle for each in (one, other)]
        assert 0.05 < np.abs(moved[0]).max() and np.abs(moved[0] + moved[1]).max() < 0.7 * np.abs(moved[0]).max()
        assert max(one.joint_residuals.values()) < 1e-12


@pytest.mark.parametrize("joint", ["fixed, parent: world", "revolute, driven: true, parent: world"])
def test_a_scene_without_freedom(joint, tmp_path, capsys):
    """It has no states, it stands, and nothing of it changes with its numbers."""
    scene, run = tmp_path / "held.yaml", tmp_path / "run.mcap"
    body, ends = "{name: a, mass: 1, inertia: [1, 1, 1]}", "child: a, child_frame: {}"
    head = f"name: held\ngravity: [0, 0, -9.81]\nbodies: [{body}]\n"
    scene.write_text(f"{head}joints: [{{name: j, type: {joint}, {ends}}}]\n")
    assert answer(capsys, "linearise", str(scene))["A"] == answer(capsys, "modes", str(scene))["modes"] == []
    assert answer(capsys, "trim", str(scene))["stability"] == "stable"
    by_mass = answer(capsys, "sensitivities", str(scene), "--by", "a.mass", "--of", "a.x", "--at", "0.1")
    assert np.ravel(by_mass["derivatives"]).tolist() == [0.0]
    assert main(["run", str(scene), "--duration", "0.1", "--out", str(run)]) == 0
    assert main(["inverse", str(scene), "--motion", str(run)]) == 2
    assert "no joint moves freely: `liegroup_sim run --torques` has" in capsys.readouterr().err


@pytest.mark.parametrize("friction", ["", ", friction: 0.5, slip: 1e-3"])
def test_inverse_dynamics_of_a_tip_that_touches(friction, tmp_path, capsys):
    """A free motion on a plane needs no efforts; friction has states, whose past a motion does not give."""
    scene, run = tmp_path / "tip.yaml", tmp_path / "run.mcap"
    tip = "shape: {type: sphere, radius: 0.1, position: [0, 0, -1]}, plane: {point: [0, 0, -1.05]}"
    scene.write_text(
        "name: tip\ngravity: [0, 0, -9.81]\n"
        "bodies: [{name: a, mass: 1, inertia: [1, 1, 1], angular_velocity: [0, 1, 0]}]\n"
        "joints: [{name: j, type: revolute, parent: world, child: a, parent_frame: {axis: [0, 1, 0]}}]\n"
        f"forces: [{{name: floor, type: contact, body: a, {tip}, stiffness: 1000, damping: 1{friction}}}]\n"
    )
    assert main(["run", str(scene), "--duration", "0.1", "--rate", "3000", "--out", str(run)]) == 0
    assert main(["inverse", str(scene), "--motion", str(run)]) == (1 if friction else 0)
    told = capsys.readouterr()
    if friction:
        assert "at t = 0 s the states of floor act" in told.err
    else:
        assert main(["inverse", str(scene), "--motion", str(run), "--json"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert answer["joints"][0]["peak_effort"] <= 2.0 * answer["sampling"]
