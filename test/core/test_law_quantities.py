# SPDX-License-Identifier: Apache-2.0
"""Laws that read sensors and lead servos, against SciPy and the reference, and laws whose numbers do not exist."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import cases, text_of
from scipy.integrate import solve_ivp

from liegroup_core import SceneError, Simulation, SimulationError
from liegroup_core.linear import linearise
from liegroup_core.reference import integrate
from liegroup_core.scene.load import scene_from_text

# Centres of mass away from the body frames, and sensors in frames of their own.
ARM = text_of("arm_law_inputs.yaml")
COUNTS = {"tracker": 13, "imu": 7, "wire": 2, "laser": 2, "coder": 1}


def arm(period="", noise="", resolution=""):
    # Numbers of sensors have two names.
    parts = {"imu": "qx qy qz qw wx wy wz", "wire": "distance rate", "coder": "position"}
    names = {name: dict(enumerate(text.split())) for name, text in parts.items()}
    inputs = ", ".join(
        f"{name}{k}: {name}.{names.get(name, {}).get(k, k)}" for name, count in COUNTS.items() for k in range(count)
    )
    signals = ", ".join(f"s_{name}{k}: {name}{k}" for name, count in COUNTS.items() for k in range(count))
    text = ARM.replace("NOISE", noise).replace("jointRESOLUTION: elbow", f"joint: elbow{resolution}")
    text = text.replace("PERIOD", f"{period}signals: {{{signals}}}")
    return scene_from_text(text.replace("INPUTS", inputs), "test")


def read(sample):
    """{SENSOR.k: number} as the law has read them, and as the sensors measure."""
    own = {name: sample.signals[f"own.s_{name.replace('.', '')}"] for name in measured(sample)}
    return own, measured(sample)


def measured(sample):
    return {f"{name}.{k}": sample.sensors[name][k] for name, count in COUNTS.items() for k in range(count)}


def test_a_law_reads_what_sensors_measure():
    """Sensors measure by NumPy from the poses of the body frames: to a few roundings of numbers near 1."""
    simulation = Simulation(arm(), accuracy=1e-8, quiet=True)
    start = simulation.state()
    for time in (0.0, 0.31, 1.0):
        simulation.advance_to(time)
        own, known = read(simulation.sample())
        assert len(own) == 25
        assert_allclose(list(own.values()), list(known.values()), rtol=0, atol=1e-14)
    found, _ = integrate(arm(), *start, np.array([1.0]))
    assert_allclose(simulation.sample().pose[:, 9:], found.position[0], rtol=0, atol=1e-7)


def test_a_sampled_law_reads_noise_and_resolution_as_they_are_recorded():
    """At its instants, in both runs of an estimate, and in the reference integration."""
    settings = "period: 0.05\n  ", ", position_noise: 0.03, seed: 4", ", resolution: 0.01"
    scene = arm(*settings)
    simulation, still = Simulation(scene, accuracy=1e-8, quiet=True), Simulation(arm(*settings[:1]), quiet=True)
    start = simulation.state()
    for k in range(20):
        simulation.advance_to(0.05 * k)
        own, known = read(simulation.sample())
        assert_allclose(list(own.values()), list(known.values()), rtol=0, atol=1e-14)
    assert simulation.largest_error < 1e-8
    still.advance_to(0.95)
    noise = np.abs(simulation.sample().pose - still.sample().pose).max()
    found, _ = integrate(scene, *start, np.array([0.95]))
    assert np.abs(simulation.sample().pose[:, 9:] - found.position[0]).max() < 1e-7 < 1e-4 < noise


@pytest.mark.parametrize("inputs, period, reason", cases("what_a_law_cannot_read_is_refused_in_one_line"))
def test_what_a_law_cannot_read_is_refused_in_one_line(inputs, period, reason):
    text = ARM.replace("NOISE", ", position_noise: 0.1")
    text = text.replace("jointRESOLUTION: elbow", "joint: elbow, resolution: 0.1")
    text = text[: text.index("forces:")]
    text += f"forces:\n- {{name: own, type: law, {period}inputs: {inputs}, signals: {{a: 1}}}}\n"
    if reason is None:
        scene_from_text(text, "test")
        return
    with pytest.raises(SceneError) as refused:
        scene_from_text(text, "test")
    assert reason in str(refused.value) and "\n" not in str(refused.value)


PENDULUM = scene_from_text(text_of("pendulum_laws.yaml"), "test")
INERTIA, WEIGHT = 0.05 + 0.8 * 0.25, 0.8 * 9.81 * 0.5
HOLD = {"type": "servo", "name": "hold", "joint": "hinge", "stiffness": 9, "damping": 0.8, "velocity": 0.1}


def pendulum(*forces):
    return PENDULUM.remade(forces=list(forces))


def leading(outputs, **keys):
    inputs = {"q": "hinge.position", "w": "hinge.velocity"}
    return {"type": "law", "name": "lead", "inputs": inputs, "outputs": [{"servo": "hold", **outputs}]} | keys


# {case: (law, effort limit, (target position, target velocity)(t, q, w))}
LED = {
    "both": (leading({"position": "0.4*sin(2*t) + 0.2*q", "velocity": "0.8*cos(2*t)"}), None,
             lambda t, q, w: (0.4 * np.sin(2 * t) + 0.2 * q, 0.8 * np.cos(2 * t))),
    "position, limited": (leading({"position": "0.8*sin(3*t) - 0.1*w"}), 2.5,
                          lambda t, q, w: (0.8 * np.sin(3 * t) - 0.1 * w, 0.1)),
    "velocity": (leading({"velocity": "tanh(t)*q"}), None, lambda t, q, w: (0.0, np.tanh(t) * q)),
}  # fmt: skip


@pytest.mark.parametrize("case", LED)
def test_a_servo_that_a_law_leads_moves_as_scipy_says(case):
    """To 1e-9: both are run a hundred times more exactly. Kinks of a limit cost SciPy's solver no more than 1e-11."""
    law, limit, targets = LED[case]

    def slope(t, y):
        position, velocity = targets(t, *y)
        effort = 9 * (position - y[0]) + 0.8 * (velocity - y[1])
        return [y[1], (np.clip(effort, -(limit or np.inf), limit) - WEIGHT * np.sin(y[0])) / INERTIA]

    known = solve_ivp(slope, (0, 2), [0.7, 0.0], "DOP853", rtol=1e-12, atol=1e-13, max_step=0.01).y[:, -1]
    scene = pendulum(HOLD | ({"effort_limit": limit} if limit else {}), law)
    simulation = Simulation(scene, accuracy=1e-11, quiet=True)
    start = simulation.state()
    simulation.advance_to(2.0)
    sample = simulation.sample()
    assert_allclose(sample.joint_coordinates["hinge"], known, rtol=0, atol=1e-9)
    position, velocity = targets(2.0, *sample.joint_coordinates["hinge"])
    q, w = sample.joint_coordinates["hinge"]
    effort = np.clip(9 * (position - q) + 0.8 * (velocity - w), -(limit or np.inf), limit)
    assert sample.force_efforts["hold"] == pytest.approx(effort, abs=1e-12)
    assert sample.power == pytest.approx(effort * w, abs=1e-12)
    exact, _ = integrate(scene, *start, np.array([2.0]))
    turn = exact.rotation[0, 0].T @ sample.pose[0, :9].reshape(3, 3)
    assert np.abs(turn - np.eye(3)).max() < 1e-9


