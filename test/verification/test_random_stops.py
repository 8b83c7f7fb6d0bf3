# SPDX-License-Identifier: Apache-2.0
"""Random mechanisms with cables, struts, cones, backlash, stops and friction everywhere."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from liegroup_core import Simulation
from liegroup_core.engine import Engine
from liegroup_core.scene.consistency import resolve_frames, switch_coordinates
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
KINDS = ("revolute", "prismatic", "screw", "spherical", "cylindrical")
ONE = KINDS[:3]


def stops(rng, size):
    """Limits about 0, mostly with some restitution."""
    return {
        "lower": float(-rng.uniform(0.2, 1.0) * size),
        "upper": float(rng.uniform(0.2, 1.0) * size),
        "restitution": float(rng.choice([0.0, 0.3, 0.8])),
    }


def dry(rng, size):
    """Friction of a size."""
    coulomb = float(rng.uniform(0.01, 0.3) * size)
    return {"coulomb": coulomb, "static": coulomb * float(rng.uniform(1.0, 1.5))}


def link(rng, number, parent, kind, floating):
    """Joint of a random chain, with stops and friction."""
    turn = rng.uniform(-1.0, 1.0, 3).tolist()
    joint = {"name": f"j{number}", "type": kind, "parent": parent, "child": f"b{number}"}
    joint["child_frame"] = {"position": [-0.3, 0.0, 0.0], "rotation_vector": turn}
    size = 0.1 if floating else 1.0
    if kind == "spherical":
        joint["limits"] = {"cone": float(rng.uniform(0.3, 1.2)), "restitution": 0.3}
    elif kind == "cylindrical":
        joint["limits"] = {"rotation": stops(rng, 1.0), "translation": stops(rng, 0.2)}
        joint["friction"] = {"rotation": dry(rng, size)}
    else:
        joint["limits"] = stops(rng, 0.2 if kind == "prismatic" else 1.0)
        joint["friction"] = dry(rng, size)
    if kind == "screw":
        joint["pitch"] = 0.03
    return joint


def mechanism(seed, floating):
    """Random tree of seven bodies with two cables, a strut and, where two joints suit, a gear with slack."""
    rng = np.random.default_rng(seed)
    bodies, joints = [], []
    for i in range(7):
        place = [0.3 * i, *rng.normal(scale=0.05, size=2).tolist()]
        body = {"name": f"b{i}", "mass": float(rng.uniform(0.5, 2.0))}
        bodies.append(body | {"inertia": [0.02, 0.03, 0.025], "position": place})
        if i == 0 and floating:
            continue
        parent = "world" if i == 0 else f"b{max(0, i - 1 - int(rng.integers(2)))}"
        joints.append(link(rng, i, parent, KINDS[int(rng.integers(len(KINDS)))], floating))
    geared = [joint["name"] for joint in joints if joint["type"] in ONE]
    couplings = []
    if len(geared) >= 2:
        gear = {"name": "gear", "joint": geared[0], "other": geared[1], "ratio": -0.7}
        couplings = [gear | {"backlash": {"gap": 0.1, "restitution": 0.2}}]
    for name, kind in (("rope0", "cable"), ("rope1", "cable"), ("rod", "strut")):
        one, other = sorted(rng.choice(7, 2, replace=False))
        ends = [rng.normal(scale=0.1, size=3) for _ in range(2)]
        places = [np.add(bodies[b]["position"], end) for b, end in zip((one, other), ends)]
        length = float(np.linalg.norm(places[1] - places[0]))
        length *= float(rng.uniform(1.02, 1.3)) if kind == "cable" else float(rng.uniform(0.4, 0.9))
        joint = {"name": name, "type": kind, "parent": f"b{one}", "child": f"b{other}"}
        joint |= {"length": length, "restitution": float(rng.choice([0.0, 0.5]))}
        joint["parent_frame"] = {"position": ends[0].tolist()}
        joints.append(joint | {"child_frame": {"position": ends[1].tolist()}})
    if floating:
        # As one rigid body: all joints are at rest at the start.
        spin, at = rng.normal(scale=3.0, size=3), rng.normal(scale=0.2, size=3)
        for body in bodies:
            body["angular_velocity"] = spin.tolist()
            body["linear_velocity"] = (at + np.cross(spin, body["position"])).tolist()
    scene = {"name": "random", "gravity": [0.0, 0.0, 0.0 if floating else -9.81]}
    scene |= {"bodies": bodies, "joints": joints, "couplings": couplings}
    return scene_from_text(yaml.safe_dump(scene))


class Excess:
    """How far the coordinates of a mechanism are beyond their stops, from poses alone."""

    def __init__(self, scene):
        self._scene, self._frames = scene, resolve_frames(scene)

    def __call__(self, sample):
        start = {"world": (np.eye(4), np.zeros(6))}
        start |= {name: (pose, np.zeros(6)) for name, pose in sample.poses.items()}
        found = switch_coordinates(self._scene, start, self._frames)
        return max(switch.limits.excess(q) for switch, q in found if switch.limits)


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.volume(2)
def test_random_mechanisms(seed, floating):
    """Over 2 s (floating: 1 s) no stop is passed by 1e-9, no energy gained, and momentum is kept.

    rkmk8 with 1 ms (floating: 0.5 ms) and projection: its errors between events are below 1e-9 of 50 J,
    and 1e-11 of the angular momentum, up to 80 kg m^2/s.
    """
    scene, step = mechanism(seed, floating), 5e-4 if floating else 1e-3
    engine, excess = Engine(scene, "rkmk8", step, stabilisation="projection"), Excess(scene)
    sample, count = engine.sample(), 0
    energy, momentum = sample.energy, sample.spatial_momentum
    for step_count in range(2000):
        engine.advance(1)
        events, sample = engine.drain_events(), engine.sample()
        count += len(events)
        if step_count % 8 == 0:  # it takes ten times the step
            assert excess(sample) <= 1e-9
        assert sample.energy <= energy + 1e-8
        assert all(event.energy <= 1e-12 for event in events) or len(events) > 1
        energy = sample.energy
        if floating:
            assert sample.spatial_momentum == pytest.approx(momentum, abs=1e-10 + 1e-11 * np.abs(momentum).max())
            momentum = sample.spatial_momentum
    assert count >= 5 or floating


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.volume(1)
def test_estimate_of_random_mechanisms(seed):
    """The estimated error of a simulation covers what half its step changes."""
    scene = mechanism(seed, False)
    simulation = Simulation(scene, accuracy=1e-5, horizon=1.0)
    finer = Engine(scene, "rkmk8", 2.5e-4, stabilisation="projection")
    for _ in range(8):
        simulation.advance(round(0.1 / simulation.step))
        finer.advance(400)
        ours, theirs = simulation.sample(), finer.sample()
        true = np.linalg.norm(ours.pose[:, 9:] - theirs.pose[:, 9:], axis=1)
        turned = (
            Rotation.from_matrix(ours.pose[:, :9].reshape(-1, 3, 3))
            * Rotation.from_matrix(theirs.pose[:, :9].reshape(-1, 3, 3)).inv()
        )
        estimate = np.array(list(ours.error.values()))
        assert true.max() <= 2.0 * estimate[:, 0].max() + 1e-9
        assert turned.magnitude().max() <= 2.0 * estimate[:, 1].max() + 1e-9
