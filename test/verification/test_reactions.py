# SPDX-License-Identifier: Apache-2.0
"""Reactions of joints against 50 digits, closed forms, and the rate of momentum.

    python test/verification/test_reactions.py [COUNT]

prints a table for COUNT (100) random mechanisms. As a test it takes 40, or MECHANISMS of the
environment.
"""

import os
import sys
from pathlib import Path

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.path.insert(0, os.path.join(os.path.dirname(__file__), ".."))

import mechanisms
import numpy as np
import precise
import pytest
import random_mechanisms
from scene_files import filled, text_of

from liegroup_core import Scene, Simulation, load_scene
from liegroup_core.engine import Engine
from liegroup_core.joints.kinds import TYPES
from liegroup_core.scene.consistency import resolve_frames
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow

# Of the largest component of a joint's own reaction. Accelerations have 1e-12 of what the problem
# determines (test_relative_accelerations.py); a reaction of a loop is a difference of forces that
# are up to a hundred times larger.
ACCURACY = 1e-10
SCENES = sorted(path.stem for path in (Path(__file__).parents[2] / "config" / "scenes").glob("*.yaml"))
G = 9.81
LARGE = 15  # bodies; 50 digits of more take minutes


def at_start(scene, wrenches=(), **options):
    """Sample of a scene at its start, with external wrenches."""
    engine = Engine(scene, quiet=True, **options)
    for body, wrench, axes in wrenches:
        engine.apply_wrench(body, wrench, source=axes, axes=axes)
    engine.advance(0)
    return engine.sample()


def compared(name, seed):
    """[(joint, error, mask of the undetermined components, that in precise.py)], or None."""
    scene, wrenches = random_mechanisms.random_mechanism(name, seed)
    if len(scene.bodies) > LARGE:
        return None
    try:
        exact = precise.reactions(scene, wrenches)
    except precise.NearlySingular:
        return None
    found = at_start(scene, wrenches).reactions
    results = []
    for joint, (wrench, mask) in exact.items():
        lost = np.isnan(found[joint])
        both = ~lost & ~mask
        error = np.abs(found[joint] - wrench)[both].max(initial=0.0)
        results.append((joint, error / max(np.abs(wrench).max(), 1e-9), lost, mask))
    return results


@pytest.mark.parametrize("name", [c for c in random_mechanisms.CLASSES if c != "large"])
@pytest.mark.volume(2)
def test_reactions_of_random_mechanisms_against_50_digits(name):
    """Determined components to ACCURACY, and the undetermined ones are those of the rank test."""
    total = max(3, int(os.environ.get("MECHANISMS", 40)) // 7)
    done = 0
    for seed in range(total):
        for joint, error, lost, mask in compared(name, seed) or ():
            done += 1
            assert error <= ACCURACY, (seed, joint, error)
            assert (lost == mask).all(), (seed, joint, lost, mask)
    assert done > total


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.volume(8)
def test_reactions_at_the_ground_are_the_rate_of_momentum(name):
    """Force and torque of all joints to the world, with gravity, against differences of the momentum.

    Central differences of fourth order with steps of 1e-4 s of motions at round-off: their error is
    that of the momentum, 1e-13 of its size, over the step, plus h^4 of a motion at up to 100 rad/s,
    1e-8. Motors, servos and springs at joints to the world are part of it.
    """
    scene, h = load_scene(name), 1e-4
    engine = Engine(scene, "rkmk8", h, quiet=True)
    samples = []
    for _ in range(5):
        engine.advance(20 if not samples else 1)
        samples.append(engine.sample())
    momenta = np.array([sample.spatial_momentum for sample in samples])
    rate = (momenta[0] - 8 * momenta[1] + 8 * momenta[3] - momenta[4]) / (12 * h)
    sample = samples[2]
    wrench = np.zeros(6)
    reactions = sample.minimum_norm_reactions
    for body in scene.bodies:
        weight = body.mass * np.array(scene.gravity)
        com = (sample.poses[body.name] @ (*body.com, 1.0))[:3]
        wrench += [*np.cross(com, weight), *weight]
    for joint, (_, frame) in zip(scene.joints, resolve_frames(scene)):
        if joint.parent != "world":
            continue
        frame = sample.poses[joint.child] @ frame
        force = frame[:3, :3] @ reactions[joint.name][3:]
        torque = frame[:3, :3] @ reactions[joint.name][:3]
        wrench += [*(torque + np.cross(frame[:3, 3], force)), *force]
    for force in scene.forces:  # motors and springs between the world and a body
        joint = next((j for j in scene.joints if j.name == getattr(force, "joint", None)), None)
        if joint is not None and joint.parent == "world":
            frame = sample.poses[joint.child] @ joint.child_frame.pose
            effort = frame[:3, 2] * sample.force_efforts[force.name]
            if TYPES[joint.type].turns:
                wrench[:3] += effort
            else:
                wrench += [*np.cross(frame[:3, 3], effort), *effort]
        elif getattr(force, "parent", None) == "world":
            pytest.skip("a spring from the world")
    size = np.abs(rate).max() + 1e-13 * np.abs(momenta).max() / h + 1.0
    assert np.abs(rate - wrench).max() <= 1e-7 * size


def about_y(angle):
    """Quaternion (x, y, z, w) of a rotation about y."""
    return (0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2))


