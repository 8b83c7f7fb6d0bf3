# SPDX-License-Identifier: Apache-2.0
"""Slender free bodies under momentum methods: the inertia that these add, and what the estimate says."""

import math

import numpy as np
import pytest

from liegroup_core import Simulation
from liegroup_core.scene.description import Body, Scene

ACROSS = 1.25  # (rad/s)^2, squared rate about the other axes
SHARES = {"constrained_rattle": 12.0, "lie_midpoint": 8.0}


def rod(slender, spin=2.0, method="constrained_rattle", step=0.05, **options):
    """Simulation of a free rod with the moments of inertia 1 / slender, 1, 1."""
    body = Body(name="rod", mass=1.0, inertia=(1.0 / slender, 1.0, 1.0), angular_velocity=(spin, 1.0, 0.5))
    return Simulation(Scene(name="rod", gravity=(0, 0, 0), bodies=[body]), method, step, **options)


@pytest.mark.parametrize("method", SHARES)
@pytest.mark.parametrize("slender", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("step", [0.02, 0.1])
def test_the_rate_about_the_long_axis_is_that_of_a_rod_with_more_inertia(method, slender, step):
    # In body axes the angular velocity of a symmetric rod turns about the long axis at the rate
    # -(1 - I_1) w_1, over I_1 the method's inertia if it adds any. Next terms: 2 I_1 / I_3 and (h w)^2 / 10.
    simulation = rod(slender, method=method, step=step, estimate=False)
    phases = []
    for _ in range(21):
        _, y, z = simulation.state()[1][0, :3]
        phases.append(math.atan2(z, y))
        simulation.advance(1)
    rate = -(np.unwrap(phases)[-1] - phases[0]) / (20 * step)
    inertia = 2.0 * (1.0 - 1.0 / slender) / rate  # over I_1
    added = step**2 * ACROSS / SHARES[method] * slender
    assert inertia - 1.0 == pytest.approx(added, rel=2.0 / slender + 0.1 * step**2 * ACROSS)


@pytest.mark.parametrize("method", ["constrained_rattle", "constrained_rattle4", "lie_midpoint"])
def test_a_rod_that_does_not_turn_any_more_has_no_finite_estimate(method):
    simulation = rod(1e6, method=method)
    simulation.advance(20)
    assert simulation.largest_error == math.inf
    assert "is no longer known, because the added inertia of a body changes its rotation" in simulation.doubt
    assert simulation.predictable_until <= 1.0


@pytest.mark.parametrize("slender, spin, step", [(1e6, 0.0, 0.05), (1e6, 2.0, 1e-5), (50.0, 2.0, 0.05)])
def test_other_rods_have_a_finite_estimate(slender, spin, step):
    simulation = rod(slender, spin, step=step)
    simulation.advance(20)
    assert simulation.largest_error < math.inf
