# SPDX-License-Identifier: Apache-2.0
"""Rotation methods on the free body and Lagrangian top of the chapter, Figs. 6.6 to 6.9.

Numbers of independent implementations: liegroup_sim_ros/chapter/rotation_tables.py. With forces and in
other scenes: test_rotation_forces.py.
"""

import re

import mechanisms
import numpy as np
import pytest
from convergence import fitted_order
from golden import few_steps
from naive import hat
from scipy.optimize import fsolve

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.lie.groups import SO3
from liegroup_core.methods.table import METHODS
from liegroup_core.status import NO_RATTLE_STEP, NOT_CONVERGED
from liegroup_sim_ros.chapter.rotation_figures import (
    count_runs,
    end_attitude,
    errors,
    make_rotation_figures,
    order_and_constant,
    top_integrals,
)
from liegroup_sim_ros.chapter.rotation_tables import (
    FREE_ATTITUDE,
    FREE_CONSTANTS,
    FREE_R_10,
    FREE_STEPS,
    MOMENTUM,
    MOMENTUM_STEPS,
    TOP_ATTITUDE,
    TOP_CONSTANTS,
    TOP_INTEGRALS,
    TOP_R_1,
    TOP_RATES,
)

ROTATION = [name for name, method in METHODS.items() if method.family == "rotation"]
KEEP_MOMENTUM = [name for name in ROTATION if name != "lie_newmark"]
SYMMETRIC = ["lie_newmark", "rattle", "simo_wong", "austin_krishnaprasad_wang", "lie_midpoint"]
FREE, TOP = load_scene("free_body"), load_scene("lagrangian_top")


def attitude(simulation):
    return simulation.state()[0][0, :9].reshape(3, 3)


def attitude_error(scene, method, step, time, reference):
    """||R - Rref||_2 at `time` (s), or None if a step has no solution."""
    simulation = Simulation(scene, method=method, step=step)
    try:
        simulation.advance(round(time / step))
    except SimulationError as failure:
        assert failure.status in (NO_RATTLE_STEP, NOT_CONVERGED)
        return None
    return np.linalg.norm(attitude(simulation) - reference, 2)


@pytest.mark.parametrize("method", FREE_ATTITUDE)
def test_free_body_attitude_errors_equal_published_values(method):
    """To a unit of the fourth digit, plus 1e-13 for the round-off of 2560 steps. Order and C too:
    the latter have three or four digits, the former two decimals.
    """
    found = [attitude_error(FREE, method, step, 10, FREE_R_10) for step in FREE_STEPS]
    for step, error, expected in zip(FREE_STEPS, found, FREE_ATTITUDE[method]):
        if expected is None:
            assert error is None
        else:
            assert error == pytest.approx(expected, rel=5e-4, abs=1e-13), step
    order, constant = order_and_constant(FREE_STEPS, found, METHODS[method].order)
    assert order == pytest.approx(FREE_CONSTANTS[method][0], abs=0.015)
    assert constant == pytest.approx(FREE_CONSTANTS[method][1], rel=2.5e-3)


@pytest.mark.parametrize("method", [m for m in TOP_ATTITUDE if "austin" not in m])
@pytest.mark.turn(3)
def test_lagrangian_top_attitude_errors_equal_published_values(method):
    """To half a unit of the third digit, the order to two decimals.

    Rounding turns the spin of 150 rad/s by 150 * 1.1e-16 a step and adds up like a random walk:
    4e-12 over 65536 steps. C of rkmk4 is of an error of 1.5e-11.
    """
    steps = [1 / rate for rate in TOP_RATES]
    found = [attitude_error(TOP, method, step, 1, TOP_R_1) for step in steps]
    for rate, error, expected in zip(TOP_RATES, found, TOP_ATTITUDE[method]):
        if expected is None:
            assert error is None
        else:
            assert error == pytest.approx(expected, rel=5e-4, abs=1e-11), rate
    order, constant = order_and_constant(steps, found, METHODS[method].order)
    assert order == pytest.approx(TOP_CONSTANTS[method][0], abs=0.02)
    assert constant == pytest.approx(TOP_CONSTANTS[method][1], rel=0.02 if method == "rkmk4" else 5e-4)


# Steps per second for the slope on the free body and on the top, by order.
RATES = {
    2: ((8, 16, 32, 64), (2**14, 2**15, 2**16)),
    4: ((8, 16, 32, 64), (2**12, 2**13, 2**14)),
    8: ((1 / 2, 1, 2, 4), (64, 96, 128, 192)),
}


