# SPDX-License-Identifier: Apache-2.0
"""Sampled laws: exact discrete-time solutions, states at instants, error estimates, and what they refuse."""

import copy
from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import cases, filled, text_of
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from liegroup_core import SceneError, Simulation
from liegroup_core.identification import Log, Measured, compare
from liegroup_core.linear import linearise, sensitivities, trim
from liegroup_core.reference import integrate
from liegroup_core.scene.load import scene_from_text

MASS, STIFFNESS, DAMPING, REST = 1.3, 7.0, 0.4, 0.6
CART = filled(text_of("cart_sampled_laws.yaml"), mass=MASS, stiffness=STIFFNESS, damping=DAMPING, rest=REST)
INSTANTS = [("0.02", "0"), ("0.02", "0.04"), ("0.02", "0.05"), ("0.015", "0.0213"), ("0.007", "0.1")]
SETTINGS = [
    {"accuracy": 1e-10},
    {"method": "rkmk8", "step": 1e-3},
    {"method": "radau5", "step": 5e-3, "rtol": 1e-11, "atol": 1e-11},
]
END = "1.237"


def cart(period, delay):
    return scene_from_text(CART.replace("PERIOD", period).replace("DELAY", delay), "test")


def changes(period, delay, end):
    """[(time, 0: outputs of instant k start, or 1: instant k, k)] up to a time, in order; Fractions of s."""
    period, delay = Fraction(period), Fraction(delay)
    count = int(end / period) + 1
    found = [(k * period, 1, k) for k in range(count)]
    if delay:
        found += [(k * period + delay, 0, k) for k in range(count)]
    return sorted(each for each in found if each[0] <= end)


def exact(period, delay, end=END):
    """(position, velocity, i, effort) of the cart, by matrix exponentials from instant to instant."""
    A = np.array([[0, 1, 0], [-STIFFNESS / MASS, -DAMPING / MASS, 1 / MASS], [0, 0, 0]])
    y, i, acting, waiting, now, end = np.array([-REST, 0.0]), 0.001, 0.0, {}, Fraction(0), Fraction(end)
    for time, is_instant, k in [*changes(period, delay, end), (end, None, None)]:
        y = (expm(A * float(time - now)) @ [*y, acting])[:2]
        now = time
        if is_instant:
            e = 0.3 - (y[0] + REST) + 0.01 * float(time)
            waiting[k] = 40 * e + 20 * i - 3 * y[1]
            i += 0.02 * e
        if is_instant == 0 or is_instant and Fraction(delay) == 0:
            acting = waiting.pop(k)
    return y[0] + REST, y[1], i, acting


