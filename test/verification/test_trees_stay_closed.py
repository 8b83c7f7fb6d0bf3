# SPDX-License-Identifier: Apache-2.0
"""In relative coordinates no joint of a tree opens: every kind, every method, any step.

`make verify` takes runs of 2000 steps.

What a joint may be open is round-off of the two poses it is computed from, not of the motion: in m or
rad, with the mechanism's size L and the positions r_a, r_b of both bodies in the world (largest
components),

    1e-13 max(L, 1) + ROUNDINGS 2^-53 (|r_a| + |r_b|)

The first term is what is asked for. Arms are at most L, and a pose of a body follows from that of its
link by one product. The second term: coordinates of a body far from the origin are rounded to 2^-53 of
themselves, and bodies that have slid apart by d see a tilt of 2^-53 as 2^-53 d. The largest residual
of 400 runs is a quarter of this bound.
Residuals are those of naive.py, which shares nothing with the engine.
"""

import functools

import mechanisms
import naive
import numpy as np
import pytest
import random_mechanisms
from scipy.linalg import null_space
from volume import VERIFY

from liegroup_core import SimulationError
from liegroup_core.engine import Engine
from liegroup_core.joints import forbidden_rows
from liegroup_core.joints.kinds import CONSTRAINTS
from liegroup_core.lie.groups import SE3
from liegroup_core.methods.families import ON_JOINTS
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.consistency import resolve_elements, resolve_frames

STEPS = 2000 if VERIFY else 400
SAMPLES = 10
ROUNDINGS, ROUND_OFF = 16.0, 2.0**-53
KINDS = tuple(kind for kind in CONSTRAINTS if kind != "distance")
ON_TREES = tuple(name for name, method in METHODS.items() if method.family in ON_JOINTS)


def moving(rng, scene):
    """Scene of a tree, parents first, with random rates of its joints: in O(n)."""
    bodies = {body.name: body for body in scene.bodies}
    poses = {name: body.pose for name, body in bodies.items()} | {"world": np.eye(4)}
    twists = {"world": np.zeros(6)}
    held = {
        joint.child: (joint, frames, elements)
        for joint, frames, elements in zip(scene.joints, resolve_frames(scene), resolve_elements(scene))
    }
    for name in bodies:
        if name not in held:
            twists[name] = rng.normal(size=6)
            continue
        joint, (at_parent, at_child), elements = held[name]
        relative = np.linalg.inv(poses[joint.parent] @ at_parent) @ poses[name] @ at_child
        carried = SE3.Ad(np.linalg.inv(at_parent @ relative)) @ twists[joint.parent]
        free = null_space(forbidden_rows(elements, relative))
        own = free @ rng.normal(size=free.shape[1])
        twists[name] = SE3.Ad(at_child) @ (carried + own)
    return scene.remade(
        bodies=[
            body.remade(angular_velocity=twists[name][:3], linear_velocity=twists[name][3:])
            for name, body in bodies.items()
        ]
    )


def turned_around(rng, scene):
    """The same mechanism; half of the joints have their parent and child exchanged."""
    # Of a universal joint the axes are x of the parent frame and y of the child frame.
    quarter = np.eye(4)[:, [1, 0, 2, 3]] * [1, -1, 1, 1]
    joints = []
    for joint, (at_parent, at_child) in zip(scene.joints, resolve_frames(scene)):
        if joint.parent == "world" or rng.random() < 0.5:
            joints.append(joint)
            continue
        turn = quarter if joint.type == "universal" else np.eye(4)
        joints.append(
            joint.remade(
                parent=joint.child,
                child=joint.parent,
                parent_frame=mechanisms.frame(at_child @ turn),
                child_frame=mechanisms.frame(at_parent @ turn),
            )
        )
    return scene.remade(joints=joints)


def tree(seed, n, kinds, grounded=0.2):
    """Random tree of n bodies; parts of it may float."""
    rng = np.random.default_rng([seed, n, len(kinds)])
    links = random_mechanisms.tree(rng, n, kinds, grounded)
    scene = mechanisms.mechanism(rng, links, springs=min(3, n - 1), start=moving)
    return turned_around(rng, scene)


