# SPDX-License-Identifier: Apache-2.0
"""Rotation methods under pose- and velocity-dependent, coupling, applied and timed forces.

References: the independent integration of liegroup_core.reference, or SciPy's DOP853 on equations
written here.
"""

import re

import mechanisms
import numpy as np
import pytest
from convergence import order_by_count
from naive import hat
from scipy.integrate import solve_ivp

from liegroup_core import Scene, Simulation, SimulationError, load_scene
from liegroup_core.layout import make_layout
from liegroup_core.methods.families import fitting_methods
from liegroup_core.methods.table import METHODS
from liegroup_core.reference import integrate
from liegroup_core.scene.description import Body, ConstantWrench, Drag, SpringDamper

ROTATION = [name for name, method in METHODS.items() if method.family == "rotation"]
INERTIA = np.array([[0.9, 0.1, -0.05], [0.1, 1.1, 0.08], [-0.05, 0.08, 1.6]])
SIX = [0.9, 1.1, 1.6, 0.1, -0.05, 0.08]
# Steps per second by order.
RATES = {2: (512, 1024, 2048), 4: (128, 256, 512), 8: (32, 64, 96)}


def end(scene, method, rate, time=1.0):
    simulation = Simulation(scene, method=method, step=1 / rate)
    simulation.advance(round(time * rate))
    return simulation.state()


@pytest.fixture(scope="module")
def coupled():
    """(three bodies coupled by springs and dampers to each other and the world, end state)."""
    scene = mechanisms.rotors()
    start = Simulation(scene).state()
    trajectory, uncertainty = integrate(scene, *start, [1.0])
    assert uncertainty.attitude.max() < 1e-11
    return scene, trajectory


