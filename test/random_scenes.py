# SPDX-License-Identifier: Apache-2.0
"""Random scenes of joints, bodies and forces of many kinds."""

import yaml
from mechanisms import mechanism

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
