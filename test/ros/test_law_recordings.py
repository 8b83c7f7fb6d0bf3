# SPDX-License-Identifier: Apache-2.0
"""Recordings of runs with laws that have states: what they contain, their balance, and their replay."""

import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.scene.load import load_scene
from liegroup_sim_ros.analysis.analyse import analyse
from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.recording.read import read_recording

SCENE = text_of("pendulum_laws.yaml") + text_of("pid.yaml")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laws")
    scene, path = folder / "controlled.yaml", folder / "run.mcap"
    scene.write_text(SCENE)
    common = ["--method", "rkmk4", "--step", "1e-3", "--duration", "2", "--every", "2"]
    assert main(["run", str(scene), *common, "--out", str(path)]) == 0
    return scene, path


def test_the_states_are_in_the_samples(recorded):
    scene, path = recorded
    recording, simulation = read_recording(path), Simulation(load_scene(scene), "rkmk4", 1e-3, quiet=True)
    assert recording.settings["laws"] == ["pid.i", "pid.a"]
    found = np.concatenate([samples.laws for samples in recording.samples()])[:, :, 0]
    for row in found[:200]:
        assert row.tolist() == [simulation.sample().signals[name] for name in recording.settings["laws"]]
        simulation.advance(2)


def test_the_work_of_the_law_closes_the_balance_and_the_replay_has_the_same_bits(recorded):
    """The integral of the power between samples has an error of 1e-9 J, which it states."""
    figures = analyse(read_recording(recorded[1])).figures
    balance = figures["balance"]
    assert abs(balance["work_J"]["laws"]) > 0.1
    assert balance["largest_J"] < 1e-8 and balance["quadrature_J"] < 1e-8
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] == 1001
    assert figures["problems"] == []


SAMPLED = SCENE.replace(
    "  states: {i: {rate: e}, a: {start: 0.2, rate: (kp*e + ki*i - kd*w - a)/0.05}}\n",
    "  period: 0.02\n  delay: 0.05\n  states: {i: {update: i + 0.02*e}, a: {update: kp*e + ki*i - kd*w}}\n",
)


def test_a_sampled_law_is_recorded_and_its_balance_closes(tmp_path):
    """Samples have what acts; its power is smooth between its instants, at which every tenth sample is.

    The integral of smooth powers over 10 samples by splines of degree 5 has an error of 1e-9 J, which it states.
    """
    scene, path = tmp_path / "sampled.yaml", tmp_path / "run.mcap"
    scene.write_text(SAMPLED)
    assert main(["run", str(scene), "--method", "rkmk4", "--step", "1e-3", "--duration", "2", "--out", str(path)]) == 0
    recording, simulation = read_recording(path), Simulation(load_scene(scene), "rkmk4", 1e-3, quiet=True)
    names = recording.settings["laws"]
    assert names[:4] == ["pid.i", "pid.a", "pid.e", "pid.outputs[0].effort"] and len(names) == 7
    found = np.concatenate([samples.laws for samples in recording.samples()])[:, :, 0]
    for row in found[:200]:
        sample = simulation.sample()
        assert row[:3].tolist() == [sample.signals[name] for name in names[:3]]
        assert row[3] == sample.law_efforts["hinge"]
        simulation.advance()
    figures = analyse(recording).figures
    balance = figures["balance"]
    assert abs(balance["work_J"]["laws"]) > 0.1
    assert balance["largest_J"] < 1e-8 and balance["quadrature_J"] < 1e-8
    assert figures["repeat"]["identical"] == figures["repeat"]["samples"] == 2001
    reference = figures["reference"]
    assert reference["kind"] == "integration" and reference["seconds"] == 2.0 and reference["stopped"] is None
    assert figures["problems"] == []
