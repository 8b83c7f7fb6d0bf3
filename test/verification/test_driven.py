# SPDX-License-Identifier: Apache-2.0
"""Driven joints: their motion, the motion of the rest, and the efforts that they require.

Independent: reference integration (liegroup_core/reference), closed forms, and the energy balance.
Accelerations and reactions of random mechanisms with driven joints: test_relative_accelerations.py,
test_reactions.py.
"""

import numpy as np
import pytest
from convergence import order_by_count
from given import reference_inputs
from scene_files import cases, filled, text_of
from scipy.interpolate import PchipInterpolator, make_interp_spline

from liegroup_core import SceneError, Simulation, load_scene
from liegroup_core.engine import Engine
from liegroup_core.joints.motion import at, through
from liegroup_core.reference import integrate
from liegroup_core.scene.load import scene_from_text

pytestmark = pytest.mark.slow
G = 9.81
END = 1.5

PIVOT = text_of("pivot.yaml")
ARM = text_of("arm_driven.yaml")


def driven(scene, joint, **keys):
    """Scene with a driven joint."""
    return scene.remade(joints=[j.remade(driven=True, **keys) if j.name == joint else j for j in scene.joints])


def difference(simulation, exact, k):
    """Largest difference of rotation matrices and positions, m, to a Trajectory at its time k."""
    sample = simulation.sample()
    return max(
        np.abs(sample.pose[:, :9].reshape(-1, 3, 3) - exact.rotation[k]).max(),
        np.abs(sample.pose[:, 9:] - exact.position[k]).max(),
    )


ORDERS = cases("driven_orders")


@pytest.fixture(scope="module", params=[PIVOT, ARM], ids=["pivot", "arm"])
def moved(request):
    """(scene, its reference Trajectory at END)."""
    scene = scene_from_text(request.param)
    exact, uncertainty = integrate(scene, *Engine(scene, quiet=True).state(), [0.0, END])
    assert max(part.max() for part in uncertainty) < 1e-11
    return scene, exact


@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.volume(5)
def test_methods_keep_their_order(moved, method):
    """Slope over three steps, against a reference whose motions share only the polynomials.

    Steps that divide the knots of the motions, and steps that do not: END / step need not be whole,
    so that the step is 1.5 s / n. The slopes are those of smooth problems within a quarter.
    """
    scene, exact = moved
    order, step = ORDERS[method]
    errors, counts = [], [round(END / step * factor) for factor in (1.0, 1.3, 1.7)]
    for n in counts:
        simulation = Engine(scene, method, END / n, quiet=True)
        simulation.advance(n)
        errors.append(difference(simulation, exact, 1))
    assert order - 0.4 < order_by_count(counts, errors) < order + 0.8, errors


@pytest.mark.parametrize("options", [{}, {"space": "space"}], ids=["plane", "space"])
@pytest.mark.parametrize("name", ["slider_crank", "four_bar"])
@pytest.mark.volume(2)
def test_crank_at_constant_rate(name, options):
    """The crank turns at its initial rate; the effort's work and that of other forces is the energy.

    Samples at 640 Hz, their spline of degree 7 integrated: motions of up to 10 rad/s have an error of
    (10 / 640)^8, below round-off of the sum.
    """
    scene = load_scene(name)
    joint = next(j.name for j in scene.joints if j.parent == "world" and j.type == "revolute")
    scene = driven(scene, joint)
    engine = Engine(scene, "rkmk8", 1.0 / 2560, stabilisation="projection", quiet=True, **options)
    exact, uncertainty = integrate(scene, *engine.state(), [0.0, 1.0])
    samples = [engine.sample()]
    for _ in range(640):
        engine.advance(4)
        samples.append(engine.sample())
    q, v = samples[0].joint_coordinates[joint]
    assert samples[-1].prescribed[joint] == (q + v, v, 0.0)
    assert abs(samples[-1].joint_coordinates[joint][0] - (q + v)) < 1e-13 * (1.0 + abs(q + v))
    unknown = max(part.max() for part in uncertainty)
    assert difference(engine, exact, 1) < 1e-10 + unknown
    times, power = [s.time for s in samples], [s.power for s in samples]
    work = make_interp_spline(times, power, k=7).integrate(0.0, 1.0)
    size = np.trapezoid(np.abs(power), times) if hasattr(np, "trapezoid") else np.trapz(np.abs(power), times)
    assert size > 0.0
    assert abs(samples[-1].energy - samples[0].energy - work) < 1e-9 * size


