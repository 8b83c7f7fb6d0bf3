# SPDX-License-Identifier: Apache-2.0
"""Contract of every motion group of the table: what a sweep asks, against dense matrices.

A further group is tested by its line in the table. The references are exp and Ad on SE(3) and dense
algebra with the columns of S, from the data of the group alone.
"""

import itertools
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest

from liegroup_core.compiling import Struct
from liegroup_core.lie import SE3, SO3
from liegroup_core.lie.coefficients import dexpinv_coefficients
from liegroup_core.mechanism.arrays import LINK, PLANE_LINK
from liegroup_core.motion_groups import derived, direct, table
from liegroup_core.motion_groups.elimination import ENTRIES

CODES = range(len(table.GROUPS))
PITCH = 0.3
CLOSE = dict(rtol=1e-12, atol=1e-12)


class HelicalSpline:
    """A pair of data alone, as one who adds it would write its file: a turn, and a slide beside its thread."""

    COMPONENTS, ORDER = (2, 5), (1, 0)
    MAY_BE_HELD = HAS_PITCH = True


def functions_alone():
    """The functions of table.py for HelicalSpline alone."""
    functions = table.functions_of(HelicalSpline)
    found = {}
    with mock.patch.dict(derived.CALLED):
        for name in sorted(functions, key=lambda name: name != "lift"):  # displace calls it
            found[name] = table.choice(name, table.SPACE[name], {0: functions[name]})
            derived.CALLED["lift"] = found["lift"]

    def relative_pose(link, coordinates, row):
        parts = found["relative_rotation"], found["relative_point"]
        return [part(link, coordinates, row) for part in parts]

    found |= {"relative_pose": relative_pose, "displace_by_twist": found["displace"]}
    found |= {"move_coordinates": found["displace"]}
    return SimpleNamespace(**found, is_curved=lambda link: False, in_world_axes=lambda link: False)


GROUPS = (*table.GROUPS, HelicalSpline)
NAMES = [group.__name__.rpartition(".")[2] for group in GROUPS]
every_group = pytest.mark.parametrize("code", range(len(GROUPS)), ids=NAMES)


def may_be_held(code):
    return getattr(GROUPS[code], "MAY_BE_HELD", False)


class Scratch(Struct):
    """Fields of RelativeWork that a motion group uses, for a link 1 with a parent 0."""

    freedoms: np.ndarray
    acceleration: np.ndarray
    held: np.ndarray
    response: np.ndarray
    relative: np.ndarray
    drift: np.ndarray
    inertia: np.ndarray
    stage_pose: np.ndarray
    force: np.ndarray


def scratch(count, stage_pose, **sizes):
    """Scratch of `count` freedoms, with arrays of zeros of these sizes."""
    sizes |= {"freedoms": (count, 8), "acceleration": (count, 1), "held": count}
    return Scratch(stage_pose=stage_pose, **{name: np.zeros(size) for name, size in sizes.items()})


