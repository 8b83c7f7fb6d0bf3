# SPDX-License-Identifier: Apache-2.0
"""Energy balance and curves of the joints in an analysis, against closed forms."""

import math

import numpy as np
import pytest
from scene_files import filled, text_of

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.recording import read
from liegroup_sim_ros.recording.read import read_recording
from liegroup_sim_ros.recording.write_run import LogFile
from liegroup_sim_ros.report.plots import JOINT_PLOTS, PARTS, make_plots
from liegroup_sim_ros.report.summary import balance_table

MASS, SPEED, G, END = 2.0, 1.0, 9.81, 3.0  # kg, m/s, m/s^2, s
K, C = 8.0, 0.4  # N/m, N s/m
SLIDE = text_of("slide.yaml")
FORCE = "forces:\n  - {{name: acts, type: {}}}"


def oscillation(time):
    """(position, velocity) of a damped oscillator from rest position with SPEED."""
    decay, wave = C / (2.0 * MASS), math.sqrt(K / MASS - (C / (2.0 * MASS)) ** 2)
    x = SPEED / wave * np.exp(-decay * time) * np.sin(wave * time)
    return x, np.exp(-decay * time) * SPEED * np.cos(wave * time) - decay * x


def kinetic(speed):
    return 0.5 * MASS * speed**2


LAST, LAST_SPEED = oscillation(END)
# Work by closed forms: (term, gravity, joint, force, command, J).
CASES = {
    "damper": (
        "dampers",
        {"more": FORCE.format(f"linear_spring_damper, joint: rail, stiffness: {K}, damping: {C}")},
        kinetic(LAST_SPEED) + 0.5 * K * LAST**2 - kinetic(SPEED),
    ),
    "servo": (
        "servos",
        {"more": FORCE.format(f"linear_servo, joint: rail, stiffness: {K}, damping: {C}")},
        kinetic(LAST_SPEED) - kinetic(SPEED),
    ),
    "motor": (
        "motors",
        {"more": FORCE.format("linear_motor, joint: rail, force: 3.0")},
        3.0 * (SPEED * END + 0.5 * 3.0 / MASS * END**2),
    ),
    "drag": (
        "drag",
        {"more": FORCE.format("drag, body: block, linear: 0.4")},
        kinetic(SPEED * math.exp(-0.4 / MASS * END)) - kinetic(SPEED),
    ),
    "law": (
        "laws",
        {"more": FORCE.format("law, signals: {f: 3*cos(2*t)}, outputs: [{joint: rail, effort: f}]")},
        kinetic(SPEED + 1.5 / MASS * math.sin(2.0 * END)) - kinetic(SPEED),
    ),
    "wrench of the scene": (
        "wrenches",
        {"more": FORCE.format("applied_wrench, body: block, force: [3, 0, 0], start: 0.1234, end: 1.2345")},
        kinetic(SPEED + 3.0 / MASS * 1.1111) - kinetic(SPEED),
    ),
    "commanded wrench": (
        "wrenches",
        {"wrench": dict(wrench=(0, 0, 0, 3.0, 0, 0), start=0.1234, duration=1.1111, axes="world", point=(0, 0.1, 0))},
        kinetic(SPEED + 3.0 / MASS * 1.1111) - kinetic(SPEED),
    ),
    "drive against gravity": ("driven joints", {"gravity": -G, "joint": ", driven: true"}, MASS * G * SPEED * END),
    "friction": (
        "stops and friction",
        {"joint": ", friction: {coulomb: 0.8, static: 0.9}"},  # at rest after 2.5 s
        -kinetic(SPEED),
    ),
    "friction with a rotor": (  # that adds 1 kg; at rest after 3.75 s
        "stops and friction",
        {"joint": ", friction: {coulomb: 0.8, static: 0.9}, rotor: {inertia: 0.01, ratio: 10}"},
        -0.8 * (SPEED * END - 0.5 * 0.8 / (MASS + 1.0) * END**2),
    ),
    "contact": (  # a spring of 0.5 N/m and 0.5 rad/s, which is 1.1 m deep at the start
        "contacts",
        {
            "more": FORCE.format(
                "contact, body: block, plane: {point: [-1, 0, 0], normal: [-1, 0, 0]}, stiffness: 0.5, damping: 0, "
                "shape: {type: sphere, radius: 0.1}"
            )
        },
        -0.25 * ((1.1 * math.cos(0.5 * END) + SPEED / 0.5 * math.sin(0.5 * END)) ** 2 - 1.1**2),
    ),
    "impact": ("impacts", {"joint": ", limits: {upper: 0.5123, restitution: 0.6}"}, -(1.0 - 0.36) * kinetic(SPEED)),
}


