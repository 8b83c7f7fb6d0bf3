# SPDX-License-Identifier: Apache-2.0
"""State transitions: Kapitza's pendulum, differences of runs, symplecticity; inverse dynamics against runs."""

import numpy as np
import pytest
import random_mechanisms
import scipy
from scene_files import filled, text_of

from liegroup_core import Simulation, SimulationError, load_scene
from liegroup_core.errors import SceneError
from liegroup_core.linear import inverse_dynamics, linearise, transition
from liegroup_core.linear.coordinates import Coordinates
from liegroup_core.linear.probe import Probe
from liegroup_core.scene.load import scene_from_text

GRAVITY, LENGTH, STROKE, KNOTS = 9.81, 0.5, 0.05, 12


def driven(speed):
    """Motion of the pivot, STROKE cos(w t), for 7/4 periods: times, positions, velocities, accelerations."""
    t = np.linspace(0.0, 3.5 * np.pi / speed, 7 * KNOTS // 4 + 1)
    c, s = np.cos(speed * t), np.sin(speed * t)
    c[-1] = 0.0
    return t, STROKE * c, -STROKE * speed * s, -STROKE * speed**2 * c


def kapitza(speed):
    """A pendulum that stands on a pivot which is driven up and down."""
    t, q, v, a = (each.tolist() for each in driven(speed))
    return scene_from_text(
        filled(
            text_of("kapitza.yaml"),
            gravity=GRAVITY,
            stroke=STROKE,
            top=STROKE + LENGTH,
            t=t,
            q=q,
            v=v,
            a=a,
            length=LENGTH,
        ),
        source="t",
    )


@pytest.mark.parametrize("speed, is_stable", [(40.0, False), (100.0, True), (160.0, True)])
@pytest.mark.turn(3)
def test_kapitzas_pendulum_stands_if_its_pivot_is_fast(speed, is_stable):
    """Multipliers of l q'' = (g + z'') q, with z'' of the quintic Hermite spline of the pivot.

    The method of averages has it stable above a w = sqrt(2 g l), which is w = 62.6 rad/s here.
    """
    t, q, v, a = driven(speed)
    up = scipy.interpolate.BPoly.from_derivatives(t, np.stack([q, v, a], 1)).derivative(2)

    def rates(time, x):
        return [x[2], x[3], *((GRAVITY + up(time)) / LENGTH * x[:2])]

    x = np.eye(2).ravel()
    for first, last in zip(t[:KNOTS], t[1:]):
        x = scipy.integrate.solve_ivp(rates, (first, last), x, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    found = transition(Simulation(kapitza(speed)), t[KNOTS])
    assert found.states == ("pin", "pin.rate")
    assert np.abs(found.phi - x.reshape(2, 2)).max() < 1e-7 * np.abs(x).max()
    assert np.linalg.det(found.phi) == pytest.approx(1.0, abs=1e-8)
    assert bool(np.abs(found.multipliers).max() < 1.0 + 1e-6) is is_stable


@pytest.mark.parametrize("name", ["loops", "planar loops", "couplings", "driven"])
@pytest.mark.turn(3)
def test_differences_of_runs_arrive_as_the_transition_says(name):
    """Two runs that start apart by 1e-5 along random directions of the independent coordinates and rates."""
    scene, _ = random_mechanisms.random_mechanism(name, 5)
    duration = 0.05
    here = Simulation(scene, accuracy=1e-11, quiet=True)
    before = here.sample().pose.copy()
    found = transition(here, duration)
    assert here.time == 0.0 and (here.sample().pose == before).all() and found.error <= 1e-9
    m, n = found.coordinates, len(found.states)
    start = np.linspace(1.0, 2.0, n)
    chosen = list(found.states[:m])
    here.advance_to(duration)
    shown = linearise(here, [], ["twists"], chosen, duration).C
    twists = []
    for sign in (1.0, -1.0):
        other = Simulation(scene, accuracy=1e-11, quiet=True)
        probe = Probe(other)
        coordinates = Coordinates(probe, chosen)
        y = sum(
            coordinates.neighbour(j % m, sign * 1e-5 * start[j] * coordinates.signs[j % m], j >= m) for j in range(n)
        )
        _, pose, twist = probe.closed(y)
        other.set_state(pose, twist)
        other.advance_to(duration)
        twists.append(other.sample(duration).twist.ravel())
    expected = (twists[0] - twists[1]) / 2e-5
    assert np.abs(shown @ found.phi @ start - expected).max() < 1e-5 * np.abs(expected).max()


RAIL = text_of("rail_transition.yaml")


def test_an_impact_changes_its_time():
    """x = L - e (x0 + v t - L) after an impact at L: dx = -e (dx0 + t dv), dv -> -e dv."""
    text = filled(RAIL, gravity=0.0, speed=2.0, rest="limits: {lower: -9, upper: 0.5, restitution: 0.6}")
    found = transition(Simulation(scene_from_text(text, "t")), 1.0)
    assert np.abs(found.phi - [[-0.6, -0.6], [0.0, -0.6]]).max() < 1e-9
    # At the impact itself, neighbouring runs are before it or after it.
    with pytest.raises(SimulationError, match="runs to both sides behave differently"):
        transition(Simulation(scene_from_text(text, "t")), 0.2)


def test_dry_friction_that_reverses_changes_its_time():
    """Up with v - (g + f) t, down with (g - f) (t - t1), t1 = v / (g + f)."""
    g, f, v, end = 9.0, 3.0, 2.4, 0.7
    text = filled(RAIL, gravity=g, speed=v, rest=f"friction: {{coulomb: {f}, static: {f}}}")
    found = transition(Simulation(scene_from_text(text, "t")), end)
    back = end - v / (g + f)
    expected = [[1.0, v / (g + f) + (g - f) / (g + f) * back], [0.0, (g - f) / (g + f)]]
    assert np.abs(found.phi - expected).max() < 1e-9


def test_rests():
    """At an equilibrium it is exp(A T)."""
    with pytest.raises(SceneError, match="greater than 0"):
        transition(Simulation(load_scene("double_pendulum")), 0.0)
    hanging = Simulation(
        scene_from_text("name: f\ngravity: [0, 0, 0]\nbodies: [{name: b, mass: 1, inertia: [1, 1, 1]}]\n", "t")
    )
    found = transition(hanging, 2.0)
    np.testing.assert_allclose(found.phi, scipy.linalg.expm(2.0 * linearise(hanging).A), atol=1e-9)


SCENES = {"double_pendulum": ["shoulder", "elbow"], "four_bar": ["ground_crank"]}


def simulation_of(scene, step=1e-3):
    return Simulation(scene, "rkmk8", step, estimate=False, quiet=True)


def of_joints(sample, joints):
    """(2, m) positions and velocities."""
    return np.array([sample.joint_coordinates[joint] for joint in joints]).T


@pytest.mark.parametrize("name, duration", [("double_pendulum", 0.25), ("four_bar", 0.08)])
@pytest.mark.turn(3)
def test_a_run_with_the_efforts_that_were_found_returns_the_motion(name, duration):
    """Sines in the joints. Efforts are constant in each step, with the values of its middle.

    Such runs are symmetric in time: their error has even powers of the step, and extrapolation removes three of them.
    """
    scene, joints = load_scene(name), SCENES[name]
    start = simulation_of(scene)
    q, v = of_joints(start.sample(), joints)
    w, size = np.arange(3.0, 3.0 + len(joints)), 0.3

    def motion(t):
        position, rate = q + (v - size * w) * t + size * np.sin(w * t), v + size * w * (np.cos(w * t) - 1.0)
        return position, rate, -size * w**2 * np.sin(w * t)

    errors = []
    for steps in (40, 80, 160, 320):
        step = duration / steps
        middles = (np.arange(steps) + 0.5) * step
        found = inverse_dynamics(start, middles, *zip(*map(motion, middles)), joints)
        run = simulation_of(scene, step)
        for efforts in found.efforts:
            for joint, effort in zip(joints, efforts):
                run.apply_effort(joint, float(effort))
            run.advance(1)
        error = of_joints(run.sample(), joints) - motion(duration)[:2]
        error[0] -= 2.0 * np.pi * np.round(error[0] / (2.0 * np.pi))
        errors.append(error)
    assert np.abs(errors[-1]).max() > 1e-8  # without extrapolation
    for power in (4.0, 16.0, 64.0):
        errors = [(power * fine - coarse) / (power - 1.0) for coarse, fine in zip(errors, errors[1:])]
    assert np.abs(errors[0]).max() < 1e-9


@pytest.mark.parametrize("name", SCENES)
def test_efforts_are_those_of_driven_joints(name):
    """The multipliers of the prescribed motion along a run; both are solutions of the same equations."""
    scene, joints = load_scene(name), SCENES[name]
    start = simulation_of(scene)
    q, v = of_joints(start.sample(), joints)
    points = {joint: [q[k], q[k] + 0.1 * v[k] + 0.2, q[k] - 0.1] for k, joint in enumerate(joints)}
    driven = [
        joint.remade(driven=True, motion={"times": [0.0, 0.1, 0.3], "positions": points[joint.name]})
        if joint.name in joints
        else joint
        for joint in scene.joints
    ]
    run, times, motion, efforts = simulation_of(scene.remade(joints=driven)), [], [], []
    for _ in range(15):
        run.advance(20)
        sample = run.sample()
        times.append(sample.time)
        motion.append([sample.prescribed[joint] for joint in joints])
        efforts.append([sample.drive_efforts[joint] for joint in joints])
    found = inverse_dynamics(start, times, *np.array(motion).transpose(2, 0, 1), joints)
    assert np.abs(found.efforts - efforts).max() < 1e-12 * np.abs(efforts).max()
    assert found.residual.max() < 1e-11


PENDULUM = text_of("pendulum_inverse.yaml")


def test_a_motion_leaves_a_stop():
    """From a stop that holds the rod at the start."""
    text = PENDULUM.replace("{FRICTION}", "{viscous: 0.1}").replace("lower: -1.0", "lower: 0.0")
    start = simulation_of(scene_from_text(text, source="test"))
    found = inverse_dynamics(start, [0.0], [[0.2]], [[0.3]], [[2.0]], ["pin"])
    assert found.efforts[0, 0] == pytest.approx(0.27 * 2.0 + 0.1 * 0.3 + 9.81 * 0.5 * np.sin(0.2), rel=1e-12)


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_friction_opposes_the_motion(mu):
    """From a state at rest, in both directions: m g l sin(q) + I a + friction; by load with the force on the pin."""
    friction = f"coulomb: 0.7, viscous: 0.1, mu: {mu}, radius: 0.05"
    start = simulation_of(scene_from_text(PENDULUM.replace("FRICTION", friction), source="test"))
    times, motion = [0.0, 1.0, 2.0], np.array([[0.3, 0.5, 0.2], [0.3, -0.5, 0.2], [-0.2, 0.0, 3.0]])
    found = inverse_dynamics(start, times, *motion.T[..., None], ["pin"])
    q, v, a = motion.T
    along, across = 0.5 * v**2 + 9.81 * np.cos(q), 0.5 * a + 9.81 * np.sin(q)
    expected = 0.27 * a + 9.81 * 0.5 * np.sin(q) + 0.1 * v
    expected += np.sign(v) * (0.7 + mu * 0.05 * np.hypot(along, across))
    assert found.efforts[:, 0] == pytest.approx(expected, rel=1e-12)
    assert found.residual.max() < 1e-11
    with pytest.raises(SimulationError, match="the motion is beyond a stop at 0 s: pin would be at 1.2 rad"):
        inverse_dynamics(start, [0.0], [[1.2]], [[0.0]], [[0.0]], ["pin"])