class Case:
    """A link of a group at a random place, its coordinates and S."""

    def __init__(self, code):
        self.rng = rng = np.random.default_rng(code)
        group = GROUPS[code]
        self.ask = table if group in table.GROUPS else functions_alone()
        self.count = len(group.COMPONENTS)
        self.order = list(getattr(group, "ORDER", range(self.count)))
        self.S = np.eye(6)[:, list(group.COMPONENTS)]
        pitch = PITCH if getattr(group, "HAS_PITCH", False) else 0.0
        self.S[5, 0] += pitch
        self.T = SE3.exp(rng.uniform(-1.0, 1.0, 6))
        records = np.zeros(1, dtype=LINK)
        self.link = record = records[0]
        record["group"], record["freedoms"], record["pitch"] = code, self.count, pitch
        record["rotation"], record["point"] = self.T[:3, :3].ravel(), self.T[:3, 3]
        self.coordinates = np.zeros((1, 12))
        # A screw is in its second turn.
        self.X = SE3.exp(self.S @ rng.uniform(3.5, 4.0, self.count))
        self.project(self.X, self.coordinates)
        sizes = {"response": self.count, "relative": (2, 12), "drift": (2, 6), "inertia": (2, 21), "force": (0, 6)}
        self.work = scratch(self.count, np.zeros((0, 12)), **sizes)

    def project(self, X, coordinates):
        self.ask.project_pose(self.link, tuple(X[:3, :3].ravel()), tuple(X[:3, 3]), coordinates, 0)

    def pose(self, coordinates):
        """T X as a matrix."""
        rot, p = self.ask.relative_pose(self.link, coordinates, 0)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.reshape(rot, (3, 3)), p
        return pose

    def displaced(self, psi, by="displace"):
        out = self.coordinates.copy()
        square = getattr(self.ask, by)(self.link, self.coordinates, 0, psi.reshape(-1, 1), 0, out)
        return out, square

    @property
    def is_direct(self):
        """Whether rotation and position are products of their own."""
        return self.ask.in_world_axes(self.link)

    def displaced_densely(self, psi):
        """X exp(Psi) as a matrix."""
        if not self.is_direct:
            return self.X @ SE3.exp(self.S @ psi)
        X = self.X.copy()
        X[:3, :3] = X[:3, :3] @ SO3.exp(psi[:3])
        X[:3, 3] += psi[3:]
        return X

    def numbers(self, size):
        return self.rng.uniform(-size, size, self.count)


def dense(m):
    """Inertia (6, 6) of its 21 numbers."""
    matrix = np.zeros((6, 6))
    for (i, j), value in zip(ENTRIES, m):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def pair(vector):
    """Angular and linear part as tuples."""
    return tuple(vector[:3]), tuple(vector[3:])


@every_group
def test_project_pose_finds_the_coordinates_of_a_pose(code):
    case = Case(code)
    np.testing.assert_allclose(case.pose(case.coordinates), case.T @ case.X, **CLOSE)
    again = np.zeros((1, 12))
    case.project(SE3.inverse(case.T) @ case.pose(case.coordinates), again)
    np.testing.assert_allclose(again, case.coordinates, **CLOSE)


@every_group
@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_displace_multiplies_by_exp_and_back(code, size):
    case = Case(code)
    psi = case.numbers(size)
    out, square = case.displaced(psi)
    np.testing.assert_allclose(case.pose(out), case.T @ case.displaced_densely(psi), **CLOSE)
    np.testing.assert_allclose(square, ((case.S @ psi)[:3] ** 2).sum(), **CLOSE)
    case.ask.displace(case.link, out, 0, -psi.reshape(-1, 1), 0, out)
    np.testing.assert_allclose(out, case.coordinates, **CLOSE)


@every_group
def test_rate_twist_is_the_derivative_of_the_pose(code):
    case = Case(code)
    rates = case.numbers(1.0)
    row = np.zeros((1, 6))
    row[0, : case.count] = rates
    twist = np.concatenate(case.ask.rate_twist(case.link, row, 0))
    np.testing.assert_array_equal(twist, case.S @ rates)
    step = 1e-5
    after, before = (case.pose(case.displaced(h * rates, "displace_by_twist")[0]) for h in (step, -step))
    slope = SE3.log(SE3.inverse(before) @ after) / (2.0 * step)
    np.testing.assert_allclose(twist, slope, atol=1e-9)


@every_group
def test_rates_and_forces_of_the_freedoms_follow_from_twists_and_wrenches(code):
    case = Case(code)
    rates, F = case.numbers(1.0), case.rng.uniform(-1.0, 1.0, 6)
    row, forces = np.zeros((1, 6)), np.zeros(case.count + 1)
    case.ask.rates_of(case.link, pair(case.S @ rates), row, 0)
    np.testing.assert_allclose(row[0, : case.count], rates, **CLOSE)
    case.ask.own_forces(case.link, pair(F), forces, 1)
    np.testing.assert_allclose(forces[1:], case.S.T @ F, **CLOSE)
    twist = np.concatenate(case.ask.column_twist(case.link, rates.reshape(-1, 1), 0))
    np.testing.assert_array_equal(twist, case.S @ rates)