@pytest.mark.parametrize("method", ROTATION)
@pytest.mark.volume(5)
def test_order_with_bodies_coupled_by_springs_and_dampers(coupled, method):
    """Position of the free body, attitude and velocity of all bodies.

    At order 8 slopes are up to 9.4: the smallest step is next to the reference's own error.
    """
    scene, reference = coupled
    order = METHODS[method].order
    errors = []
    for rate in RATES[order]:
        pose, twist = end(scene, method, rate)
        errors.append(
            [
                np.abs(pose[:, :9] - reference.rotation[0].reshape(-1, 9)).max(),
                np.abs(pose[:, 9:] - reference.position[0]).max(),
                np.abs(twist - reference.twist[0]).max(),
            ]
        )
    for of_one_kind in np.transpose(errors):
        found = order_by_count(RATES[order], of_one_kind)
        assert found == pytest.approx(order, abs=1.5 if order == 8 else 0.25), errors


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("method", ROTATION)
@pytest.mark.volume(8)
def test_order_with_drag(method, held):
    """Linear and quadratic drag of rotation and translation; reference: DOP853 in R, r, w, v."""
    d = np.array([0.3, -0.2, 0.4]) if held else np.zeros(3)
    mass, gravity, w0 = 2.0, np.array([0.2, -0.1, -0.8]), np.array([0.5, 0.8, 0.1])
    v0 = np.cross(w0, d) if held else np.array([0.4, -0.3, 0.2])
    about = INERTIA + mass * (d @ d * np.eye(3) - np.outer(d, d))
    scene = mechanisms.one_body(
        {"type": "spherical", "child_frame": {"position": -d}} if held else None,
        [Drag(name="air", body="a", linear=0.6, quadratic=0.4, angular=0.5, angular_quadratic=0.3)],
        gravity,
        **{"mass": mass, "inertia": SIX, "position": d, "angular_velocity": w0, "linear_velocity": v0},
    )

    def rate(_, y):
        R, w = y[:9].reshape(3, 3), y[12:15]
        v = np.cross(w, d) if held else y[15:]
        force = mass * R.T @ gravity - (0.6 + 0.4 * np.linalg.norm(v)) * v
        torque = -(0.5 + 0.3 * np.linalg.norm(w)) * w + np.cross(d, force)
        wdot = np.linalg.solve(about, torque - np.cross(w, about @ w))
        return np.concatenate([(R @ hat(w)).ravel(), R @ v, wdot, force / mass - np.cross(w, v)])

    start = np.concatenate([np.eye(3).ravel(), d, w0, v0])
    found = solve_ivp(rate, (0, 4), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    order = METHODS[method].order
    rates = {2: (8, 16, 32, 64), 4: (4, 8, 16, 32), 8: (1, 1.5, 2, 3)}[order]
    poses = [end(scene, method, count, 4)[0][0] for count in rates]
    for part in (slice(0, 9), slice(9, 12)):
        off = [np.abs(pose[part] - found[part]).max() for pose in poses]
        assert order_by_count(rates, off) == pytest.approx(order, abs=1.0 if order == 8 else 0.2), off


@pytest.mark.parametrize("method", ROTATION)
def test_the_spherical_joint_holds_to_round_off(method):
    """Also with the centre of mass off the body frame, and at much too large steps."""
    at = {"position": (-0.5, 0, 0)}
    keys = {"mass": 2.0, "com": (0.1, 0.2, -0.1), "inertia": SIX}
    keys |= {"angular_velocity": (3, 1, -2), "linear_velocity": (0, -1, -0.5)}
    scene = mechanisms.one_body({"type": "spherical", "parent_frame": at, "child_frame": at}, (), (0, 0, -9.81), **keys)
    for step in (1e-3, 0.05, 0.1):
        simulation = Simulation(scene, method=method, step=step)
        simulation.advance(200)
        # r is computed from R anew in every step: some roundings of lengths below 1 m.
        assert simulation.sample().constraint_residual <= 1e-15


@pytest.mark.parametrize("method", ROTATION)
@pytest.mark.volume(5)
def test_wrenches_starting_and_ending_within_steps_keep_the_order(method):
    """Torque and force in world axes from 0.3 s to 0.7137 s; reference: piecewise DOP853."""
    torque, force, mass = np.array([0.4, -0.3, 0.5]), np.array([1.0, 2.0, -0.5]), 2.0
    w0 = np.array([0.5, 0.8, 0.1])
    push = ConstantWrench(name="push", body="a", torque=torque, force=force, axes="world", start=0.3, end=0.7137)
    scene = mechanisms.one_body(None, [push], mass=mass, inertia=SIX, angular_velocity=w0)

    def rate(_, y, on):
        R, w = y[:9].reshape(3, 3), y[9:]
        return np.concatenate(
            [(R @ hat(w)).ravel(), np.linalg.solve(INERTIA, on * R.T @ torque - np.cross(w, INERTIA @ w))]
        )

    y = np.concatenate([np.eye(3).ravel(), w0])
    for first, last, on in ((0, 0.3, 0), (0.3, 0.7137, 1), (0.7137, 1, 0)):
        y = solve_ivp(rate, (first, last), y, method="DOP853", rtol=1e-13, atol=1e-13, args=(on,)).y[:, -1]
    order = METHODS[method].order
    rates = {2: (32, 64, 128, 256), 4: (8, 16, 32, 64), 8: (1, 2, 4)}[order]
    poses = [end(scene, method, count)[0][0] for count in rates]
    off = [np.abs(pose[:9] - y[:9]).max() for pose in poses]
    if order == 8:
        assert off[-1] < 1e-10
    else:
        assert order_by_count(rates, off) == pytest.approx(order, abs=0.25), off
    # A constant force is integrated exactly by all of them: x = f/m (t1^2/2 + t1 t2).
    held, after = 0.7137 - 0.3, 1 - 0.7137
    for pose in poses:
        assert np.abs(pose[9:] - force / mass * (held**2 / 2 + held * after)).max() <= 1e-14


@pytest.mark.parametrize("method", ["lie_midpoint", "simo_wong", "bottasso_borri_candidate"])
def test_a_torque_beyond_fixed_point_convergence_ends_with_a_status(method):
    """Spring with h omega far above 2 at both ends."""
    ends = {"parent": "a", "child": "b", "parent_point": (0, 0.1, 0), "child_point": (0, 0, 0.1)}
    bodies = [Body(name=name, mass=1, inertia=(0.1, 0.2, 0.2), position=(x, 0, 0)) for name, x in (("a", 0), ("b", 1))]
    rod = SpringDamper(name="rod", stiffness=1e6, rest_length=0.9, **ends)
    scene = Scene(name="stiff", gravity=(0, 0, 0), bodies=bodies, forces=[rod])
    simulation = Simulation(scene, method=method, step=0.01)
    before = simulation.state()
    with pytest.raises(SimulationError, match="smaller step") as failure:
        simulation.advance(1)
    assert (simulation.state()[0] == before[0]).all() and simulation.steps == 0
    works = float(re.search(r"([\d.e-]+) s works from here", str(failure.value)).group(1))
    assert works < 0.01
    Simulation(scene, method=method, step=works).advance(1)
    Simulation(scene, method=method, step=1e-4).advance(100)


@pytest.mark.parametrize("method", ["lie_midpoint", "simo_wong"])
def test_drag_beyond_fixed_point_convergence_is_solved(method):
    """h c / 2 m = 5: fixed-point iteration would multiply the error by five each time.

    The midpoint rule in world axes, v+ (1 + 5) = v (1 - 5) + h g; turning is as stiff, and stops.
    """
    mass, h = 2.0, 0.01
    drag = Drag(name="honey", body="a", linear=10 * mass / h, angular=10 * 1.1 / h)
    keys = {"mass": mass, "inertia": SIX, "angular_velocity": (0.5, 0.8, 0.1), "linear_velocity": (0.4, -0.3, 0.2)}
    scene = mechanisms.one_body(None, [drag], (0, 0, -9.81), **keys)
    simulation = Simulation(scene, method=method, step=h)
    v, r = np.array([0.4, -0.3, 0.2]), np.zeros(3)
    for _ in range(30):
        simulation.advance(1)
        v, before = ((1 - 5) * v + h * np.array([0, 0, -9.81])) / (1 + 5), v
        r = r + h * (v + before) / 2
        pose, twist = simulation.state()
        # Repeated until displacements change by 1e-15 m or some roundings of them: velocities are
        # 2/h times as far off, and what is left of that shrinks by 4/6 in every step.
        assert np.abs(pose[0, :9].reshape(3, 3) @ twist[0, 3:] - v).max() <= 3 * 2e-15 / h
        assert np.abs(pose[0, 9:] - r).max() <= 30 * 2e-15
    assert np.abs(twist[0, :3]).max() < 1e-3


def pendulum():
    """Body that swings about its lower position at sqrt(m g a / (I + m a^2)) rad/s."""
    keys = {"position": (0, 0, -1), "angular_velocity": (0.1, 0, 0), "linear_velocity": (0, 0.1, 0)}
    return mechanisms.one_body({"type": "spherical", "child_frame": {"position": (0, 0, 1)}}, (), (0, 0, -9.81), **keys)


@pytest.mark.parametrize("method", ["stoermer_verlet", "lie_newmark", "rattle", "austin_krishnaprasad_wang"])
def test_a_step_beyond_the_stability_limit_has_a_large_estimate(method):
    """h omega = 2 for all methods explicit in forces; the other step is an eighth of it."""
    omega = np.sqrt(9.81 / 2)
    stable = Simulation(pendulum(), method=method, step=0.25 / omega)
    stable.advance(100)
    assert stable.sample().errors[0, 1] < 0.1
    unstable = Simulation(pendulum(), method=method, step=2.1 / omega)
    try:
        unstable.advance(100)
    except SimulationError as error:
        assert method == "rattle" and "RATTLE has no solution" in str(error)
    else:
        assert "may differ completely from the true one" in unstable.doubt


@pytest.mark.parametrize(
    "name, why",
    [
        ("double_pendulum", r"\w+ is a \w+ joint from \w+ to \w+"),
        ("four_bar", r"is a revolute joint from world to \w+"),
    ],
)
def test_unsupported_scenes_are_refused_with_applicable_methods(name, why):
    for method in ROTATION:
        with pytest.raises(ValueError, match=why) as refusal:
            Simulation(load_scene(name), method=method)
        assert "\n" not in str(refusal.value)
        fitting = str(refusal.value).split("Use one of: ")[1].split(", ")
        assert fitting == [name for name in METHODS if name not in ROTATION]


def test_two_spherical_joints_on_a_body_and_stabilisation_are_refused():
    scene = mechanisms.one_body({"type": "spherical", "child_frame": {"position": (0, 0, 0)}}, gravity=(0, 0, -1))
    other = scene.joints[0].remade(name="other", child_frame={"position": (1, 0, 0)})
    scene = scene.remade(joints=[*scene.joints, other])
    with pytest.raises(ValueError, match="one spherical joint per body, but a has more"):
        Simulation(scene, method="rattle")
    for kind in ("projection", "baumgarte"):
        with pytest.raises(ValueError, match="stoermer_verlet satisfies the constraints itself"):
            Simulation(load_scene("heavy_top"), method="stoermer_verlet", stabilisation=kind)


def test_applicable_methods_of_a_scene():
    assert fitting_methods(make_layout(load_scene("heavy_top"))) == list(METHODS)
    assert fitting_methods(make_layout(mechanisms.rotors())) == list(METHODS)
    others = fitting_methods(make_layout(load_scene("four_bar")))
    assert others == [name for name in METHODS if name not in ROTATION]
