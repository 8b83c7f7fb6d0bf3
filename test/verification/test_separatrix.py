# SPDX-License-Identifier: Apache-2.0
"""Free bodies that start to turn beside their middle axis, with the defaults: all error is rounding."""

import math

import numpy as np
import pytest

from liegroup_core import Simulation
from liegroup_core.reference.elliptic import free_body, to_floats
from liegroup_core.scene.description import Body, Scene

pytestmark = pytest.mark.slow


def angle_between(one, other):
    """Angle of the rotation from one matrix to another, rad."""
    r = one.T @ other
    axis = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return math.atan2(0.5 * np.linalg.norm(axis), 0.5 * (np.trace(r) - 1.0))


@pytest.mark.parametrize(
    "inertia, rate",
    [
        ((1.0, 2.0, 3.0), (1e-6, 1.0, 0.0)),
        ((0.6340416972471647, 0.9031129864471292, 0.9534978894806515), (1e-6, 1.0, 0.0)),
        ((0.7, 0.8, 0.9), (1e-5, 2.0, 1e-7)),
        ((0.55, 0.7, 0.95), (1e-7, 2.5, 1e-6)),
    ],
)
@pytest.mark.turn(3)
def test_the_estimate_knows_an_error_that_is_all_rounding(inertia, rate):
    """Against Jacobi's elliptic functions in 30 digits; the steps are so fine that no tolerance matters."""
    body = Body(name="body", mass=1.0, inertia=inertia, angular_velocity=rate)
    simulation = Simulation(Scene(name="top", gravity=(0, 0, 0), bodies=[body]), quiet=True)
    rows = []
    for time in np.arange(10.0, 301.0, 10.0):
        simulation.advance(round(time / simulation.step) - simulation.steps)
        exact = free_body(np.diag(inertia), np.eye(3), np.array(rate), simulation.time)[0]
        exact = np.array(to_floats(exact), dtype=float).reshape(3, 3)
        error = angle_between(simulation.sample().pose_matrices[0][:3, :3], exact)
        rows.append((time, error, simulation.largest_error))
    times, errors, estimates = np.array(rows).T
    kept = times <= simulation.accurate_until
    assert (errors[kept] <= 1e-4 * np.maximum(1.0, times[kept] / 60.0)).all()
    # The companion rounds to 16 times as much; both are random, and close to each other by chance.
    known = errors > 1e-11
    assert np.median(estimates[known] / errors[known]) > 1.0
    assert "finer" not in (simulation.doubt or "") and "times smaller" not in (simulation.doubt or "")
