# SPDX-License-Identifier: Apache-2.0
"""Stabilisation: projection is the least-squares solution, Baumgarte's method damps errors."""

import engine
import mechanisms
import naive
import numpy as np
import pytest
from convergence import order_of
from scene_files import cases

from liegroup_core import Simulation, SimulationError
from liegroup_core.joints import LOWER_PAIRS
from liegroup_core.lie.groups import SE3
from liegroup_core.status import DEPENDENT_ROWS, NOT_PROJECTED, OK

# Poses pass through the coordinates of the links and back: two products of three terms each.
ROUNDED = 8 * 2.0**-53


def floating(name, **options):
    """Simulation of a mechanism with an empty tree: every joint is open to errors."""
    return Simulation(mechanisms.named(name), method="rkmk4", group="se3", **options)


def disturbed(simulation, rng, size):
    """State of a simulation with random perturbations of poses and twists.

    Bodies that are welded together move together, and those of the world do not move.
    """
    pose, twist = simulation.state()
    moves = simulation._integrator.mechanism[0].bodies["link"][:, None] >= 0
    displacement, change = size * rng.normal(size=(2, *twist.shape)) * moves
    pose = naive.flat(naive.matrices(pose) @ SE3.exp(displacement))
    return engine.placed(*engine.at_stage(simulation, pose, twist + change))


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
@pytest.mark.parametrize("size", [1e-9, 1e-5, 1e-2])
def test_projection_closes_all_joints_to_round_off(name, size):
    simulation = floating(name)
    model = simulation.layout.model
    rng = np.random.default_rng(1)
    for _ in range(5):
        status, pose, twist = engine.projected(simulation, *disturbed(simulation, rng, size))
        assert status == OK
        # lengths of up to 8 m at 16 units of 2^-52: see ROUND_OFF
        assert np.abs(engine.residual(model, naive.matrices(pose))).max() <= 128 * 2.0**-52
        J, _ = engine.rows(simulation, pose, twist)
        # the size times the condition of S, below 1e4, and 2^-52
        assert np.abs(J @ twist.ravel()).max() <= 1e-11 * size + 1e-14


@pytest.mark.parametrize("name", mechanisms.UNWELDED)
def test_the_projection_is_the_least_change_in_the_mass_metric(name):
    """M X and M dV are combinations of the rows: the condition of the least-squares solution.

    For the displacement up to second order in its size, 1e-5; for the velocity up to the round-off
    of twists of size 10.
    """
    simulation = floating(name)
    M = engine.masses(simulation.scene)
    rng = np.random.default_rng(2)
    start_pose, start_twist = disturbed(simulation, rng, 1e-5)
    _, pose, twist = engine.projected(simulation, start_pose, start_twist)
    J, _ = engine.rows(simulation, pose, twist)
    X = SE3.log(np.linalg.inv(naive.matrices(start_pose)) @ naive.matrices(pose)).ravel()
    # At the projected pose, from the velocity after the first part of the projection.
    _, same, pushed = engine.projected(simulation, pose, start_twist)
    dV = (pushed - start_twist).ravel()
    assert np.abs(same - pose).max() <= ROUNDED * np.abs(pose).max()
    for change, tolerance in ((X, 1e-8), (dV, 1e-14)):
        impulse = M @ change
        left = impulse - J.T @ np.linalg.lstsq(J.T, impulse, rcond=None)[0]
        assert np.abs(left).max() <= tolerance
        assert 1e-7 < np.abs(impulse).max() < 1e-3


@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
def test_a_consistent_state_is_not_changed(name):
    simulation = floating(name)
    pose, twist = simulation.state()
    status, new_pose, new_twist = engine.projected(simulation, pose, twist)
    assert status == OK and np.abs(new_pose - pose).max() <= ROUNDED * (1.0 + np.abs(pose).max())
    assert np.abs(new_twist - twist).max() <= 1e-14 * (1.0 + np.abs(twist).max())


def momenta(simulation, pose, twist):
    """(spatial momentum (6,), kinetic energy, centre of mass (3,))."""
    sample = simulation.layout.sample(pose, twist)
    mass = np.array([body.mass for body in simulation.scene.bodies])
    M = engine.masses(simulation.scene)
    return (sample.spatial_momentum, 0.5 * twist.ravel() @ M @ twist.ravel(), mass @ pose[:, 9:] / mass.sum())


def test_projection_of_inner_joints_conserves_momentum():
    simulation = floating("floating")
    rng = np.random.default_rng(3)
    pose, _ = simulation.state()
    twist = rng.normal(size=(len(pose), 6))
    status, _, new_twist = engine.projected(simulation, pose, twist)
    assert status == OK and np.abs(new_twist - twist).max() > 0.1
    before, energy, _ = momenta(simulation, pose, twist)
    after, less, _ = momenta(simulation, pose, new_twist)
    # sums of products of size 10
    assert np.abs(after - before).max() <= 1e-13 and less < energy


def test_position_projection_conserves_linear_momentum_energy_and_centre_of_mass():
    """Energy by Pythagoras: the second part removes exactly the energy of its change."""
    simulation = floating("floating")
    M = engine.masses(simulation.scene)
    rng = np.random.default_rng(4)
    pose, twist = disturbed(simulation, rng, 1e-3)
    _, new_pose, new_twist = engine.projected(simulation, pose, twist)
    before, energy, centre = momenta(simulation, pose, twist)
    after, now, new_centre = momenta(simulation, new_pose, new_twist)
    assert np.abs(new_pose - pose).max() > 1e-4
    # sums of products of size 10
    assert np.abs(after[3:] - before[3:]).max() <= 1e-13
    turned = twist.copy()  # the same velocity in the world, in the new body axes
    R, new_R = naive.matrices(pose)[:, :3, :3], naive.matrices(new_pose)[:, :3, :3]
    turned[:, 3:] = np.einsum("nji,njk,nk->ni", new_R, R, twist[:, 3:])
    change = (new_twist - turned).ravel()
    assert now + 0.5 * change @ M @ change == pytest.approx(energy, abs=1e-13 * energy)
    # second order in the displacement, which goes along screws and not along straight lines
    assert np.abs(new_centre - centre).max() <= 1e-5


