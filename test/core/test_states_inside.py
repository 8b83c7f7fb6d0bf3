# SPDX-License-Identifier: Apache-2.0
"""States at any time: inside a step of a method, and inside the longer substeps of a run to an accuracy."""

import numpy as np
import pytest
import yaml
from convergence import fitted_order
from scene_files import cases, text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.methods.munthe_kaas.ahead import further_stages, polynomials
from liegroup_core.methods.munthe_kaas.collocation import stage_polynomials
from liegroup_core.methods.table import METHODS
from liegroup_core.scene.load import scene_from_text

PUSH = (0.0, 0.0, 0.0, 1.0, 0.0, 1.0)
TIGHT = {"accuracy": 1e-12, "horizon": 10.0}


def apart(one, other):
    return np.abs(one.pose - other.pose).max()


def test_the_polynomials_integrate_all_powers_up_to_their_order():
    """sum b_j(theta) c_j^k = theta^(k+1) / (k+1) for k < 7: exact but for rounding of the coefficients, below 1e3."""
    _, further = further_stages()
    tableau = METHODS["rkmk853"].tableau
    nodes = np.concatenate([tableau.c, [1.0], further])
    for theta in (0.1, 0.37, 0.5, 0.93, 1.0):
        weights = polynomials() @ theta ** np.arange(1, 8)
        for k in range(7):
            assert weights @ nodes**k == pytest.approx(theta ** (k + 1) / (k + 1), abs=1e-12)


def error_inside(scene, h, times, truth):
    """Largest error at times inside substeps of size h."""
    simulation = Simulation(scene, accuracy=1.0, horizon=10.0, step=1.0, quiet=True)
    control = simulation._integrator._control
    control.part_of("rtol", "atol")[:], control.longest[0], control.size[0] = 1e6, h, h
    simulation._choice._begun = True  # without a search for the first tolerance
    return max(map(apart, simulation.samples(times), truth))


@pytest.mark.parametrize("name", ["heavy_top", "double_pendulum", "slider_crank"])
def test_states_inside_a_substep_have_at_least_order_seven(name):
    """Against a run to 1e-12, at ten times that lie inside the substeps of all sizes."""
    scene = load_scene(name)
    times = np.sort(0.05 + 0.6 * np.random.default_rng(5).random(10))
    fine = Simulation(scene, step=1.0, quiet=True, **TIGHT)
    truth = list(fine.samples(times))
    sizes = np.array([0.06, 0.04, 0.03, 0.02]) if name != "slider_crank" else np.array([0.02, 0.015, 0.01, 0.0075])
    errors = [error_inside(scene, h, times, truth) for h in sizes]
    assert fitted_order(sizes, errors) > 6.5, errors


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.volume(8)
def test_states_inside_a_step_have_the_order_of_the_method(method):
    """A part of a step is a step. Fitted slope of the largest error at eleven times between steps."""
    name = "lagrangian_top" if METHODS[method].family == "rotation" else "double_pendulum"
    scene, order = load_scene(name), METHODS[method].order
    times = 0.3 + 0.0317 * np.arange(11)
    fine = Simulation(scene, step=0.01, quiet=True, **TIGHT)
    truth = list(fine.samples(times))
    options = {"rtol": 1e3, "atol": 1e3} if METHODS[method].controlled else {}
    sizes = np.array([0.02, 0.0125, 0.01]) if order > 3 else np.array([4e-3, 2e-3, 1e-3])
    if METHODS[method].family == "rotation":  # the top spins fast
        sizes = 0.2 * sizes
    errors = []
    for h in sizes:
        samples = Simulation(scene, method, h, quiet=True, estimate=False, **options).samples(times)
        errors.append(max(map(apart, samples, truth)))
    # Above order 5 the error at these steps is near round-off.
    assert fitted_order(sizes, errors) > 0.85 * min(order, 5), errors


def pushed(name, ask, **options):
    """(simulation after 120 steps with two pushes, samples at random times between)."""
    simulation = Simulation(load_scene(name), quiet=True, **options)
    rng, body, found = np.random.default_rng(2), simulation.layout.body_names[-1], []
    simulation.apply_wrench(body, PUSH, 3.33 * simulation.step, 2.111 * simulation.step)
    simulation.drain_instants()
    for k in range(120):
        if ask:
            step = simulation.step
            found += [simulation.sample((simulation.steps + part) * step) for part in np.sort(rng.random(2))]
        simulation.advance(1)
        if k == 70:
            simulation.apply_wrench(body, PUSH, None, 0.5)
    return simulation, found


