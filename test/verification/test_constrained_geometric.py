# SPDX-License-Identifier: Apache-2.0
"""Constrained RATTLE and its compositions: order, symmetry, constraints, invariants, long runs.

Orders without forces of velocity are in test_orders.py.
"""

import engine
import mechanisms
import numpy as np
import pytest
import random_mechanisms
from convergence import order_by_count

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.engine import Engine
from liegroup_core.forces.external import no_wrenches
from liegroup_core.mechanism.arrays import PlaneModel
from liegroup_core.methods.rattle.rattle import SUBSTEPS
from liegroup_core.methods.table import METHODS
from liegroup_core.reference import integrate
from liegroup_core.scene.description import Drag, Motor, TorsionalSpringDamper
from liegroup_core.status import NOT_CONVERGED, ROTATION_TOO_LARGE

CONSTRAINED = [name for name, method in METHODS.items() if method.family == "constrained"]
GROUPS = ("so3xr3", "relative")
UNIT = 2.0**-53
# Steps per second by order.
TIME = 0.5  # s
RATES = {2: (256, 512, 1024), 4: (64, 128, 256), 8: (40, 48, 64)}


@pytest.fixture(scope="module")
def driven():
    """(loop with gravity, springs, dampers, drag and a motor; its reference state at TIME)."""
    scene = mechanisms.named("loop of hinges and balls")
    forces = [
        *scene.forces,
        Drag(name="air", body="b", linear=0.4, angular=0.2),
        TorsionalSpringDamper(name="wound", joint="j0", stiffness=2.0, damping=0.5),
        Motor(name="drive", joint="j3", torque=0.3, rate_limit=20.0),
    ]
    scene = scene.remade(forces=forces)
    trajectory, uncertainty = integrate(scene, *Simulation(scene, method="rkmk4").state(), [TIME])
    assert uncertainty.attitude.max() < 1e-11
    return scene, trajectory


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("method", CONSTRAINED)
@pytest.mark.volume(3)
def test_order_with_velocity_dependent_forces(driven, method, group):
    """Poses and velocities against the independent DOP853 integration in maximal coordinates."""
    scene, reference = driven
    order, found = METHODS[method].order, []
    for rate in RATES[order]:
        simulation = Simulation(scene, method=method, step=1 / rate, group=group)
        simulation.advance(round(TIME * rate))
        pose, twist = simulation.state()
        found.append(
            [
                np.abs(pose[:, :9] - reference.rotation[0].reshape(-1, 9)).max(),
                np.abs(pose[:, 9:] - reference.position[0]).max(),
                np.abs(twist - reference.twist[0]).max(),
            ]
        )
    for errors in np.transpose(found):
        assert order_by_count(RATES[order], errors) == pytest.approx(order, abs=0.2)


def in_a_plane(name):
    """Scene whose motion in relative coordinates is that in a plane."""
    if name == "hinges":
        return mechanisms.chain(6, "revolute")
    return random_mechanisms.random_mechanism(name, 0)[0] if name == "planar loops" else load_scene(name)


IN_PLANE = ("four_bar", "double_pendulum", "planar loops", "hinges")


@pytest.mark.parametrize("name, group, step", [
    *((name, group, 2e-3) for name in ("net", "every kind", "floating") for group in GROUPS),
    *((name, "relative", 1e-3) for name in IN_PLANE),
])  # fmt: skip
@pytest.mark.parametrize("method", CONSTRAINED)
@pytest.mark.volume(4)
def test_backward_steps_undo_forward_steps(method, name, group, step):
    """With dampers. A method that is not symmetric misses the start by O(h^3).

    What is left are roundings. A closed joint is closed to 16 units of lengths of some metres,
    1e-14, and a velocity to 2/h times that, 1e-11; three steps each way.
    """
    scene = in_a_plane(name) if name in IN_PLANE else mechanisms.named(name)
    simulation = Engine(scene, method, step, group, quiet=True)
    assert isinstance(simulation.layout.relative, PlaneModel) == (name in IN_PLANE)
    simulation.advance(2)  # from here on joints are closed as the method closes them
    pose, twist = simulation.state()
    simulation.advance(3)
    there_pose, there_twist = simulation.state()
    assert name in IN_PLANE or np.abs(there_pose - pose).max() > 1e-3
    external = simulation.inputs.acting.external
    assert simulation._integrator.advance(-step, 3, there_pose, there_twist, external) == (3, 0)
    size = max(1.0, simulation.layout.size) if name in IN_PLANE else 1.0
    assert np.abs(there_pose - pose).max() <= 6e-14 * size
    assert np.abs(there_twist - twist).max() <= 2e-3 / step * 6e-11 * size


def test_rkmk4_is_not_symmetric():
    """Counterexample: the test distinguishes a non-symmetric method."""
    simulation = Simulation(mechanisms.named("net"), method="rkmk4", step=5e-3)
    pose, twist = simulation.state()
    simulation.advance(3)
    there_pose, there_twist = simulation.state()
    external = no_wrenches(simulation.layout.offsets)
    simulation._integrator.advance(-5e-3, 3, there_pose, there_twist, external)
    assert np.abs(there_twist - twist).max() > 1e-9


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("name", mechanisms.MECHANISMS)
@pytest.mark.volume(6)
def test_position_and_velocity_constraints_hold_to_round_off(name, group):
    """Tolerance: 16 units of round-off of lengths of 10 m; J V sums ten terms of 10 m/s."""
    for method, step in (("constrained_rattle", 2e-3), ("constrained_rattle4", 4e-3)):
        simulation = Simulation(mechanisms.named(name), method=method, step=step, group=group)
        for _ in range(10):
            simulation.advance(10)
            assert simulation.sample().constraint_residual <= 16 * 2 * UNIT * 10.0
            J, _ = engine.rows(simulation)
            speed = np.abs(simulation.state()[1]).max()
            assert np.abs(J @ simulation.state()[1].ravel()).max() <= 100 * UNIT * max(1.0, speed)


