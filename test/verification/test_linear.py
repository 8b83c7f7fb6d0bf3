# SPDX-License-Identifier: Apache-2.0
"""Linear systems, modes, equilibria and inverse dynamics: closed forms, 50 digits, and the motion itself."""

import os

import numpy as np
import precise
import pytest
import random_mechanisms
import scipy
from scene_files import filled, text_of

from liegroup_core import Simulation
from liegroup_core.errors import SceneError
from liegroup_core.linear import TrimError, inverse_dynamics, linearise, modes_of, trim
from liegroup_core.linear.coordinates import Coordinates
from liegroup_core.linear.differences import derivative
from liegroup_core.linear.probe import Probe
from liegroup_core.scene.load import load_scene, scene_from_text

GRAVITY = 9.81
# Derivatives have about 12 digits (differences.py); references of exact accelerations at rounded poses have
# 2e-16 / 0.01 of the accelerations.
DIGITS = 1e-10
CLASSES = [name for name in random_mechanisms.CLASSES if name not in ("large", "mass ratios", "slender")]
CASES = [(name, seed) for seed in range(int(os.environ.get("MECHANISMS", 12))) for name in CLASSES]


def paused(scene, method="rkmk4", step=1e-3):
    return Simulation(scene, method, step, estimate=False, quiet=True)


def yaml_scene(text):
    return scene_from_text(text, source="test")


DOUBLE = text_of("double.yaml")


def test_the_modes_of_a_double_pendulum_are_those_in_closed_form():
    """Hanging at rest, coordinates shoulder and elbow: M and K by hand."""
    m1, m2, I1, I2, a, L, b = 2.0, 1.5, 0.03, 0.05, 0.4, 0.8, 0.3
    M = np.array(
        [[I1 + m1 * a**2 + I2 + m2 * (L + b) ** 2, I2 + m2 * b * (L + b)], [I2 + m2 * b * (L + b), I2 + m2 * b**2]]
    )
    K = GRAVITY * np.array([[m1 * a + m2 * (L + b), m2 * b], [m2 * b, m2 * b]])
    system = linearise(paused(yaml_scene(DOUBLE)))
    assert system.states == ("shoulder", "elbow", "shoulder.rate", "elbow.rate")
    np.testing.assert_allclose(system.A[2:, :2], -np.linalg.solve(M, K), rtol=1e-11)
    np.testing.assert_allclose(system.B[2:], np.linalg.inv(M), rtol=1e-11)
    np.testing.assert_allclose(system.C, np.eye(4)[[0, 2, 1, 3]], atol=1e-12)
    expected = np.sqrt(scipy.linalg.eigvalsh(K, M))
    for damped in (True, False):
        modes = modes_of(system, damped)
        np.testing.assert_allclose([mode.pole.imag for mode in modes], expected, rtol=1e-11)
        np.testing.assert_allclose([mode.frequency for mode in modes], expected / (2.0 * np.pi), rtol=1e-11)
        for mode in modes:
            shape = mode.shape.real
            assert np.abs(K @ shape - mode.pole.imag**2 * M @ shape).max() < 1e-9 * np.abs(K).max()
    assert system.error < 1e-10 and not len(system.uncontrollable()) and not len(system.unobservable())


PARALLELOGRAM = text_of("parallelogram.yaml")


@pytest.mark.parametrize("chosen", [None, ["a"], ["b"]])
def test_a_closed_loop_has_the_mode_of_its_only_freedom(chosen):
    """A bar on two equal cranks moves in parallel; a torsional spring and damper act at one of them."""
    inertia = 2.0 * (0.04 + 1.0 * 0.25**2) + 3.0 * 0.5**2
    stiffness = GRAVITY * (2.0 * 1.0 * 0.25 + 3.0 * 0.5) + 2.0
    omega, zeta = np.sqrt(stiffness / inertia), 0.5 * 0.6 / np.sqrt(stiffness * inertia)
    system = linearise(paused(yaml_scene(PARALLELOGRAM)), independent=chosen)
    assert system.A.shape == (2, 2) and (chosen is None or system.states[0] == chosen[0])
    (mode,) = modes_of(system)
    assert abs(mode.pole) == pytest.approx(omega, rel=1e-10) and mode.damping == pytest.approx(zeta, rel=1e-10)
    assert mode.oscillates and np.abs(mode.shape) == pytest.approx(1.0, abs=1e-10)
    (undamped,) = modes_of(system, damped=False)
    assert undamped.pole == pytest.approx(1j * omega, rel=1e-10)
    # All three efforts of cranks do the same work.
    b = dict(zip(system.inputs, system.B[1]))
    assert b["a.effort"] == pytest.approx(1.0 / inertia, rel=1e-10) == b["b.effort"]


