# SPDX-License-Identifier: Apache-2.0
"""Builder of mechanisms in space: bodies on joints with given velocities, and shapes of bodies.

All frames are aligned with the world at the start, as in problems.py.
"""

from dataclasses import replace

import numpy as np

from .problems import BALL, CYLINDRICAL, FREE, GRAVITY, GROUND, HINGE, SLIDE, UNIVERSAL, Body, Joint, Problem

X, Y, Z = np.eye(3)
DOWN = np.array([0.0, 0.0, -GRAVITY])


def unit(vector):
    """Unit vector (3,) along a vector."""
    return np.asarray(vector, dtype=float) / np.linalg.norm(vector)


def slender(mass, length, direction, along, across):
    """Inertia (3, 3) of a straight body about its centre: m l^2 / 12 + `across`, and `along` it."""
    axis = np.outer(unit(direction), unit(direction))
    return (mass * length**2 / 12 + across) * (np.eye(3) - axis) + along * axis


def square_rod(mass, length, width, direction):
    """Inertia (3, 3) of a rod of square section; about its transverse axes without its thickness."""
    return slender(mass, length, direction, mass * width**2 / 6, 0.0)


def round_link(mass, length, radius, direction):
    """Inertia (3, 3) of a link of an arm: m r^2 / 2 about every axis, and a rod's across."""
    return slender(mass, length, direction, *(mass * radius**2 / 2,) * 2)


def box(mass, x, y, z):
    """Inertia (3, 3) of a box with sides along the axes, m."""
    return mass / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])


class Builder:
    """Mechanism to which bodies are added, each on a joint to an earlier one or to the ground."""

    def __init__(self):
        self.bodies, self.tree, self.loops = [], [], []

    def velocity(self, body, point):
        """Velocity (3,) of a point of a body or of the ground, m/s."""
        if body == GROUND:
            return np.zeros(3)
        body = self.bodies[body]
        return body.velocity + np.cross(body.omega, np.asarray(point) - body.position)

    def omega(self, body):
        """Angular velocity (3,) of a body or of the ground, rad/s."""
        return np.zeros(3) if body == GROUND else self.bodies[body].omega

    def add(self, kind, parent, point, axis, rates, mass, centre, inertia, second=None):
        """Index of a new body on a joint.

        point  : (3,) m, of the joint
        axis   : (3,) or None, direction of its axis; `second`: second axis of a universal joint
        rates  : its velocities at the start as in `Problem.rates`, rad/s and m/s
        centre : (3,) m, of the body; inertia (3, 3) about it
        """
        point, centre = np.array(point, dtype=float), np.array(centre, dtype=float)
        axes = [np.zeros(3) if given is None else unit(given) for given in (axis, second)]
        omega, velocity = self.omega(parent), self.velocity(parent, point)
        if kind == FREE:
            velocity, omega = np.array(rates[:3], dtype=float), np.array(rates[3:], dtype=float)
        elif kind == BALL:
            omega = omega + rates
        elif kind == SLIDE:
            velocity = velocity + rates[0] * axes[0]
        else:
            omega = omega + rates[0] * axes[0]
            if kind == UNIVERSAL:
                omega = omega + rates[1] * axes[1]
            elif kind == CYLINDRICAL:
                velocity = velocity + rates[1] * axes[0]
        velocity = velocity + np.cross(omega, centre - point)
        self.bodies.append(Body(mass, inertia, centre, omega, velocity))
        self.tree.append(Joint(kind, parent, len(self.tree), point, *axes))
        return len(self.tree) - 1

    def hinge(self, parent, point, axis, rate, mass, centre, inertia):
        """Index of a new body on a hinge, see `add`."""
        return self.add(HINGE, parent, point, axis, (rate,), mass, centre, inertia)

    def rod(self, parent, start, end, mass, width, velocity, spin=0.0):
        """Index of a new rod on a ball at `start`, whose `end` has a velocity (3,), m/s.

        spin : rad/s, about itself. The velocity must keep the length; width: side of the square section, m
        """
        start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        along = end - start
        omega = np.cross(along, velocity - self.velocity(parent, start)) / (along @ along)
        omega = omega + spin * unit(along) - self.omega(parent)
        inertia = square_rod(mass, np.linalg.norm(along), width, along)
        return self.add(BALL, parent, start, None, omega, mass, (start + end) / 2, inertia)

    def close(self, one, other, point):
        """Close a loop by a ball between two bodies at a point (3,), m."""
        self.loops.append(Joint(BALL, one, other, np.array(point, dtype=float)))

    def problem(self, name, title, duration, coarsest, wanted, changes=True, gravity=DOWN):
        """Problem with the exact end state of mechanism_reference.py; see problems.Problem."""
        from .mechanism_reference import end_attitudes

        made = Problem(
            name,
            title,
            tuple(self.bodies),
            tuple(self.tree),
            tuple(self.loops),
            np.array(gravity, dtype=float),
            duration,
            coarsest,
            changes,
            None,
            wanted,
        )
        return replace(made, exact=lambda fineness: end_attitudes(made, fineness))