def on_joint(joint, **keys):
    """Scene of a body of 2 kg on a joint to the world whose frames are at the origin."""
    keys = {"mass": 2.0, "inertia": [0.3, 0.3, 0.1]} | keys
    return mechanisms.one_body({"parent_frame": {}} | joint, gravity=(0, 0, -G), **keys)


def test_pendulum():
    """m l theta'' along the path, m (g cos theta + l theta'^2) along the rod."""
    l, angle, rate = 0.7, 0.4, 1.3
    frame = {"axis": [0, 1, 0]}
    scene = on_joint(
        {"type": "revolute", "parent_frame": frame, "child_frame": frame},
        com=(0, 0, -l),
        quaternion=about_y(angle),
        angular_velocity=(0, rate, 0),
    )
    sample = at_start(scene)
    turn = 2.0 * G * l * np.sin(angle) / (0.3 + 2.0 * l**2)  # of the rod, towards the bottom
    # In the axes of the rod: z away from the mass. The hinge's own axes turn with the rod.
    along = 2.0 * (G * np.cos(angle) + l * rate**2)
    across = 2.0 * (l * turn - G * np.sin(angle))
    R = scene.joints[0].child_frame.pose[:3, :3]
    force = R @ sample.reactions["j"][3:]
    assert force == pytest.approx([across, 0.0, along], rel=1e-13, abs=1e-13)
    assert sample.reactions["j"][:3] == pytest.approx([0, 0, 0], abs=1e-14)


def test_conical_pendulum():
    """A point mass at an angle a circles with w^2 = g / (l cos a): the pull is m g / cos a."""
    l, a = 0.8, 0.6
    w = np.sqrt(G / (l * np.cos(a)))
    scene = on_joint(
        {"type": "universal", "child_frame": {}},
        inertia=[0, 0, 0],
        com=(0, 0, -l),
        quaternion=about_y(a),
        # About the arm of the cross that is fixed to the world: the velocity w l sin a.
        angular_velocity=(w * np.sin(a), 0, w * np.sin(a) * np.tan(a)),
    )
    pull = at_start(scene).reactions["j"]
    assert pull == pytest.approx([0, 0, 0, 0, 0, 2.0 * G / np.cos(a)], rel=1e-12, abs=1e-12)


