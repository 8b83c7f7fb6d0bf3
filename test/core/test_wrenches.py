# SPDX-License-Identifier: Apache-2.0
"""Applied wrenches: schedule, and momentum after a known impulse."""

from fractions import Fraction

import numpy as np
import pytest
from scene_files import text_of

from liegroup_core import Simulation, load_scene
from liegroup_core.forces.commands import WRENCH, Command
from liegroup_core.forces.instants import AFTER, NEVER, StepGrid
from liegroup_core.forces.schedule import Schedule
from liegroup_core.scene.description import Body, ConstantWrench, Scene
from liegroup_core.scene.load import scene_from_text

PUSH = (1.0, 0.0, 0.0, 0.0, 2.0, 0.0)
boundary = StepGrid(1e-3).boundary


def command(schedule, source, wrench, start, end=None):
    """Apply a wrench to body 0 from one step to another."""
    given = Command(WRENCH, "body", tuple(wrench), 0, None, source)
    end = AFTER if end is None else boundary(end)
    schedule.insert(given, (source, "", 0), (("body", 0, given.values),), boundary(start), end)


def totals(schedule, steps):
    history = []
    for step in range(steps):
        schedule.update(boundary(step))
        history.append(schedule.total["body"][0].copy())
    return np.array(history)


def test_a_wrench_acts_only_during_its_steps():
    schedule = Schedule(1)
    command(schedule, "a", PUSH, 2, 5)
    acts = totals(schedule, 8).any(axis=1)
    assert acts.tolist() == [False, False, True, True, True, False, False, False]


def test_a_source_replaces_its_wrench_and_sources_add():
    schedule = Schedule(1)
    command(schedule, "a", PUSH, 0)
    command(schedule, "b", PUSH, 1, 4)
    command(schedule, "a", 3 * np.array(PUSH), 2)
    assert totals(schedule, 6)[:, 0].tolist() == [1, 2, 4, 4, 3, 3]


def test_zero_ends_a_wrench_and_clear_ends_a_source():
    schedule = Schedule(1)
    command(schedule, "a", PUSH, 0)
    command(schedule, "a", np.zeros(6), 2)
    command(schedule, "b", PUSH, 0)
    command(schedule, "b", PUSH, 100)
    assert totals(schedule, 4)[:, 0].tolist() == [2, 2, 1, 1]
    schedule.clear("b", boundary(4))
    assert schedule.update(boundary(4)) == [(0, "body")]
    assert not schedule.total["body"].any() and schedule.next_change(4) == NEVER


def test_the_later_of_two_commands_for_one_step_applies():
    schedule = Schedule(1)
    command(schedule, "a", PUSH, 1)
    command(schedule, "a", 5 * np.array(PUSH), 1)
    assert totals(schedule, 2)[1, 0] == 5


@pytest.mark.parametrize("h", [1e-3, 1.0 / 3000.0, 0.7, 1e-9])
def test_an_instant_is_a_step_boundary_or_whole_nanoseconds(h):
    grid = StepGrid(h)
    for step in (0, 1, 7, 10**6 + 1):
        start = grid.boundary(step)
        assert grid.instant(round(start.time * 1e9) * 1e-9).step == step
        assert grid.instant(step * h) == (step, 0, step * h)
    assert grid.instant(1e300).step == NEVER
    inside = grid.instant(5.4321e-5)
    assert inside == grid.instant(inside.time)  # a recorded time gives the same instant
    if h > 5.4321e-5:
        assert (inside.step, inside.time) == (0, 5.4321e-5)
        assert grid.between(grid.boundary(0), inside) == 5.4321e-5
        assert grid.boundary(0) < inside < grid.boundary(1)


