# SPDX-License-Identifier: Apache-2.0
"""Rotation methods on the chapter's free body and Lagrangian top, Figs. 6.6 to 6.9.

Numbers of independent implementations: liegroup_sim_ros/rotation_tables.py. With forces and in
other scenes: test_rotation_forces.py.
"""
import re
from dataclasses import replace

import numpy as np
import pytest

from liegroup_core import Scene, Simulation, SimulationError, load_scene
from liegroup_core.integrators.methods import METHODS
from liegroup_core.integrators.status import NO_RATTLE_STEP, NOT_CONVERGED
from liegroup_core.lie.groups import SO3
from liegroup_core.scene.description import Body
from liegroup_sim_ros.rotation_figures import PANELS, end_attitude, errors, make_rotation_figures
from liegroup_sim_ros.rotation_tables import (FREE_ATTITUDE, FREE_R_10, FREE_STEPS, MOMENTUM,
                                              MOMENTUM_STEPS, TOP_ATTITUDE, TOP_INTEGRALS, TOP_R_1,
                                              TOP_RATES)

ROTATION = [name for name, method in METHODS.items() if method.family == "rotation"]
KEEP_MOMENTUM = [name for name in ROTATION if name != "lie_newmark"]
SYMMETRIC = ["lie_newmark", "rattle", "simo_wong", "austin_krishnaprasad_wang", "lie_midpoint"]
FREE, TOP = load_scene("free_body"), load_scene("lagrangian_top")


def attitude(simulation):
    return simulation.state()[0][0, :9].reshape(3, 3)


def attitude_error(scene, method, step, time, reference):
    """||R - Rref||_2 at a time, or None where the step has no solution."""
    simulation = Simulation(scene, method=method, step=step)
    try:
        simulation.advance(round(time / step))
    except SimulationError as failure:
        assert failure.status in (NO_RATTLE_STEP, NOT_CONVERGED)
        return None
    return np.linalg.norm(attitude(simulation) - reference, 2)