def sleeping(spin):
    return yaml_scene(
        "name: top\ngravity: [0, 0, -9.81]\nbodies:\n  - {name: top, mass: 2.0, inertia: [0.05, 0.05, 0.02], "
        f"position: [0, 0, 0.3], angular_velocity: [0, 0, {spin}]}}\njoints:\n  - {{name: pivot, type: spherical, "
        "parent: world, child: top, child_frame: {position: [0, 0, -0.3]}}\n"
    )


@pytest.mark.parametrize("spin", [2.0, 25.0, 60.0, 140.0])
def test_a_sleeping_top_has_the_poles_of_its_steady_spin(spin):
    """About an upright spin n: A s^2 - i C n s - m g l = 0 in world axes; body axes turn with n.

    Stable above n^2 = 4 A m g l / C^2.
    """
    A, C, weight = 0.05 + 2.0 * 0.3**2, 0.02, 2.0 * GRAVITY * 0.3
    in_space = np.roots([A, -1j * C * spin, -weight])
    in_body = np.concatenate([in_space - 1j * spin, in_space.conj() + 1j * spin, [0.0, 0.0]])
    system = linearise(paused(sleeping(spin)))
    found = list(system.poles)
    for pole in in_body:
        nearest = min(found, key=lambda each: abs(each - pole))
        found.remove(nearest)
        # A double zero is the root of the round-off of its square.
        assert abs(nearest - pole) < (1e-9 if pole else 1e-5) * max(spin, abs(pole))
    result = trim(paused(sleeping(spin)), {"pivot.rz": spin})
    assert result.is_stable is (None if spin**2 > 4.0 * A * weight / C**2 else False)


