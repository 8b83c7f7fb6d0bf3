# SPDX-License-Identifier: Apache-2.0
"""Code-independent descriptions of problems: P1..P4, and planar mechanisms of any length.

Mechanisms in space are in spatial.py and robots.py.

All body frames are aligned with the world at the start, R_i(0) = I, with origins at the centres of
mass; inertias (3, 3) are about them. So a joint is a point and an axis in the world at the start,
and no code has an advantage from its choice of frames. SI units, rad/s.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import acos, atan2, cos, hypot, pi, sin, sqrt

import numpy as np

from . import references

BALL, HINGE, FREE = "ball", "hinge", "free"
SLIDE, UNIVERSAL, CYLINDRICAL = "slide", "universal", "cylindrical"
GROUND = -1
GRAVITY = 9.81


@dataclass(frozen=True)
class Body:
    """Rigid body in its initial state; vectors (3,) in world axes, equal to its axes at the start."""

    mass: float
    inertia: np.ndarray
    position: np.ndarray
    omega: np.ndarray = field(default_factory=lambda: np.zeros(3))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Joint:
    """Joint of a kind at a world point (3,), m; axes are unit vectors (3,) in the world.

    axis   : for all but BALL and FREE; for a UNIVERSAL the axis fixed in the parent
    second : for a UNIVERSAL, the axis fixed in the child, perpendicular to `axis`
    """

    kind: str
    parent: int
    child: int
    point: np.ndarray
    axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    second: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Problem:
    """Mechanism with its duration and requested results.

    tree     : joint i connects body i to an earlier body or to the ground; empty for a free body.
               A FREE joint connects the ground and its body at the body's centre
    loops    : additional joints that close loops
    duration : s; attitudes are compared at its end
    coarsest : steps per duration of the coarsest run
    changes  : True if the motion is of another kind after the duration
    exact    : function of a fineness 0 or 1 that returns the exact attitudes at the end, (n, 3, 3)
    wanted   : requested speed relative to the best other code, at each of TARGETS
    redundant: True if ball joints that close loops have redundant rows
    """

    name: str
    title: str
    bodies: tuple
    tree: tuple
    loops: tuple
    gravity: np.ndarray
    duration: float
    coarsest: int
    changes: bool
    exact: Callable | None = None
    wanted: tuple = (3.0, 5.0, 8.0)
    redundant: bool = False

    @property
    def joints(self):
        """Kind of its joints as text, if all are hinges or all are balls."""
        kinds = {joint.kind for joint in self.tree}
        return {BALL: "balls", HINGE: "hinges"}.get(kinds.pop(), "") if len(kinds) == 1 else ""

    def rates(self, i):
        """Speeds of tree joint i at the start, rad/s and m/s, a list with a number per degree of freedom.

        FREE: velocity and omega; BALL: omega relative to the parent, world axes; UNIVERSAL: about
        `axis`, about `second`; CYLINDRICAL: about and along its axis
        """
        joint, body = self.tree[i], self.bodies[i]
        if joint.kind == FREE:
            return [*body.velocity, *body.omega]
        turn, shift = body.omega, body.velocity + np.cross(body.omega, joint.point - body.position)
        if joint.parent != GROUND:
            parent = self.bodies[joint.parent]
            turn = turn - parent.omega
            shift = shift - parent.velocity
            shift = shift - np.cross(parent.omega, joint.point - parent.position)
        return {
            BALL: [*turn],
            HINGE: [turn @ joint.axis],
            SLIDE: [shift @ joint.axis],
            UNIVERSAL: [turn @ joint.axis, turn @ joint.second],
            CYLINDRICAL: [turn @ joint.axis, shift @ joint.axis],
        }[joint.kind]


def heavy_top():
    """P1: fast symmetric top about a fixed point."""
    mass, inertia = 15.0, np.diag([0.234375, 0.46875, 0.234375])
    arm, omega = np.array([0.0, 1.0, 0.0]), np.array([0.0, 150.0, -4.61538])
    gravity = np.array([0.0, 0.0, -GRAVITY])
    about_pivot = np.diag(inertia) + mass * np.array([1.0, 0.0, 1.0])
    return Problem(
        "P1",
        "heavy top",
        (Body(mass, inertia, arm, omega, np.cross(omega, arm)),),
        (Joint(BALL, GROUND, 0, np.zeros(3)),),
        (),
        gravity,
        1.0,
        40,
        False,
        lambda fineness: references.spinning_body(about_pivot, omega, mass * arm, gravity, 1.0, fineness),
    )


def free_body():
    """P2: free body with three different principal moments, no force."""
    moments, omega = np.array([0.9144, 1.098, 1.66]), np.array([0.45549, 0.82623, 0.03476])
    return Problem(
        "P2",
        "free body",
        (Body(1.0, np.diag(moments), np.zeros(3), omega),),
        (),
        (),
        np.zeros(3),
        10.0,
        2,
        False,
        lambda fineness: references.spinning_body(moments, omega, np.zeros(3), np.zeros(3), 10.0, fineness),
    )


def _rod_inertia(mass, length, width, angle):
    """Inertia (3, 3) of a square rod in the xy plane, at `angle` (rad) from x."""
    along, across = mass * width**2 / 6, mass * (length**2 + width**2) / 12
    turn = np.array([[cos(angle), -sin(angle), 0], [sin(angle), cos(angle), 0], [0, 0, 1]])
    return turn @ np.diag([along, across, across]) @ turn.T


class _Planar:
    """Builder of rods in the xy plane and their joints."""

    def __init__(self, width, density):
        self.width, self.density = width, density
        self.bodies, self.tree = [], []

    def add(self, start, length, angle, rate, parent, start_velocity):
        """Add a rod on a revolute joint: (body index, end point, velocity of the end point)."""
        arm = length / 2 * np.array([cos(angle), sin(angle), 0.0])
        omega = np.array([0.0, 0.0, rate])
        mass = self.density * self.width**2 * length
        self.bodies.append(
            Body(
                mass,
                _rod_inertia(mass, length, self.width, angle),
                start + arm,
                omega,
                start_velocity + np.cross(omega, arm),
            )
        )
        last = len(self.bodies) - 1
        self.tree.append(Joint(HINGE, parent, last, start))
        return last, start + 2 * arm, start_velocity + np.cross(omega, 2 * arm)


def four_bar(density=1000.0):
    """P3: planar four-bar, its crank at 90 degrees turning at 10 pi rad/s, gravity along -y.

    density : kg/m^3 of the bars; the exact end states are for 1000
    """
    crank, rod, base, rate = 0.5, 1.0, 1.0, 10.0 * pi
    # The elbow is the upper intersection of circles about the crank's tip and the rocker's pivot.
    half = hypot(base, crank) / 2
    line, turn = atan2(-crank, base), acos(half / rod)
    coupler_angle, rocker_angle = line + turn, line + pi - turn
    # The elbow has the same velocity on coupler and rocker, compared along each of them.
    coupler_rate = -rate * crank * sin(rocker_angle - pi / 2) / (rod * sin(rocker_angle - coupler_angle))
    rocker_rate = rate * crank * sin(coupler_angle - pi / 2) / (rod * sin(coupler_angle - rocker_angle))
    rods, still = _Planar(0.05, density), np.zeros(3)
    first, tip, velocity = rods.add(np.zeros(3), crank, pi / 2, rate, GROUND, still)
    rods.add(tip, rod, coupler_angle, coupler_rate, first, velocity)
    foot = np.array([base, 0.0, 0.0])
    _, elbow, _ = rods.add(foot, rod, rocker_angle, rocker_rate, GROUND, still)
    return Problem(
        "P3",
        "planar four-bar",
        tuple(rods.bodies),
        tuple(rods.tree),
        (Joint(HINGE, 1, 2, elbow),),
        np.array([0.0, -GRAVITY, 0.0]),
        1.0,
        80,
        False,
        references.four_bar,
    )


def windows(count):
    """n upright square windows of 1 m, side by side; their top moves at 1 m/s."""
    rods, still = _Planar(sqrt(1e-3), 1000.0), np.zeros(3)
    loops = []
    last, tip, velocity = rods.add(np.zeros(3), 1.0, pi / 2, -1.0, GROUND, still)
    for window in range(count):
        coupler, _, _ = rods.add(tip, 1.0, 0.0, 0.0, last, velocity)
        foot = np.array([window + 1.0, 0.0, 0.0])
        last, tip, velocity = rods.add(foot, 1.0, pi / 2, -1.0, GROUND, still)
        loops.append(Joint(HINGE, coupler, last, tip))
    return Problem(
        f"{count} windows",
        "four-bars in a row",
        tuple(rods.bodies),
        tuple(rods.tree),
        tuple(loops),
        np.array([0.0, -GRAVITY, 0.0]),
        0.1,
        100,
        True,
    )


def chain(links, kind):
    """P4: rods of 0.1 m and 0.1 kg hang on each other; horizontal along x and at rest."""
    mass, length, width = 0.1, 0.1, 0.01
    bodies = tuple(
        Body(
            mass,
            _rod_inertia(mass, length, 0.0, 0.0) + np.diag([mass * width**2 / 6, 0.0, 0.0]),
            np.array([(i + 0.5) * length, 0.0, 0.0]),
        )
        for i in range(links)
    )
    tree = tuple(
        Joint(kind, i - 1, i, np.array([i * length, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])) for i in range(links)
    )
    return Problem(
        f"P4 N={links}",
        f"chain of {links}",
        bodies,
        tree,
        (),
        np.array([0.0, 0.0, -GRAVITY]),
        0.5,
        12,
        True,
        lambda fineness: references.planar_chain(links, mass, length, GRAVITY, 0.5, fineness),
    )