@pytest.mark.parametrize("method", ROTATION)
@pytest.mark.turn(3)
def test_order_on_both_problems(method):
    """The coadjoint methods come down to their order slowly on the top: from 4.2 and 10.6 here.

    Errors of higher order stand in front there; those of order 8 are at rounding before they fade.
    """
    order = METHODS[method].order
    free, top = RATES[order]
    found = [attitude_error(FREE, method, 1 / rate, 10, FREE_R_10) for rate in free]
    assert fitted_order(1 / np.array(free), found) == pytest.approx(order, abs=0.2)
    found = [attitude_error(TOP, method, 1 / rate, 1, TOP_R_1) for rate in top]
    assert order - 0.1 < fitted_order(1 / np.array(top), found) < {2: 2.1, 4: 4.25, 8: 11}[order]


def test_austin_on_the_top_is_close_to_the_implicit_form():
    """Here the midpoint rule uses the momentum after the first half kick."""
    for rate, expected in zip(TOP_RATES[4:], TOP_ATTITUDE["austin_krishnaprasad_wang"][4:]):
        found = attitude_error(TOP, "austin_krishnaprasad_wang", 1 / rate, 1, TOP_R_1)
        assert 0.98 * expected < found < 0.985 * expected


def test_the_implicit_form_of_austin_uses_the_mean_momentum():
    """w_m = I^-1 (y + y+)/2 with both half kicks in y+, which is implicit in the torque.

    Written anew it gives their numbers to all digits: nothing else differs.
    """
    I, d, unit = np.array([15.234375, 0.46875, 15.234375]), np.array([0.0, 1.0, 0.0]), np.eye(3)

    def torque(R):
        return np.cross(d, 15.0 * R.T @ [0, 0, -9.81])

    for rate, expected in ((512, 1.033), (1024, 2.7347e-1)):
        R, w, h = np.eye(3), np.array([0.0, 150.0, -4.61538]), 1 / rate
        for _ in range(rate):
            y, middle, apart = I * w + h / 2 * torque(R), w, np.inf
            while apart > 1e-11:  # of 150 rad/s
                x = 0.5 * h * hat(middle)
                Q = np.linalg.solve(unit - x, unit + x)
                end = Q.T @ y + h / 2 * torque(R @ Q)
                previous, middle = middle, (I * w + end) / 2 / I
                apart = np.abs(middle - previous).max()
            R, w = R @ Q, end / I
        assert np.linalg.norm(R - TOP_R_1, 2) == pytest.approx(expected, rel=5e-4)


@pytest.mark.parametrize("method", KEEP_MOMENTUM)
@pytest.mark.volume(4)
def test_free_body_momentum_is_conserved_at_every_step(method):
    """16 s in steps of 8 s to 1/4096 s: round-off.

    Each step rounds some three times by 1.1e-16 of |Y| = 1; they add up like a random walk, with
    room for twice the deviation that is to be expected.
    """
    for step in (8, 4, 2, 1, 1 / 2, 1 / 4, 1 / 16, 1 / 256, 1 / 4096):
        simulation = Simulation(FREE, method=method, step=step)
        before = simulation.sample().spatial_momentum[:3]
        try:
            simulation.advance(round(16 / step))
        except SimulationError as failure:
            assert failure.status == NO_RATTLE_STEP and method == "rattle" and step > 1
            continue
        off = np.linalg.norm(simulation.sample().spatial_momentum[:3] - before)
        assert off <= 2e-15 + 6 * 1.1e-16 * np.sqrt(16 / step), step


@pytest.mark.parametrize("method", ["stoermer_verlet", "coadjoint_rkmk4", "rattle", "austin_krishnaprasad_wang"])
@pytest.mark.volume(1)
def test_momentum_round_off_grows_like_a_random_walk(method):
    """3e6 steps, bounded as above: 1.1e-12. A body that is brought back to SO(3) in every step was
    seen at 2.6e-12 to 3e-12, as some of the rounding is then the same in every step; with
    v = R^T P / m the linear momentum, of 0.6 N s, would be off by up to 3.6e-15 in each.
    """
    simulation = Simulation(FREE, method=method, step=0.05)
    I = FREE.bodies[0].inertia_matrix
    pose, twist = simulation.state()
    twist[0, 3:] = 0.3, -0.5, 0.2
    simulation.set_state(pose, twist)
    before = I @ twist[0, :3], twist[0, 3:]
    simulation.advance(3_000_000)
    R, twist = attitude(simulation), simulation.state()[1][0]
    assert np.linalg.norm(R @ I @ twist[:3] - before[0]) <= 6 * 1.1e-16 * np.sqrt(3e6)
    assert np.linalg.norm(R @ twist[3:] - before[1]) <= 6 * 1.1e-16 * np.sqrt(3e6)
    # What is put right is 32 units, and a step takes it there by a few.
    assert np.abs(R.T @ R - np.eye(3)).max() <= 40 * 2.0**-53


