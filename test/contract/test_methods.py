# SPDX-License-Identifier: Apache-2.0
"""Contract of every registered method: its coefficients, and its behaviour in Simulation.

The order on problems with references: test/verification/test_orders.py.
"""

import math
import os
import subprocess
import sys
from itertools import combinations_with_replacement

import mechanisms
import numpy as np
import pytest
from scipy.integrate import RK45
from volume import some

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.forces.commands import WRENCH, Command
from liegroup_core.methods.families import NOT_ON_SE3, ON_JOINTS
from liegroup_core.methods.munthe_kaas import steps
from liegroup_core.methods.table import CONFIGURATION_GROUPS, METHODS, RELATIVE
from liegroup_core.settings import check_options
from liegroup_core.status import (
    DEPENDENT_ROWS,
    DIVERGED,
    NO_RATTLE_STEP,
    NOT_CONVERGED,
    NOT_FINITE,
    ROTATION_TOO_LARGE,
    SUBSTEP_TOO_SMALL,
    TOO_MANY_SUBSTEPS,
)

TABLEAUS = {name: method for name, method in METHODS.items() if method.coefficients}
ANYWHERE = [name for name, method in METHODS.items() if method.family != "rotation"]
CONTROLLED = [name for name, method in METHODS.items() if method.controlled]
ON_GROUPS = [
    (name, group)
    for name, method in METHODS.items()
    for group in CONFIGURATION_GROUPS
    if group == "so3xr3" or (method.family in ON_JOINTS if group == RELATIVE else method.family not in NOT_ON_SE3)
]
OF_FAMILY = {}
for each in METHODS:
    OF_FAMILY.setdefault(METHODS[each].family, []).append(each)
UNIT = 2.0**-53


def rooted_trees(order):
    """All rooted trees with `order` vertices; a tree is the sorted tuple of its subtrees."""
    if order == 1:
        return [()]
    return sorted(set(forests(order - 1, order - 1)))


