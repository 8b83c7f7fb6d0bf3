# SPDX-License-Identifier: Apache-2.0
"""Controllers in Python are called at exact times, and what they command repeats the run without them."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from liegroup_core import Simulation, load_scene
from liegroup_core.control import ControlError, read_setup, set_up
from liegroup_core.scene.parameters import ParameterError
from liegroup_core.study.sweep.sweep import Sweep, describe, described
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.playback.resimulate import resimulate
from liegroup_sim_ros.recording.read import read_recording

# PD of the shoulder at 1 kHz, and of the elbow with what it remembers at 30 Hz.
SOURCE = """
def pd(simulation):
    angle, rate = simulation.sample().joint_coordinates["shoulder"]
    simulation.apply_effort("shoulder", -3.0 * angle - 0.2 * rate)

def setup(simulation):
    total = 0.0

    def integral(simulation):
        nonlocal total
        total += simulation.sample().joint_coordinates["elbow"][0]
        simulation.apply_effort("elbow", -0.5 * total, source="integral")

    simulation.control(pd, 1e-3)
    simulation.control(integral, 1 / 30)
"""
SCENE = load_scene("double_pendulum")
RUNS = [{"method": "rkmk4", "step": 1e-3}, {"method": "rkmk8", "step": 7e-3, "estimate": False}, {}]


def state(simulation):
    return simulation.state()[0].tobytes() + simulation.state()[1].tobytes()


@pytest.mark.parametrize("settings", RUNS, ids=["steps of the period", "other steps", "accuracy"])
def test_times_are_exact_and_the_commands_repeat_the_run(settings):
    simulation, again = (Simulation(SCENE, **settings) for _ in range(2))
    times = {1e-3: [], 1 / 30: []}
    for period, found in times.items():
        simulation.control(lambda run, found=found: found.append(run.time_ns), period)
    set_up(simulation, SOURCE, "setup")
    for end in (0.0371, 0.0371, 0.1, 0.2):  # where a run stops does not matter
        simulation.advance_to(end)
    for period, found in times.items():
        exact = Fraction(period).limit_denominator(1000)
        assert found == [round(k * exact * 10**9) for k in range(200) if k * exact < Fraction(1, 5)]
    commands = simulation.drain_applied()
    assert len(commands) == 206
    for command in commands:
        command.repeat(again)
    again.advance_to(0.2)
    assert state(again) == state(simulation)


def test_a_state_that_is_set_is_controlled_from_its_time_on():
    simulation = Simulation(SCENE, **RUNS[1])
    times = []
    simulation.control(lambda run: times.append(run.time_ns), 0.01)
    simulation.advance_to(0.03)
    before = simulation.snapshot()
    simulation.advance_to(0.05)
    simulation.restore(before)
    simulation.advance_to(0.05)
    simulation.reset()
    simulation.advance_to(0.01)
    assert times == [10**7 * k for k in (0, 1, 2, 3, 4, 3, 4, 0)]


@pytest.mark.parametrize(("function", "period"), [("pd", 0.1), (print, 0.0), (print, np.nan), (print, "1")])
def test_wrong_controllers(function, period):
    with pytest.raises(ValueError, match="controller"):
        Simulation(SCENE, **RUNS[1]).control(function, period)


def test_the_commands_run_and_sweep_take_a_file(tmp_path, capsys):
    file, out = tmp_path / "pd.py", tmp_path / "run.mcap"
    file.write_text(SOURCE)
    arguments = ["double_pendulum", "--method", "rkmk4", "--step", "1e-3", "--duration", "0.2"]
    assert main(["run", *arguments, "--no-estimate", "--out", str(out), "--control", f"{file}:setup"]) == 0
    recording = read_recording(out)
    assert len(recording.inputs) == 206
    figures = resimulate(recording)
    assert figures["identical"] == figures["samples"] == 201
    given = {"settings": RUNS[0], "record": ["shoulder.position"], "control": read_setup(f"{file}:setup")}
    sweep = Sweep.of(SCENE, ["bodies.lower.mass=1:1.0001"], 2, 200, **given)
    (columns,) = sweep.run(range(2), workers=1)
    with pytest.raises(ControlError, match="a file of a sweep has no code"):
        described(describe(sweep)).simulation(0)
    assert SOURCE not in str(describe(sweep)) and describe(sweep) != describe(replace(sweep, control=("", "setup")))
    controlled = sweep.simulation(1)
    controlled.advance(200)
    assert columns["status"] == ["ok", "ok"]
    assert columns["shoulder.position"][1] == controlled.sample().joint_coordinates["shoulder"][0]
    free = Simulation(sweep.scene(1), **RUNS[0])
    free.advance(200)
    assert abs(columns["shoulder.position"][1] - free.sample().joint_coordinates["shoulder"][0]) > 1e-3
    with pytest.raises(ParameterError, match="--gradient or --control"):
        Sweep.of(SCENE, ["bodies.lower.mass=1:2"], 2, 200, gradient=["shoulder.position"], **given)


@pytest.mark.parametrize(("text", "message"), [("pd.py", "FILE.py:NAME"), ("nothing.py:pd", "cannot be read")])
def test_wrong_files(text, message):
    with pytest.raises(ControlError, match=message):
        read_setup(text)


def test_a_file_without_the_function():
    with pytest.raises(ControlError, match="pd.py: has no function other"):
        set_up(None, SOURCE, "other", "pd.py")