def residuals(scene, frames, sample):
    """[(joint, largest component of its residual, |r_a| + |r_b|)] of all joints."""
    poses = {body.name: pose for body, pose in zip(scene.bodies, sample.pose_matrices)}
    poses["world"] = np.eye(4)
    found = []
    for joint, (at_parent, at_child) in zip(scene.joints, frames):
        a, b = poses[joint.parent], poses[joint.child]
        with np.errstate(over="ignore"):  # Euler's method: 1e160 m, whose square it does not need
            gap = naive.joint_residual(joint, a @ at_parent, b @ at_child, 0.0)
        far = np.abs(a[:3, 3]).max() + np.abs(b[:3, 3]).max()
        found.append((joint, np.abs(gap).max(), far))
    return found


def opening(scene, method, step, group="relative", spoil=lambda relative: None):
    """Follow a run, to where it ends: with SimulationError the last valid state is judged.

    spoil : function (RelativeModel) that changes it
    returns (largest residual relative to its bound, its joint, steps)
    """
    engine = Engine(scene, method, step, group, quiet=True)
    spoil(engine.layout.relative)
    frames = resolve_frames(scene)
    size = max(1.0, engine.layout.size)
    worst, where, going = 0.0, None, True
    for _ in range(SAMPLES):
        try:
            engine.advance(STEPS // SAMPLES)
        except SimulationError:
            going = False
        for joint, gap, far in residuals(scene, frames, engine.sample()):
            part = gap / (1e-13 * size + ROUNDINGS * ROUND_OFF * far)
            if not part <= worst:  # also a residual that is not a number
                worst, where = part, f"{joint.name}, {joint.type}"
        if not going:
            break
    return worst, where, engine.steps


def assert_closed(scene, method, step):
    """Returns the number of steps."""
    worst, where, steps = opening(scene, method, step)
    assert worst <= 1.0, (where, method, step, steps)
    return steps


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.volume(1)
def test_joints_of_every_kind_stay_closed(kind):
    """Trees of four bodies; between bodies and to ground, in both directions."""
    done = [
        assert_closed(tree(seed, 4, (kind,)), method, step)
        for method in ON_TREES
        for step in (0.05, 0.01, 0.002)
        for seed in (1, 2)
    ]
    assert len(done) / 2 < sum(steps == STEPS for steps in done)


@functools.cache
def random_tree(n):
    """Tree of all kinds, with floating parts."""
    return tree(n, n, (*KINDS, None))


@pytest.mark.parametrize("method", ON_TREES)
@pytest.mark.volume(2)
def test_random_trees_stay_closed(method):
    """The matrices of implicit Munthe-Kaas methods are dense: 200 bodies would take a quarter of an hour."""
    most = 30 if METHODS[method].implicit else 200
    for n, step in ((12, 0.05), (12, 0.01), (30, 0.005), (70, 0.002), (200, 0.001), (200, 0.05)):
        if n <= most:
            assert_closed(random_tree(n), method, step)


@pytest.mark.turn(3)
def test_the_last_valid_state_of_runs_that_end_early_is_closed():
    """Methods without error control with steps that are too large for fast light bodies; others: see above."""
    for n in (5, 70):
        methods = [name for name in ON_TREES if not METHODS[name].controlled]
        done = [assert_closed(random_tree(n), method, 0.05) for method in methods]
        assert min(done) < STEPS


def test_other_groups_open_the_same_trees():
    """The test can fail: on SE(3)^n joints between bodies open, and a displaced joint is seen."""
    scene = tree(1, 4, KINDS)
    for group in ("se3", "so3xr3"):
        assert opening(scene, "rkmk4", 0.002, group)[0] > 1e3

    def displace(relative):
        relative.links["point"][:, 0] += 1e-11

    assert opening(scene, "rkmk4", 0.002, spoil=displace)[0] > 10.0