def test_two_links_against_the_textbook():
    """Efforts of a planar arm: Spong, Robot Modeling and Control, (7.87), at all samples of a motion."""
    m1, m2, l1, c1, c2, I1, I2 = 2.0, 1.5, 0.6, 0.25, 0.2, 0.05, 0.03
    scene = scene_from_text(
        filled(text_of("two_links_driven.yaml"), g=G, m1=m1, i1=I1, c1=c1, m2=m2, i2=I2, c2=c2, l1=l1)
    )
    engine = Engine(scene, "rkmk4", 0.01, stabilisation="projection", quiet=True)
    for _ in range(101):
        sample = engine.sample()
        (q1, v1, a1), (q2, v2, a2) = sample.prescribed.values()
        h = m2 * l1 * c2 * np.sin(q2)
        H12 = I2 + m2 * (c2**2 + l1 * c2 * np.cos(q2))
        H22 = I2 + m2 * c2**2
        H11 = I1 + m1 * c1**2 + I2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * np.cos(q2))
        g2 = m2 * c2 * G * np.cos(q1 + q2)
        g1 = (m1 * c1 + m2 * l1) * G * np.cos(q1) + g2
        one = H11 * a1 + H12 * a2 - h * v2 * (v2 + 2 * v1) + g1
        two = H12 * a1 + H22 * a2 + h * v1**2 + g2
        # Rates after projection are the prescribed ones to round-off.
        size = 1.0 + H11 * abs(a1) + H12 * abs(a2) + m2 * (v1**2 + v2**2) + g1
        assert abs(sample.drive_efforts["a"] - one) < 1e-13 * size
        assert abs(sample.drive_efforts["b"] - two) < 1e-13 * size
        engine.advance()


def test_motions_meet_twice_differentiably():
    """Position, rate and acceleration at every point, and those that are given there."""
    times = [0.0, 0.3, 1.0, 1.4]
    start = (0.2, -1.0, 4.0)
    for given in (
        ([1.0, 2.0, 0.5],),
        ([1.0, 2.0, 0.5], [0.3, 0.0, -2.0]),
        ([1.0, 2.0, 0.5], [0.3, 0.0, -2.0], [1.0, 2.0, 0.0]),
    ):
        rows = through(start, times, *given)
        assert at(rows[0], 0.0) == pytest.approx(start, abs=1e-15)
        for i, (before, after) in enumerate(zip(rows, rows[1:])):
            assert at(before, after[0]) == pytest.approx(at(after, after[0]), abs=1e-11)
            for part, values in zip(at(after, after[0]), given):
                assert part == pytest.approx(values[i], abs=1e-11)


def commanded(simulation, upto=None):
    """Take 150 steps of 10 ms with commands at a step, inside one, and one that replaces another."""
    changes = []
    plan = {
        20: lambda: simulation.command_motion("slide", [0.2, 0.5], [0.1, 0.3]),
        40: lambda: simulation.command_motion("slide", [0.3], [-0.2], [0.1], start=0.4567),
        60: lambda: simulation.command_motion("slide", [0.4], [0.0], [0.0], [0.0], start=0.7),
    }
    for k in range(150 if upto is None else upto):
        if k in plan:
            plan[k]()
        simulation.advance()
        changes += simulation.drain_applied()
    return changes


def test_commanded_motions_against_the_reference():
    """A command acts from its time, inside a step too; its motion continues the one before."""
    scene = scene_from_text(PIVOT)
    simulation = Simulation(scene, "rkmk8", 0.01, stabilisation="projection")
    start = simulation.state()
    changes = commanded(simulation)
    assert len(changes) >= 5
    for before, after in zip(changes, changes[1:]):
        assert at(before.values, after.start) == pytest.approx(at(after.values, after.start), abs=1e-9)
    exact, _ = integrate(scene, *start, [0.0, 1.5], reference_inputs(simulation.layout, changes))
    assert difference(simulation, exact, 1) < 1e-10
    estimate = simulation.sample().errors.max()
    assert estimate < 1e-8


def test_a_monotone_motion_stays_between_its_points():
    """Velocities of PCHIP up to 1.25 of the lower slope; positions at 200 times of each interval, by quintics.

    Sums of six terms up to a few hundred: 1e-12 is their round-off, relative to the largest position.
    """
    random = np.random.default_rng(5)
    for _ in range(60):
        count = random.integers(3, 9)
        times = np.append(0.0, np.cumsum(random.uniform(0.1, 2.0, count)))
        steps = random.choice([0.0, 0.0, 1.0, -1.0, 1e-3, 40.0], count + 1) * random.uniform(0.5, 1.0, count + 1)
        q = np.cumsum(steps)
        rows = through((q[0], 0.0, 0.0), times, q[1:], monotone=True)
        slopes = np.abs(np.diff(q) / np.diff(times))
        found = PchipInterpolator(times, q).derivative()(times)[1:-1]
        limited = np.minimum(np.abs(found), 1.25 * np.minimum(slopes[1:], slopes[:-1])) * np.sign(found)
        assert rows[1:-1, 2] == pytest.approx(limited, rel=1e-12)
        for k, row in enumerate(rows[:-1]):
            path = np.array([at(row, time)[0] for time in np.linspace(times[k], times[k + 1], 200)])
            rounding = 1e-12 * (1.0 + np.abs(q).max())
            assert (np.diff(path) * np.sign(q[k + 1] - q[k]) > -rounding).all()
            assert abs(path - q[k]).max() <= abs(q[k + 1] - q[k]) + rounding
            assert at(row, times[k + 1]) == pytest.approx(at(rows[k + 1], times[k + 1]), rel=1e-9, abs=1e-9)


