# SPDX-License-Identifier: Apache-2.0
"""Random scenes of joints, bodies and forces of many kinds, through the commands: an answer, or one line that says why.

A run repeats to the bit, and its free motion needs no efforts.
"""

import json

import numpy as np
import pytest
import yaml
from mechanisms import mechanism
from volume import some

from liegroup_sim_ros.commands.main import main

ALONG = ["revolute", "prismatic", "screw"]  # one coordinate
KINDS = [*ALONG, "revolute", "spherical", "cylindrical", "universal", "planar", "fixed", None]
# Keys of a joint with one coordinate; forces of a joint, and of a body.
KEYS = """
- {friction: {coulomb: 0.3, static: 0.4, viscous: 0.1}}
- {rotor: {inertia: 1e-3, ratio: 10}}
- {limits: {lower: -40, upper: 40, restitution: 0.4}}
- {limits: {lower: -40, upper: 40, stiffness: 100, damping: 1}}
- {driven: true}
- {}
- {}
"""
ON_JOINTS = """
- {type: law, parameters: {k: 3}, states: {z: {rate: q - z}}, outputs: [{joint: J, effort: "-k*z - w"}]}
- {type: law, parameters: {k: 3}, period: 0.01, delay: 3e-3, signals: {u: -k*q}, outputs: [{joint: J, effort: u}]}
- {type: law, parameters: {k: 3}, outputs: [{joint: J, effort: "-k*max(q, 0) + (1 if t > 0.05 else 0)"}]}
- {type: law, tables: {f: {x: [-1, 0, 1], y: [1, 0, -2]}}, outputs: [{joint: J, effort: f(q) - w}]}
- {type: law, outputs: [{joint: J, effort: "-0.3*((w > 0) - (w < 0))"}]}
- null
"""
ON_BODIES = """
- {type: contact, shape: {type: sphere, radius: 0.1}, sinks: 1e-3, restitution: 0.3}
- {type: contact, shape: {type: box, size: [0.2, 0.2, 0.2]}, sinks: 1e-3, restitution: 0.3, friction: 0.5}
- {type: drag, linear: 0.3, quadratic: 0.1}
- {type: applied_wrench, force: [1, 0, 2], start: 0.013, end: 0.0571, axes: world}
- null
"""
MASSLESS = {"name": "bob", "mass": 0.3, "inertia": [0, 0, 0]}
HELD = ["prismatic, child_frame: {}", "universal, child_frame: {position: [0, 0, 1]}"]


def scene_of(rng):
    """Text of a random scene."""
    names = "abcd"[: rng.integers(1, 5)]
    links = [
        ("world" if k == 0 else names[rng.integers(k)], name, KINDS[rng.integers(10)]) for k, name in enumerate(names)
    ]
    found = yaml.safe_load(mechanism(rng, links, springs=int(rng.integers(3))).text)
    forces, is_driven = list(found.get("forces") or []), False

    def drawn(table):
        options = yaml.safe_load(table)
        return options[rng.integers(len(options))]

    for joint in found.get("joints") or []:
        if joint["type"] in ALONG:
            keys = drawn(KEYS)
            joint |= keys if not (is_driven and "driven" in keys) else {}
            is_driven |= "driven" in keys
            if law := drawn(ON_JOINTS.replace("J", joint["name"])):
                inputs = {"q": f"{joint['name']}.position", "w": f"{joint['name']}.velocity"}
                forces.append({"name": f"law_{joint['name']}", "inputs": inputs} | law)
    for k, body in enumerate(found["bodies"]):
        if force := drawn(ON_BODIES):
            plane = {"plane": {"point": [0, 0, body["position"][2] - 0.2]}} if force["type"] == "contact" else {}
            forces.append({"name": f"f{k}", "body": body["name"]} | force | plane)
    if rng.random() < 0.4:
        found["bodies"].append(MASSLESS)
        held = yaml.safe_load(f"{{name: jb, parent: world, child: bob, type: {HELD[rng.integers(2)]}}}")
        found["joints"] = [*(found.get("joints") or []), held]
    return yaml.safe_dump(found | {"forces": forces})


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
