# SPDX-License-Identifier: Apache-2.0
"""Impulses of short pushes late in a run, where floats of seconds lie far apart."""

from fractions import Fraction

import numpy as np
import pytest

from liegroup_core import Simulation
from liegroup_core.forces.instants import NEVER, StepGrid
from liegroup_core.scene.description import Body, ConstantWrench, Scene

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
