# SPDX-License-Identifier: Apache-2.0
"""Events do not depend on forces that do no work, nor on units: scenes with stops and backlash, in seven variants."""

import copy

import numpy as np
import pytest
import yaml
from scene_files import text_of

from liegroup_core import Simulation
from liegroup_core.scene.load import scene_from_text

SCENES, DURATION = 45, 1.0
SIZES = {
    "prismatic": ("linear_spring_damper", "rest_position", 1.0),
    "revolute": ("torsional_spring_damper", "rest_angle", 0.1),
}
FRAMES = {"parent_frame": {}, "child_frame": {}}

# At t = 1.86 s the spring is without force while `a` leaves its stop, so all accelerations vanish with the effort.
TWO_MASS = text_of("two_mass.yaml")


def draw(seed):
    """(scene, type of its joints): a chain or parallel rails or shafts, with springs, stops, friction, backlash.

    Every spring has damping and no rest position is a stop: else a joint would graze its stop, or rest at it without
    force, and round-off would decide whether that is an event.
    """
    rng = np.random.default_rng(seed)
    kind = "prismatic" if rng.random() < 0.5 else "revolute"
    spring, rest, soft = SIZES[kind]
    bodies, joints, forces, couplings = [], [], [], []
    for i in range(int(rng.integers(2, 5))):
        mass = 10.0 ** rng.uniform(-1.0, 1.0)
        bodies.append({"name": f"b{i}", "mass": mass, "inertia": [mass * 10.0 ** rng.uniform(-3.0, -1.0)] * 3})
        q, rate = rng.uniform(-0.2, 0.2), rng.normal() if rng.random() < 0.7 else 0.0
        parent = "world" if i == 0 or rng.random() < 0.3 else f"b{i - 1}"
        joint = {
            "name": f"j{i}",
            "type": kind,
            "parent": parent,
            "child": f"b{i}",
            "coordinate": q,
            "rate": rate,
        } | FRAMES
        if rng.random() < 0.7:
            at_stop = rng.random() < 0.4
            lower = q if at_stop else q - rng.uniform(0.01, 0.2)
            joint["rate"] = max(rate, 0.0) if at_stop else rate
            joint["limits"] = {"lower": lower, "upper": lower + rng.uniform(0.21, 0.6)}
            if rng.random() < 0.5:
                joint["limits"]["restitution"] = rng.uniform(0.1, 0.8)
        if rng.random() < 0.2:
            joint["friction"] = {"coulomb": rng.uniform(0.1, 2.0) * soft}
        joints.append(joint)
        spring_of = {
            "name": f"s{i}",
            "type": spring,
            "joint": f"j{i}",
            "stiffness": 10.0 ** rng.uniform(1.0, 3.0) * soft,
        }
        forces.append(spring_of | {"damping": rng.uniform(0.01, 0.2) * soft, rest: q + rng.uniform(-0.1, 0.1)})
    if seed % 3 == 0:
        # Gears with backlash: the last shaft, on the world, and the first one.
        joints[-1]["parent"] = "world"
        joints[-1].pop("limits", None)
        joints[0].pop("limits", None)
        offset = joints[-1]["coordinate"] - 0.5 * joints[0]["coordinate"]
        couplings.append({"name": "gears", "joint": joints[-1]["name"], "other": "j0", "ratio": 0.5, "offset": offset})
        couplings[0]["backlash"] = {"gap": rng.uniform(0.001, 0.05)}
    scene = {"name": "s", "gravity": [0.0, 0.0, 0.0], "assemble": True, "bodies": bodies, "joints": joints}
    return scene | {"forces": forces, "couplings": couplings}, kind


