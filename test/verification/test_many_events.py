# SPDX-License-Identifier: Apache-2.0
"""Stops and friction in all joints of random chains: thousands of events, and what they must keep."""

import numpy as np
import pytest
import yaml

from liegroup_core.engine import Engine
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow


def chain(seed, joints, floating):
    """Random tree of hinges and slides with stops, most of them with friction.

    floating : True: in space, tumbling; False: held by the world, falling
    """
    rng = np.random.default_rng(seed)
    bodies, links = [], []
    for i in range(joints + 1):
        bodies.append(
            {
                "name": f"b{i}",
                "mass": float(rng.uniform(0.5, 2.0)),
                "inertia": [0.02, 0.03, 0.025],
                "position": [0.3 * i, 0.0, 0.0],
            }
        )
        if i == 0:
            continue
        size = 1.0 if rng.random() < 0.8 else 0.2
        joint = {
            "name": f"j{i}",
            "type": "revolute" if size == 1.0 else "prismatic",
            "parent": f"b{i - 1 if rng.random() < 0.8 else int(rng.integers(i))}",
            "child": f"b{i}",
            "child_frame": {
                "position": [-0.3, 0.0, 0.0],
                "rotation_vector": rng.uniform(-1.5, 1.5, 3).tolist(),
            },
            "limits": {
                "lower": float(-rng.uniform(0.2, 1.0) * size),
                "upper": float(rng.uniform(0.2, 1.0) * size),
                "restitution": float(rng.choice([0.0, 0.3, 0.8])),
            },
        }
        if rng.random() < 0.7:
            coulomb = float(rng.uniform(0.01, 0.5)) * (0.1 if floating else 10.0)
            joint["friction"] = {"coulomb": coulomb, "static": coulomb * float(rng.uniform(1, 1.5))}
        links.append(joint)
    if floating:
        # As one rigid body: all joints are at rest at the start.
        spin, at = np.array([2.0, 3.0, -4.0]), np.array([0.0, 0.1, 0.2])
        for body in bodies:
            body["angular_velocity"] = spin.tolist()
            body["linear_velocity"] = (at + np.cross(spin, body["position"])).tolist()
    else:
        hinge = {"name": "j0", "type": "revolute", "parent": "world", "child": "b0"}
        links.append(hinge | {"child_frame": {"axis": [0.1, 1.0, 0.2]}})
    gravity = [0.0, 0.0, 0.0 if floating else -9.81]
    scene = {"name": "chain", "gravity": gravity, "bodies": bodies, "joints": links}
    return scene_from_text(yaml.safe_dump(scene))


def test_momentum_of_a_floating_chain():
    """Stops and friction are inner forces: 150 events leave momentum and angular momentum as they are.

    rkmk8 with 2 ms follows the motion between events to 1e-12. An impact solves for all rates at once,
    with round-off of 1e-15 of the momenta of single bodies: 150 of them stay below 1e-10.
    """
    engine = Engine(chain(3, 12, True), "rkmk8", 2e-3)
    start = engine.sample().spatial_momentum
    energy, count = engine.energy(), 0
    for _ in range(1500):
        engine.advance(1)
        count += len(engine.drain_events())
        now = engine.energy()
        assert now <= energy + 1e-9
        energy = now
    assert count >= 150
    assert engine.sample().spatial_momentum == pytest.approx(start, abs=1e-10)


@pytest.mark.parametrize("seed", [1, 5])
def test_falling_robots(seed):
    """Twenty joints with stops and friction fall: no joint passes a stop, no energy is gained."""
    scene = chain(seed, 20, False)
    limits = {joint.name: joint.limits for joint in scene.joints if joint.limits}
    engine = Engine(scene, "rkmk4", 2e-3)
    energy, count = engine.energy(), 0
    for _ in range(600):
        engine.advance(1)
        count += len(engine.drain_events())
        sample = engine.sample()
        for joint, (q, _) in sample.joint_coordinates.items():
            if joint in limits:
                assert limits[joint].lower - 1e-12 <= q <= limits[joint].upper + 1e-12
        # The error of a step of order 4 that follows an impact at 10 m/s.
        assert sample.energy <= energy + 1e-5
        energy = sample.energy
    assert count >= 500


def test_repeated_runs_and_parts_are_bit_equal():
    """A run in single steps, one in blocks, and one from a snapshot in its middle have the same bits."""
    scene = chain(2, 12, False)
    once, blocks = Engine(scene, "rkmk4", 2e-3), Engine(scene, "rkmk4", 2e-3)
    for _ in range(400):
        once.advance(1)
        if once.steps == 200:
            middle = once.snapshot()
    blocks.advance(77)
    blocks.advance(323)
    end = once.state()
    assert blocks.state()[0].tobytes() == end[0].tobytes()
    assert blocks.state()[1].tobytes() == end[1].tobytes()
    events = len(blocks.drain_events())
    assert events == len(once.drain_events()) > 100
    once.restore(middle)
    once.advance(200)
    assert once.state()[0].tobytes() == end[0].tobytes()
    assert once.state()[1].tobytes() == end[1].tobytes()