def slope(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize("method", FREE_ATTITUDE)
def test_free_body_has_the_attitude_errors_of_the_method(method):
    """To a unit of the fourth digit; 1e-13 more for the rounding of 2560 steps."""
    for step, expected in zip(FREE_STEPS, FREE_ATTITUDE[method]):
        found = attitude_error(FREE, method, step, 10, FREE_R_10)
        if expected is None:
            assert found is None
        else:
            assert found == pytest.approx(expected, rel=5e-4, abs=1e-13), step


@pytest.mark.parametrize("method", [m for m in TOP_ATTITUDE if "austin" not in m])
def test_lagrangian_top_has_the_attitude_errors_of_the_method(method):
    """To half a unit of the third digit.

    Rounding turns the spin of 150 rad/s by 150 * 1.1e-16 a step and adds up like a random walk:
    4e-12 over 65536 steps.
    """
    for rate, expected in zip(TOP_RATES, TOP_ATTITUDE[method]):
        found = attitude_error(TOP, method, 1 / rate, 1, TOP_R_1)
        if expected is None:
            assert found is None
        else:
            assert found == pytest.approx(expected, rel=5e-4, abs=1e-11), rate


# Steps per second for the slope on the free body and on the top, by order.
RATES = {2: ((8, 16, 32, 64), (2**14, 2**15, 2**16)), 4: ((8, 16, 32, 64), (2**12, 2**13, 2**14)),
         8: ((1/2, 1, 2, 4), (64, 96, 128, 192))}


@pytest.mark.parametrize("method", ROTATION)
def test_order_on_both_problems(method):
    """The coadjoint methods come down to their order slowly on the top: from 4.2 and 10.6 here.

    Errors of higher order stand in front there; those of order 8 are at rounding before they fade.
    """
    order = METHODS[method].order
    free, top = RATES[order]
    found = [attitude_error(FREE, method, 1 / rate, 10, FREE_R_10) for rate in free]
    assert slope(1 / np.array(free), found) == pytest.approx(order, abs=0.2)
    found = [attitude_error(TOP, method, 1 / rate, 1, TOP_R_1) for rate in top]
    assert order - 0.1 < slope(1 / np.array(top), found) < {2: 2.1, 4: 4.25, 8: 11}[order]


def test_austin_on_the_top_is_close_to_the_other_impulse():
    """Ours is explicit in the torque; theirs has half of it in the midpoint rule."""
    for rate, expected in zip(TOP_RATES[4:], TOP_ATTITUDE["austin_krishnaprasad_wang"][4:]):
        found = attitude_error(TOP, "austin_krishnaprasad_wang", 1 / rate, 1, TOP_R_1)
        assert 0.95 * expected < found < expected


@pytest.mark.parametrize("method", KEEP_MOMENTUM)
def test_free_body_keeps_its_momentum_at_every_step(method):
    """16 s in steps of 8 s to 1/4096 s: round-off.

    Each step rounds some three times by 1.1e-16 of |Y| = 1; they add up like a random walk, with
    room for twice the deviation that is to be expected.
    """
    for step in (8, 4, 2, 1, 1/2, 1/4, 1/16, 1/256, 1/4096):
        simulation = Simulation(FREE, method=method, step=step)
        before = simulation.sample().spatial_momentum[:3]
        try:
            simulation.advance(round(16 / step))
        except SimulationError as failure:
            assert failure.status in (NO_RATTLE_STEP, NOT_CONVERGED) and step > 1
            assert method == "rattle" or (method, step) == ("simo_wong", 4)
            continue
        off = np.linalg.norm(simulation.sample().spatial_momentum[:3] - before)
        assert off <= 2e-15 + 6 * 1.1e-16 * np.sqrt(16 / step), step


@pytest.mark.parametrize("method", ["lie_newmark", "rkmk4"])
def test_momentum_is_lost_as_the_method_loses_it(method):
    """To a unit of the fourth digit; at 8 s a stage of rkmk4 turns by more than its 2 pi."""
    for step, expected in zip(MOMENTUM_STEPS, MOMENTUM[method]):
        if (method, step) == ("rkmk4", 8):
            continue
        simulation = Simulation(FREE, method=method, step=step)
        before = simulation.sample().spatial_momentum[:3]
        simulation.advance(round(16 / step))
        off = np.linalg.norm(simulation.sample().spatial_momentum[:3] - before)
        assert off == pytest.approx(expected, rel=5e-4, abs=1e-12), step


@pytest.mark.parametrize("method, step", TOP_INTEGRALS)
def test_integrals_of_the_top_over_ten_seconds(method, step):
    """Largest deviations, looked at in every step; to the digits that are printed."""
    simulation = Simulation(TOP, method=method, step=step)
    start = simulation.sample()
    energy, momentum, spin = [], [], []
    for _ in range(round(10 / step) // 10):
        simulation.advance(10)
        sample = simulation.sample()
        energy.append(sample.energy - start.energy)
        momentum.append(sample.spatial_momentum[2] - start.spatial_momentum[2])
        spin.append(sample.twist[0, 1] - start.twist[0, 1])
    for found, expected in zip((energy, momentum, spin), TOP_INTEGRALS[method, step]):
        largest = np.abs(found).max()
        if expected is None:
            # y of 70 N m s and w of 150 rad/s, rounded 20000 times: as a random walk 2e-12.
            assert largest <= 2e-11
        else:
            # Seen at every tenth step, nutation hides a little of its peaks.
            assert largest == pytest.approx(expected, rel=0.01)


def test_energy_of_stoermer_verlet_drifts_and_that_of_lie_newmark_does_not():
    """(E - E0)/E0 of the free body at 100, 300, 1000 s: h^3 t against bounded."""
    drift = {0.2: (3.5e-3, 1.0e-2, 3.3e-2), 0.1: (4.6e-4, 1.3e-3, 4.2e-3),
             0.05: (6.1e-5, 1.6e-4, 5.4e-4)}
    for step, expected in drift.items():
        for time, ratio in zip((100, 300, 1000), expected):
            assert _energy_ratio("stoermer_verlet", step, time) == pytest.approx(ratio, rel=0.04)
    for time, ratio in zip((100, 300, 1000), (-6e-5, -1.6e-5, -7.6e-5)):
        assert _energy_ratio("lie_newmark", 0.1, time) == pytest.approx(ratio, rel=0.05)
    assert _energy_ratio("bottasso_borri_candidate", 0.1, 1000) == pytest.approx(-4.5e-4, rel=0.02)


@pytest.mark.parametrize("method", ["rattle", "simo_wong", "austin_krishnaprasad_wang"])
def test_energy_of_the_free_body_is_kept_too(method):
    """To rounding, 1e-16 a step."""
    assert abs(_energy_ratio(method, 0.1, 1000)) <= 1e-12


def _energy_ratio(method, step, time):
    simulation = Simulation(FREE, method=method, step=step)
    start = simulation.energy()
    simulation.advance(round(time / step))
    return simulation.energy() / start - 1


def test_lie_newmark_is_the_scheme_6_41():
    """All three of its equations with the torque of the top in them, (6.41c) implicit."""
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
    """How far a step and a step from there with velocities turned round miss the start."""
    simulation = Simulation(TOP, method=method, step=step)
    simulation.advance(50)
    pose, twist = simulation.state()
    simulation.advance(1)
    simulation.set_state(simulation.state()[0], -simulation.state()[1])
    simulation.advance(1)
    return np.abs(simulation.state()[0] - pose).max(), np.abs(simulation.state()[1] + twist).max()


@pytest.mark.parametrize("method", SYMMETRIC)
def test_implicit_methods_are_symmetric_in_time(method):
    """Round-off: some ten units of 1 and of 150 rad/s. The candidate is implicit and is not."""
    off = back_and_forth(method, 1e-3)
    assert off[0] <= 1e-14 and off[1] <= 1e-12


def test_stoermer_verlet_is_not_symmetric():
    """Back at O(h^4) in velocity: 16 times less at half the step."""
    off = [back_and_forth("stoermer_verlet", step)[1] for step in (1e-3, 5e-4)]
    assert off[0] > 1e-9 and off[0] / off[1] == pytest.approx(16, rel=0.3)


@pytest.mark.parametrize("step", [1/64, 1/128])
def test_rattle_says_which_step_would_work(step):
    simulation = Simulation(TOP, method="rattle", step=step)
    with pytest.raises(SimulationError, match="RATTLE has no solution for body top") as failure:
        simulation.advance(1)
    assert failure.value.status == NO_RATTLE_STEP and simulation.steps == 0
    # sin f = h w about the axis: h |w| = 1 at the most, w as it starts.
    angle = float(re.search(r"turns by ([\d.]+) rad", str(failure.value)).group(1))
    works = float(re.search(r"step, ([\d.e-]+) s, would", str(failure.value)).group(1))
    speed = np.linalg.norm([150, 4.61538])
    assert angle == pytest.approx(step * speed, rel=5e-3) and 0.9 < works * speed < 1.0
    simulation = Simulation(TOP, method="rattle", step=works)
    simulation.advance(200)


def test_rattle_works_up_to_a_turn_of_one_rad_whatever_the_inertia():
    """Just below always; above only about other axes than principal ones."""
    rng = np.random.default_rng(2)
    for _ in range(40):
        points = rng.normal(size=(4, 3)) * 10 ** rng.uniform(-1, 0, size=3)
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
        w = rng.normal(size=3)
        body = Body(name="b", mass=1.0, angular_velocity=w,
                    inertia=[*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]])
        scene = Scene(name="one", gravity=(0, 0, 0), bodies=[body])
        Simulation(scene, method="rattle", step=0.999 / np.linalg.norm(w)).advance(1)
        with pytest.raises(SimulationError, match="RATTLE has no solution"):
            Simulation(scene, method="rattle", step=1.6 / np.linalg.norm(w)).advance(1)


def test_limits_of_rattle_on_the_two_problems():
    """By bisection elsewhere: 0.0066650 s for the top and 1.06019 s for the free body."""
    for scene, limit in ((TOP, 0.0066650), (FREE, 1.06019)):
        Simulation(scene, method="rattle", step=0.9999 * limit).advance(1)
        with pytest.raises(SimulationError, match="RATTLE"):
            Simulation(scene, method="rattle", step=1.0001 * limit).advance(1)


def test_simo_wong_says_where_it_has_no_solution_nearby():
    """At 4 s all three solutions of its equation are far from the motion."""
    with pytest.raises(SimulationError, match="smaller step") as failure:
        Simulation(FREE, method="simo_wong", step=4.0).advance(4)
    assert failure.value.status == NOT_CONVERGED


def test_figures_use_exact_end_states_and_say_what_elsewhere_was_found(monkeypatch, tmp_path):
    """The scenes' numbers in binary are not the decimal ones: 1e-15 of 150 rad."""
    assert np.abs(end_attitude("free_body", 10) - FREE_R_10).max() <= 1e-15
    assert np.abs(end_attitude("lagrangian_top", 1) - TOP_R_1).max() <= 2e-13
    short = [replace(panel, steps=panel.steps[2:5], elsewhere={
        method: values[2:5] for method, values in panel.elsewhere.items()}) for panel in PANELS]
    monkeypatch.setattr("liegroup_sim_ros.rotation_figures.PANELS", short)
    paths, tables = make_rotation_figures(tmp_path)
    assert [path.name for path in paths] == [f"fig_6_{k}.png" for k in (6, 7, 8, 9)]
    assert all(path.stat().st_size > 10_000 for path in paths)
    assert [table.row_count for table in tables] == [6] * 4
    found = errors(short[1])
    assert found["rattle"][0] == pytest.approx(1.817, rel=5e-4)
    assert found["stoermer_verlet"][2] == pytest.approx(2.1462e-2, rel=1e-4)