@every_group
def test_add_rates_adds_the_twist_and_finds_its_bracket(code):
    case = Case(code)
    own, above = case.S @ case.numbers(1.0), case.rng.uniform(-1.0, 1.0, 6)
    (w, v), (cw, cv) = case.ask.add_rates(case.link, *pair(own), *pair(above))
    V = np.concatenate([w, v])
    np.testing.assert_allclose(V, above + own, **CLOSE)
    np.testing.assert_allclose(np.concatenate([cw, cv]), SE3.ad(V) @ own, **CLOSE)


@every_group
def test_normalise_removes_round_off_and_nothing_else(code):
    case = Case(code)
    out, kept = case.coordinates.copy(), case.coordinates.copy()
    out[0, :2] *= 1.0 + 1e-9
    case.ask.normalise(case.link, out, 0)
    rot = case.pose(out)[:3, :3]
    if case.S[:3].any():  # a slide never leaves its group
        np.testing.assert_allclose(rot @ rot.T, np.eye(3), atol=1e-14)
    case.ask.normalise(case.link, kept, 0)
    np.testing.assert_allclose(kept, case.coordinates, atol=1e-15)


@every_group
def test_slope_is_the_inverse_of_dexp_on_the_algebra(code):
    case = Case(code)
    psi, rates = case.numbers(1.0), case.numbers(1.0)
    slopes, row = psi.reshape(-1, 1).copy(), np.zeros((1, 6))
    row[0, : case.count] = rates
    if case.ask.is_curved(case.link):
        b, u = dexpinv_coefficients(float(((case.S @ psi)[:3] ** 2).sum()))
        case.ask.slope(case.link, 0.5, b, u, row, 0, slopes, 0)
        rates_of_psi = slopes[:, 0]
    else:
        rates_of_psi = rates
    if case.is_direct:  # what integrates on the group converts the velocity of the position
        expected, found = SO3.dexpinv(-psi[:3]) @ rates[:3], rates_of_psi[:3]
    else:
        expected, found = SE3.dexpinv(-case.S @ psi) @ case.S @ rates, case.S @ rates_of_psi
    np.testing.assert_allclose(found, expected, **CLOSE)


def test_velocities_of_direct_products_are_those_of_the_position():
    """rdot and its derivative against differences of positions, and the way back."""
    case = Case(table.DIRECT)
    (w, v), (dw, dv) = pair(case.numbers(1.0)), pair(case.numbers(1.0))
    h, at = 1e-4, []
    for t in (-h, 0.0, h):
        # the pose after t: twist and its derivative, up to t^3
        psi = np.array([*w, *v]) * t + np.array([*dw, *dv]) * t * t / 2.0
        at.append(case.displaced(psi, "displace_by_twist")[0][0, 9:])
    coordinates = case.coordinates
    first, second = (at[2] - at[0]) / (2.0 * h), (at[2] - 2.0 * at[1] + at[0]) / h**2
    velocity = direct.to_world(coordinates, 0, v)
    rate = direct.to_world_rate(coordinates, 0, w, v, dv)
    np.testing.assert_allclose(velocity, first, atol=1e-7)
    np.testing.assert_allclose(rate, second, atol=1e-6)
    np.testing.assert_allclose(direct.to_link(coordinates, 0, velocity), v, **CLOSE)
    np.testing.assert_allclose(direct.to_link_rate(coordinates, 0, w, v, rate), dv, **CLOSE)


@every_group
def test_move_coordinates_displaces_by_rotation_and_shift(code):
    case = Case(code)
    psi = case.numbers(0.7).reshape(-1, 1)
    turn, shift = case.ask.column_twist(case.link, psi, 0)
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = SO3.exp(np.array(turn)), shift
    out = case.coordinates.copy()
    case.ask.move_coordinates(case.link, out, 0, psi, 0, out)
    np.testing.assert_allclose(case.pose(out), case.T @ case.X @ step, **CLOSE)