def forests(vertices, largest):
    """All sorted tuples of trees with `vertices` vertices in total, none above `largest`."""
    if vertices == 0:
        return [()]
    found = []
    for size in range(1, min(vertices, largest) + 1):
        for count in range(1, vertices // size + 1):
            for rest in forests(vertices - count * size, size - 1):
                for trees in combinations_with_replacement(rooted_trees(size), count):
                    found.append(tuple(sorted(trees + rest)))
    return found


def vertices(tree):
    return 1 + sum(map(vertices, tree))


def density(tree):
    """Density gamma(t): the product of the sizes of all subtrees."""
    return vertices(tree) * math.prod(map(density, tree))


def weights(a, tree):
    """(s,) elementary weights: product over the subtrees of a times their weights."""
    product = np.ones(len(a))
    for subtree in tree:
        product = product * (a @ weights(a, subtree))
    return product


def defect(a, b, tree, wanted):
    """Violation of the tree's order condition, and its bound by round-off of the coefficients.

    Every factor is rounded once and every product and sum of up to s terms again: at most
    2 vertices (s + 2) units of the sum of all absolute values.
    """
    value = b @ weights(a, tree)
    size = np.abs(b) @ weights(np.abs(a), tree)
    return abs(value - wanted), 2 * vertices(tree) * (len(b) + 2) * UNIT * max(size, 1.0)


def test_the_number_of_rooted_trees_is_the_published_one():
    """Numbers of rooted trees with 1..9 vertices: OEIS A000081."""
    assert [len(rooted_trees(n)) for n in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]


@pytest.mark.parametrize("name", TABLEAUS)
def test_tableau_is_explicit_and_nodes_are_row_sums(name):
    """Implicit ones end at their last stage, which a stiff force needs."""
    tableau = METHODS[name].tableau
    s = len(tableau.b)
    assert tableau.a.shape == (s, s) and tableau.c.shape == (s,)
    if METHODS[name].implicit:
        assert (tableau.a[-1] == tableau.b).all() and np.linalg.matrix_rank(tableau.a) == s
    else:
        assert (np.triu(tableau.a) == 0.0).all()
    assert np.abs(tableau.a.sum(axis=1) - tableau.c).max() <= s * UNIT * np.abs(tableau.a).max()


@pytest.mark.parametrize("name", TABLEAUS)
def test_all_order_conditions_up_to_the_stated_order(name):
    method = METHODS[name]
    a, b = method.tableau.a, method.tableau.b
    for order in range(1, method.order + 1):
        for tree in rooted_trees(order):
            off, allowed = defect(a, b, tree, 1.0 / density(tree))
            assert off <= allowed, tree
    # One order more is not reached, and not by a rounding's width.
    assert max(defect(a, b, tree, 1.0 / density(tree))[0] for tree in rooted_trees(method.order + 1)) > 1e-6


@pytest.mark.parametrize("name", CONTROLLED)
def test_error_estimates_have_their_orders(name):
    """e is the difference of two methods, with the derivative at the end as an extra stage.

    Of an implicit method that at the start.
    """
    method = METHODS[name]
    tableau = method.tableau
    a = np.zeros((len(tableau.b) + 1,) * 2)
    a[:-1, :-1] = tableau.a
    if not method.implicit:
        a[-1, :-1] = tableau.b
    orders = [method.order - 1] if len(tableau.e) == 1 else [5, 3]
    if method.implicit:
        orders = [len(tableau.b)]
    assert len(orders) == len(tableau.e)
    for weights, highest in zip(tableau.e, orders):
        for order in range(1, highest + 1):
            for tree in rooted_trees(order):
                off, allowed = defect(a, weights, tree, 0.0)
                assert off <= allowed, tree
        assert max(defect(a, weights, tree, 0.0)[0] for tree in rooted_trees(highest + 1)) > 1e-6


def test_dormand_prince_tableau_equals_that_of_scipy():
    tableau = METHODS["rkmk54"].tableau
    assert np.abs(tableau.a[:, :5] - RK45.A).max() <= 2 * UNIT
    assert np.abs(tableau.b - RK45.B).max() <= UNIT
    # Differences of weights below 1, each rounded.
    assert np.abs(tableau.e + RK45.E).max() <= 2 * UNIT


@pytest.mark.parametrize("name", METHODS)
def test_method_entry_is_complete(name):
    method = METHODS[name]
    assert method.name == name and method.order >= 1 and method.source
    assert set(check_options(name, {})) == set(method.options)


@pytest.mark.slow
@pytest.mark.parametrize("name, group", ON_GROUPS)
@pytest.mark.volume(6)
def test_runs_are_bit_identical_however_the_steps_are_split(name, group):
    """Also with a wrench that starts and ends between the calls, and after a reset.

    In space, with forces of all kinds; and in a plane, where coordinates of a loop are found from the poses at the
    end of every step.
    """
    scenes = [mechanisms.fitting(name)]
    if METHODS[name].family != "rotation":
        scenes += [load_scene("four_bar"), mechanisms.under_many_forces()]

    def run(simulation, counts):
        simulation.reset()
        body = simulation.layout.body_names[1]
        simulation.apply_wrench(body, (0.1, 0.2, -0.3, 1.0, 2.0, 3.0), start=0.02, duration=0.03)
        for count in counts:
            simulation.advance(count)
        return *(part.tobytes() for part in simulation.state()), simulation.sample().angles.tobytes()

    for scene in scenes:
        whole, pieces = (Simulation(scene, method=name, group=group, step=1e-3) for _ in range(2))
        expected = run(whole, [60])
        assert run(pieces, [1, 2, 0, 7, 0, 20, 30]) == expected
        assert run(pieces, [30, 30]) == expected
        assert whole.steps == 60


@pytest.mark.parametrize("name", METHODS)
def test_set_state_continues_like_a_new_simulation(name):
    """set_state clears everything that a method stores between calls."""
    scene = load_scene("heavy_top")
    used, new = (Simulation(scene, method=name, step=1e-3) for _ in range(2))
    used.advance(37)
    pose, twist = used.state()
    used.set_state(pose, twist)
    new.set_state(pose, twist)
    for simulation in (used, new):
        simulation.advance(20)
    assert used.state()[0].tobytes() == new.state()[0].tobytes()
    assert used.state()[1].tobytes() == new.state()[1].tobytes()


@pytest.mark.parametrize("name", METHODS)
def test_too_large_steps_stop_with_the_last_valid_state(name, caplog):
    """150 rad/s and a step of 0.1 s give 15 rad; error control avoids that by substeps.

    Rotation methods but RATTLE may have a solution there, however useless, and warn.
    """
    simulation = Simulation(load_scene("lagrangian_top"), method=name, step=0.1)
    before = simulation.state()
    if name in CONTROLLED:
        simulation.advance(1)
        assert simulation.substeps[0] > 15.0 / (2.0 * math.pi)
        return
    try:
        simulation.advance(10)
    except SimulationError as failure:
        assert failure.status & 0xFF in (ROTATION_TOO_LARGE, NOT_FINITE, NOT_CONVERGED, NO_RATTLE_STEP, DIVERGED)
        assert "smaller step" in str(failure) and "\n" not in str(failure)
        good = simulation.steps
        assert good == 0 or METHODS[name].family == "rotation"
        for mine, theirs in zip(simulation.state(), before):
            assert good or mine.tobytes() == theirs.tobytes()
        return
    assert METHODS[name].family == "rotation" and name != "rattle"
    assert any("more than pi" in record.message for record in caplog.records)


@pytest.mark.parametrize("name", METHODS)
def test_overflow_stops_with_the_last_valid_state(name):
    simulation = Simulation(load_scene("free_body"), method=name, step=1.0)
    Command(WRENCH, "body", (0, 0, 0, 1e308, 0, 0), 3 * 10**9).repeat(simulation)  # without checks
    with pytest.raises(SimulationError) as failure:
        simulation.advance(1000)
    statuses = (NOT_FINITE, ROTATION_TOO_LARGE, NOT_CONVERGED)
    if name in CONTROLLED:  # such a force lets no error estimate pass either
        statuses += (SUBSTEP_TOO_SMALL, TOO_MANY_SUBSTEPS)
    assert failure.value.status in statuses
    assert np.isfinite(simulation.state()[0]).all() and np.isfinite(simulation.state()[1]).all()
    assert simulation.steps >= 3
    stopped = simulation.state()[0].tobytes()
    with pytest.raises(SimulationError):
        simulation.advance(1)
    assert simulation.state()[0].tobytes() == stopped
    simulation.reset()
    simulation.advance(2)
    assert simulation.steps == 2


@pytest.mark.parametrize("name", ANYWHERE)
@pytest.mark.volume(4)
def test_a_singular_pose_is_solved_or_stops_with_the_last_valid_state(name):
    """Two collinear links between ground points: the middle joint's rows become dependent.

    It is open by half a metre there, which an implicit method cannot close within a step.
    """
    simulation = Simulation(mechanisms.two_links(1.5), method=name)
    pose, twist = np.zeros((2, 12)), np.zeros((2, 6))
    pose[0, :9] = np.eye(3).ravel()
    pose[1, :9] = np.diag([-1.0, -1.0, 1.0]).ravel()
    pose[0, 9], pose[1, 9] = 0.5, 2.0 - 0.75
    simulation.set_state(pose, twist, steps=3)
    try:
        simulation.advance(1)
    except SimulationError as failure:
        assert failure.status in (DEPENDENT_ROWS, NOT_CONVERGED, ROTATION_TOO_LARGE)
        assert simulation.steps == 3
        assert (simulation.state()[0] == pose).all() and (simulation.state()[1] == twist).all()
    assert simulation.singular_solves > 0
    # From rest they can only fall by O(h^2).
    assert np.abs(simulation.state()[0] - pose).max() <= 1e-4


@pytest.mark.parametrize(
    "name",
    [n for n in METHODS if n not in CONTROLLED and n not in ("rattle", "constrained_rattle4", "constrained_rattle8")],
)
def test_a_rotation_beyond_pi_warns_once(name, caplog):
    """A free body rotates about a principal axis; only RATTLE limits the step for that.

    Methods that take a step in several turn by less than pi in each.
    """
    simulation = Simulation(load_scene("free_body"), method=name, step=0.5)
    simulation.set_state(simulation.state()[0], [[0.0, 0.0, 8.0, 0.0, 0.0, 0.0]])
    simulation.advance(1)
    simulation.advance(2)
    said = [r.message for r in caplog.records if "more than pi" in r.message]
    # 4 rad a step: pi is at 0.39 s.
    assert len(said) == 1 and said[0].startswith(f"{name}, step 0.5 s:") and "step below 0.39" in said[0]


@pytest.mark.parametrize("name, group", ON_GROUPS)
def test_a_free_body_at_rest_without_forces_stays_at_rest(name, group):
    simulation = Simulation(load_scene("free_body"), method=name, group=group, step=0.25)
    pose = simulation.state()[0]
    simulation.set_state(pose, np.zeros((1, 6)))
    simulation.advance(8)
    assert (simulation.state()[0] == pose).all() and (simulation.state()[1] == 0.0).all()


def test_inapplicable_or_invalid_options_are_refused():
    scene = load_scene("free_body")
    for options, text in (
        ({"method": "rkmk4", "rtol": 1e-6}, "rkmk4 has no option 'rtol'; it has: dexpinv"),
        ({"method": "rkmk54", "rho_inf": 1.0}, "it has: dexpinv, space, rtol, atol"),
        ({"method": "rattle", "rtol": 1e-6}, "rattle has no option 'rtol'; it has none$"),
        ({"method": "rattle", "group": "se3"}, "group must be 'so3xr3' or 'auto', got 'se3'"),
        (
            {"method": "constrained_rattle", "group": "se3"},
            "on SE\\(3\\): group must be 'so3xr3', 'relative' or 'auto', got 'se3'",
        ),
        ({"method": "rkmk4", "group": "so3"}, "unknown group 'so3'; choose one of: auto, se3"),
        ({"method": "rkmk54", "atol": 0.0}, "atol must be a positive number, got 0.0"),
        ({"method": "rkmk54", "rtol": math.nan}, "rtol must be a positive number"),
        ({"method": "rkmk4", "dexpinv": "none"}, "unknown dexpinv 'none'; choose one of: exact, truncated"),
        ({"method": "rkmk4", "space": "plane"}, "unknown space 'plane'; choose one of: auto, space"),
        ({"method": "generalized_alpha", "rho_inf": 1.1}, "rho_inf must be a number from 0"),
        ({"method": "generalized_alpha", "stabilisation": "projection"}, "satisfies the constraints"),
    ):
        with pytest.raises(ValueError, match=text):
            Simulation(scene, **options)
    groups = {name: Simulation(scene, method=name).group for name in METHODS}
    assert groups == {name: "so3xr3" if method.family == "rotation" else "relative" for name, method in METHODS.items()}
    assert Simulation(scene, method="rkmk54", rtol=1e-3).options == {
        "dexpinv": "exact",
        "space": "auto",
        "rtol": 1e-3,
        "atol": 1e-6,
    }


def test_substeps_are_deterministic_counted_and_reset():
    simulation = Simulation(load_scene("heavy_top"), method="rkmk54", step=0.1, rtol=1e-9, atol=1e-9)
    assert simulation.substeps == (0, 0)
    simulation.advance(5)
    good, attempts = simulation.substeps
    assert 5 < good < attempts
    state = simulation.state()[0].tobytes()
    simulation.reset()
    assert simulation.substeps == (0, 0)
    simulation.advance(5)
    assert simulation.substeps == (good, attempts)
    assert simulation.state()[0].tobytes() == state
    assert Simulation(load_scene("heavy_top")).substeps == (0, 0)


def test_the_error_norm_is_the_documented_one():
    """Maximum over bodies of |dxi|, |deta| / atol and |dw|, |dv| / (atol + rtol |velocity|)."""
    simulation = Simulation(mechanisms.named("chain of balls"), method="rkmk54", group="se3", rtol=3e-4, atol=2e-5)
    integrator = simulation._integrator
    model, work = integrator.mechanism
    weights = METHODS["rkmk54"].tableau.e[0]
    n, stages = 3, len(weights)
    rng = np.random.default_rng(4)
    slopes = rng.normal(size=(stages, n, 12))
    before, after = rng.normal(size=(2, n, 6))
    of_freedoms = slopes.reshape(stages, n, 2, 6).swapaxes(2, 3).reshape(-1, 2)
    work.slopes[: len(of_freedoms)] = of_freedoms
    work.stage_twist[:n] = after
    delta = 0.01 * np.einsum("s,snc->nc", weights, slopes).reshape(n, 4, 3)
    size = np.maximum(*(np.linalg.norm(v.reshape(n, 2, 3), axis=2) for v in (before, after)))
    # |deta| and |dv| are compared with atol times a length of 0.7 m.
    tolerance = 2e-5 * np.array([1.0, 0.7, 1.0, 0.7]) + 3e-4 * np.hstack([np.zeros((n, 2)), size])
    expected = np.sqrt(((np.linalg.norm(delta, axis=2) / tolerance) ** 2).sum(axis=1)).max()
    found = math.sqrt(
        max(
            steps.error_square(model, work, integrator._methods[0][0], 0, 0.01, before, i, 3e-4, 2e-5, 0.7)
            for i in range(n)
        )
    )
    assert found == pytest.approx(expected, rel=1e-12)


def test_an_unattainable_tolerance_ends_with_a_status():
    """Below round-off every substep is rejected; a long step needs too many substeps."""
    simulation = Simulation(load_scene("heavy_top"), method="rkmk54", step=0.01, rtol=1e-40, atol=1e-40)
    before = simulation.state()[0].tobytes()
    with pytest.raises(SimulationError, match="increase atol and rtol") as failure:
        simulation.advance(1)
    assert failure.value.status == SUBSTEP_TOO_SMALL
    assert simulation.state()[0].tobytes() == before and simulation.steps == 0
    simulation = Simulation(load_scene("heavy_top"), method="rkmk54", step=1000.0)
    with pytest.raises(SimulationError, match="too many substeps") as failure:
        simulation.advance(1)
    assert failure.value.status == TOO_MANY_SUBSTEPS
    assert simulation.state()[0].tobytes() == before and simulation.steps == 0


PLAIN = """
import sys
sys.path.insert(0, sys.argv[1])
import mechanisms
from liegroup_core import load_scene
from liegroup_core.engine import Engine
from liegroup_core.methods.families import ON_JOINTS
from liegroup_core.methods.table import METHODS

for name in sys.argv[2:]:
    method = METHODS[name]
    scenes = [(mechanisms.fitting(name, "chain of balls"), "auto")]
    if method.family in ON_JOINTS:
        scenes += [(load_scene(scene), "relative") for scene in ("four_bar", "bricard")]
        scenes += [(mechanisms.under_many_forces(), "relative")]
    for scene, group in scenes:
        engine = Engine(scene, name, 5e-3, group, quiet=True)
        engine.advance(4)
        print(*(part.tobytes().hex() for part in engine.state()[:2]))
"""


def lines_of(code, names, **environment):
    """What a program prints, in another process."""
    return subprocess.run(
        [sys.executable, "-c", code, os.path.dirname(os.path.dirname(__file__)), *names],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    ).stdout.splitlines()


@pytest.mark.slow
@pytest.mark.turn(2)
def test_plain_python_gives_the_same_bits():
    """Without fast-math both round alike, and both use the functions of libm. One method of each family a day."""
    names = [name for group in OF_FAMILY.values() for name in some(group, 1)]
    plain, fast = (lines_of(PLAIN, names, NUMBA_DISABLE_JIT=disable) for disable in ("1", "0"))
    assert len(plain) > len(names)
    assert plain == fast


ALLOCATIONS = """
import sys
sys.path.insert(0, sys.argv[1])
import mechanisms
from numba.core.runtime import rtsys
from liegroup_core import load_scene
from liegroup_core.engine import Engine
from liegroup_core.methods.families import NOT_ON_SE3, ON_JOINTS
from liegroup_core.methods.table import METHODS

for name in sys.argv[2:]:
    method = METHODS[name]
    # In their plane, in space with redundant rows, and without joints that close loops.
    cases = [(mechanisms.rotors(), "auto", "none")]
    if method.family != "rotation":
        groups = ["so3xr3"] if method.family in NOT_ON_SE3 else ["se3", "so3xr3"]
        groups += ["relative"] * (method.family in ON_JOINTS)
        ways = ["none", "projection", "baumgarte"] if method.family == "rkmk" else ["none"]
        cases += [
            (load_scene(scene), group, way)
            for scene in ("four_bar", "bricard", "n_four_bar", "heavy_top")
            for group in groups
            for way in ways
        ]
    for scene, group, way in cases:
        engine = Engine(scene, name, 1e-4, group, way, quiet=True)
        engine._block = 1000  # one call of the kernel
        counts = []
        for steps in (10, 10, 200):
            before = rtsys.get_allocation_stats().alloc
            engine.advance(steps)
            counts.append(rtsys.get_allocation_stats().alloc - before)
        print(name, scene.name, engine.group, way, *counts)
"""


@pytest.mark.turn(2)
def test_steps_allocate_nothing():
    """Numba's allocation count is the same for 10 and for 200 steps in one call. One method of each family a day."""
    names = [name for group in OF_FAMILY.values() for name in some(group, 1)]
    found = [line.split() for line in lines_of(ALLOCATIONS, names, NUMBA_NRT_STATS="1")]
    assert {line[0] for line in found} == set(names)
    assert {line[2] for line in found} == set(CONFIGURATION_GROUPS)
    assert [line for line in found if line[-2] != line[-1]] == []