@pytest.mark.parametrize("method", ["lie_newmark", "rkmk4"])
def test_momentum_loss_equals_published_values(method):
    """To a unit of the fourth digit; at a step of 8 s a stage of rkmk4 exceeds 2 pi."""
    for step, expected in zip(MOMENTUM_STEPS, MOMENTUM[method]):
        if (method, step) == ("rkmk4", 8):
            continue
        simulation = Simulation(FREE, method=method, step=step)
        before = simulation.sample().spatial_momentum[:3]
        simulation.advance(round(16 / step))
        off = np.linalg.norm(simulation.sample().spatial_momentum[:3] - before)
        assert off == pytest.approx(expected, rel=5e-4, abs=1e-12), step


@pytest.mark.parametrize("method, step", TOP_INTEGRALS)
@pytest.mark.volume(3)
def test_invariants_of_the_top_over_ten_seconds(method, step):
    """To the published digits."""
    for found, expected in zip(top_integrals(method, step), TOP_INTEGRALS[method, step]):
        if expected is None:
            # y of 70 N m s and w of 150 rad/s, rounded 20000 times: as a random walk 2e-12.
            assert found <= 2e-11
        else:
            assert found == pytest.approx(expected, rel=0.01)


def test_energy_of_stoermer_verlet_drifts_and_that_of_lie_newmark_does_not():
    """(E - E0)/E0 of the free body at 100, 300, 1000 s: growth with h^3 t, or bounded."""
    drift = {0.2: (3.5e-3, 1.0e-2, 3.3e-2), 0.1: (4.6e-4, 1.3e-3, 4.2e-3), 0.05: (6.1e-5, 1.6e-4, 5.4e-4)}
    for step, expected in drift.items():
        for time, ratio in zip((100, 300, 1000), expected):
            assert _energy_ratio("stoermer_verlet", step, time) == pytest.approx(ratio, rel=0.04)
    for time, ratio in zip((100, 300, 1000), (-6e-5, -1.6e-5, -7.6e-5)):
        assert _energy_ratio("lie_newmark", 0.1, time) == pytest.approx(ratio, rel=0.05)
    assert _energy_ratio("bottasso_borri_candidate", 0.1, 1000) == pytest.approx(-4.5e-4, rel=0.02)


@pytest.mark.parametrize("method", ["rattle", "simo_wong", "austin_krishnaprasad_wang"])
def test_free_body_energy_is_conserved(method):
    """Tolerance: round-off of 1e-16 per step."""
    assert abs(_energy_ratio(method, 0.1, 1000)) <= 1e-12


def _energy_ratio(method, step, time):
    simulation = Simulation(FREE, method=method, step=step)
    start = simulation.energy()
    simulation.advance(round(time / step))
    return simulation.energy() / start - 1


def test_lie_newmark_satisfies_equations_6_41():
    """All three equations with the torque of the top, (6.41c) being implicit."""
    I, d, h = np.array([15.234375, 0.46875, 15.234375]), np.array([0.0, 1.0, 0.0]), 1e-3
    simulation = Simulation(TOP, method="lie_newmark", step=h)
    simulation.advance(100)
    R0, w0 = attitude(simulation), simulation.state()[1][0, :3]
    simulation.advance(1)
    R1, w1 = attitude(simulation), simulation.state()[1][0, :3]

    def rate(R, w):
        torque = np.cross(d, 15.0 * R.T @ [0, 0, -9.81])
        return (torque - np.cross(w, I * w)) / I

    half = w0 + h / 2 * rate(R0, w0)
    # Some roundings of 1, and of 150 rad/s.
    assert np.abs(R0 @ SO3.exp(h * half) - R1).max() <= 1e-15
    assert np.abs(half + h / 2 * rate(R1, w1) - w1).max() <= 1e-13


def back_and_forth(method, step):
    """Distance from the start after one step, velocity reversal and another step."""
    simulation = Simulation(TOP, method=method, step=step)
    simulation.advance(50)
    pose, twist = simulation.state()
    simulation.advance(1)
    simulation.set_state(simulation.state()[0], -simulation.state()[1])
    simulation.advance(1)
    return np.abs(simulation.state()[0] - pose).max(), np.abs(simulation.state()[1] + twist).max()


@pytest.mark.parametrize("method", SYMMETRIC)
def test_implicit_methods_are_symmetric_in_time(method):
    """Tolerance: ten round-offs of 1 and of 150 rad/s. The candidate is implicit but asymmetric."""
    off = back_and_forth(method, 1e-3)
    assert off[0] <= 1e-14 and off[1] <= 1e-12


def test_stoermer_verlet_is_not_symmetric():
    """The velocity returns to O(h^4): 16 times closer at half the step."""
    off = [back_and_forth("stoermer_verlet", step)[1] for step in (1e-3, 5e-4)]
    assert off[0] > 1e-9 and off[0] / off[1] == pytest.approx(16, rel=0.3)


