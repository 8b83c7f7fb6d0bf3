# SPDX-License-Identifier: Apache-2.0
"""Generalised forces of joint accelerations, in space and in the plane.

The mass matrix M of the joints is that of the kinetic energy, which bodies, their masses and twists
give without joints. The whole is compared with articulated bodies: forces vanish at the accelerations
and multipliers of the index-1 equations, which test_relative_accelerations.py checks against 50
digits to 1e-12 of an acceleration. A force is a sum over at most 40 bodies of products with such
errors: 1e-10 of the largest addend, |M| |qddot| or the bias, leaves room for levers.
"""

import engine
import numpy as np
import pytest
import random_mechanisms

from liegroup_core.dynamics.inverse_dynamics import inverse_dynamics
from liegroup_core.engine import Engine
from liegroup_core.methods.munthe_kaas import steps as relative

SPACES = ("auto", "space")
CASES = [(name, seed) for name in random_mechanisms.CLASSES for seed in range(4)]
ADDENDS = 1e-10


def solved(scene, wrenches, space):
    """(engine, model, work) of a mechanism, with accelerations and multipliers in work."""
    simulation = Engine(scene, "rkmk4", quiet=True, group="relative", space=space)
    for body, wrench, axes in wrenches:
        simulation.apply_wrench(body, wrench, source=axes, axes=axes)
    simulation.advance(0)
    model, work = engine.at_stage(simulation)
    assert relative.accelerate(model, work, simulation.inputs.acting.external) == -1
    return simulation, model, work


def forces(model, work, rates):
    """Forces (f,) of the joint accelerations `rates`."""
    out = np.zeros(len(rates))
    inverse_dynamics(model, work, rates.reshape(-1, 1), out)
    return out


def mass_matrix(model, work):
    """(M, bias) (f, f) and (f,), by unit accelerations."""
    f = len(work.acceleration)
    bias = forces(model, work, np.zeros(f))
    return np.column_stack([forces(model, work, unit) - bias for unit in np.eye(f)]), bias


@pytest.mark.parametrize("name, seed", CASES)
@pytest.mark.parametrize("space", SPACES)
@pytest.mark.volume(5)
def test_forces_vanish_at_the_accelerations_of_the_equations_of_motion(name, seed, space):
    scene, wrenches = random_mechanisms.random_mechanism(name, seed)
    _, model, work = solved(scene, wrenches, space)
    rates = work.acceleration[:, 0].copy()
    left = forces(model, work, rates)
    M, bias = mass_matrix(model, work)
    assert np.abs(M - M.T).max() <= 1e-12 * np.abs(M).max()
    largest = np.abs(M).max() * np.abs(rates).max() + np.abs(bias).max()
    assert np.abs(left).max() <= ADDENDS * largest


@pytest.mark.parametrize("name", ["tree", "loops", "planar loops"])
@pytest.mark.parametrize("space", SPACES)
@pytest.mark.volume(2)
def test_the_mass_matrix_is_that_of_the_kinetic_energy(name, space):
    for seed in range(4):
        simulation, model, work = solved(*random_mechanisms.random_mechanism(name, seed), space)
        M, _ = mass_matrix(model, work)
        rates = np.concatenate(
            [row[:count] for row, count in zip(work.stage_twist[len(model.bodies) :], model.links["freedoms"])]
        )
        twists = simulation.state()[1].ravel()
        energy = 0.5 * twists @ engine.masses(simulation.layout.centred) @ twists
        assert 0.5 * rates @ M @ rates == pytest.approx(energy, rel=1e-11)
