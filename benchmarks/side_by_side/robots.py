# SPDX-License-Identifier: Apache-2.0
"""Problems S6..S8: robots for which no code was tuned.

A humanoid in free fall, a Delta robot, and a crane with every kind of joint.
"""

from math import cos, pi, sin, sqrt

import numpy as np

from .builder import Builder, X, Y, Z, box, round_link, square_rod, unit
from .problems import BALL, CYLINDRICAL, FREE, GROUND, SLIDE, UNIVERSAL

WANTED = (3.0, 6.0, 12.0)


def humanoid():
    """S6: 26 bodies on a free pelvis: 25 hinges of waist, neck, arms and legs, all turning."""
    made = Builder()
    pelvis = made.add(
        FREE,
        GROUND,
        (0.0, 0.0, 1.0),
        None,
        (0.3, -0.2, 1.0, 0.5, 1.2, -0.4),
        10.0,
        (0.0, 0.0, 1.0),
        box(10.0, 0.2, 0.3, 0.15),
    )
    signs = iter([1, -1] * 13)

    def limb(parent, at, links):
        """Add links (axis, length along z in m, mass in kg, radius in m, rate in rad/s)."""
        at = np.array(at)
        for axis, length, mass, radius, rate in links:
            end = at + length * Z
            # Between joints at one point there is a small housing.
            size = max(abs(length), 0.06)
            parent = made.hinge(
                parent,
                at,
                axis,
                3.0 * rate * next(signs),
                mass,
                (at + end) / 2 + 0.01 * X,
                round_link(mass, size, radius, Z),
            )
            at = end
        return parent, at

    waist = [(Z, 0.05, 1.5, 0.06, 0.8), (X, 0.05, 1.5, 0.06, 0.6), (Y, 0.35, 20.0, 0.12, 0.9)]
    torso, shoulders = limb(pelvis, (0.0, 0.0, 1.1), waist)
    limb(torso, shoulders, [(Z, 0.05, 0.5, 0.04, 1.0), (Y, 0.2, 4.0, 0.08, 1.5)])
    for side in (1.0, -1.0):
        limb(
            torso,
            shoulders + (0.0, 0.22 * side, -0.05),
            [
                (Y, 0.0, 1.0, 0.05, 2.0),
                (X, 0.0, 1.0, 0.05, 1.5),
                (Z, -0.28, 2.2, 0.04, 1.0),
                (Y, -0.25, 1.6, 0.035, 3.0),
            ],
        )
        limb(
            pelvis,
            (0.0, 0.1 * side, 0.92),
            [
                (Z, 0.0, 1.2, 0.05, 0.7),
                (X, 0.0, 1.2, 0.05, 0.9),
                (Y, -0.42, 7.0, 0.06, 2.0),
                (Y, -0.4, 3.5, 0.045, 2.5),
                (Y, 0.0, 0.6, 0.04, 1.5),
                (X, -0.08, 1.2, 0.05, 1.0),
            ],
        )
    return made.problem("S6", "humanoid of 26 bodies", 0.5, 3, WANTED)


def delta():
    """S7: Delta robot: three driven arms, each with a pair of rods on balls to the platform.

    Thrown upwards, so that its arms never stretch out; the rods turn about themselves.
    """
    made = Builder()
    velocity, centre = np.array([1.0, -0.6, 1.8]), np.array([0.0, 0.0, -sqrt(0.7**2 - 0.42**2)])
    pairs = []
    for angle in (0.0, 2 * pi / 3, 4 * pi / 3):
        out, tangent = (np.array([cos(angle), sin(angle), 0.0]), np.array([-sin(angle), cos(angle), 0.0]))
        elbow, along = 0.5 * out, centre - 0.42 * out
        # Velocity of the elbow that keeps the length of the rods.
        swing = np.cross(tangent, 0.3 * out)
        arm = made.hinge(
            GROUND,
            0.2 * out,
            tangent,
            (velocity @ along) / (swing @ along),
            0.8,
            0.35 * out,
            round_link(0.8, 0.3, 0.02, out),
        )
        for side in (0.05, -0.05):
            start = elbow + side * tangent
            rod = made.rod(arm, start, start + along, 0.15, 0.012, velocity, 200.0 * side)
            pairs.append((rod, start + along))
    middle = centre + (0.01, -0.005, -0.02)
    platform = made.add(FREE, GROUND, middle, None, (*velocity, 0.0, 0.0, 0.0), 0.6, middle, box(0.6, 0.16, 0.14, 0.04))
    for rod, corner in pairs:
        made.close(rod, platform, corner)
    return made.problem("S7", "Delta robot", 0.4, 3, (4.0, 6.0, 15.0))


def crane():
    """S8: tree of slides, hinges, universal, cylindrical and ball joints: a crane with two loads."""
    made = Builder()
    bridge = made.add(SLIDE, GROUND, (0.0, 0.0, 3.0), X, (0.5,), 40.0, (0.0, 0.0, 3.0), box(40.0, 0.5, 3.0, 0.4))
    trolley = made.add(SLIDE, bridge, (0.0, 0.2, 3.0), Y, (-0.4,), 15.0, (0.05, 0.2, 2.9), box(15.0, 0.4, 0.4, 0.3))
    mast = made.add(
        CYLINDRICAL,
        trolley,
        (0.0, 0.2, 2.8),
        (0.05, 0.0, 1.0),
        (4.0, 0.2),
        8.0,
        (0.02, 0.2, 2.4),
        round_link(8.0, 0.8, 0.06, Z),
    )
    boom = made.hinge(mast, (0.0, 0.2, 2.0), Y, 3.0, 5.0, (0.4, 0.2, 2.02), round_link(5.0, 0.8, 0.05, X))
    stick = made.add(SLIDE, boom, (0.8, 0.2, 2.0), X, (0.3,), 2.0, (1.0, 0.2, 2.01), round_link(2.0, 0.4, 0.03, X))
    rope = made.add(
        UNIVERSAL, stick, (1.2, 0.2, 2.0), X, (2.0, -3.0), 0.5, (1.2, 0.2, 1.7), square_rod(0.5, 0.6, 0.02, Z), Y
    )
    made.add(BALL, rope, (1.2, 0.2, 1.4), None, (2.0, -3.0, 6.0), 4.0, (1.22, 0.18, 1.25), box(4.0, 0.2, 0.3, 0.25))
    counter = made.hinge(
        mast, (-0.1, 0.2, 2.1), (0.0, 1.0, 0.3), -3.0, 3.0, (-0.4, 0.2, 2.1), round_link(3.0, 0.6, 0.04, X)
    )
    made.add(
        CYLINDRICAL,
        counter,
        (-0.5, 0.2, 2.1),
        unit((1.0, 0.0, 0.2)),
        (9.0, -0.2),
        2.0,
        (-0.5, 0.23, 2.1),
        round_link(2.0, 0.1, 0.08, X),
    )
    swing = made.add(
        UNIVERSAL, bridge, (0.0, -0.8, 2.8), Y, (2.4, 1.6), 1.0, (0.0, -0.8, 2.5), square_rod(1.0, 0.6, 0.03, Z), X
    )
    made.add(BALL, swing, (0.0, -0.8, 2.2), None, (-4.0, 3.0, 5.0), 2.5, (0.03, -0.78, 2.0), box(2.5, 0.2, 0.15, 0.3))
    return made.problem("S8", "crane of all joints", 0.5, 3, WANTED)