@pytest.mark.parametrize("step", [1 / 64, 1 / 128])
def test_rattle_suggests_a_working_step(step):
    simulation = Simulation(TOP, method="rattle", step=step)
    before = simulation.state()
    with pytest.raises(SimulationError, match="RATTLE has no solution for body top") as failure:
        simulation.advance(1)
    assert failure.value.status == NO_RATTLE_STEP and simulation.steps == 0
    assert all((one == other).all() for one, other in zip(simulation.state(), before))
    # sin f = h w about the axis: h |w| = 1 at the most, w as it starts.
    angle = float(re.search(r"rotates by ([\d.]+) rad", str(failure.value)).group(1))
    works = float(re.search(r"([\d.e-]+) s works from here", str(failure.value)).group(1))
    speed = np.linalg.norm([150, 4.61538])
    assert angle == pytest.approx(step * speed, rel=5e-3) and 0.9 < works * speed < 1.0
    simulation = Simulation(TOP, method="rattle", step=works)
    simulation.advance(200)


def test_rattle_solves_rotations_up_to_one_radian_for_any_inertia():
    """Just below 1 rad always; above only about axes that are not principal."""
    rng = np.random.default_rng(2)
    for _ in range(40):
        points = rng.normal(size=(4, 3)) * 10 ** rng.uniform(-1, 0, size=3)
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
        w = rng.normal(size=3)
        six = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        scene = mechanisms.one_body(angular_velocity=w, inertia=six)
        Simulation(scene, method="rattle", step=0.999 / np.linalg.norm(w)).advance(1)
        with pytest.raises(SimulationError, match="RATTLE has no solution"):
            Simulation(scene, method="rattle", step=1.6 / np.linalg.norm(w)).advance(1)


def test_step_limits_of_rattle_on_both_problems():
    """Independent bisection: 0.0066650 s for the top and 1.06019 s for the free body."""
    for scene, limit in ((TOP, 0.0066650), (FREE, 1.06019)):
        Simulation(scene, method="rattle", step=0.9999 * limit).advance(1)
        with pytest.raises(SimulationError, match="RATTLE"):
            Simulation(scene, method="rattle", step=1.0001 * limit).advance(1)


def test_simo_wong_takes_the_solution_continued_from_small_steps():
    """At h = 4 s the equation has three solutions; Newton's method from h w finds none of them.

    The one for steps from 0.01 s to 4 s, each found from the one before by SciPy; to rounding of
    3 rad times 20, the condition of the equation there.
    """
    w = FREE.bodies[0].angular_velocity
    I = FREE.bodies[0].inertia_matrix

    def equation(x, h):
        return 2 / h * I @ x - I @ w - SO3.exp(x).T @ I @ w

    x = 0.01 * np.array(w)
    for h in np.arange(2, 401) / 100:
        x, _, found, _ = fsolve(equation, x, (h,), xtol=1e-14, full_output=True)
        assert found == 1 or np.abs(equation(x, h)).max() <= 1e-14
    simulation = Simulation(FREE, method="simo_wong", step=4.0)
    simulation.advance(1)
    assert np.abs(attitude(simulation) - SO3.exp(x)).max() <= 60 * 2.0**-52


@pytest.mark.turn(3)
def test_figures_use_exact_end_states_and_report_published_values(monkeypatch, tmp_path):
    """Tolerance: binary scene numbers differ from the decimal ones by 1e-15 of 150 rad."""
    assert np.abs(end_attitude("free_body", 10) - FREE_R_10).max() <= 1e-15
    assert np.abs(end_attitude("lagrangian_top", 1) - TOP_R_1).max() <= 2e-13
    short = few_steps()
    monkeypatch.setattr("liegroup_sim_ros.chapter.rotation_figures.PANELS", short)
    monkeypatch.setattr(
        "liegroup_sim_ros.chapter.rotation_figures.TOP_INTEGRALS", {("rattle", 1e-3): TOP_INTEGRALS["rattle", 1e-3]}
    )
    said = []
    paths, tables = make_rotation_figures(tmp_path, said.append)
    assert len(said) == count_runs() and "Fig. 6.7, rattle, 1/512 s" in said
    assert [path.name for path in paths] == [f"fig_6_{k}.png" for k in (6, 7, 8, 9)]
    assert all(path.stat().st_size > 10_000 for path in paths)
    assert [table.row_count for table in tables] == [6, 10, 6, 10, 2]
    found = errors(short[1])
    assert found["rattle"][0] == pytest.approx(1.817, rel=5e-4)
    assert found["stoermer_verlet"][2] == pytest.approx(2.1462e-2, rel=1e-4)