def in_units(scene, kind, length=1.0, mass=1.0):
    """The scene with all lengths and masses multiplied."""
    scene = copy.deepcopy(scene)
    q = length if kind == "prismatic" else 1.0
    effort = mass * length * length / q
    for body in scene["bodies"]:
        body["mass"] *= mass
        body["inertia"] = [each * mass * length**2 for each in body["inertia"]]
    for joint in scene["joints"]:
        factors = {"coordinate": q, "rate": q, "lower": q, "upper": q, "coulomb": effort}
        for part in (joint, joint.get("limits", {}), joint.get("friction", {})):
            part.update({key: part[key] * factors[key] for key in part.keys() & factors})
    for force in scene["forces"]:
        factors = {"stiffness": effort / q, "damping": effort / q, SIZES[kind][1]: q}
        force.update({key: force[key] * factors[key] for key in factors})
    for coupling in scene.get("couplings", ()):
        coupling["offset"] *= q
        coupling["backlash"]["gap"] *= q
    return scene


def variants(scene, kind):
    """{name: the same motion with another text}."""
    across, opposed = [0.0, -9.81, 0.0] if kind == "prismatic" else [0.0, 0.0, -9.81], copy.deepcopy(scene)
    first, rest = opposed["forces"].pop(0), SIZES[kind][1]
    for sign in (-1.0, 1.0):
        half = {
            "name": "up" if sign > 0.0 else "down",
            "stiffness": first["stiffness"] / 2,
            "damping": first["damping"] / 2,
        }
        opposed["forces"].append(first | half | {rest: first[rest] + sign})
    far = copy.deepcopy(scene)
    for joint in far["joints"]:
        if joint["parent"] == "world":
            joint["parent_frame"] = {"position": [0.0, 100.0, 0.0] if kind == "prismatic" else [0.0, 0.0, 100.0]}
    return {
        "gravity across": scene | {"gravity": across},
        "opposed springs": opposed,
        "far from the origin": far,
        "mm": in_units(scene, kind, length=1e3),
        "km": in_units(scene, kind, length=1e-3),
        "ng": in_units(scene, kind, mass=1e-9),
        "Tg": in_units(scene, kind, mass=1e9),
    }


def events_of(scene):
    """{joint: [(time, kind)]} during DURATION, with an estimated error that is finite."""
    simulation = Simulation(scene_from_text(yaml.safe_dump(scene)), accuracy=1e-6)
    simulation.advance_to(DURATION)
    assert all(np.isfinite(error).all() for error in simulation.sample().error.values())
    found = {}
    for event in simulation.drain_events():
        found.setdefault(event.joint, []).append((event.time, event.kind))
    return found


@pytest.mark.parametrize("seed", range(SCENES))
@pytest.mark.volume(9)
def test_the_same_motion_in_seven_variants_has_the_same_events(seed):
    scene, kind = draw(seed)
    expected = events_of(scene)
    for name, variant in variants(scene, kind).items():
        found = events_of(variant)
        assert found.keys() == expected.keys(), name
        for joint in expected:
            kinds = [[kind for time, kind in each[joint] if time < 0.99 * DURATION] for each in (expected, found)]
            assert kinds[0] == kinds[1], (name, joint)
            # Two runs to an accuracy of 1e-6; slow impacts multiply their distance, by up to 100 in these scenes.
            for (time, _), (other, _) in zip(expected[joint], found[joint]):
                assert abs(time - other) < 1e-4, (name, joint)


def test_a_stop_is_left_where_all_forces_vanish():
    scene = yaml.safe_load(TWO_MASS)
    states = []
    for gravity in ([0.0, 0.0, 0.0], [0.0, -9.81, 0.0]):
        simulation = Simulation(scene_from_text(yaml.safe_dump(scene | {"gravity": gravity})))
        simulation.advance_to(3.0)
        sample = simulation.sample()
        states.append(np.array([sample.positions["a"][2], sample.positions["b"][2]]))
        assert max(error[0] for error in sample.error.values()) < 1e-4
    # Gravity acts across the rails: both runs keep 1e-4 of the characteristic length, 0.2 m.
    assert np.abs(states[0] - states[1]).max() < 2e-5
