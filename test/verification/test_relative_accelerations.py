# SPDX-License-Identifier: Apache-2.0
"""Accelerations of random trees and loops, with an empty tree too, against 50 digits.

    python test/verification/test_relative_accelerations.py [COUNT [SPACE ...]]

prints a table for COUNT (500) mechanisms. As a test it takes 60, or MECHANISMS of the environment.

What a body does must come out to the digits that its data determine. Of a body with acceleration a
an error, in rad/s^2 or m/s^2 (bodies and arms are 0.1 to 1 m long), may be

    1e-12 max(|a|, |g|) + ROUNDINGS change

`change` is what one unit of round-off in every number of the scene (2^-53, at random, three times)
changes of a in exact arithmetic: no algorithm that receives rounded data can do better. The largest
of a hundred such changes is up to five times that of three, and every algorithm rounds numbers more
than once: together 16. The first term is the accuracy that is asked for. It is ten thousand times the
rounding of a: room for sums along forty bodies and for levers. There is a bound for every body, so
that a light body that is thrown about hides no error of a heavy one.

With an empty tree, group se3, all joints are cut and S = J M^-1 J^T is that of all of them. What it
starts from are the accelerations without joints, M^-1 Q. They may be much larger than those with
joints, and joints take them away only to their round-off. In a loop their errors grow by cond(S), of
unit diagonal. Both are allowed here for that group only. Pivots below 1e-10 are taken as those of a
singular pose (SMALLEST_PIVOT of relative/matrix.py): loops with such a cond(S), of bodies whose masses
differ by 1e8, are not asked from it.
"""

import os
import sys
from typing import NamedTuple

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.path.insert(0, os.path.join(os.path.dirname(__file__), ".."))

import engine
import numpy as np
import precise
import pytest
import random_mechanisms

from liegroup_core.engine import Engine
from liegroup_core.joints.kinds import CONSTRAINTS
from liegroup_core.layout import make_layout
from liegroup_core.mechanism.redundancy import loop_joints
from liegroup_core.scene.description import FORCES

pytestmark = pytest.mark.slow

ACCURACY, ROUNDINGS, ROUND_OFF = 1e-12, 16.0, 2.0**-53
# Roundings of the largest acceleration without joints: 7 in 400 trees.
LOST = 16.0
SINGULAR = 1e10  # cond(S)
# Parts of all mechanisms, in percent; those of 20 to 40 bodies take a few seconds each.
SHARES = {
    "tree": 25,
    "loops": 20,
    "planar loops": 14,
    "spherical loops": 10,
    "mass ratios": 16,
    "slender": 12,
    "large": 3,
    "couplings": 16,
    "driven": 16,
}


# Formulations, and what the engine is given for them; "plane" for planar mechanisms only.
SPACES = {"se3": {"group": "se3"}, "relative": {"group": "relative", "space": "space"}, "plane": {"group": "relative"}}


def count(name, total):
    """Number of mechanisms of a class."""
    return max(1, round(SHARES[name] * total / 100))


def sizes(scene, exact):
    """(n,) max(|a|, |g|) of every body."""
    own = np.abs(exact.acceleration.astype(float)).max(axis=1)
    return np.maximum(own, np.linalg.norm(scene.gravity))


def bound(scene, exact):
    """(n,) largest error of every body, see above."""
    return ACCURACY * sizes(scene, exact) + ROUNDINGS * exact.change.max(axis=1)


class Judged(NamedTuple):
    """Errors of one formulation in one mechanism."""

    space: str
    error: np.ndarray  # (n,) of every body, rad/s^2 or m/s^2
    size: np.ndarray  # (n,) max(|a|, |g|)
    bound: np.ndarray  # (n,) for every formulation
    allowed: np.ndarray  # (n,) for this one


def judged(name, seed, spaces):
    """[Judged] of a mechanism; none at a nearly singular pose."""
    scene, wrenches = random_mechanisms.random_mechanism(name, seed)
    try:
        exact = precise.accelerations(scene, wrenches)
    except precise.NearlySingular:
        return []
    size, limit = sizes(scene, exact), bound(scene, exact)
    in_loops = loop_joints([(joint.parent, joint.child) for joint in scene.joints])
    lost = max(LOST, exact.squared_condition) if in_loops else LOST
    lost *= ROUND_OFF * max(size.max(), np.abs(exact.free).max())
    results = []
    for space in spaces:
        if space == "plane" and make_layout(scene).normal is None:
            continue
        if space == "se3" and name in ("couplings", "driven"):
            continue
        if space == "se3" and in_loops and exact.squared_condition > SINGULAR:
            continue
        found = engine.engine_accelerations(scene, wrenches, **SPACES[space])
        error = precise.errors(exact, found).max(axis=1)
        allowed = limit + lost if space == "se3" else limit
        results.append(Judged(space, error, size, limit, allowed))
    return results