def analysed(path, scene, wrench=None, seconds=END, faster_from=math.inf, method="rkmk8"):
    """Analysis of a run that is recorded every 10 ms; from a time in s on, a tenth is added to the twists."""
    simulation = Simulation(scene, method, 1e-3, estimate=False)
    if wrench:
        simulation.apply_wrench("block", **wrench)
    with LogFile(path, simulation, 10, 0) as file:
        file.sample(simulation.sample())
        for _ in range(round(seconds * 100)):
            simulation.advance(10)
            sample = simulation.sample()
            sample.twist = sample.twist * (1.1 if sample.time > faster_from else 1.0)
            file.sample(sample)
        file.finish(simulation, None, False, 1.0)
    return analyse(read_recording(path), reference=False)


@pytest.mark.parametrize("piece", [read.PIECE, 1])
@pytest.mark.parametrize("case", CASES)
@pytest.mark.volume(8)
def test_work_is_that_of_the_closed_form(tmp_path, monkeypatch, case, piece):
    """One term each; the others are zero, and the balance closes, also if the samples come in several blocks."""
    monkeypatch.setattr(read, "PIECE", piece)
    term, given, expected = CASES[case]
    given = {"gravity": 0, "joint": "", "more": "", "speed": SPEED} | given
    wrench = given.pop("wrench", None)
    figures = analysed(tmp_path / "a.mcap", scene_from_text(filled(SLIDE, **given)), wrench).figures
    balance = figures["balance"]
    work = balance["work_J"]
    # A sine of w = 4 rad/s (the power of an oscillation of 2 rad/s) sampled every h = 10 ms has, between
    # quintic splines, relative errors of (w h)^6 = 4e-9; energies are of the order of 1 to 60 J.
    error = 1e-8
    assert work[term] == pytest.approx(expected, abs=error)
    assert all(value == pytest.approx(0.0, abs=1e-12) for name, value in work.items() if name != term)
    assert abs(balance["remainder_J"]) <= error and not any("add up" in text for text in figures["problems"])
    change = sum(entry["end_J"] - entry["start_J"] for entry in balance["stored"])
    assert change - sum(work.values()) == pytest.approx(balance["remainder_J"], abs=1e-12)
    assert ("does not add up by", "", "", f"{balance['remainder_J']:.6g} J") in balance_table(balance).rows or (
        balance["remainder_J"] == 0.0
    )


@pytest.mark.parametrize("piece", [read.PIECE, 1])
def test_work_between_samples_that_are_too_far_apart(tmp_path, monkeypatch, piece):
    """A servo of 2e4 N/m that saturates at 60 N, or 3 mm, which the block passes within 6 ms; samples are 10 ms apart.

    Each of the 4 kinks of a period of 140 ms changes the slope of the power by k v^2 < 2e4 W/s. A spline through states
    every 1/64 ms errs by 2e4 (1.6e-5)^2 / 12, or 4e-7 J there: by 4e-6 J at the 8 kinks of 0.25 s.
    """
    monkeypatch.setattr(read, "PIECE", piece)
    force = FORCE.format("linear_servo, joint: rail, stiffness: 2.0e+4, effort_limit: 60")
    scene = scene_from_text(filled(SLIDE, gravity=0, joint="", more=force, speed=SPEED))
    balance = analysed(tmp_path / "a.mcap", scene, seconds=0.25, method="rkmk853").figures["balance"]
    # The method with error control keeps 1e-9 in a step; the energy of 1 J has that of 250 steps.
    assert abs(balance["remainder_J"]) < 4e-6 + 250e-9
    assert balance["quadrature_J"] < 1e-3 * kinetic(SPEED)
    assert balance["work_J"]["servos"] == pytest.approx(balance["stored"][0]["end_J"] - kinetic(SPEED), abs=5e-6)