@pytest.mark.parametrize("period, delay", INSTANTS)
@pytest.mark.parametrize("settings", SETTINGS, ids=lambda each: each.get("method", "accuracy"))
def test_a_sampled_controller_with_delay_has_the_exact_discrete_motion(period, delay, settings):
    """To 1e-12 of motion and integral, and of the effort, which is 40 times as large: a few hundred roundings."""
    simulation = Simulation(cart(period, delay), quiet=True, **settings)
    simulation.advance_to(float(END))
    sample, known = simulation.sample(), exact(period, delay)
    found = *sample.joint_coordinates["rail"], sample.signals["pid.i"], sample.law_efforts["rail"]
    assert_allclose(np.divide(found, (1, 1, 1, 40)), np.divide(known, (1, 1, 1, 40)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("period, delay", INSTANTS)
@pytest.mark.volume(2)
def test_the_reference_integration_has_the_exact_discrete_motion(period, delay):
    scene = cart(period, delay)
    found, uncertainty = integrate(scene, *Simulation(scene, quiet=True).state(), np.array([0.3, float(END)]))
    known = exact(period, delay)
    assert_allclose((found.position[-1, 0, 0], found.twist[-1, 0, 3]), known[:2], rtol=0, atol=1e-12)
    assert uncertainty.position.max() < 1e-12


def test_methods_keep_their_order_with_a_sampled_law():
    """Fitted slopes of the error; a change within a step that was missed would leave order 1."""
    known = exact("0.02", "0.05")[:2]
    for method, order, steps in (
        ("rkmk2", 2, [1 / 100, 1 / 200, 1 / 400]),
        ("rkmk4", 4, [1 / 100, 1 / 200, 1 / 400]),
        ("generalized_alpha", 2, [1 / 200, 1 / 400, 1 / 800]),
        ("constrained_rattle", 2, [1 / 200, 1 / 400, 1 / 800]),
    ):
        errors = []
        for step in steps:
            simulation = Simulation(cart("0.02", "0.05"), method, step, quiet=True, estimate=False)
            simulation.advance_to(float(END))
            errors.append(np.abs(np.subtract(simulation.sample().joint_coordinates["rail"], known)).max())
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert order - 0.4 <= slope <= order + 1.2, (method, errors)


def test_a_sample_at_an_instant_shows_what_was_computed_there():
    """Also where the run stands within a step, and whatever was read before."""
    for settings in ({"accuracy": 1e-9}, {"method": "rkmk4", "step": 3e-3}):
        simulation = Simulation(cart("0.02", "0.025"), quiet=True, **settings)
        assert simulation.sample().signals["pid.e"] == 0.3
        for time in (0.02, 0.04, 0.045, 0.06):
            before = simulation.sample(time - 1e-9)
            simulation.advance_to(time)
            sample = simulation.sample()
            q = sample.joint_coordinates["rail"][0]
            if time == 0.045:  # the outputs of 0.02 s start
                assert sample.signals["pid.e"] == before.signals["pid.e"]
                assert sample.law_efforts["rail"] == simulation.sample(time + 1e-9).law_efforts["rail"]
                assert sample.law_efforts["rail"] != before.law_efforts["rail"]
            else:
                assert sample.signals["pid.e"] == pytest.approx(0.3 - q + 0.01 * time, abs=1e-15)
                assert sample.signals["pid.e"] != before.signals["pid.e"]
                assert sample.law_efforts["rail"] == before.law_efforts["rail"]


def test_what_a_law_holds_is_part_of_snapshots_branches_and_states_that_are_set():
    scene = cart("0.02", "0.05")
    simulation = Simulation(scene, accuracy=1e-6, quiet=True)
    simulation.advance_to(0.62)  # an instant
    restored, branch = Simulation(scene, accuracy=1e-6, quiet=True), copy.deepcopy(simulation)
    restored.restore(simulation.snapshot())
    first = simulation.sample()
    for run in (simulation, restored, branch):
        run.advance_to(1.13)
    ends = [run.sample() for run in (simulation, restored, branch)]
    assert {end.angles.tobytes() + end.pose.tobytes() for end in ends} == {
        ends[0].angles.tobytes() + ends[0].pose.tobytes()
    }
    fixed = Simulation(scene, "rkmk8", 1e-3, quiet=True)
    pose, twist = simulation.layout.offsets.to_centres(first.pose, first.twist)
    fixed.set_state(pose, twist, 620, angles=first.angles)
    assert fixed.sample().angles.tolist() == first.angles.tolist()
    fixed.advance_to(1.13)
    # Both continue the same motion, to the accuracy of the first one.
    assert_allclose(fixed.sample().angles, ends[0].angles, rtol=0, atol=1e-4)
    held = fixed.sample().angles.tolist()
    fixed.place(joints={"rail": (0.1, 0.0)})
    assert fixed.sample().angles.tolist() == held


PENDULUM = scene_from_text(text_of("pendulum_laws.yaml"), "test")
INERTIA, WEIGHT = 0.05 + 0.8 * 0.25, 0.8 * 9.81 * 0.5


def swing(period, delay, times):
    """Angles of the pendulum under a sampled PD, by SciPy from instant to instant."""
    found, y, acting, waiting, now = [], np.array([0.7, 0.0]), 0.0, {}, 0.0
    stops = changes(period, delay, Fraction(repr(times[-1])))
    for time, is_instant, k in sorted([*stops, *((Fraction(repr(t)), 2, None) for t in times)]):
        if float(time) > now:
            slope = lambda t, y, u=acting: [y[1], (u - WEIGHT * np.sin(y[0])) / INERTIA]  # noqa: E731
            y = solve_ivp(slope, (now, float(time)), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
            now = float(time)
        if is_instant == 2:
            found.append(y[0])
            continue
        if is_instant:
            waiting[k] = 6 * (0.5 * np.sin(2 * now) - y[0]) - 0.4 * y[1]
        if is_instant == 0 or Fraction(delay) == 0:
            acting = waiting.pop(k)
    return np.array(found)


@pytest.mark.parametrize("period, delay", [("0.05", "0.02"), ("0.02", "0")])
def test_estimated_errors_are_at_least_half_of_the_true_ones(period, delay):
    """Steps as long as the period, or that do not divide it: the companion is compared with other parts of steps."""
    law = {
        "type": "law",
        "name": "pd",
        "period": float(period),
        "delay": float(delay),
        "inputs": {"q": "hinge.position", "w": "hinge.velocity"},
        "outputs": [{"joint": "hinge", "effort": "6*(0.5*sin(2*t) - q) - 0.4*w"}],
    }
    scene, times = PENDULUM.remade(forces=[law]), np.arange(1, 11) * 0.4
    known = swing(period, delay, times.tolist())
    for settings in (
        {"method": "rkmk2", "step": 0.02},
        {"method": "rkmk4", "step": 0.02},
        {"method": "generalized_alpha", "step": 0.02},
        {"method": "rkmk54", "step": 0.05, "rtol": 1e-4, "atol": 1e-4},
        {"accuracy": 1e-3},
    ):
        simulation = Simulation(scene, quiet=True, **settings)
        for time, angle in zip(times.tolist(), known):
            simulation.advance_to(time)
            error = abs(simulation.sample().joint_coordinates["hinge"][0] - angle)
            assert simulation.largest_error >= 0.5 * error - 1e-12, (settings, time)


def test_a_sampled_law_is_a_controller_in_python():
    """The same efforts at the same times, which enter the mechanics as wrenches: equal to round-off of 100 instants."""
    scene = cart("0.02", "0")
    bare = scene.remade(forces=scene.forces[:1])
    simulation, other = (Simulation(each, "rkmk4", 1e-3, quiet=True) for each in (scene, bare))
    state = {"i": 0.001}

    def pid(run):
        q, w = run.sample().joint_coordinates["rail"]
        e = 0.3 - q + 0.01 * run.time
        run.apply_effort("rail", 40 * e + 20 * state["i"] - 3 * w)
        state["i"] += 0.02 * e

    other.control(pid, 0.02)
    for run in (simulation, other):
        run.advance_to(2.0)
    ends = [run.sample().joint_coordinates["rail"] for run in (simulation, other)]
    assert_allclose(*ends, rtol=0, atol=1e-12)


def test_laws_of_several_periods_read_each_other_in_order():
    """At an instant of two laws the second one reads what the first one has computed there."""
    laws = [
        {"type": "law", "name": "count", "period": 0.01, "states": {"n": {"update": "n + 1"}}, "signals": {"m": "n"}},
        {"type": "law", "name": "smooth", "inputs": {"m": "count.m"}, "signals": {"twice": "2*m"}},
        {
            "type": "law",
            "name": "slow",
            "period": 0.03,
            "inputs": {"n": "count.n", "twice": "smooth.twice"},
            "signals": {"sum": "n + twice + 1000*t"},
        },
    ]
    simulation = Simulation(PENDULUM.remade(forces=laws), "rkmk4", 4e-3, quiet=True)
    simulation.advance_to(0.07)
    signals = simulation.sample().signals
    assert signals == {"count.n": 8, "count.m": 7, "smooth.twice": 14, "slow.sum": 7 + 2 * 6 + 60}


@pytest.mark.parametrize("change, reason", cases("a_wrong_sampled_law_is_refused_in_one_line"))
def test_a_wrong_sampled_law_is_refused_in_one_line(change, reason):
    law = {"type": "law", "name": "own", "inputs": {"q": "hinge.position"}, "signals": {"e": "q"}} | change
    with pytest.raises(SceneError) as refused:
        PENDULUM.remade(forces=[law])
    assert reason in str(refused.value) and "\n" not in str(refused.value)


def test_what_needs_derivatives_refuses_a_sampled_law():
    scene, reason = cart("0.02", "0"), "the law pid has a period: "
    simulation = Simulation(scene, quiet=True)
    times = np.linspace(0.0, 1.0, 101)
    log = Log((), (Measured("log", times, ("rail.position",), np.sin(times)[:, None], np.array([1e-3]), 0.0),))
    for ask in (
        lambda: linearise(simulation),
        lambda: trim(simulation),
        lambda: sensitivities(scene, ["pid.parameters.kp"], [1.0], ["rail.position"]),
        lambda: compare(scene, log, workers=1),
    ):
        with pytest.raises(SceneError, match=reason):
            ask()


def test_dry_friction_gives_way_at_the_instant_of_a_larger_effort():
    """A wheel of inertia 0.2 that friction of 1 N m holds: efforts of 0.9 and then 3 N m, later 0.5, in closed form."""
    text = text_of("wheel_sampled_laws.yaml")
    scene = scene_from_text(text.replace("EFFORT", "0.9 if t < 0.39 else (3 if t < 0.65 else 0.5)"), "test")
    # Efforts start 0.1 s after the instants 0.39 s and 0.65 s.
    starts, stops = 30 * 0.013 + 0.1, 50 * 0.013 + 0.1
    speed = (3 - 1) / 0.2 * (stops - starts)
    rest = stops + speed * 0.2 / (1 - 0.5)
    angle = 0.5 * speed * (rest - starts)
    for settings in ({"accuracy": 1e-9}, {"method": "rkmk4", "step": 4e-3}, {"method": "radau5", "step": 0.01}):
        simulation = Simulation(scene, quiet=True, **settings)
        simulation.advance_to(starts)
        assert tuple(simulation.sample().joint_coordinates["axle"]) == (0.0, 0.0)
        simulation.advance_to(stops)
        q, w = simulation.sample().joint_coordinates["axle"]
        assert (q, w) == pytest.approx((0.5 * speed * (stops - starts), speed), abs=1e-9), settings
        simulation.advance_to(rest + 0.5)
        q, w = simulation.sample().joint_coordinates["axle"]
        assert (q, w) == pytest.approx((angle, 0.0), abs=1e-8), settings