@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_projection_leaves_ground_joints_on_se3_unchanged(kind):
    """SE(3) satisfies them to machine precision: the runs differ by amplified round-off."""
    scene = mechanisms.named(f"{kind} to ground")
    with_it, without = (
        Simulation(scene, method="rkmk4", step=2e-3, group="se3", stabilisation=s) for s in ("projection", "none")
    )
    with_it.advance(500)
    without.advance(500)
    for mine, theirs in zip(with_it.state(), without.state()):
        assert np.abs(mine - theirs).max() <= 1e-11
    assert with_it.sample().constraint_residual <= 1e-13


@pytest.mark.parametrize("name", ["chain of hinges", "every kind", "net", "floating"])
@pytest.mark.parametrize("group", ["se3", "so3xr3"])
@pytest.mark.volume(3)
def test_projection_keeps_order_four_and_satisfies_joints(name, group):
    """Order 4 against a run without projection whose step is so small that drift is negligible."""
    scene = mechanisms.named(name)
    reference = Simulation(scene, method="rkmk4", step=1e-4, group=group)
    reference.advance(1000)
    errors = {}
    for h in (2e-3, 1e-3, 5e-4):
        simulation = Simulation(scene, method="rkmk4", step=h, group=group, stabilisation="projection")
        simulation.advance(round(0.1 / h))
        errors[h] = np.abs(simulation.state()[0] - reference.state()[0]).max()
        # measured on poses of up to 10 m
        assert simulation.sample().constraint_residual <= 1e-13
        J, _ = engine.rows(simulation)
        assert np.abs(J @ simulation.state()[1].ravel()).max() <= 1e-12
    assert order_of(errors) == pytest.approx(4.0, abs=0.2), errors


def test_a_constraint_without_solution_is_reported():
    """Pendulum of 1 m on a rod that becomes too short: the last valid state is kept."""
    scene = mechanisms.mechanism(
        np.random.default_rng(5), [("world", "a", "spherical")], loops=[("world", "a", "distance")]
    )
    simulation = Simulation(scene, method="rkmk4", group="se3", stabilisation="projection")
    simulation.advance(10)
    before = simulation.state()
    simulation._integrator.mechanism[0].elements["parameter"][1] += 100.0
    status, _, _ = engine.projected(simulation, *before)
    assert status & 0xFF in (NOT_PROJECTED, DEPENDENT_ROWS)
    with pytest.raises(SimulationError, match="smaller step|singular pose") as failure:
        simulation.advance(5)
    assert failure.value.status in (NOT_PROJECTED, DEPENDENT_ROWS) and simulation.steps == 10
    for mine, theirs in zip(simulation.state(), before):
        assert mine.tobytes() == theirs.tobytes()


# ---------------------------------------------------------------- Baumgarte


@pytest.mark.parametrize("name", ["net", "every kind"])
@pytest.mark.parametrize("group", ["se3", "so3xr3"])
def test_constraint_errors_die_out_as_baumgarte_predicts(name, group):
    """g = g0 (1 + a t) exp(-a t) for a small residual g0 with zero initial rate."""
    time = 0.02
    simulation = Simulation(
        mechanisms.named(name), method="rkmk4", step=2e-4, group=group, stabilisation="baumgarte", baumgarte_time=time
    )
    model = simulation.layout.model
    pose, twist = disturbed(simulation, np.random.default_rng(6), 1e-7)
    J, _ = engine.rows(simulation, pose, twist)
    twist = (twist.ravel() - np.linalg.pinv(J) @ (J @ twist.ravel())).reshape(twist.shape)
    simulation.set_state(pose, twist)
    gap = engine.residual(model, naive.matrices(pose))
    for _ in range(10):
        simulation.advance(50)
        a_t = simulation.time / time
        expected = gap * (1.0 + a_t) * np.exp(-a_t)
        found = engine.residual(model, naive.matrices(simulation.state()[0]))
        # the frames, in whose axes gaps are measured, turn by some 2 rad/s
        assert np.abs(found - expected).max() <= 2.0 * simulation.time * np.abs(gap).max()
    assert np.abs(found).max() <= 0.05 * np.abs(gap).max()  # 6 exp(-5) = 0.040


def test_baumgarte_bounds_the_drift_of_a_long_run():
    runs = {}
    for stabilisation in ("none", "baumgarte", "projection"):
        simulation = Simulation(
            mechanisms.named("chain of balls"), method="rkmk4", step=4e-3, group="se3", stabilisation=stabilisation
        )
        simulation.advance(1000)
        runs[stabilisation] = simulation.sample().constraint_residual
    assert runs["baumgarte"] < 0.1 * runs["none"]
    assert runs["projection"] < 1e-13


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize("setting, text", cases("wrong_stabilisation_options_are_refused_with_a_remedy"))
def test_wrong_stabilisation_options_are_refused_with_a_remedy(setting, text):
    with pytest.raises(ValueError, match=text):
        Simulation(mechanisms.named("ball"), "rkmk4", **setting)