@pytest.mark.parametrize("name", random_mechanisms.CLASSES)
@pytest.mark.volume(1)
def test_accelerations_have_the_digits_that_the_data_determine(name):
    total = count(name, int(os.environ.get("MECHANISMS", 60)))
    wrong, done = [], 0
    for seed in range(total):
        results = judged(name, seed, SPACES)
        done += bool(results)
        for found in results:
            part = (found.error / found.allowed).max()
            if not part <= 1.0:
                wrong.append(f"{name} {seed}, {found.space}: {part:.3g} of the bound")
    assert not wrong
    assert done >= 0.8 * total


def as_thin_rods(scene, normal, thickness):
    """The scene with bodies that have a part of their inertia about the normal about an axis across it."""
    bodies = []
    for body in scene.bodies:
        n = body.rotation.T @ normal
        along = np.cross(n, [0.3, 0.5, 0.8])
        along /= np.linalg.norm(along)
        J = (n @ body.inertia_matrix @ n) * (np.eye(3) - (1.0 - thickness) * np.outer(along, along))
        inertia = (J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
        bodies.append(body.model_copy(update={"inertia": tuple(map(float, inertia))}))
    return scene.model_copy(update={"bodies": type(scene.bodies)(bodies)})


@pytest.mark.parametrize("thickness", [1e-3, 1e-6])
@pytest.mark.turn(3)
def test_rods_of_any_thickness_need_no_refinement_in_a_plane(thickness):
    for seed in range(6):
        scene, wrenches = random_mechanisms.random_mechanism("planar loops", seed)
        scene = as_thin_rods(scene, make_layout(scene).normal, thickness)
        layout = make_layout(scene)
        assert layout.relative.refinements == 0 and layout.model.refinements > 0
        exact = precise.accelerations(scene, wrenches)
        found = engine.engine_accelerations(scene, wrenches, group="relative")
        assert (precise.errors(exact, found).max(axis=1) <= bound(scene, exact)).all()


@pytest.mark.parametrize("name", ["tree", "loops", "planar loops", "mass ratios"])
@pytest.mark.turn(3)
def test_rounded_rows_of_the_engine_meet_the_bound_if_they_are_solved_exactly(name):
    """The bound asks for what rounded numbers allow, and two derivations of the rows agree.

    Rows and right-hand sides are those of an empty tree, with its choice of independent rows; only
    the elimination is left out. Welded bodies have none.
    """
    for seed in range(3):
        scene, wrenches = random_mechanisms.random_mechanism(name, seed)
        if any(joint.type == "fixed" for joint in scene.joints):
            continue
        exact = precise.accelerations(scene, wrenches)
        J, right = engine.rows(Engine(scene, quiet=True))
        kept = J.any(axis=1)
        found = precise.solved_with(scene, wrenches, J[kept], right[kept])
        error = np.abs((found - exact.acceleration).astype(float)).max(axis=1)
        assert (error <= bound(scene, exact)).all(), seed


@pytest.mark.turn(3)
def test_every_type_of_joint_and_force_is_among_them():
    """A contact is a law."""
    kinds = {cls.model_fields["type"].default for cls in FORCES} - {"contact"}
    missing = {*CONSTRAINTS, *kinds, "body", "world"}
    each = sorted((seed, name) for name in random_mechanisms.CLASSES for seed in range(count(name, 60)))
    for seed, name in each:
        if missing:
            scene, wrenches = random_mechanisms.random_mechanism(name, seed)
            missing -= {part.type for part in (*scene.joints, *scene.forces)} | {push[2] for push in wrenches}
    assert not missing


def main(total=500, *spaces):
    """Print the worst errors of every class and formulation."""
    print("Worst error of a body, in brackets its seed: relative to max(|a|, |g|); as a part of the")
    print("bound of all formulations, and of that allowed here; mechanisms beyond either bound.")
    for name in random_mechanisms.CLASSES:
        rows = {space: [] for space in spaces or SPACES}
        for seed in range(count(name, int(total))):
            for found in judged(name, seed, rows):
                scales = found.size, found.bound, found.allowed
                rows[found.space].append([*((found.error / x).max() for x in scales), seed])
        for space, found in rows.items():
            if found:
                worst = [max(found, key=lambda row: row[k]) for k in range(3)]
                print(
                    f"{name:16s} {space:9s} {len(found):4d}",
                    *(f"{row[k]:9.2g} ({row[3]})".ljust(16) for k, row in enumerate(worst)),
                    *(f"{sum(not row[k] <= 1.0 for row in found):4d}" for k in (1, 2)),
                    flush=True,
                )


if __name__ == "__main__":
    main(*sys.argv[1:])