def eliminated(case):
    """(I, p, both without the freedoms) of a random articulated body."""
    root = case.rng.uniform(-1.0, 1.0, (6, 6))
    I, p = root @ root.T + np.eye(6), case.rng.uniform(-1.0, 1.0, 6)
    m = tuple(I[i, j] for i, j in ENTRIES)
    m, torque, force = case.ask.eliminate(case.link, case.work, 0, m, *pair(p))
    return I, p, m, np.concatenate([torque, force])


@every_group
def test_eliminated_freedoms_leave_the_schur_complement(code):
    case = Case(code)
    I, p, m, left = eliminated(case)
    share = I @ case.S @ np.linalg.inv(case.S.T @ I @ case.S)
    if case.count < 6:  # a floating link has no parent to which something is left
        np.testing.assert_allclose(dense(m), I - share @ case.S.T @ I, **CLOSE)
        np.testing.assert_allclose(left, p - share @ case.S.T @ p, **CLOSE)
        # Rows of components that are freedoms are exactly zero.
        if not case.link["pitch"]:
            assert not (case.S.T @ dense(m)).any() and not (case.S.T @ left).any()


@pytest.mark.parametrize(
    "code, held",
    [
        (code, held)
        for code, group in enumerate(GROUPS)
        for held in itertools.product((0.0, 1.0), repeat=len(group.COMPONENTS))
        if may_be_held(code) or not any(held)
    ],
    ids=lambda value: value if isinstance(value, tuple) else NAMES[value],
)
def test_accelerations_and_responses_are_those_of_the_dense_equations(code, held):
    """Whichever freedoms are held: these stay in the inertia."""
    case = Case(code)
    case.work.held[:] = held
    I, p, m, _ = eliminated(case)
    free = np.diag(1.0 - np.array(held))
    D = np.linalg.pinv(free @ case.S.T @ I @ case.S @ free)
    if case.count < 6:
        np.testing.assert_allclose(dense(m), I - I @ case.S @ D @ case.S.T @ I, **CLOSE)
    above, W = case.rng.uniform(-1.0, 1.0, (2, 6))
    rates = -D @ case.S.T @ (p + I @ above)
    moved = np.concatenate(case.ask.accelerate(case.link, case.work, 0, *pair(above)))
    np.testing.assert_allclose(case.work.acceleration[:, 0], rates, **CLOSE)
    np.testing.assert_allclose(moved, above + case.S @ rates, **CLOSE)
    expected = W - I @ case.S @ D @ case.S.T @ W
    left = np.concatenate(case.ask.leave(case.link, case.work, 0, 0, 1, *pair(W)))
    np.testing.assert_allclose(left, expected, **CLOSE)
    mobility = (case.work.response**2 * case.work.freedoms[case.order, 6]).sum()
    np.testing.assert_allclose(mobility, W @ case.S @ D @ case.S.T @ W, **CLOSE)
    # u for the wrench -W is what accelerations under it follow from.
    left = np.concatenate(case.ask.load_freedoms(case.link, case.work, 0, *pair(W)))
    np.testing.assert_allclose(left, expected, **CLOSE)
    case.ask.accelerate(case.link, case.work, 0, *pair(above))
    rates = -D @ case.S.T @ (W + I @ above)
    np.testing.assert_allclose(case.work.acceleration[:, 0], rates, **CLOSE)


@every_group
def test_what_is_left_is_handed_on_as_a_whole_inertia_would_be(code):
    case = Case(code)
    own, above = case.S @ case.numbers(1.0), case.rng.uniform(-1.0, 1.0, 6)
    _, drift = case.ask.add_rates(case.link, *pair(own), *pair(above))
    _, _, m, left = eliminated(case)
    C = case.T @ case.X
    case.work.drift[1] = np.concatenate(drift)
    case.work.relative[1] = [*C[:3, :3].ravel(), *C[:3, 3]]
    short, torque, force = case.ask.hand_on(case.link, case.work, 1, m, *pair(left))
    if short:
        X = SE3.Ad(SE3.inverse(C))
        np.testing.assert_allclose(dense(case.work.inertia[0]), X.T @ dense(m) @ X, **CLOSE)
        expected = left + dense(m) @ case.work.drift[1]
        np.testing.assert_allclose(np.concatenate([torque, force]), expected, **CLOSE)
    else:
        np.testing.assert_array_equal(np.concatenate([torque, force]), left)
        assert not case.work.inertia.any()