@pytest.mark.parametrize("name, accuracy", cases("errors_between_steps_are_covered"))
@pytest.mark.volume(4)
def test_errors_between_steps_are_covered_by_their_estimate_and_loops_stay_closed(name, accuracy):
    """Of all states 5 % may have an error above the estimate, as between two runs whose errors are equal by chance.

    If the substeps of the two were equal after an event, the error would be 1e5 times the estimate.
    """
    simulation, samples = pushed(name, True, accuracy=accuracy)
    size = simulation.promise["length"]
    fine = Simulation(simulation.scene, quiet=True, step=simulation.step, accuracy=1e-12)
    body, energies, ratios = fine.layout.body_names[-1], [], []
    fine.apply_wrench(body, PUSH, 3.33 * fine.step, 2.111 * fine.step)
    for sample in samples:
        while fine.steps < sample.steps:
            fine.advance(1)
            if fine.steps == 71:
                fine.apply_wrench(body, PUSH, None, 0.5)
        true = fine.sample(sample.time)
        error = np.linalg.norm(sample.pose[:, 9:] - true.pose[:, 9:], axis=1)
        ratios.append(error.max() / max(sample.errors[:, 0].max(), 1e-11 * size))
        assert error.max() < accuracy * size and sample.constraint_residual < 1e-12
        energies.append(abs(sample.energy - true.energy) / (1.0 + abs(true.energy)))
    assert max(energies) < accuracy
    assert np.mean(np.array(ratios) > 1.0) <= 0.05 and max(ratios) < 10.0


@pytest.mark.parametrize("name, most", [("door", 0.1), ("stick_slip", 0.25)])
def test_stops_and_friction_limit_substeps_only_at_their_events(name, most):
    """Attempted substeps in 10 s, as a part of the steps; and modes and times of the events are those to 1e-12."""
    run, fine = (Simulation(load_scene(name), accuracy=accuracy, step=0.01, quiet=True) for accuracy in (1e-4, 1e-12))
    for simulation in (run, fine):
        simulation.advance(1000)
    events, exact = run.drain_events(), fine.drain_events()
    assert run.substeps[1] < most * run.steps and len(exact) >= 3
    assert [(event.joint, event.kind) for event in events] == [(event.joint, event.kind) for event in exact]
    assert [event.time for event in events] == pytest.approx([event.time for event in exact], abs=1e-5)
    assert np.abs(run.sample().switching - fine.sample().switching).max() < 1e-4


@pytest.mark.parametrize("name", ["four_bar", "gripper", "stick_slip", "driven_arm", "cable", "heavy_top"])
@pytest.mark.volume(3)
def test_states_and_errors_are_the_same_one_by_one_together_and_backwards(name):
    """At 700 Hz, between steps of 10 ms; a wrench that is given after a state changes those that follow."""
    times = np.arange(1, 350) / 700.0

    def read(kind, push):
        simulation, found = Simulation(load_scene(name), step=0.01, quiet=True), []
        body = simulation.layout.body_names[-1]
        if kind == "backwards":
            for step in range(50):
                inside = times[(times >= step * 0.01) & (times < (step + 1) * 0.01)]
                found += [simulation.sample(time) for time in inside[::-1].tolist()][::-1]
                simulation.advance(1)
        elif kind == "together":
            for k, sample in enumerate(simulation.samples(times)):
                found.append(sample)
                if k % 100 == 99 and push:
                    simulation.apply_wrench(body, PUSH, None, 0.0123)
        else:
            for k, time in enumerate(times):
                simulation.advance_to(time)
                found.append(simulation.sample(time))
                if k % 100 == 99 and push:
                    simulation.apply_wrench(body, PUSH, None, 0.0123)
        arrays = ("pose", "twist", "errors", "angles")
        return [(s.time_ns, s.modes, *(getattr(s, name).tobytes() for name in arrays)) for s in found]

    for push in (False, True):
        expected = read("one by one", push)
        for kind in ("together",) if push else ("together", "backwards"):
            for one, other in zip(expected, read(kind, push), strict=True):
                assert one == other, (kind, push, one[0])


STIFF_STOP = text_of("stiff_stop.yaml")


def test_a_restored_run_with_both_methods_has_the_same_snapshots():
    one, other = (
        Simulation(scene_from_text(STIFF_STOP), accuracy=1e-4, horizon=2.0, step=0.01, quiet=True) for _ in range(2)
    )
    methods = set()
    for _ in range(20):
        one.advance(5)
        other.restore(one.snapshot())
        for simulation in (one, other):
            simulation.advance(5)
        methods.add(one.method)
        assert one.snapshot() == other.snapshot(), one.time
    assert methods == {"rkmk853", "radau5"}


def test_only_times_from_the_present_one_on_can_be_had():
    simulation = Simulation(load_scene("heavy_top"), step=0.01, quiet=True)
    simulation.advance_to(0.0567)
    assert simulation.steps == 5
    sample = simulation.sample(0.0567)
    assert (sample.time_ns, sample.steps) == (56_700_000, 5) and simulation.sample(0.0723).time == 0.0723
    assert simulation.time == 0.0567
    for time in (0.0566, np.nan, np.inf, "now", None):
        if time is None:
            continue
        with pytest.raises(ValueError):
            simulation.sample(time)
    with pytest.raises(ValueError, match="before the present"):
        simulation.advance_to(0.01)
    for times in ([0.06, 0.057], [0.06, np.nan], np.ones((2, 2)), ["now"]):
        with pytest.raises(ValueError, match="times must be finite numbers in one row that do not decrease"):
            simulation.samples(times)
    with pytest.raises(ValueError, match=r"9.2e\+09 at most, got 10000000000.0"):
        simulation.samples([0.06, 1e10])