def test_energy_that_no_work_explains_is_a_problem(tmp_path):
    """A block with drag gets a tenth more speed at 1.5 s, so its energy jumps by 21 %."""
    scene = scene_from_text(filled(SLIDE, gravity=0, joint="", speed=SPEED, **CASES["drag"][1]))
    figures = analysed(tmp_path / "a.mcap", scene, faster_from=1.5).figures
    jump = 0.21 * kinetic(SPEED * math.exp(-0.4 / MASS * 1.51))
    # The work between the samples around the jump is known to about its power, 0.4 N s/m v^2, times 10 ms.
    assert figures["balance"]["largest_J"] == pytest.approx(jump, abs=0.4 * SPEED**2 * 0.01)
    assert 0.0 < figures["balance"]["quadrature_J"] < 0.1 * jump
    (text,) = [text for text in figures["problems"] if "the energy does not add up by" in text]
    assert f"by {figures['balance']['largest_J']:.3g} J, above the estimated error of the work" in text


def test_the_balance_of_a_conservative_scene_is_its_energy_drift(tmp_path):
    """Both are the change of the recorded energy."""
    text = filled(
        SLIDE, gravity=0, joint="", speed=1, more=FORCE.format(f"linear_spring_damper, joint: rail, stiffness: {K}")
    )
    figures = analysed(tmp_path / "a.mcap", scene_from_text(text)).figures
    assert figures["balance"]["remainder_J"] == pytest.approx(figures["energy"]["final_J"], rel=1e-12)
    assert figures["balance"]["largest_J"] == pytest.approx(figures["energy"]["drift_J"], rel=1e-12)
    assert figures["balance"]["quadrature_J"] == 0.0


def test_curves_of_a_joint_are_those_of_the_closed_form(tmp_path):
    """Position, velocity, effort and power of a servo that oscillates; units on the axes."""
    more = FORCE.format(f"linear_servo, joint: rail, stiffness: {K}, damping: {C}")
    scene = scene_from_text(filled(SLIDE, gravity=0, joint="", speed=SPEED, more=more))
    analysis = analysed(tmp_path / "a.mcap", scene)
    times, _, values = analysis.columns([f"rail.{part}" for part in PARTS])
    x, v = oscillation(times)
    effort = -K * x - C * v
    assert values == pytest.approx(np.stack([x, v, effort, effort * v], axis=1), abs=1e-9)
    drawn = {
        title: (plot["layout"]["yaxis"]["title"]["text"], plot["data"][0]["y"])
        for title, _, plot in make_plots(analysis, ["positions"])
        if "pick" in plot
    }
    axes = "m", "m/s", "N", "W"
    assert [drawn[f"Joint {name}"][0] for name in ("displacements", "velocities", "forces", "powers")] == [*axes]
    assert drawn["Body x"][1] == pytest.approx(x.tolist(), abs=1e-4)