def test_a_sampled_law_leads_a_servo():
    """The target is constant from instant to instant, and a command to the servo is refused."""
    law = leading({"position": "0.5*sin(2*t) - 0.3*q"}, period=0.05)
    simulation = Simulation(pendulum(HOLD, law), accuracy=1e-10, quiet=True)
    y = np.array([0.7, 0.0])
    for k in range(20):
        target = 0.5 * np.sin(2 * 0.05 * k) - 0.3 * y[0]

        def slope(t, y, target=target):
            return [y[1], (9 * (target - y[0]) + 0.8 * (0.1 - y[1]) - WEIGHT * np.sin(y[0])) / INERTIA]

        y = solve_ivp(slope, (0, 0.05), y, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    simulation.advance_to(1.0)
    assert_allclose(simulation.sample().joint_coordinates["hinge"], y, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="the target of the servo of hinge is an output of the law lead"):
        simulation.command_servo("hinge", 0.1)


def test_linear_systems_have_the_derivatives_of_targets():
    simulation = Simulation(pendulum(HOLD, leading({"position": "2*q", "velocity": "3*q"})), quiet=True)
    found = linearise(simulation)
    row = [(9 * (2 - 1) + 0.8 * 3 - WEIGHT * math.cos(0.7)) / INERTIA, -0.8 / INERTIA]
    assert_allclose(found.A, [[0, 1], row], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "forces, reason",
    [
        ([HOLD, leading({})], "position or velocity is missing"),
        ([HOLD, leading({"position": 1, "effort": 1})], "give either joint and effort"),
        ([HOLD, leading({"position": 1, "point": [0, 0, 0]})], "give either joint and effort"),
        ([leading({"position": 1})], "servo 'hold' is not a servo; the scene has no servo"),
        ([HOLD, leading({"position": 1}), leading({"velocity": 1}) | {"name": "two"}], "'hold' is not a servo"),
        ([HOLD, leading({}) | {"outputs": [{"servo": "hold", "position": 1}] * 2}], "two of its outputs are for"),
    ],
)
def test_a_wrong_target_is_refused_in_one_line(forces, reason):
    with pytest.raises(SceneError) as refused:
        pendulum(*forces)
    assert reason in str(refused.value) and "\n" not in str(refused.value)


def test_a_law_whose_number_does_not_exist_is_named():
    """The root of cos(q) - 0.5 does not exist from an angle of pi/3 on, which the pendulum passes at a known time."""
    inputs = {"q": "hinge.position"}
    fine = {"type": "law", "name": "fine", "inputs": inputs, "outputs": [{"joint": "hinge", "effort": "4"}]}
    signals = {"twice": "2*q", "root": "sqrt(cos(twice/2) - 0.5)", "after": "root + 1"}
    own = {"type": "law", "name": "own", "inputs": inputs, "signals": signals}
    own["outputs"] = [{"body": "bob", "force": [0, 0, 0], "torque": [0, "0.001*after", 0]}]
    slope = lambda t, y: [y[1], (4 - WEIGHT * np.sin(y[0])) / INERTIA]  # noqa: E731
    passes = lambda t, y: y[0] - np.pi / 3  # noqa: E731
    known = solve_ivp(slope, (0, 2), [0.7, 0.0], rtol=1e-10, atol=1e-12, events=passes).t_events[0][0]
    for settings in ({"accuracy": 1e-6}, {"method": "rkmk4", "step": 1e-3}, {"method": "radau5", "step": 0.01}):
        simulation = Simulation(pendulum(fine, own), quiet=True, **settings)
        with pytest.raises(SimulationError) as stopped:
            simulation.advance_to(2.0)
        text = str(stopped.value)
        assert "the law own gives outputs[0].torque[1] = nan at t = " in text and "\n" not in text
        assert text.endswith("because its signal root is not finite: change its formula")
        time = float(text.split("at t = ")[2].split()[0])
        assert known - 1e-3 <= time <= known + 0.011, settings  # the torque of the law is 1e-4 of the weight


def test_a_sampled_law_and_a_state_whose_numbers_do_not_exist_are_named():
    """At its first instant after 0.5 s, and where a rate grows without bound."""
    sampled = {"type": "law", "name": "own", "period": 0.1, "delay": 0.3, "states": {"n": {"update": "n + 1"}}}
    sampled["outputs"] = [{"joint": "hinge", "effort": "log(5.5 - n)"}]
    simulation = Simulation(pendulum(sampled), quiet=True)
    with pytest.raises(SimulationError) as stopped:
        simulation.advance_to(2.0)
    assert str(stopped.value) == (
        "stopped at t = 0.6 s: the law own gives outputs[0].effort = nan at t = 0.6 s: change its formula"
    )
    grows = {"type": "law", "name": "own", "states": {"x": {"start": 1.0, "rate": "exp(x**3)/(1 - t)"}}}
    simulation = Simulation(pendulum(grows), "rkmk4", 0.01, quiet=True)
    with pytest.raises(SimulationError, match=r"the law own gives states.x.rate = inf at t = 0\.\d+ s"):
        simulation.advance_to(2.0)
