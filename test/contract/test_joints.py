# SPDX-License-Identifier: Apache-2.0
"""Contract of every joint type. A new type only needs its parameters in PARAMETERS of test/mechanisms.py."""

import math
from typing import get_args

import mechanisms
import numpy as np
import pytest
from scipy.linalg import null_space

from liegroup_core.joints.elements import ELEMENT, PAIR
from liegroup_core.joints.kinds import (
    CONSTRAINTS,
    JOINTS,
    ROLLING,
    TYPES,
    forbidden_rows,
    position_residual,
    variable_residual,
    variable_row,
)
from liegroup_core.joints.rolling import is_holonomic
from liegroup_core.lie.groups import SE3

ENDS = {"name": "j", "parent": "world", "child": "b", "parent_frame": {}, "child_frame": {}}
EPS = np.finfo(float).eps


def example(kind):
    """Joint of a type."""
    return mechanisms.joint(kind, **ENDS | mechanisms.parameters(kind))


def closed_pose(kind, rng):
    """Pose (4, 4) that satisfies the joint, reached along its free directions from the start."""
    C = np.eye(4)
    if kind == "distance":
        C[:3, 3] = mechanisms.PARAMETERS["length"], 0.0, 0.0
    elif kind in ROLLING:
        C = SE3.exp([1.3, 0.0, 0.0, 0.0, 0.0, 0.0])  # the axis of a wheel is not normal to its plane
        C[2, 3] = mechanisms.PARAMETERS["radius"]
    elements = example(kind).elements(C)
    for _ in range(300):
        rows = forbidden_rows(elements, C)
        free = null_space(rows) if len(rows) else np.eye(6)
        C = C @ SE3.exp(3e-3 * free @ rng.uniform(0.0, 2.0, free.shape[1]))
    for _ in range(4):  # back onto the joint
        rows = forbidden_rows(elements, C)
        C = C @ SE3.exp(-np.linalg.pinv(rows) @ position_residual(elements, C))
    return elements, C


def test_every_joint_type_has_exactly_one_class():
    named = [kind for cls in JOINTS for kind in get_args(cls.model_fields["type"].annotation)]
    assert sorted(named) == sorted(TYPES)
    assert all(kind.text for kind in TYPES.values())
    elements = [each for kind in TYPES for each in example(kind).elements(np.eye(4))]
    variable = {(each.kind, each.names) for each in elements if each.kind != PAIR}
    assert len(variable) == len(VARIABLE), "two kinds of elements have the same KIND"


@pytest.mark.parametrize("kind", [*CONSTRAINTS, "wheel", "ball_on_plane"])
def test_rows_are_named_and_are_the_derivative_of_the_residual(kind):
    """residual(C exp X) = rows X + O(X^2). Tolerance: |X| = 1e-6, curvature below 100, so 1e-10."""
    rng = np.random.default_rng(7)
    elements, C = closed_pose(kind, rng)
    assert np.abs(position_residual(elements, C)).max(initial=0.0) <= 100 * EPS
    rows = forbidden_rows(elements, C)
    assert rows.shape == (sum(len(element.names) for element in elements), 6)
    holonomic = np.concatenate([[is_holonomic(each.kind)] * len(each.names) for each in elements])
    for _ in range(5):
        X = 1e-6 * rng.normal(size=6) / math.sqrt(6.0)
        gaps = position_residual(elements, C @ SE3.exp(X))
        assert np.abs((gaps - rows @ X)[holonomic]).max(initial=0.0) <= 1e-10
        assert not gaps[~holonomic].any()


@pytest.mark.parametrize("kind", CONSTRAINTS)
def test_rows_of_lower_pairs_are_constant_and_other_rows_combine_directions(kind):
    elements, C = closed_pose(kind, np.random.default_rng(8))
    first = 0
    for element, rows in ((e, len(e.names)) for e in elements):
        block = forbidden_rows(elements, C)[first : first + rows]
        first += rows
        if element.kind == PAIR:
            np.testing.assert_array_equal(block, element.forbidden)
        else:
            outside = block @ null_space(element.forbidden)
            assert rows == 1 and np.abs(outside).max(initial=0.0) <= 4 * EPS


@pytest.mark.parametrize("kind", CONSTRAINTS)
def test_declared_rotation_and_translation_match_the_null_space_of_the_rows(kind):
    """At a consistent pose; the null space of the rows has (f, 6) free directions.

    Torques about z need parallel z axes, forces along z also coincident ones.
    """
    elements, C = closed_pose(kind, np.random.default_rng(9))
    wx, wy, wz, vx, vy, vz = np.abs(null_space(forbidden_rows(elements, C))).max(axis=1, initial=0.0)
    free = len(null_space(forbidden_rows(elements, C)).T)
    parallel, coincident = max(wx, wy) < 1e-9, max(wx, wy, vx, vy) < 1e-9
    assert TYPES[kind].turns == (parallel and wz > 1e-3)
    assert TYPES[kind].slides == (coincident and vz > 1e-3)
    assert TYPES[kind].rate == (2 if TYPES[kind].turns else 5 if TYPES[kind].slides else None)
    if TYPES[kind].coordinate is not None:
        assert free == 1
        assert TYPES[kind].coordinate == ("rad" if TYPES[kind].turns else "m")


VARIABLE = {
    element.kind: element for kind in TYPES for element in example(kind).elements(np.eye(4)) if element.kind != PAIR
}


@pytest.mark.parametrize("kind", VARIABLE)
@pytest.mark.parametrize("seed", range(5))
def test_rows_and_bias_are_time_derivatives_of_the_residual(kind, seed):
    """Along a motion of constant relative twist, by the five-point rule of step 1e-4.

    At rates below 20/s it leaves h^4 20^6 / 30 = 2e-10, and eps / h of values below 30: 1e-9 in
    all. Rows are compared at closed poses, where they are the slope of the residual.
    """
    rng = np.random.default_rng([seed, 11])
    F_a, F_b = mechanisms.random_pose(rng), mechanisms.random_pose(rng)
    V = rng.normal(size=6)
    element = VARIABLE[kind]
    C_rel = next(
        closed_pose(name, rng)[1]
        for name in TYPES
        if element.kind in [each.kind for each in example(name).elements(np.eye(4))]
    )
    record = np.array([element.record(-1, 0, 0, F_a, F_b)], dtype=ELEMENT)[0]
    C_ab = F_a @ C_rel @ np.linalg.inv(F_b)  # pose of the child in the parent

    def at(t):
        """Row (6,), rate and residual after a time t."""
        moved = C_ab @ SE3.exp(t * V)
        back, joint = np.linalg.inv(moved), np.linalg.inv(F_a) @ moved @ F_b
        w, v = tuple(V[:3].tolist()), tuple(V[3:].tolist())
        angular, linear, rate = variable_row(record, *flat(back), w, v)
        gap = variable_residual(kind, *flat(joint), element.parameter)
        return np.array([*angular, *linear]), rate, gap

    h = 1e-4
    ((row, rate, _), *around) = map(at, (0.0, -2 * h, -h, h, 2 * h))

    def slope(values):
        return np.dot([1.0, -8.0, 8.0, -1.0], values) / (12.0 * h)

    assert abs(row @ V) > 1e-3
    if is_holonomic(kind):
        assert row @ V == pytest.approx(slope([gap for _, _, gap in around]), abs=1e-9)
    assert rate == pytest.approx(slope([there @ V for there, _, _ in around]), abs=1e-9)


def flat(C):
    """Rotation (9,) and position (3,) of a pose, as kernels take them."""
    return tuple(C[:3, :3].ravel().tolist()), tuple(C[:3, 3].tolist())