def test_steady_precession_of_a_top():
    """The pivot carries the weight and turns the centre of mass on its circle."""
    l, a, spin = 0.5, 0.9, 60.0
    A, C = 0.3 + 2.0 * l**2, 0.1
    # A p^2 cos a - C n p + m g l = 0, of the slow precession p.
    roots = np.roots([A * np.cos(a), -C * spin, 2.0 * G * l])
    p = min(roots)
    # Body rate: precession about the vertical, and a spin such that the total along the axis is n.
    rate = (-p * np.sin(a), 0.0, spin)
    scene = on_joint(
        {"type": "spherical", "child_frame": {}}, com=(0, 0, l), quaternion=about_y(a), angular_velocity=rate
    )
    sample = at_start(scene)
    R = sample.pose_matrices[0, :3, :3]
    force = R @ sample.reactions["j"][3:]
    circle = -2.0 * p**2 * l * np.sin(a)
    assert force == pytest.approx([circle, 0.0, 2.0 * G], rel=1e-11, abs=1e-11)


def test_a_weld_carries_what_is_behind_it():
    """A cantilever of two welded bodies at rest: weight and its moments, summed by hand."""
    scene = scene_from_text(text_of("beam.yaml"))
    found = at_start(scene).reactions
    assert found["flange"] == pytest.approx([0, 0, 0, 0, -7, 3 * G], abs=1e-13)
    wall = [0.2 * 3 * G, -(0.5 * 2 + 1.5 * 3) * G, -1.5 * 7, 0, -7, 5 * G]
    assert found["wall"] == pytest.approx(wall, abs=1e-12)
    assert found["free"] == pytest.approx([0, 0, 0, 0, 0, G], abs=1e-13)


def coaxial(count):
    """Door on so many hinges of one vertical axis."""
    door = mechanisms.one_body(
        {"name": "hinge0", "type": "revolute", "parent_frame": {}}, gravity=(0, 0, -G), mass=4.0, position=(0.5, 0, 1)
    )
    hinges = [door.joints[0].remade(name=f"hinge{k}", parent_frame={"position": (0, 0, k)}) for k in range(count)]
    return door.remade(joints=hinges)


def test_three_coaxial_hinges_share_in_any_proportion():
    """Only the torque about the axis is determined; the smallest reactions share the weight."""
    sample = at_start(coaxial(3))
    for wrench in sample.reactions.values():
        assert np.isnan(wrench).tolist() == [True, True, False, True, True, True]
        assert wrench[2] == 0.0
    assert "shared with hinge1, hinge2 in any proportion" in sample.undetermined["hinge0"]
    least = sample.minimum_norm_reactions
    assert sum(wrench[3:] for wrench in least.values()) == pytest.approx([0, 0, 4 * G])
    assert [wrench[5] for wrench in least.values()] == pytest.approx([4 * G / 3] * 3)
    # Torque about the lowest hinge: their own ones, and those of the forces above.
    torque = sum(w[:3] + np.cross([0, 0, k], w[3:]) for k, w in enumerate(least.values()))
    assert torque[:2] == pytest.approx([0, -0.5 * 4 * G], abs=1e-12)
    assert not at_start(coaxial(1)).undetermined