def test_reactions_snapshots_and_places_are_those_of_the_time_reached():
    one, other = (Simulation(load_scene("double_pendulum"), step=0.1, quiet=True) for _ in range(2))
    one.advance_to(2.0777)
    assert (one.reaction_array() == one.sample().reaction_array).all()
    other.restore(one.snapshot())
    assert other.time == one.time == 2.0777
    for each in (one, other):
        each.apply_wrench("lower", PUSH, None, 0.1)
        each.advance(10)
    assert one.snapshot() == other.snapshot()
    other.advance_to(3.1777)
    one.advance_to(3.2)
    other.place(joints={"shoulder": (one.sample().joint_coordinates["shoulder"][0], None)})
    assert (other.time, other.steps) == (one.time, one.steps)  # the end of the step
    assert np.abs(other.sample().pose - one.sample().pose).max() < 1e-12


def test_the_error_between_the_first_steps_is_estimated_or_unknown():
    """To an accuracy the companion starts with the first state, with a method they meet after four steps."""
    to_accuracy, fine = (Simulation(load_scene("heavy_top"), step=0.1, accuracy=a, quiet=True) for a in (1e-2, 1e-12))
    for time in (0.05, 0.09, 0.15):
        to_accuracy.advance_to(time)
        fine.advance_to(time)
        one, true = to_accuracy.sample(), fine.sample()
        error = np.linalg.norm(one.pose[:, 9:] - true.pose[:, 9:], axis=1).max()
        assert 0.0 < 0.2 * error < one.errors[:, 0].max() < 1e-2
    given = Simulation(load_scene("heavy_top"), "rkmk4", 0.01, quiet=True)
    assert (given.sample().errors == 0.0).all()
    unknown = [np.isnan(sample.errors).all() for sample in given.samples([0.005, 0.01, 0.015, 0.035, 0.04, 0.045])]
    assert unknown == [True] * 4 + [False] * 2


def test_a_repeated_run_with_servos_may_know_later_commands():
    """The trial of another method sees what acts, and not what follows."""
    text = yaml.safe_load(load_scene("four_bar").text)
    servo = {"name": "servo", "type": "servo", "joint": "ground_crank", "stiffness": 300.0, "damping": 10.0}
    scene = scene_from_text(yaml.safe_dump(text | {"forces": [servo]}))
    first, other = (Simulation(scene, quiet=True, step=2e-3) for _ in range(2))
    rng, given, poses = np.random.default_rng(3), [], []
    for k in range(400):
        if rng.random() < 0.9:
            first.inputs.set_target("ground_crank", 1.0 + 0.001 * k, 0.5, None, 0.5)
        first.advance(1)
        given += [(k, command) for command in first.drain_applied()]
        assert np.isfinite(first.largest_error)
        poses.append(first.sample().pose.tobytes())
    for k in range(0, 400, 10):
        while given and given[0][0] < k + 10:
            given.pop(0)[1].repeat(other)
        other.advance(10)
        assert other.sample().pose.tobytes() == poses[k + 9]


def test_the_collocation_polynomial_passes_through_the_stages():
    nodes = METHODS["radau5"].tableau.c
    weights = stage_polynomials(nodes) @ nodes[None] ** np.arange(1, 4)[:, None]
    assert weights == pytest.approx(np.eye(3), abs=1e-13)


@pytest.mark.parametrize("name", ["four_bar", "gripper", "heavy_top"])
def test_commands_between_states_begin_where_the_caller_is(name):
    """At 900 Hz from the start on: a state, then a wrench without a start; and the same with starts, most unread."""

    def driven(reads):
        simulation, found = Simulation(load_scene(name), step=0.01, quiet=True), []
        body = simulation.layout.body_names[-1]
        for k in range(1, 180):
            time = k / 900.0
            simulation.advance_to(time)
            if reads:
                assert simulation.time == pytest.approx(time, abs=1e-9)
                assert simulation.sample().time == simulation.sample(time).time == pytest.approx(time, abs=1e-9)
            if k % 7 == 0:
                sample = simulation.sample()
                found.append((k, *(getattr(sample, each).tobytes() for each in ("pose", "twist", "errors"))))
            wrench = (0, 0, 0, 0, np.sin(k), 0)
            simulation.apply_wrench(body, wrench, None if reads else round(time * 1e9) * 1e-9, 0.05)
        simulation.advance(3)
        return simulation, found

    (one, read), (other, few) = driven(True), driven(False)
    assert read == few
    assert one.snapshot() == other.snapshot() and one.drain_applied() == other.drain_applied()
    one.restore(other.snapshot())
    assert one.time == other.time