@pytest.mark.parametrize("group", ["se3", "so3xr3"])
@pytest.mark.parametrize("steps_at_once", [1, 7, 1000])
def test_a_known_wrench_gives_the_closed_form_momentum(group, steps_at_once):
    """Body at rest, torque and force along one principal axis, for 250 steps of 1 ms.

    Then L = tau t and p = f t for ever after: the axis does not turn, so body and world axes agree
    on it. Rounding: 250 additions to sums of at most 2.5e-1 and 7.5e-1, each eps/2 relative, and
    the four stage weights of a step, each once more: below 8 * 250 eps * 0.75 = 4e-13.
    """
    simulation = Simulation(load_scene("free_body"), method="rkmk4", step=1e-3, group=group)
    pose, twist = simulation.state()
    simulation.set_state(pose, 0.0 * twist)
    simulation.apply_wrench("body", (0, 0, 1.0, 0, 0, 3.0), start=0.1, duration=0.25)
    for _ in range(1000 // steps_at_once):
        simulation.advance(steps_at_once)
    simulation.advance(1000 - simulation.steps)
    momentum = simulation.sample().spatial_momentum
    assert np.abs(momentum - [0, 0, 0.25, 0, 0, 0.75]).max() <= 4e-13
    (given,) = simulation.drain_applied()
    assert (given.start_ns, given.end_ns, given.source) == (100_000_000, 350_000_000, "api")


@pytest.mark.parametrize("group", ["se3", "so3xr3"])
def test_a_force_in_world_axes_keeps_its_direction_on_a_spinning_body(group):
    """Impulse F t in world axes, for a body that rotates by 10 rad in that time.

    Seen from the body the momentum, at most 2 N s, rotates by w h = 0.02 in every step: RKMK4 has
    an error of (w h)^5 / 120 of its size there, over 800 steps 4.3e-8 N s.
    """
    simulation = Simulation(load_scene("free_body"), method="rkmk4", step=1e-3, group=group)
    spin, force = 20.0, 4.0
    simulation.set_state(np.array([[1.0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]]), [[0, 0, spin, 0, 0, 0]])
    simulation.apply_wrench("body", (0, 0, 0, force, 0, 0), 1e-4, 0.5, axes="world")
    simulation.advance(800)
    change = simulation.sample().spatial_momentum[3:]
    assert np.abs(change - [0.5 * force, 0.0, 0.0]).max() <= 800 * 2.0 * 0.02**5 / 120
    wrench = (0, 0, 0, force, 0, 0)
    assert simulation.drain_applied() == [Command(WRENCH, "body", wrench, 100_000, 500_100_000, "api", "world")]


def test_wrenches_in_world_and_body_axes_of_two_sources_add():
    """A quarter turn about z: the torque about x of the world is one about -y of the body."""
    simulation = Simulation(load_scene("free_body"), method="rkmk4", step=1e-9)
    quarter = [[0.0, -1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0]]
    simulation.set_state(np.array(quarter), np.zeros((1, 6)))
    simulation.apply_wrench("body", (1, 0, 0, 0, 2, 0), source="world", axes="world")
    simulation.apply_wrench("body", (0, 0, 3, 0, 0, 0), source="body")
    assert (simulation.input_count, simulation.wrench_sources) == (2, {"world", "body"})
    simulation.advance(1)
    assert simulation.drain_applied() == [
        Command(WRENCH, "body", (1, 0, 0, 0, 2, 0), 0, None, "world", "world"),
        Command(WRENCH, "body", (0, 0, 3, 0, 0, 0), 0, None, "body"),
    ]
    momentum = simulation.sample().spatial_momentum
    assert np.abs(momentum / 1e-9 - (1, 0, 3, 0, 2, 0)).max() < 1e-12
    with pytest.raises(ValueError, match="axes must be 'body' or 'world', got 'top'"):
        simulation.apply_wrench("body", PUSH, axes="top")


@pytest.mark.parametrize("wrench", [(1, 2, 3), (np.nan, 0, 0, 0, 0, 0), (0, 0, 0, np.inf, 0, 0)])
def test_an_invalid_wrench_is_refused_and_changes_nothing(wrench):
    simulation = Simulation(load_scene("free_body"), method="rkmk4")
    with pytest.raises(ValueError, match="six finite numbers"):
        simulation.apply_wrench("body", wrench)
    with pytest.raises(ValueError, match="unknown body 'nobody'; choose one of: body"):
        simulation.apply_wrench("nobody", PUSH)
    with pytest.raises(ValueError, match="duration must be positive"):
        simulation.apply_wrench("body", PUSH, duration=0.0)
    simulation.advance(1)
    assert simulation.drain_applied() == []


@pytest.mark.parametrize("axes", ["body", "world"])
def test_a_source_has_one_wrench_whatever_its_point(axes):
    """Torque p x R^T F about the origin of the body frame; a new one of the source ends the pairs."""
    simulation = Simulation(load_scene("free_body"), method="rkmk4", step=1e-9)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    point, force = np.array([0.2, -0.5, 0.7]), np.array([3.0, -1.0, 2.0])
    simulation.set_state(np.array([[*quarter.ravel(), 0, 0, 0]]), np.zeros((1, 6)))
    simulation.apply_wrench("body", [0, 0, 0, *force], axes=axes, point=point)
    simulation.advance(1)
    turned = quarter @ point
    pushed = force if axes == "world" else quarter @ force
    expected = [*np.cross(turned, pushed), *pushed]
    assert np.abs(simulation.sample().spatial_momentum / 1e-9 - expected).max() < 1e-6
    assert [(c.axes, c.point) for c in simulation.drain_applied()] == [(axes, tuple(point.tolist()))]
    simulation.apply_wrench("body", [0, 0, 0, 0, 0, 5.0], axes="world")
    simulation.advance(1)
    (acting,) = simulation.inputs.commands.acting
    assert acting.values == (0, 0, 0, 0, 0, 5.0) and acting.point is None
    assert simulation.sample().accelerations["body"][:3] == pytest.approx(0.0, abs=1e-7)


def test_a_snapshot_and_an_accuracy_keep_forces_at_points():
    """The companion of the error estimate has them too: the estimate stays small."""
    run = Simulation(load_scene("heavy_top"), accuracy=1e-6, horizon=1.0)
    run.apply_wrench("top", [0, 0, 0, 8.0, 0, 0], 0.05, 0.3, axes="world", point=[0, 0.1, 0.2])
    run.advance(20)
    kept = run.snapshot()
    run.advance(60)
    after, error = [part.tobytes() for part in run.state()], run.sample().errors[:, :2].max()
    run.restore(kept)
    run.advance(60)
    assert [part.tobytes() for part in run.state()] == after
    assert 0.0 < error < 1e-6


@pytest.mark.parametrize(
    "wrench, point, axes, text",
    [
        (PUSH, (1, 2), "world", "three finite numbers, got"),
        (PUSH, (1, 2, np.nan), "body", "three finite numbers"),
        ((0, 0, 0, 1e60, 0, 0), (1e60, 0, 0), "world", "point times force .* 1e\\+120 is too large"),
        (PUSH, (1, 2, 3), "world_x", "axes must be"),
    ],
)
def test_an_invalid_point_is_refused_and_changes_nothing(wrench, point, axes, text):
    simulation = Simulation(load_scene("free_body"), method="rkmk4")
    with pytest.raises(ValueError, match=text):
        simulation.apply_wrench("body", wrench, axes=axes, point=point)
    assert simulation.input_count == 0


def test_a_command_for_the_past_acts_from_now_to_its_stated_end(caplog):
    """Given at 0.5 s, within a step of 0.2 s: 3 N from 0.2 s for 0.5 s act for 0.2 s; for 0.25 s they are over."""
    scene = scene_from_text("name: one\ngravity: [0, 0, 0]\nbodies: [{name: b, mass: 2, inertia: [1, 1, 1]}]\n")
    simulation = Simulation(scene, "rkmk4", 0.2)
    simulation.advance_to(0.5)
    for duration in (0.5, 0.25):
        simulation.apply_wrench("b", [0, 0, 0, 3, 0, 0], 0.2, duration, source=str(duration))
    simulation.advance_to(1.1)
    # Each of five parts of steps rounds a velocity of at most 0.3 m/s a few times.
    assert simulation.sample().twist[0, 3] == pytest.approx(3.0 * 0.2 / 2.0, abs=1e-15)
    assert [(c.start_ns, c.end_ns) for c in simulation.drain_applied()] == [(500_000_000, 700_000_000)]
    late = [record.getMessage() for record in caplog.records if "for t = 0.2 s" in record.getMessage()]
    assert late == ["command to b for t = 0.2 s at 0.5 s: it acts from then to its end"]


BY_SCENE = text_of("pushed.yaml")


def test_a_wrench_of_the_scene_is_no_command_of_users():
    """It adds to theirs, nobody ends it, and it acts at its times wherever a run starts; also inside of steps."""
    simulation = Simulation(scene_from_text(BY_SCENE), "rkmk4", 1e-3, estimate=False)
    simulation.apply_wrench("body", [0, 0, 0, 1, 0, 0], start=0.02, duration=0.01, source="scene")
    simulation.advance(12)
    for source in ("scene", "api"):
        simulation.clear_wrenches(source)
    assert simulation.input_count == 0 and not simulation.wrench_sources and not simulation.inputs.has_wrenches
    assert [command.kind for command in simulation.drain_applied()] == ["wrench", "clear"]
    assert simulation.sample().external_wrenches[0].tolist() == [0, 0, 0, 3, 0, 0]
    assert simulation.sample().power == pytest.approx(3 * 3 / 2 * 0.0015, rel=1e-12)
    middle = simulation.snapshot()
    assert not middle.parts["inputs"]["commands"].acting
    simulation.advance(28)
    after = simulation.sample()
    assert after.twist[0, 3] == pytest.approx(3 / 2 * 0.021, rel=1e-12)
    assert after.power == 0.0 and not after.external_wrenches.any()
    simulation.restore(middle)
    simulation.advance(28)
    assert simulation.sample().twist.tobytes() == after.twist.tobytes()
    simulation.set_state(*simulation.state(), steps=30)
    simulation.advance(5)
    assert simulation.sample().twist[0, 3] == pytest.approx(3 / 2 * 0.0225, rel=1e-12)


# Impulses of short pushes late in a run, where floats of seconds lie far apart.


US = Fraction(1, 10**6)
EPS = np.finfo(float).eps
# A push at rest has the velocity F d / m after some parts of a step, each the weighted sum of the four stages
# of rkmk4 (weights, sum and product: 8 roundings) or the 13 of rkmk853. Its duration is rounded once a part.
# 3 parts or fewer: below 3 * 30 eps / 2.
IMPULSE = 45 * EPS


def scene(*forces):
    body = Body(name="b", mass=1.0, inertia=(1.0, 1.0, 1.0))
    return Scene(name="s", gravity=(0, 0, 0), bodies=[body], forces=list(forces))


def pushed(simulation, start, force):
    """Velocities of the simulation and of its companion after a push of 1 us."""
    begin_before(simulation, start)
    simulation.apply_wrench("b", (0, 0, 0, force, 0, 0), start=start, duration=1e-6)
    simulation.advance(48)
    return velocities(simulation, start)


def begin_before(simulation, time):
    """Set the state to a step, shortly before a time, at which the companion starts."""
    simulation.set_state(*simulation.state(), int(time / simulation.step) // 24 * 24)


def velocities(simulation, time):
    both = simulation, simulation._running.companion
    assert all(engine.time > time for engine in both)
    return [engine.state()[1][0, 3] for engine in both]


@pytest.mark.parametrize(
    "start", [100000, Fraction("100000.0000003"), Fraction("100049.9999995"), Fraction("99999.9999995"), 500123]
)
def test_a_push_of_one_microsecond_has_its_impulse_at_any_time(start):
    """At the start of a step of 100 s, inside one, and over its end; the companions take longer steps.

    At t = 1e5 s floats of seconds lie 1.5e-11 s apart, 1.5e-5 of the push.
    """
    for options in ({"accuracy": 1e-4, "horizon": 1e6}, {"method": "rkmk4"}, {"method": "rkmk8"}):
        simulation = Simulation(scene(), step=100.0, **options)
        for velocity in pushed(simulation, float(start), 1e6):
            assert abs(velocity - 1.0) <= IMPULSE


def test_floats_are_the_same_as_exact_times_and_these_resolve_nanoseconds_at_any_time():
    """At t = 1e8 s floats of seconds lie 15 ns apart."""
    start = 10**8 + Fraction("50.000000123")
    simulation = Simulation(scene(), "rkmk4", 100.0)
    velocity, companion = pushed(simulation, start, 1e6)
    assert max(abs(velocity - 1.0), abs(companion - 1.0)) <= IMPULSE
    changes = simulation.drain_applied()
    assert [(c.start_ns, c.end_ns) for c in changes] == [(start * 10**9, (start + US) * 10**9)]
    again = Simulation(scene(), "rkmk4", 100.0)
    begin_before(again, start)
    for change in changes:
        change.repeat(again)
    again.advance(48)
    assert again.state()[1].tobytes() == simulation.state()[1].tobytes()


@pytest.mark.parametrize("start, end", [(1e5, 100000.000001), (100049.9999995, 100050.0000005)])
@pytest.mark.parametrize("step", [100.0, 1e-3])
def test_a_wrench_of_the_scene_has_the_impulse_between_its_decimal_times(start, end, step):
    push = ConstantWrench(name="push", body="b", force=(1e6, 0, 0), start=start, end=end)
    for options in ({"accuracy": 1e-4, "horizon": 1e6}, {"method": "rkmk4"}):
        simulation = Simulation(scene(push), step=step, **options)
        begin_before(simulation, start)
        simulation.advance(48)
        for velocity in velocities(simulation, start):
            assert abs(velocity - 1.0) <= IMPULSE


@pytest.mark.parametrize("h", [1e-3, 4e-3, 4.0 / 3.0 * 1e-3, 6.0 / 5.0 * 1e-3, 1.0 / 240.0, 100.0])
def test_parts_of_steps_add_up_to_exact_durations(h):
    """From any instant to the next: the parts of both steps and the whole steps between, against fractions."""
    exact = Fraction(round(h * 12e6), 12 * 10**6)  # each of these steps is a multiple of 1 s / 12e6
    grid = StepGrid(h)
    for begin in (Fraction("100000.000000001"), Fraction("1234567.123456789"), 10**9 + 17 * US):
        first = grid.instant(begin)
        last = grid.after(first, 1e-6)
        assert grid.time_ns(last) - grid.time_ns(first) == 1000 and first < last
        assert first.step == begin // exact and last.step == (begin + US) // exact
        # The float of the offset, rounded once.
        offset = grid.between(grid.boundary(first.step), first)
        assert offset == float(begin - first.step * exact)
    assert grid.instant(1e300).step == grid.after(first, 1e300).step == NEVER