FLOATING = {
    "floating": (5, *mechanisms.MECHANISMS["floating"], 0),
    **{
        " ".join(kinds): (8, links, (), 2)
        for kinds in (("revolute", "spherical", "universal"), ("screw", "planar"))
        for links in [[("world", "b0", None)] + [(f"b{i // 2}", f"b{i + 1}", kinds[i % len(kinds)]) for i in range(4)]]
    },
}


@pytest.mark.parametrize("name", FLOATING)
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("method", CONSTRAINED)
@pytest.mark.volume(4)
def test_momentum_of_a_free_linkage_is_conserved_to_round_off(method, group, name):
    """Floating loop or tree without gravity. Tolerance: a few same-sign round-offs of every link per substep.

    They are those of the momenta of single bodies, with their moments about the origin.
    """
    seed, links, loops, springs = FLOATING[name]
    made = mechanisms.mechanism(np.random.default_rng(seed), links, springs=springs, loops=loops)
    simulation = Simulation(made.remade(gravity=(0, 0, 0)), method=method, step=4e-3, group=group)
    start = simulation.sample()
    simulation.advance(500)
    end = simulation.sample()
    masses = np.array([body.mass for body in made.bodies])
    sizes = [masses * np.linalg.norm(each.twist[:, 3:], axis=1) for each in (start, end)]
    arms = [np.maximum(np.linalg.norm(each.pose[:, 9:], axis=1), 1.0) for each in (start, end)]
    size = max(np.sum(momenta * lengths) for momenta, lengths in zip(sizes, arms))
    roundings = 4 * 500 * len(SUBSTEPS[method])
    off = np.abs(end.spatial_momentum - start.spatial_momentum).max()
    assert off <= UNIT * roundings * size
    assert np.abs(end.pose - start.pose).max() > 0.5


def energies(method, step, count, samples=400, **settings):
    """Energy errors (J) along the chaotic motion of the double pendulum."""
    simulation = Simulation(load_scene("double_pendulum"), method=method, step=step, **settings)
    start, found = simulation.energy(), []
    for _ in range(samples):
        simulation.advance(count // samples)
        found.append(simulation.energy() - start)
    return np.array(found)


@pytest.mark.turn(2)
def test_energy_oscillates_and_does_not_drift():
    """200 000 steps of 4 ms: both halves of the run have the same mean error.

    Samples are 2 s apart and taken as independent after ten of them: the difference of two means
    of 200 has a standard error of sqrt(2 * 10 / 200) = 0.32 scatters, and three times that is
    allowed. RKMK4 on SE(3)^n at the same step shows what fails: it moves by many of its own scatters.
    """
    found = energies("constrained_rattle", 4e-3, 200_000)
    halves = found.reshape(2, -1)
    assert abs(halves[1].mean() - halves[0].mean()) <= 0.95 * halves.std(axis=1).max()
    # No more than in a short run at the same step, and O(h^2): 11.8 J are at play.
    assert np.abs(found).max() <= 0.1
    halved = energies("constrained_rattle", 2e-3, 100_000)
    assert found.std() / halved.std() > 2.0
    drifting = energies("rkmk4", 4e-3, 200_000, group="se3")
    assert abs(drifting[-1]) > 10.0 * np.abs(found).max()


def test_compositions_are_symmetric_and_satisfy_order_conditions():
    """sum g = 1; from order 4 sum g^3 = 0; for order 8 also the sums of powers 5 and 7."""
    for name in CONSTRAINED:
        g = SUBSTEPS[name]
        assert (g == g[::-1]).all() and abs(g.sum() - 1.0) <= 4 * UNIT
        for power in range(3, METHODS[name].order, 2):
            assert abs((g**power).sum()) <= 10 * UNIT * (np.abs(g) ** power).sum()


@pytest.mark.parametrize("method", CONSTRAINED)
def test_a_step_too_large_for_the_motion_ends_with_a_status(method):
    """The crank rotates by more than pi/2 in a step: no velocity impulse closes the loop."""
    simulation = Simulation(load_scene("four_bar"), method=method, step=0.1)
    before = simulation.state()
    with pytest.raises(SimulationError, match="smaller step") as failure:
        simulation.advance(10)
    assert failure.value.status in (NOT_CONVERGED, ROTATION_TOO_LARGE)
    if simulation.steps == 0:
        assert (simulation.state()[0] == before[0]).all()
    assert np.isfinite(simulation.state()[0]).all()


@pytest.mark.parametrize("kind", ["projection", "baumgarte"])
def test_stabilisation_is_refused(kind):
    with pytest.raises(ValueError, match="constrained_rattle satisfies the constraints itself"):
        Simulation(load_scene("four_bar"), method="constrained_rattle", stabilisation=kind)