@pytest.mark.parametrize("code", list(filter(may_be_held, range(len(GROUPS)))), ids=NAMES.__getitem__)
def test_an_inertia_with_a_held_freedom_is_handed_on_as_a_whole(code):
    case = Case(code)
    case.work.held[:] = 1.0
    _, p, m, _ = eliminated(case)
    short, *_ = case.ask.hand_on(case.link, case.work, 1, m, *pair(p))
    assert not short


def test_a_lower_pair_has_one_motion_group():
    kinds = [kind for group in table.GROUPS for kind in group.JOINTS]
    assert len(kinds) == len(set(kinds)) == len(table.OF_JOINT)
    for code in CODES:
        assert sorted(table.ORDERS[code]) == list(range(table.FREEDOMS[code]))


class PlaneCase:
    """A link of a group in a plane; the references are those in space, with z normal to the plane."""

    KEPT = [2, 3, 4]  # components of a twist that are left

    def __init__(self, code):
        self.rng = rng = np.random.default_rng(code)
        components = table.PLANE_COMPONENTS[code]
        self.count = len(components)
        self.S = np.eye(6)[:, list(components)]
        self.T = SE3.exp(self.in_space(rng.uniform(-1.0, 1.0, 3)))
        self.link = np.zeros(1, dtype=PLANE_LINK)[0]
        self.link["group"], self.link["parent"], self.link["freedoms"] = code, 0, self.count
        self.link["cos"], self.link["sin"] = self.T[:2, 0]
        self.link["x"], self.link["y"] = self.T[:2, 3]
        self.X = SE3.exp(self.S @ rng.uniform(3.5, 4.0, self.count))
        self.coordinates = np.zeros((2, 12))
        rot, p = tuple(self.X[:3, :3].ravel()), tuple(self.X[:3, 3])
        table.plane_project_pose(self.link, rot, p, self.coordinates, 1)
        sizes = {"response": 0, "relative": (0, 12), "drift": (0, 2), "inertia": (2, 6), "force": (2, 3)}
        self.work = scratch(self.count, self.coordinates, **sizes)

    def in_space(self, V):
        return np.eye(6)[:, self.KEPT] @ V

    def pose(self, coordinates):
        c, s, x, y = coordinates[1, :4]
        pose = np.eye(4)
        pose[:2, :2], pose[:2, 3] = [[c, -s], [s, c]], (x, y)
        return pose

    def numbers(self, size):
        return self.rng.uniform(-size, size, self.count)

    def displaced(self, psi, displace):
        out = self.coordinates.copy()
        square = displace(self.link, self.coordinates, 1, psi.reshape(-1, 1), 0, out)
        return out, square

    def inertia(self):
        root = self.rng.uniform(-1.0, 1.0, (3, 3))
        return root @ root.T + np.eye(3)


UPPER = np.triu_indices(3)
every_plane_group = pytest.mark.parametrize(
    "code", list(table.PLANE_COMPONENTS), ids=[NAMES[code] for code in table.PLANE_COMPONENTS]
)


@every_plane_group
def test_coordinates_in_a_plane_are_those_in_space(code):
    case = PlaneCase(code)
    np.testing.assert_allclose(case.pose(case.coordinates), case.T @ case.X, **CLOSE)
    psi = case.numbers(1.0)
    out, square = case.displaced(psi, table.plane_displace)
    np.testing.assert_allclose(case.pose(out), case.T @ case.X @ SE3.exp(case.S @ psi), **CLOSE)
    np.testing.assert_allclose(square, ((case.S @ psi)[:3] ** 2).sum(), **CLOSE)
    turn, x, y = table.plane_column_twist(case.link, psi.reshape(-1, 1), 0)
    step = SE3.exp([0.0, 0.0, turn, 0.0, 0.0, 0.0])
    step[:2, 3] = x, y
    out, _ = case.displaced(psi, table.plane_move_coordinates)
    np.testing.assert_allclose(case.pose(out), case.T @ case.X @ step, **CLOSE)
    kept = case.coordinates.copy()
    table.plane_normalise(case.link, kept, 1)
    np.testing.assert_allclose(kept, case.coordinates, atol=1e-15)
    moved = case.coordinates * (1.0 + 1e-9)
    table.plane_normalise(case.link, moved, 1)
    np.testing.assert_allclose(np.hypot(*moved[1, :2]), 1.0, atol=1e-14)
    if case.count == 1:
        angle = SE3.log(case.X) @ case.S
        found = table.plane_coordinate(case.link, case.coordinates, 1)
        np.testing.assert_allclose(found, angle, **CLOSE)


