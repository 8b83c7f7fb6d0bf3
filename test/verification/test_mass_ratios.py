# SPDX-License-Identifier: Apache-2.0
"""Chains of very different bodies against equations in joint angles, solved with 60 digits.

A pendulum of rods has M_ij = m L^2 cos(a_i - a_j), m the mass beyond both. Its condition is that
of the masses; what a body does is well-defined all the same, and has to come out.
"""

import mpmath
import numpy as np
import pytest

from liegroup_core import Scene, Simulation
from liegroup_core.scene.description import Body, Frame, Joint

GRAVITY = (1.0, -9.81, 0.0)
ANGLES, RATES = (0.3, 1.2, -0.8, 0.5, 2.0), (0.5, -1.0, 2.0, 0.3, -0.2)
LIGHT = 0.01  # kg m^2 for each kg: a gyration radius of 0.1 m, at arms of 1 m
CHAINS = {
    "heavy end": ((1, 1e8), LIGHT),
    "heavy middle": ((1, 1e8, 1), LIGHT),
    "light middle": ((1, 1e-8, 1), LIGHT),
    "heavy start": ((1e8, 1), LIGHT),
    "ever heavier": ((1e-4, 1e-2, 1, 1e2, 1e4), LIGHT),
    "much heavier": ((1, 900, 8e5, 7e8), LIGHT),
    "nearly points": ((1, 1, 1), 1e-10),
    "large inertia": ((1, 1, 1), (0.01, 1e8, 0.01)),
}


def exact(masses, inertias):
    """Angular accelerations, rad/s^2, at zero relative angles."""
    with mpmath.workdps(60):
        n = len(masses)
        a, w = ([mpmath.mpf(value) for value in values[:n]] for values in (ANGLES, RATES))
        beyond = [mpmath.fsum(mpmath.mpf(m) for m in masses[i:]) for i in range(n)]
        M, right = mpmath.matrix(n, n), mpmath.matrix(n, 1)
        for i in range(n):
            right[i] = beyond[i] * (
                mpmath.cos(a[i]) * mpmath.mpf(GRAVITY[1]) - mpmath.sin(a[i]) * mpmath.mpf(GRAVITY[0])
            )
            for j in range(n):
                m = beyond[max(i, j)]
                M[i, j] = m * mpmath.cos(a[i] - a[j]) + (inertias[i] if i == j else 0)
                right[i] -= m * mpmath.sin(a[i] - a[j]) * w[j] ** 2
        return np.array([float(value) for value in mpmath.lu_solve(M, right)])


def chain(masses, inertias, swapped=()):
    """Rods of 1 m with their mass at the far end; joints in `swapped` have the child as parent."""
    bodies, joints, place, speed = [], [], np.zeros(2), np.zeros(2)
    for i, (mass, inertia) in enumerate(zip(masses, inertias)):
        along = np.array([np.cos(ANGLES[i]), np.sin(ANGLES[i])])
        across = np.array([-along[1], along[0]])
        place, speed = place + along, speed + RATES[i] * across
        bodies.append(
            Body(
                name=f"b{i}",
                mass=mass,
                inertia=[inertia] * 3,
                position=(*place, 0.0),
                rotation_vector=(0, 0, ANGLES[i]),
                angular_velocity=(0, 0, RATES[i]),
                linear_velocity=(speed @ along, speed @ across, 0.0),
            )
        )
        ends = [("world" if i == 0 else f"b{i - 1}", Frame()), (f"b{i}", Frame(position=(-1, 0, 0)))]
        (parent, parent_frame), (child, child_frame) = ends[::-1] if i in swapped else ends
        joints.append(
            Joint(
                name=f"j{i}",
                type="revolute",
                parent=parent,
                child=child,
                parent_frame=parent_frame,
                child_frame=child_frame,
            )
        )
    return Scene(name="chain", gravity=GRAVITY, bodies=bodies, joints=joints)


@pytest.mark.parametrize("swapped", [(), (1,)])
@pytest.mark.parametrize("space", ["auto", "space"])
@pytest.mark.parametrize("name", CHAINS)
def test_accelerations_at_extreme_mass_ratios(name, space, swapped):
    """From one Euler step: rates of 2 rad/s are rounded to 4e-16, divided by the step
    2e-11 rad/s^2, of some 10: 1e-11.
    """
    masses, inertias = CHAINS[name]
    if np.isscalar(inertias):
        inertias = [inertias * mass for mass in masses]
    simulation = Simulation(chain(masses, inertias, swapped), method="rkmk1", step=1e-5, space=space)
    before = simulation.state()[1][:, 2]
    simulation.advance(1)
    found = (simulation.state()[1][:, 2] - before) / simulation.step
    wanted = exact(masses, inertias)
    assert np.abs(found - wanted).max() <= 1e-11 * max(10.0, np.abs(wanted).max())
    assert simulation.singular_solves == 0


def test_fixed_bodies_of_tiny_inertia_stay_at_rest():
    bodies = [
        Body(name=name, mass=1.0, inertia=[1e-10] * 3, position=(x, y, 0.0))
        for name, x, y in (("a", 0.3, 0.0), ("b", 1.0, 0.5), ("c", 1.2, -0.3))
    ]
    joints = [
        Joint(name="ja", type="fixed", parent="world", child="a", child_frame=Frame()),
        Joint(name="jb", type="fixed", parent="b", child="a", parent_frame=Frame(position=(-0.4, 0.2, 0.0))),
        Joint(name="jc", type="fixed", parent="b", child="c", child_frame=Frame(position=(0.1, 0.3, 0.0))),
    ]
    scene = Scene(name="welded", gravity=(0, -9.81, 0), bodies=bodies, joints=joints)
    for space in ("auto", "space"):
        simulation = Simulation(scene, space=space)
        simulation.advance(1000)
        # Rows of lever 1 m against a gyration radius of 1e-5 m lose ten digits of an angular
        # acceleration, which a refinement finds: accelerations of 10 m/s^2 are then right to some
        # 1e-15 of that, 5e-15 m in 1 s; 1e-13 has room for a few of them.
        assert simulation.sample().constraint_residual <= 1e-13
        assert simulation.singular_solves == 0
