# SPDX-License-Identifier: Apache-2.0
"""Problems S1..S5: mechanisms in space, without planar parts that a code may exploit.

An arm and chains of hinges, a four-bar of hinges and balls, a Stewart platform; and rows of
spatial four-bars of any length.
"""

from math import cos, pi, radians, sin

import numpy as np

from .builder import Builder, X, Y, Z, round_link, square_rod, unit
from .problems import BALL, FREE, GROUND, HINGE, SLIDE, UNIVERSAL

SPACE_GRAVITY = (0.0, -3.0, -9.81)  # m/s^2, not in the plane of the first links of a chain
SEEDS = {10: 7, 100: 11}  # of the axes of S2 and S3


def arm():
    """S1: robot arm of six hinges, all turning, falling."""
    made, radius = Builder(), 0.05
    # Direction of the link, its length (m), mass (kg), axis of its hinge and rate (rad/s).
    links = [
        (Z, 0.1, 3.7, Z, 1.0),
        (Z, 0.42, 8.4, Y, -0.5),
        (X, 0.39, 2.3, Y, 0.7),
        (X, 0.1, 1.2, Y, -2.0),
        (Y, 0.09, 1.2, Z, 3.0),
        (Y, 0.08, 0.25, Y, -4.0),
    ]
    at, last = np.zeros(3), GROUND
    for direction, length, mass, axis, rate in links:
        last = made.hinge(
            last, at, axis, rate, mass, at + length / 2 * direction, round_link(mass, length, radius, direction)
        )
        at = at + length * direction
    return made.problem("S1", "robot arm of 6 hinges", 0.5, 4, (3.0, 6.0, 12.0))


def chain_in_space(links, kind=HINGE):
    """S2, S3: rods of P4 with hinges across them at random angles, level and at rest.

    kind : HINGE, or BALL for a chain without axes
    """
    made, mass, length, width = Builder(), 0.1, 0.1, 0.01
    angles = np.random.default_rng(SEEDS.get(links, links)).uniform(0.0, pi, links)
    for i, angle in enumerate(angles.tolist()):
        made.add(
            kind,
            i - 1,
            i * length * X,
            None if kind == BALL else (0.0, cos(angle), sin(angle)),
            np.zeros(3),
            mass,
            (i + 0.5) * length * X,
            square_rod(mass, length, width, X),
        )
    name, wanted = ("S3", (3.0, 8.0, 20.0)) if links == 100 else ("S2", (3.0, 6.0, 12.0))
    return made.problem(name, f"chain of {links} {kind}s in space", 0.5, 6, wanted, gravity=SPACE_GRAVITY)


def _four_bar(made, crank, foot, axis):
    """Add coupler and rocker of a spatial four-bar to a turning crank; returns the rocker.

    crank : (body, its tip (3,), m); foot, axis: point and axis of the rocker's hinge; the rocker is upright
    """
    body, tip = crank
    foot, axis, height = np.array(foot), unit(axis), 0.5
    top = foot + height * Z
    along, speed = top - tip, made.velocity(body, tip)
    # Velocity of the rocker that keeps the length of the coupler.
    swing = np.cross(axis, height * Z)
    rate = (speed @ along) / (swing @ along)
    coupler = made.rod(body, tip, top, 2.0, 0.02, rate * swing)
    rocker = made.hinge(GROUND, foot, axis, rate, 1.5, foot + height / 2 * Z, square_rod(1.5, height, 0.02, Z))
    made.close(coupler, rocker, top)
    return rocker


def four_bar_in_space():
    """S4: hinge, ball, ball, hinge: the crank turns about z, the rocker about a level axis."""
    made = Builder()
    tip = 0.2 * X
    crank = made.hinge(GROUND, np.zeros(3), Z, 10.0, 1.0, tip / 2, square_rod(1.0, 0.2, 0.02, X))
    _four_bar(made, (crank, tip), (0.6, 0.3, 0.0), (0.2, 1.0, 0.0))
    return made.problem("S4", "spatial four-bar", 1.0, 8, (4.0, 6.0, 15.0), changes=False)


def stewart():
    """S5: Stewart platform thrown upwards, turning, its centre of mass off its middle.

    Six legs of two parts, with a universal joint at the base, a slide, and a ball at the platform.
    The platform is free in the tree, and all six balls close loops. If a leg connects it in the tree,
    Pinocchio's constraintDynamics gives a wrong motion (gaps closed, converged, 90 degrees off), and
    MuJoCo takes longer.
    """
    made = Builder()
    base = [0.5 * _on_circle(a) for a in (-20, 20, 100, 140, 220, 260)]
    tops = [0.3 * _on_circle(a) + 0.6 * Z for a in (-45, 45, 75, 165, 195, 285)]
    centre = np.array([0.04, -0.03, 0.65])
    velocity, omega = np.array([0.4, -0.2, 2.2]), np.array([2.0, -1.5, 2.0])
    uppers = []
    for foot, top in zip(base, tops):
        length, d = np.linalg.norm(top - foot), unit(top - foot)
        tangent = np.cross(Z, unit(foot))
        across = np.cross(d, tangent)
        sine, second = np.linalg.norm(across), unit(across)
        speed = velocity + np.cross(omega, top - centre)
        rate = speed @ d
        rates = np.array([-speed @ second, (speed - rate * d) @ tangent]) / (length * sine)
        lower = made.add(
            UNIVERSAL, GROUND, foot, tangent, rates, 2.0, foot + 0.175 * d, round_link(2.0, 0.35, 0.03, d), second
        )
        upper = made.add(
            SLIDE, lower, foot + 0.35 * d, d, (rate,), 1.0, top - 0.175 * d, round_link(1.0, 0.35, 0.02, d)
        )
        uppers.append(upper)
    inertia = np.array([[0.30, 0.02, -0.01], [0.02, 0.22, 0.015], [-0.01, 0.015, 0.42]])
    platform = made.add(FREE, GROUND, centre, None, (*velocity, *omega), 6.0, centre, inertia)
    for upper, top in zip(uppers, tops):
        made.close(upper, platform, top)
    return made.problem("S5", "Stewart platform", 0.5, 1, (4.0, 6.0, 15.0))


def _on_circle(degrees):
    """Point (3,) of the unit circle in the xy plane."""
    return np.array([cos(radians(degrees)), sin(radians(degrees)), 0.0])


def ladder(loops):
    """Row of spatial four-bars along x: a rocker drives the next coupler.

    Every rocker is upright on a level hinge, whose axis is turned a little from one to the next. A
    coupler is a rod on two balls. There are two degrees of freedom, and the spins of couplers.
    """
    made = Builder()
    tip = 0.5 * Z
    crank = made.hinge(GROUND, np.zeros(3), Y, 1.0, 1.5, tip / 2, square_rod(1.5, 0.5, 0.02, Z))
    for i in range(1, loops + 1):
        foot = np.array([0.4 * i, 0.1 * (i % 2), 0.0])
        crank, tip = (_four_bar(made, (crank, tip), foot, (0.2 * (-1) ** i, 1.0, 0.0)), foot + tip[2] * Z)
    return made.problem(f"{loops} spatial loops", "spatial four-bars in a row", 0.1, 100, (4.0, 6.0, 15.0))
