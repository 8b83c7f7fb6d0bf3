# SPDX-License-Identifier: Apache-2.0
"""Stops and friction in all joints of random chains: thousands of events, and what they must keep."""

import numpy as np
import pytest
import yaml
from scene_files import text_of
from scipy.spatial.transform import Rotation
from stop_scenes import chain

from liegroup_core.engine import Engine
from liegroup_core.errors import SimulationError
from liegroup_core.events import complementarity
from liegroup_core.scene.centres import pose_matrix
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow


def momentum_changes(engine):
    """List that grows at every impact of an engine: time, pose of the first body, and the changes of linear
    momentum and of angular momentum about the origin of the world, (6,).
    """
    switching, found = engine._switching, []
    impact, bodies = switching._impact, engine.layout.model.bodies

    def watched(time, state, *rest):
        pose, twist = state[0].copy(), state[1].copy()
        status = impact(time, state, *rest)
        total = np.zeros(6)
        for body, at, change in zip(bodies, pose, state[1] - twist):
            R, I = at[:9].reshape(3, 3), body["inertia"].reshape(3, 3)
            linear = body["mass"] * R @ change[3:]
            total += np.concatenate([linear, R @ I @ change[:3] + np.cross(at[9:], linear)])
        if found and found[-1][0] == time:  # impulses of one instant, at the same pose, are one impact
            total += found.pop()[2]
        found.append((time, pose[0], total))
        return status

    switching._impact = watched
    return found


@pytest.mark.parametrize("seed", [1, 7])
@pytest.mark.volume(1)
def test_momentum_at_every_impact_of_a_falling_robot(seed):
    """What the impulse of the base gives the mechanism is the change of its momentum.

    Both are sums over 21 bodies of impulses of up to 100 N s, with the round-off of the inverse of the
    mass matrix: 1e-10.
    """
    scene = chain(seed, 20, False)
    engine = Engine(scene, "rkmk4", 2e-3)
    engine.drain_impacts()
    changes, count = momentum_changes(engine), 0
    names = [joint.name for joint in scene.joints]
    base = engine.layout.joint_frames[names.index("j0")][1]
    for _ in range(600):
        engine.advance(1)
        impacts = engine.drain_impacts()
        assert len(impacts) == len(changes)
        for impact, (_, pose, change) in zip(impacts, changes):
            frame = pose_matrix(pose) @ base
            force = frame[:3, :3] @ impact.impulses["j0"][3:]
            torque = frame[:3, :3] @ impact.impulses["j0"][:3] + np.cross(frame[:3, 3], force)
            assert np.abs(np.concatenate([force, torque]) - change).max() <= 1e-10
            count += 1
        changes.clear()
    assert count >= 100


def two_links(kind, reverse):
    """Arm and tool, whose joint is described from the arm to the tool or the other way round."""
    on_arm = {"position": [0.5, 0.0, 0.0], "rotation_vector": [0.3, 0.2, 0.1]}
    on_tool = {"position": [-0.3, 0.0, 0.0], "rotation_vector": [0.1, 0.7, 0.2]}
    poses = [np.eye(4), np.eye(4)]
    for pose, frame in zip(poses, (on_arm, on_tool)):
        pose[:3, :3] = Rotation.from_rotvec(frame["rotation_vector"]).as_matrix()
        pose[:3, 3] = frame["position"]
    tool = poses[0] @ np.linalg.inv(poses[1])
    joint = {
        "name": "wrist",
        "type": kind,
        "friction": {"coulomb": 0.1, "static": 0.15},
        "parent": "tool" if reverse else "arm",
        "child": "arm" if reverse else "tool",
        "parent_frame": on_tool if reverse else on_arm,
        "child_frame": on_arm if reverse else on_tool,
        "limits": {"lower": -0.5 if reverse else -0.3, "upper": 0.3 if reverse else 0.5, "restitution": 0.5},
    }
    if kind == "screw":
        joint["pitch"] = 0.05
    base = {"name": "base", "type": "revolute", "parent": "world", "child": "arm"}
    base |= {"child_frame": {"axis": [0.1, 1.0, 0.2]}, "limits": {"lower": -1.0, "restitution": 0.3}}
    inertia = [0.02, 0.03, 0.04]
    bodies = [
        {"name": "arm", "mass": 1.0, "inertia": inertia, "com": [0.2, 0.02, 0.0]},
        {
            "name": "tool",
            "mass": 0.7,
            "inertia": inertia,
            "com": [0.1, 0.0, 0.05],
            "position": tool[:3, 3].tolist(),
            "rotation_vector": Rotation.from_matrix(tool[:3, :3]).as_rotvec().tolist(),
        },
    ]
    scene = {"name": "arm", "gravity": [0.0, 1.0, -9.81], "bodies": bodies, "joints": [base, joint]}
    return scene_from_text(yaml.safe_dump(scene))


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw"])
def test_a_joint_described_the_other_way_round(kind):
    """Parent and child exchanged, and the limits with them: the same motion, bit by bit.

    The coordinate changes its sign: from 1 to -1 about the same axis.
    """
    ends, events = [], []
    for reverse in (False, True):
        engine = Engine(two_links(kind, reverse), "rkmk8", 5e-3)
        engine.advance(600)
        ends.append(engine.state()[0])
        events.append(engine.drain_events())
    assert ends[0].tobytes() == ends[1].tobytes()
    assert len(events[0]) >= 3
    assert [e._replace(impulse=abs(e.impulse)) for e in events[0]] == [
        e._replace(impulse=abs(e.impulse)) for e in events[1]
    ]


