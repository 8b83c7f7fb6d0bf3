# SPDX-License-Identifier: Apache-2.0
"""Which joints hold to round-off without stabilisation, and which drift.

On SE(3) a lower pair to ground moves in a subgroup, and a Munthe-Kaas step along its algebra stays
there, whatever the step: the index 1 equations are enough. On SO(3) x R^3 that subgroup is none of
the direct product's wherever turning moves the centre of mass or along the axis: ball, hinge,
sleeve and screw open, at the method's order, while slider, plate and weld stay closed. Between
two moving bodies, and for joints that are no subgroups, joints open at the method's order on both.
"""

import engine
import mechanisms
import numpy as np
import pytest
from convergence import order_of

from liegroup_core import Simulation, SimulationError
from liegroup_core.joints import LOWER_PAIRS
from liegroup_core.methods.table import METHODS

WRENCH = (0.3, -0.2, 0.1, 0.5, 1.0, -0.7)
SEEDS = (1, 3, 4)


def opening(kind, group, step, seed, method, steps=1000):
    """(largest residual of a pair to ground during a run, the same relative to its round-off bound).

    Random frames, body and start; gravity, and a wrench over the first second.
    Bound: a rate that a joint forbids is rounded to some ten eps of those it allows, and nobody
    sees that without stabilisation: an acceleration that is off by 2e-14 adds up to 1e-14 t^2; a
    tilt counts over the distance moved. Measured: up to 0.4 of it, for six seeds. On SO(3) x R^3
    nothing clears the velocities of what the solve has rounded, 2^-53 g times the condition of
    S = J M^-1 J^T, 12 to 99 here; measured: up to 0.5 of that, for nine seeds.
    returns (residual / distance moved, residual / bound), the largest each
    """
    scene = mechanisms.mechanism(np.random.default_rng([seed, 7]), [("world", "a", kind)], springs=0)
    simulation = Simulation(scene, method=method, step=step, group=group)
    rate = 1e-14
    if group == "so3xr3":
        J = engine.rows(simulation)[0]
        rate = 0.5 * 2.0**-53 * 9.81 * np.linalg.cond(J @ np.linalg.solve(engine.masses(scene), J.T))
    simulation.apply_wrench("a", WRENCH, duration=1.0)
    start = simulation.sample().positions["a"]
    moved, of_moved, of_bound = 1.0, 0.0, 0.0
    for _ in range(50):
        try:
            simulation.advance(steps // 50)
        except SimulationError:  # Euler's method winds the body up: until then it was kept
            break
        sample = simulation.sample()
        moved = max(moved, np.linalg.norm(sample.positions["a"] - start))
        of_moved = max(of_moved, sample.constraint_residual / moved)
        of_bound = max(of_bound, sample.constraint_residual / (moved * rate * (1.0 + sample.time**2)))
    return of_moved, of_bound


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.family != "rotation"])
@pytest.mark.parametrize("kind", LOWER_PAIRS)
@pytest.mark.volume(10)
def test_every_lower_pair_to_ground_holds_on_se3(kind, method):
    """Also with methods that enforce joints themselves, on their own group.

    1000 steps, whatever steps of up to 0.05 s do to the motion itself.
    """
    for step in (0.05, 0.01, 0.002):
        for seed in SEEDS:
            of_moved, of_bound = opening(kind, "auto", step, seed, method)
            assert of_bound <= 1.0
            assert of_moved <= 1e-11  # the largest is 4e-12, after a fall of 11 km


@pytest.mark.parametrize("kind", LOWER_PAIRS)
def test_on_so3xr3_only_pairs_that_decouple_rotation_and_translation_hold(kind):
    """Those that keep no point of the child: without rotation, or with all shifts across its axis."""
    turns, shifts = np.hsplit(mechanisms.directions(kind), 2)
    across = np.cross(turns[0], np.eye(3)) if len(turns) else turns
    rank = np.linalg.matrix_rank
    coupled = turns.any() and rank(np.vstack([shifts, across])) > rank(shifts)
    found = [opening(kind, "so3xr3", 0.05, seed, "rkmk4") for seed in SEEDS]
    if coupled:
        assert max(of_moved for of_moved, _ in found) > 1e-5
    else:
        assert max(of_bound for _, of_bound in found) <= 1.0


def drift(name, group, step, time, seed):
    """Largest residual during a run of `time` seconds."""
    simulation = Simulation(mechanisms.named(name, seed), method="rkmk4", step=step, group=group)
    worst = 0.0
    for _ in range(10):
        simulation.advance(round(time / step) // 10)
        worst = max(worst, simulation.sample().constraint_residual)
    return worst


@pytest.mark.parametrize(
    "name",
    [
        *(f"{kind} between bodies" for kind in mechanisms.KINDS if kind != "fixed"),
        "universal to ground",
        "distance to ground",
        "every kind",
        "floating",
    ],
)
@pytest.mark.parametrize("group", ["se3", "so3xr3"])
@pytest.mark.volume(8)
def test_other_joints_drift_at_order_four(name, group):
    drifts = {h: drift(name, group, h, 0.4, 1) for h in (4e-3, 2e-3, 1e-3)}
    assert order_of(drifts) == pytest.approx(4.0, abs=0.2), drifts
    assert min(drifts.values()) > 1e-13