def test_what_cannot_be_driven_is_refused():
    with pytest.raises(SceneError, match="ball.*spherical joint cannot be driven"):
        scene_from_text(PIVOT.replace("type: spherical", "type: spherical, driven: true"))
    scene = driven(
        driven(load_scene("four_bar"), *(j.name for j in load_scene("four_bar").joints[:1])),
        load_scene("four_bar").joints[1].name,
    )
    with pytest.raises(SceneError, match="cannot be driven, because the other joints"):
        Simulation(scene)
    with pytest.raises(ValueError, match="has driven joints"):
        Simulation(scene_from_text(PIVOT), "rkmk4", 0.01, group="se3")


def test_wrong_commands_are_refused_and_change_nothing():
    simulation = Simulation(scene_from_text(PIVOT), "rkmk4", 0.01)
    for arguments, words in (
        (("ball", [1.0], [0.0]), "not driven"),
        (("slide", [0.0], [0.0]), "positive"),
        (("slide", [1.0, 0.5], [0.0, 0.0]), "increase"),
        (("slide", [1.0], [0.0, 1.0]), "1 finite"),
        (("slide", [1.0], [np.nan]), "finite"),
        (("slide", [1.0], [0.0], None, [0.0]), "require velocities"),
        (("slide", [1.0], [0.0], [0.0], [1.0]), "last one must be 0"),
        (("slide", [1.0], [0.0], None, None, np.inf), "finite"),
    ):
        with pytest.raises(ValueError, match=words):
            simulation.command_motion(*arguments)
    assert simulation.input_count == 0


GEARS = text_of("gears_driven.yaml")


def test_the_effort_of_a_driven_joint_also_moves_what_is_coupled_to_it():
    """At the start, at rest: the static torque of j, and half of that of k, and their inertias."""
    engine = Engine(scene_from_text(GEARS), "rkmk4", 0.01, stabilisation="projection", quiet=True)
    for _ in range(150):
        sample = engine.sample()
        q, v, a = sample.prescribed["j"]
        one = (0.1 + 0.09) * a - G * 0.3 * np.cos(q)
        r, phase = np.hypot(0.2, 0.1), np.arctan2(0.1, 0.2)
        other = (0.2 + 2 * r**2) * 0.5 * a - 2 * G * r * np.cos(0.5 * q - phase)
        assert abs(sample.drive_efforts["j"] - (one + 0.5 * other)) < 1e-12 * (1.0 + abs(a))
        assert abs(sample.reactions["j"][2] - one) < 1e-12 * (1.0 + abs(a))
        engine.advance()


@pytest.mark.parametrize("method", [None, "rkmk8"])
def test_a_state_that_is_set_leaves_other_motions_as_they_are(method):
    """Shoulder: the rest of its trajectory. Elbow, which is moved: on at its new velocity."""
    settings = {"method": method, "step": 0.01, "stabilisation": "projection"} if method else {}
    simulation = Simulation(load_scene("driven_arm"), **settings)
    simulation.advance(20)
    simulation.command_motion("shoulder", [0.5, 1.0], [0.4, 0.6])
    simulation.advance(20)
    simulation.place(joints={"elbow": (0.5, 2.0)})
    simulation.advance(10)
    found = simulation.sample().joint_coordinates
    time = 10 * simulation.step
    assert found["elbow"] == pytest.approx((0.5 + 2.0 * time, 2.0), abs=1e-12)
    simulation.advance(round(2.0 / simulation.step))
    assert simulation.sample().joint_coordinates["shoulder"] == pytest.approx((0.6, 0.0), abs=1e-12)
    other = Simulation(load_scene("driven_arm"), **settings)
    other.advance(20)
    other.place(joints={"elbow": (0.5, None)})
    other.advance(round(3.0 / other.step))
    assert other.sample().joint_coordinates["shoulder"] == pytest.approx((0.2, 0.0), abs=1e-12)


def test_the_first_mode_is_that_of_the_motion_at_the_start():
    """A stage that rests and then accelerates within the first step: its load sticks until then."""
    scene = scene_from_text(text_of("stage_driven.yaml"), source="t")
    simulation = Simulation(scene, "rkmk4", 0.01)
    assert simulation.modes == {"slide": "stick"}
    simulation.advance(1)
    assert simulation.event_count == 2  # it slides and sticks again
