# SPDX-License-Identifier: Apache-2.0
"""Random scenes of joints, bodies and forces of many kinds, through the commands: an answer, or one line that says why.

A run repeats to the bit, and its free motion needs no efforts.
"""

import json

import numpy as np
import pytest
from random_scenes import scene_of
from volume import some

from liegroup_sim_ros.commands.main import main


@pytest.mark.parametrize("seed", some(range(5000), 3))
def test_commands_answer_or_say_why_in_a_line(seed, tmp_path, capsys):
    rng = np.random.default_rng([seed, 88])
    scene, run, table = tmp_path / "scene.yaml", tmp_path / "run.mcap", tmp_path / "run.csv"
    scene.write_text(scene_of(rng))

    def told(*arguments):
        code, (out, error) = main(list(map(str, arguments))), capsys.readouterr()
        lines = [line for line in error.splitlines() if line.startswith("liegroup_sim")]
        assert code == 0 or (code in (1, 2) and len(lines) == 1), (arguments, code, error)
        return out if code == 0 else None

    if told("describe", scene) is None:
        return
    assert told("run", scene, "--duration", "0.2", "--rate", "200", "--reactions", "--out", run) is not None
    told(
        "run",
        scene,
        "--duration",
        "0.05",
        "--out",
        table,
        "--columns",
        "states",
        "joints",
        "reactions",
        "sensors",
        "forces",
    )
    assert told("analyze", run, "--json", tmp_path / "run.json", "--html", tmp_path / "run.html") is not None
    (log,) = json.loads((tmp_path / "run.json").read_text())["logs"]
    assert log["repeat"]["identical"] == log["samples"] and log["promise"]["kept"] is not False
    for command in ("linearise", "modes", "trim"):
        told(command, scene)
    told("linearise", scene, "--outputs", "a.x", "--at", "0.05", "--json")
    told("sensitivities", scene, "--by", "a.mass", "--of", "a.x", "--at", "0.05")
    told("run", scene, "--method", "rkmk4", "--step", "1e-3", "--duration", "0.05", "--out", tmp_path / "run.npz")
    if efforts := told("inverse", scene, "--motion", run, "--json"):
        answer = json.loads(efforts)
        largest = max(joint["peak_effort"] for joint in answer["joints"])
        # Four bodies of 3 kg within 2 m have about 50 kg m^2; `sampling` is what is not known of their accelerations.
        assert answer["residual"] < 1e-6 and largest <= 50.0 * answer["sampling"] + 1e-6