def test_a_stop_of_one_of_two_geared_wheels():
    """The stop of a wheel takes the momentum of both: (I + r^2 J) w, and both are at rest.

    The other wheel turns r times as fast. Its joint has no stop of its own.
    """
    text = text_of("gears_many_events.yaml")
    engine = Engine(scene_from_text(text), "rkmk4", 1e-2)
    engine.drain_impacts()
    engine.advance(100)
    impact, stop = engine.drain_events()
    assert (impact.kind, stop.kind) == ("impact", "stop")
    assert impact.time == pytest.approx(0.5, abs=1e-14)
    assert impact.impulse == pytest.approx(-2.0 * (0.2 + 9.0 * 0.03), abs=1e-13)
    assert impact.energy == pytest.approx(-0.5 * 4.0 * (0.2 + 9.0 * 0.03), abs=1e-13)
    assert engine.state()[1] == pytest.approx(np.zeros((2, 6)), abs=1e-14)


@pytest.mark.parametrize("seed", range(8))
def test_small_impulses_beside_large_ones_are_found_to_their_own_digits(seed, monkeypatch):
    """Three groups of stops that hardly touch each other, mobilities over 8 and velocities over 16 decades.

    Every row of the complementarity problem holds to 1e-9 of its own terms, after few rounds.
    """
    rng, k = np.random.default_rng(seed), 30
    rounds, one_round = [], complementarity._with
    monkeypatch.setattr(complementarity, "_with", lambda *given: rounds.append(1) or one_round(*given))
    A = 1e-7 * rng.normal(size=(k, k))
    A += A.T
    for first in range(0, k, 10):
        root = rng.normal(size=(10, 10))
        A[first : first + 10, first : first + 10] = root @ root.T + 0.1 * np.eye(10)
    sizes = 10.0 ** rng.uniform(-2, 2, k)
    A *= sizes * sizes[:, None]
    b = rng.normal(size=k) * sizes * np.repeat([1.0, 1e-8, 1e-16], 10)
    x, w, at = complementarity.solve(A, b, np.zeros(k), np.full(k, np.inf))
    terms = 1e-9 * (np.abs(A) @ np.abs(x) + np.abs(b))
    assert (x >= 0.0).all() and (w >= -terms).all() and (np.abs(A @ x + b - w) <= terms).all()
    assert (x[at == complementarity.LOW] == 0.0).all() and (w[at == complementarity.FREE] == 0.0).all()
    assert len(rounds) <= 2 * k


def test_attempts_are_those_of_the_whole_step():
    """An impact is not the start of a step: else a trial of a method could take thousands of times its limit."""
    body = {"name": "bob", "mass": 1, "inertia": [1, 1, 1], "position": [1, 0, 0]}
    hinge = {"name": "hinge", "type": "revolute", "parent": "world", "child": "bob"}
    hinge |= {"parent_frame": {"axis": [0, 1, 0]}, "limits": {"lower": -0.5, "upper": 0.5, "restitution": 0.9}}
    scene = {"name": "bell", "gravity": [0, 0, -9.81], "bodies": [body], "joints": [hinge]}
    engine = Engine(scene_from_text(yaml.safe_dump(scene)), "rkmk54", 2.0, rtol=1e-9, atol=1e-9)
    start = engine.snapshot()
    engine.advance(1)
    attempts = engine.substeps[1]
    assert engine.event_count == 2
    engine.restore(start)
    engine._integrator.limit_attempts(attempts)
    engine.advance(1)
    engine.restore(start)
    engine._integrator.limit_attempts(2 * attempts // 3)  # more than in any part between two impacts
    with pytest.raises(SimulationError, match="too many substeps"):
        engine.advance(1)
    assert engine.steps == 0 and 0.6 < engine._integrator.part < 1.0