def test_statics_of_a_four_bar():
    """A square held by a diagonal spring: forces in the plane by hand, the others undetermined."""
    corners = {"left": (0, 0), "top": (0, 1), "right": (1, 1), "base": (1, 0)}
    centres = {"left": (0, 0.5), "top": (0.5, 1), "right": (1, 0.5)}
    ends = (("world", "left", "left"), ("left", "top", "top"), ("top", "right", "right"))
    bodies = [
        {"name": name, "mass": 1.0, "inertia": [0.1, 0.1, 0.1], "position": [x, 0, z]}
        for name, (x, z) in centres.items()
    ]
    joints = []
    for a, b, c in (*ends, ("world", "right", "base")):
        at = [corners[c][0] - centres[b][0], 0, corners[c][1] - centres[b][1]]
        frame = {"position": at, "axis": [0, -1, 0]}
        joints.append({"name": f"{a}_{b}", "type": "revolute", "parent": a, "child": b, "child_frame": frame})
    forces = [
        {"name": "right", "type": "applied_wrench", "body": "top", "force": [5, 0, 0]},
        {"name": "hold", "type": "applied_wrench", "body": "left", "torque": [0, -5, 0]},
    ]
    scene = Scene(name="square", gravity=(0, 0, 0), bodies=bodies, joints=joints, forces=forces)
    sample = at_start(scene)
    # The torque of 5 N m at the left bar of 1 m balances the push: the left bar gives the top 5 N
    # to the left, and the right bar, free of loads, nothing.
    R = scene.joints[0].child_frame.pose[:3, :3]
    for name, force in (("left_top", -5.0), ("top_right", 0.0), ("world_left", -5.0)):
        found = sample.reactions[name]
        assert np.isnan(found[[0, 1, 5]]).all() and not np.isnan(found[2:5]).any()
        plane = R[:, :2] @ found[3:5]
        assert plane == pytest.approx([force, 0, 0], abs=1e-12), name
    assert set(sample.undetermined) == {joint.name for joint in scene.joints}


def test_gears_act_along_the_axes_of_their_joints():
    """q1 = -2 q2 with a torque on the second wheel: the efforts are in the ratio of the gear."""
    J1, J2, T = 0.4, 0.1, 3.0
    scene = scene_from_text(filled(text_of("two_gears.yaml"), first=J1, second=J2, torque=T))
    found = at_start(scene).reactions
    acceleration = T / (J2 + 4.0 * J1)  # of the second wheel
    effort = -2.0 * J1 * acceleration
    assert found["first"] == pytest.approx([0, 0, effort, 0, 0, 0], abs=1e-14)
    assert found["second"] == pytest.approx([0, 0, 2.0 * effort, 0, 0, 0], abs=1e-14)


def test_at_a_singular_pose_more_is_undetermined():
    """A parallelogram that stands flat: forces along it are those of no unique set of reactions."""
    found = {angle: at_start(mechanisms.parallelogram(angle, 0.0, gravity=(0, -G, 0))) for angle in (0.4, 0.0)}
    regular, flat = (set(found[angle].undetermined) for angle in (0.4, 0.0))
    lost = {
        angle: sum(int(np.isnan(wrench).sum()) for wrench in sample.reactions.values())
        for angle, sample in found.items()
    }
    assert regular == flat and lost[0.0] > lost[0.4]


def test_every_method_has_the_reactions_of_its_state():
    """A reaction is a function of the state: methods differ by the error of their states only."""
    scene = load_scene("double_pendulum")
    found = []
    for method in ("rkmk8", "generalized_alpha", "constrained_rattle8"):
        simulation = Simulation(scene, method, 1e-4, estimate=False, quiet=True)
        simulation.advance(1000)
        found.append(np.array(list(simulation.sample().reactions.values())))
    assert np.abs(found[0]).max() > 1.0
    assert np.abs(found[2] - found[0]).max() < 1e-9 * np.abs(found[0]).max()
    assert np.abs(found[1] - found[0]).max() < 1e-5 * np.abs(found[0]).max()


def table(total):
    """Print the largest errors of each class."""
    print("| mechanisms | compared | largest error | undetermined | falsely determined | missed |")
    print("|---|---|---|---|---|---|")
    for name in random_mechanisms.CLASSES:
        if name == "large":
            continue
        results = [compared(name, seed) for seed in range(max(3, total // 7))]
        joints = [entry for found in results if found for entry in found]
        lost, mask = (np.array([entry[k] for entry in joints]) for k in (2, 3))
        print(
            f"| {name} | {sum(found is not None for found in results)} "
            f"| {max(entry[1] for entry in joints):.1e} | {int(lost.sum())} "
            f"| {int((mask & ~lost).sum())} | {int((lost & ~mask).sum())} |",
            flush=True,
        )


if __name__ == "__main__":
    table(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