@every_plane_group
def test_rates_in_a_plane_are_those_in_space(code):
    case = PlaneCase(code)
    rates, above = np.zeros((1, 6)), case.rng.uniform(-1.0, 1.0, 3)
    rates[0, : case.count] = case.numbers(1.0)
    own = table.plane_rate_twist(case.link, rates, 0)
    np.testing.assert_array_equal(case.in_space(own), case.S @ rates[0, : case.count])
    found, forces = np.zeros((1, 6)), np.zeros(case.count)
    table.plane_rates_of(case.link, own, found, 0)
    np.testing.assert_array_equal(found, rates)
    table.plane_own_forces(case.link, tuple(above), forces, 0)
    np.testing.assert_array_equal(forces, case.S[case.KEPT].T @ above)
    V, bracket = table.plane_add_rates(case.link, own, tuple(above))
    np.testing.assert_allclose(V, above + own, **CLOSE)
    expected = SE3.ad(case.in_space(V)) @ case.in_space(own)
    np.testing.assert_allclose([0.0, *bracket], expected[case.KEPT], **CLOSE)


@pytest.mark.parametrize(
    "code, held",
    [
        (code, held)
        for code in table.PLANE_COMPONENTS
        for held in (False, True)
        if not held or getattr(table.GROUPS[code], "MAY_BE_HELD", False)
    ],
)
def test_articulated_bodies_in_a_plane_are_those_of_the_dense_equations(code, held):
    case = PlaneCase(code)
    case.work.held[:] = held
    I, p, S = case.inertia(), case.rng.uniform(-1.0, 1.0, 3), case.S[case.KEPT]
    X = SE3.Ad(SE3.inverse(case.T @ case.X))[np.ix_(case.KEPT, case.KEPT)]
    D = np.zeros((case.count, case.count)) if held else np.linalg.inv(S.T @ I @ S)
    m, F = tuple(I[UPPER]), tuple(p)
    case.work.inertia[1], case.work.force[1] = m, F
    m, F = table.plane_eliminate(case.link, case.work, 0, m, F)
    table.plane_hand_on(case.link, case.work, 1, m, F)
    left = I - I @ S @ D @ S.T @ I
    np.testing.assert_allclose(case.work.inertia[0], (X.T @ left @ X)[UPPER], **CLOSE)
    expected = X.T @ (p - I @ S @ D @ S.T @ p)
    np.testing.assert_allclose(case.work.force[0], expected, **CLOSE)
    above, W = case.rng.uniform(-1.0, 1.0, (2, 3))
    moved = table.plane_accelerate(case.link, case.work, 0, tuple(above), tuple(X @ above))
    rates = -D @ S.T @ (p + I @ X @ above)
    np.testing.assert_allclose(case.work.acceleration[:, 0], rates, **CLOSE)
    np.testing.assert_allclose(moved, X @ above + S @ rates, **CLOSE)
    left, *parts = table.plane_leave(case.link, case.work, 0, 1, tuple(W))
    np.testing.assert_allclose(left, X.T @ (W - I @ S @ D @ S.T @ W), **CLOSE)
    mobility = (np.square(parts[: case.count]) * case.work.freedoms[:, 6]).sum()
    np.testing.assert_allclose(mobility, W @ S @ D @ S.T @ W, **CLOSE)