def test_all_signals_of_a_law_are_one_plot(tmp_path):
    """A force of a velocity is drawn at its joint, a sine at its times; a law without signals has no plot."""
    more = """
forces:
  - {name: feed, type: law, inputs: {v: rail.velocity}, signals: {wave: 0.3*sin(2*t), rate: v - wave},
     outputs: [{joint: rail, effort: -2*v}]}
  - {name: push, type: law, outputs: [{body: block, force: [0, 1, 0]}]}"""
    scene = scene_from_text(filled(SLIDE, gravity=0, joint="", speed=SPEED, more=more))
    plots = {title: plot for title, _, plot in make_plots(analysed(tmp_path / "a.mcap", scene), ["signals"])}
    assert [title for title in plots if title.startswith("Law")] == ["Law feed"]
    curves = {trace["name"]: np.array(trace["y"]) for trace in plots["Law feed"]["data"]}
    times = np.array(plots["Law feed"]["data"][0]["x"])
    assert [*curves] == ["wave", "rate"] and plots["Law feed"]["pick"] == "Signals"
    assert curves["wave"] == pytest.approx(0.3 * np.sin(2.0 * times), abs=1e-5)
    v = SPEED * np.exp(-2.0 / MASS * times)
    assert curves["rate"] == pytest.approx(v - 0.3 * np.sin(2.0 * times), abs=1e-5)
    assert plots["Joint forces"]["data"][0]["y"] == pytest.approx((-2.0 * v).tolist(), abs=1e-4)


@pytest.mark.turn(3)
def test_many_joints_are_drawn_a_few_at_a_time_and_angles_without_jumps(tmp_path):
    """Of 40 hinges that turn at different rates the six fastest are visible; a full turn is a gap."""
    bodies = "".join(
        f"  - {{name: b{k}, mass: 1.0, inertia: [0.1, 0.1, 0.1], angular_velocity: [0, 0, {0.1 * k}]}}\n"
        for k in range(40)
    )
    joints = "".join(
        f"  - {{name: j{k}, type: revolute, parent: world, child: b{k}, child_frame: {{}}}}\n" for k in range(40)
    )
    scene = scene_from_text(f"name: many\ngravity: [0, 0, 0]\nbodies:\n{bodies}joints:\n{joints}")
    plots = {title: plot for title, _, plot in make_plots(analysed(tmp_path / "a.mcap", scene))}
    assert not {"Joint torques", "Joint forces"} & set(plots)
    traces = plots["Joint angles"]["data"]
    assert len(traces) == 40 and not any(trace["showlegend"] for trace in traces)
    assert len([trace["name"] for trace in traces if trace["visible"]]) == 6
    assert len({title for title, _ in JOINT_PLOTS.values()}) == len(JOINT_PLOTS)
    fastest = traces[39]["y"]  # 3.9 rad/s for 3 s: from 0 to pi, and from -pi on
    assert fastest.count(None) == 2 and max(abs(y) for y in fastest if y is not None) <= math.pi


def test_contacts_have_a_plot_for_each_unit(tmp_path):
    """Force, depth and work of a contact do not share an axis. The way to the plane is no depth."""
    scene = scene_from_text(filled(SLIDE, gravity=0, joint="", speed=-SPEED, **CASES["contact"][1]))
    simulation = Simulation(scene, "rkmk8", 1e-3, estimate=False)
    with LogFile(tmp_path / "a.mcap", simulation, 300, 0) as file:
        for _ in range(5):
            file.sample(simulation.sample())
            simulation.advance(300)
        file.finish(simulation, None, False, 1.0)
    plots = {
        title: plot for title, _, plot in make_plots(analyse(read_recording(tmp_path / "a.mcap"), reference=False))
    }
    shown = {title: plot for title, plot in plots.items() if title.startswith(("Contact", "Law"))}
    units = {title: plot["layout"]["yaxis"]["title"]["text"] for title, plot in shown.items()}
    assert units == {"Contact acts: normal force": "N", "Contact acts: depth": "m", "Contact acts: work": "J"}
    (trace,) = shown["Contact acts: depth"]["data"]
    depths = [1.1 * math.cos(0.15 * k) - SPEED / 0.5 * math.sin(0.15 * k) for k in range(5)]
    assert trace["name"] == "acts" and trace["y"] == [pytest.approx(d, rel=1e-4) if d >= 0.0 else None for d in depths]
    assert trace["y"][-1] is None