@pytest.mark.slow
@pytest.mark.parametrize("name, seed", CASES)
@pytest.mark.volume(3)
def test_derivatives_are_those_of_the_exact_accelerations(name, seed):
    """Of all bodies of random trees, loops, couplings and driven joints, along every coordinate and rate."""
    scene, _ = random_mechanisms.random_mechanism(name, seed)
    simulation = paused(scene)
    probe = Probe(simulation)
    coordinates = Coordinates(probe)
    try:
        exact = precise.accelerations_at(scene, precise.states_of(probe.pose, probe.twist))
    except precise.NearlySingular:
        pytest.skip("nearly singular")
    system = linearise(simulation, [], ["accelerations"])
    com = np.array([body.com for body in scene.bodies])
    m = len(coordinates.independent)
    size = np.abs(system.C).max(initial=1.0)
    for rate in (False, True):
        for k in list(range(m))[:: max(1, m // 2)]:

            def accelerations(s, k=k, rate=rate):
                _, pose, twist = probe.slopes(coordinates.neighbour(k, s, rate))
                found = exact(precise.states_of(pose, twist)).astype(float).reshape(-1, 2, 3)
                (w, v), (dw, dv) = twist.reshape(-1, 2, 3).swapaxes(0, 1), found.swapaxes(0, 1)
                shift = np.cross(dw, -com) + np.cross(w, np.cross(w, -com))
                return np.hstack([dw, dv + np.cross(w, v) + shift])

            expected, _ = derivative(accelerations, coordinates.size(k))
            column = system.C[:, m * rate + k].reshape(-1, 6) * coordinates.signs[k]
            assert np.abs(column - expected).max() <= DIGITS * size


@pytest.mark.parametrize("name", ["loops", "planar loops", "couplings", "tree", "driven"])
@pytest.mark.volume(2)
def test_small_differences_of_a_motion_grow_as_the_linear_systems_along_it_say(name):
    """Phi' = A Phi along a run, against the difference of two runs that start apart by 1e-5."""
    scene, _ = random_mechanisms.random_mechanism(name, 3)
    step, count = 2e-4, 50
    here = paused(scene, "rkmk8", step)
    first = linearise(here, [], ["twists"])
    m = len(first.A) // 2
    chosen = list(first.states[:m])
    start = np.linspace(1.0, 2.0, 2 * m)
    x = start.copy()
    systems = [linearise(here, [], ["twists"], chosen)]
    for _ in range(count):
        here.advance(1)
        systems.append(linearise(here, [], ["twists"], chosen))
    for k in range(0, count - 1, 2):  # Runge-Kutta's method with two steps of the run as one
        h, (a, b, c) = 2.0 * step, (each.A for each in systems[k : k + 3])
        k1 = a @ x
        k2 = b @ (x + 0.5 * h * k1)
        k3 = b @ (x + 0.5 * h * k2)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + c @ (x + h * k3))
    twists = []
    for sign in (1.0, -1.0):
        other = paused(scene, "rkmk8", step)
        probe = Probe(other)
        coordinates = Coordinates(probe, chosen)
        y = sum(
            coordinates.neighbour(j % m, sign * 1e-5 * start[j] * coordinates.signs[j % m], j >= m)
            for j in range(2 * m)
        )
        _, pose, twist = probe.closed(y)
        other.set_state(pose, twist)
        other.advance(count)
        twists.append(other.sample().twist.ravel())
    expected = (twists[0] - twists[1]) / 2e-5
    found = systems[-1].C @ x
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()


def test_inputs_and_outputs_have_their_names_and_units():
    system = linearise(paused(load_scene("door")), ["wrenches"], ["bodies", "twists", "reactions"])
    assert len(system.inputs) == 6 * len(load_scene("door").bodies) and system.D.shape == (
        len(system.outputs),
        len(system.inputs),
    )
    with pytest.raises(SceneError, match=r'unknown input "?.?hinge.efort'):
        linearise(paused(load_scene("door")), ["hinge.efort"])
    with pytest.raises(SceneError, match="unknown coordinate"):
        linearise(paused(load_scene("door")), independent=["handle"])


def test_a_pole_that_no_input_changes_is_named():
    """Two pendulums of different lengths, one with a motor, and outputs of the other only."""
    text = "name: two\ngravity: [0, 0, -9.81]\nbodies:\n" + "".join(
        f"  - {{name: b{k}, mass: 1.0, inertia: [0.1, 0.1, 0.1], position: [{k}, 0, -{length}]}}\n"
        for k, length in enumerate((0.5, 1.5))
    )
    text += "joints:\n" + "".join(
        f"  - {{name: j{k}, type: revolute, parent: world, child: b{k}, child_frame: {{position: [0, 0, {length}], "
        "rotation_vector: [-1.5707963267948966, 0, 0]}}\n"
        for k, length in enumerate((0.5, 1.5))
    )
    system = linearise(paused(yaml_scene(text)), ["j0.effort"], ["j1.position"])
    own = [np.sqrt(GRAVITY * length / (0.1 + length**2)) for length in (0.5, 1.5)]
    np.testing.assert_allclose(sorted(np.abs(system.uncontrollable())), [own[1]] * 2, rtol=1e-9)
    np.testing.assert_allclose(sorted(np.abs(system.unobservable())), [own[0]] * 2, rtol=1e-9)


def test_the_zeros_of_a_collocated_motor_are_the_modes_with_its_joint_at_rest():
    """Effort and position of the shoulder of a double pendulum: the elbow then swings alone."""
    system = linearise(paused(yaml_scene(DOUBLE)), ["shoulder.effort"], ["shoulder.position"])
    alone = np.sqrt(1.5 * GRAVITY * 0.3 / (0.05 + 1.5 * 0.3**2))
    np.testing.assert_allclose(np.abs(system.zeros), [alone, alone], rtol=1e-8)


@pytest.mark.parametrize("start", [0.3, 1.2, 2.9])
def test_trim_finds_the_equilibrium_near_the_state(start):
    """A pendulum with a torsional spring, m g l sin(q) = -k q: stable below; near the top the unstable one."""
    weight, stiffness = 1.0 * GRAVITY * 0.5, 1.0
    at = f"{-0.5 * np.sin(start)}, 0, {-0.5 * np.cos(start)}"
    text = filled(text_of("pendulum_on_a_spring.yaml"), at=at, angle=start, joint="", stiffness=stiffness)
    result = trim(paused(yaml_scene(text)))
    q = result.joints["pin"]
    assert abs(weight * np.sin(q) + stiffness * q) < 1e-9
    slope = weight * np.cos(q) + stiffness
    assert result.is_stable is (None if slope > 0.0 else False)
    assert abs(q - start) < 3.2


def test_a_governor_turns_steadily_at_the_height_of_its_speed():
    """A conical pendulum that is driven about the vertical: cos(theta) = g / (omega^2 l)."""
    omega, length = 6.0, 0.5
    text = filled(
        text_of("governor.yaml"),
        omega=omega,
        tilt=-np.arctan(0.75),
        wx=omega * np.sin(-np.arctan(0.75)) * -1.0,
        wz=omega * 0.8,
        length=length,
    )
    result = trim(paused(yaml_scene(text)), {"bearing": omega})
    assert abs(np.cos(result.joints["hinge"])) == pytest.approx(GRAVITY / (omega**2 * length), rel=1e-9)
    assert np.linalg.norm(result.twist[0, :3]) == pytest.approx(omega, rel=1e-12)


def test_redundant_inputs_hold_a_pose_by_the_smallest_sum_of_squares():
    """Both cranks of a parallelogram carry half each, and each may take the part of the other."""
    given = "stiffness: 2.0, damping: 0.6"
    turned = yaml_scene(PARALLELOGRAM.replace(given, "stiffness: 2.0, damping: 0.0, rest_angle: 0.4"))
    torque = -2.0 * 0.4
    result = trim(paused(turned), held=["a", "b", "c"], inputs=["a.effort", "b.effort"])
    sign = np.sign(result.inputs["a.effort"])
    assert result.inputs["a.effort"] == pytest.approx(0.5 * sign * abs(torque), rel=1e-9)
    assert result.inputs["b.effort"] == pytest.approx(result.inputs["a.effort"], rel=1e-9)
    assert set(result.undetermined) == {"a.effort", "b.effort"}
    assert result.system.inputs == ("a.effort", "b.effort")  # not that of joint c


def test_an_equilibrium_beyond_a_stop_is_none():
    text = filled(text_of("rod_on_stop.yaml"), upper=0.7)
    with pytest.raises(TrimError, match="is beyond a stop: hinge would be at 1.5708 rad"):
        trim(paused(yaml_scene(text)))


def test_no_equilibrium_is_said():
    falling = yaml_scene("name: f\ngravity: [0, 0, -9.81]\nbodies: [{name: b, mass: 1.0, inertia: [1, 1, 1]}]\n")
    with pytest.raises(TrimError, match="no equilibrium near the state"):
        trim(paused(falling))


@pytest.mark.parametrize("name", ["loops", "planar loops", "couplings"])
@pytest.mark.volume(1)
def test_inverse_dynamics_returns_the_efforts_of_a_motion(name):
    """Random efforts at the independent joints, the accelerations that they give, and back."""
    rng = np.random.default_rng(7)
    done = 0
    for seed in range(40):
        scene, _ = random_mechanisms.random_mechanism(name, seed)
        simulation = paused(scene)
        layout = simulation.layout
        probe = Probe(simulation)
        coordinates = Coordinates(probe)
        joints = coordinates.names
        if not joints or not set(joints) <= set(layout.unit_efforts) - set(layout.motions) or layout.switches:
            continue
        system = linearise(simulation, [f"{joint}.effort" for joint in joints], [])
        u = rng.normal(size=len(joints))
        wanted = system.slope[len(joints) :] + system.B[len(joints) :] @ u
        q, v = np.transpose([layout.coordinates.at(*simulation.state(), simulation.sample().angles)[j] for j in joints])
        found = inverse_dynamics(simulation, [0.0], [q], [v], [wanted], joints)
        assert found.efforts[0] == pytest.approx(u, rel=1e-7, abs=1e-8 * np.abs(u).max()) and found.residual[0] < 1e-7
        assert found.rates[0] == pytest.approx(v, rel=1e-9, abs=1e-9)
        done += 1
        if done == 2:
            break
    assert done


def test_types_of_joints_give_their_names_to_coordinates():
    assert linearise(paused(load_scene("heavy_top"))).states[:3] == ("pivot.rx", "pivot.ry", "pivot.rz")


def test_python_control_takes_the_system():
    """Feedback of the angle moves the poles as in the closed form: K + gain."""
    control = pytest.importorskip("control")
    text = DOUBLE.replace("name: elbow, type: revolute", "name: elbow, type: fixed")
    plant = linearise(paused(yaml_scene(text)), ["shoulder.effort"], ["shoulder.position"]).to_control()
    closed = control.feedback(plant, 100.0)
    inertia = 0.03 + 2.0 * 0.4**2 + 0.05 + 1.5 * 1.1**2
    stiffness = GRAVITY * (2.0 * 0.4 + 1.5 * 1.1) + 100.0
    assert np.abs(control.poles(closed)) == pytest.approx([np.sqrt(stiffness / inertia)] * 2, rel=1e-9)
    assert plant.input_labels == ["shoulder_effort"]


def test_files_have_the_system(tmp_path):
    import json

    system = linearise(paused(yaml_scene(PARALLELOGRAM)))
    for name in ("a.json", "a.npz", "a.mat"):
        system.save(tmp_path / name)
    read = json.loads((tmp_path / "a.json").read_text())
    assert np.array_equal(read["A"], system.A) and tuple(read["inputs"]) == system.inputs
    arrays = np.load(tmp_path / "a.npz")
    assert np.array_equal(arrays["B"], system.B) and tuple(arrays["outputs"]) == system.outputs
    matlab = scipy.io.loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert np.array_equal(matlab["C"], system.C) and list(matlab["states"]) == list(system.states)
    with pytest.raises(ValueError, match=r"must end in \.json"):
        system.save(tmp_path / "a.txt")


@pytest.mark.parametrize("inputs", [["shoulder.effort"], ["shoulder.effort", "elbow.effort"]])
@pytest.mark.parametrize("upper, moved", [(0.0, 0.0), (0.0, -1.0), (0.5, 0.0)])
def test_stops_carry_what_they_can(upper, moved, inputs):
    """Two level rods of 1 kg, 1.2 m long: at its stop the elbow is stiff; efforts are the weights by their arms.

    A wanted acceleration away from the stop gets nothing of it.
    """
    written = load_scene("double_pendulum").text
    elbow = "    parent_frame: {position: [0.6, 0.0, 0.0], axis: [0, 1, 0]}"
    scene = scene_from_text(written.replace(elbow, f"    limits: {{upper: {upper}, restitution: 0}}\n{elbow}"), "test")
    a = np.array([[0.0, moved]])
    found = inverse_dynamics(
        Simulation(scene, quiet=True), [0.0], np.zeros((1, 2)), np.zeros((1, 2)), a, ["shoulder", "elbow"], inputs
    )
    rests, both = upper == moved == 0.0, len(inputs) == 2
    inertia = 0.1201 + 0.36  # of the lower rod about the elbow, and about the shoulder where the elbow alone moves
    expected = -9.81 * 2.4 + moved * (inertia + 1.2 * 0.6), 0.0 if rests else -9.81 * 0.6 + moved * inertia
    if rests or both:
        assert found.residual.max() < 1e-10
        assert found.efforts[0] == pytest.approx(expected[: len(inputs)], abs=1e-9)
    else:
        assert found.residual.max() > 1.0


def test_a_derivative_sees_a_kink_between_its_outer_values():
    """A straight line up to there has differences of orders 2 and 4 that agree to the last bit."""
    h = 2.0**-7
    found, error = derivative(lambda s: np.array([min(s, 2.5 * h)]), h)
    assert found == 1.0 and error <= 1e-12
