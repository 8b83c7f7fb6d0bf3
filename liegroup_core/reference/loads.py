# SPDX-License-Identifier: Apache-2.0
"""Gravity and all forces of a scene, in world axes.

Forces between bodies act along the line between two points, about the z axis of a joint, or along
that axis. Each of them is linear in coordinate and rate:

    constant - stiffness * coordinate - damping * rate, within +- limit

A spring at rest at x0 has constant = stiffness * x0. A motor with a rate limit has
damping = |its force| / limit. Only servos have a limit, of the force or torque.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import kernel, subroutine

from .vectors import add_force, add_three, cross, dot, plus, point, slide, three, turned, turning

LOADS = 36  # numbers of the external loads on a body


class Loads(NamedTuple):
    """Gravity and forces of a scene of n bodies; a law is (constant, stiffness, damping, limit)."""

    gravity: np.ndarray  # (1, 3) m/s^2
    line_body: np.ndarray  # (l, 2) parent, child; n: the world
    line_point: np.ndarray  # (l, 6) m, in the frames of the two
    line_law: np.ndarray  # (l, 4) N, N/m, N s/m, N; coordinate: the length
    turn_body: np.ndarray  # (t, 2)
    turn_axis: np.ndarray  # (t, 3) z of the joint in the parent's axes
    turn_law: np.ndarray  # (t, 4) N m, N m/rad, N m s/rad, N m; coordinate: the angle; zero for screws
    slide_body: np.ndarray  # (s, 2)
    slide_point: np.ndarray  # (s, 6) m, origins of the joint frames
    slide_axis: np.ndarray  # (s, 3) z of the joint in the parent's axes
    slide_law: np.ndarray  # (s, 4) N, N/m, N s/m, N; coordinate: origin of the child's frame along z
    drag: np.ndarray  # (n, 4) N s/m, N s^2/m^2, N m s, N m s^2: linear, quadratic, the same angular


@kernel
def _between(force, frame, bodies, i, position, f, axis):
    """Add a force f along an axis at a position on the child, and its opposite on the parent."""
    add_force(force, frame, bodies[i, 1], position, f, axis)
    add_force(force, frame, bodies[i, 0], position, -f, axis)


@kernel
def _value(law, i, coordinate, rate):
    """Force of a law."""
    return min(max(law[i, 0] - law[i, 1] * coordinate - law[i, 2] * rate, -law[i, 3]), law[i, 3])


@kernel
def _joint_forces(loads, frame, angle, force, angle_rate_out):
    for i in range(len(loads.line_body)):
        start = point(frame, loads.line_body[i, 0], three(loads.line_point, i, 0))
        end = point(frame, loads.line_body[i, 1], three(loads.line_point, i, 3))
        d = plus(end[0], -1.0, start[0])
        length = np.sqrt(dot(d, d))
        if length > 0.0:
            unit = plus(d, 1.0 / length - 1.0, d)
            rate = dot(unit, plus(end[1], -1.0, start[1]))
            f = _value(loads.line_law, i, length, rate)
            _between(force, frame, loads.line_body, i, end[0], f, unit)
    for i in range(len(loads.turn_body)):
        parent, child = loads.turn_body[i, 0], loads.turn_body[i, 1]
        axis = turned(frame, parent, three(loads.turn_axis, i, 0))
        angle_rate_out[i] = dot(axis, turning(frame, parent, child))
        torque = _value(loads.turn_law, i, angle[i], angle_rate_out[i])
        add_three(force, child, 3, torque, axis)
        add_three(force, parent, 3, -torque, axis)
    for i in range(len(loads.slide_body)):
        axis, position, coordinate, rate = slide(
            frame,
            loads.slide_body[i, 0],
            loads.slide_body[i, 1],
            three(loads.slide_axis, i, 0),
            three(loads.slide_point, i, 0),
            three(loads.slide_point, i, 3),
        )
        _between(force, frame, loads.slide_body, i, position, _value(loads.slide_law, i, coordinate, rate), axis)


@subroutine
def add_loads(loads, mass, frame, angle, wrench, force, angle_rate_out):
    """Add gravity, external wrenches and all forces of the scene at one state to `force`.

    mass   : (n,) kg
    frame  : (n + 1, FRAME) of vectors.place
    angle  : (t,) rad, of the joints with an integrated angle
    wrench : (n, LOADS) external wrenches: (6) body axes, about the centre of mass; (6) world axes,
             about the point (3) of the body, relative to the centre of mass; (9) forces in world axes
             1 m from this point along x, y and z of the body, whose opposites act at this point; a pull: (3) place in
             the world, (3) point of the body, relative to the centre of mass, (3) torque in world axes, stiffness N/m,
             damping N s/m, damping of the rotation N m s/rad
    force  : (n + 1, 6) force in N; torque in N m about the centre of mass; world axes
    angle_rate_out : (t,) rad/s
    """
    g = three(loads.gravity, 0, 0)
    for i in range(len(mass)):
        v, omega = three(frame, i, 12), three(frame, i, 15)
        add_three(force, i, 0, mass[i], g)
        add_three(force, i, 0, -loads.drag[i, 0] - loads.drag[i, 1] * np.sqrt(dot(v, v)), v)
        add_three(force, i, 3, -loads.drag[i, 2] - loads.drag[i, 3] * np.sqrt(dot(omega, omega)), omega)
        add_three(force, i, 0, 1.0, turned(frame, i, three(wrench, i, 3)))
        add_three(force, i, 3, 1.0, turned(frame, i, three(wrench, i, 0)))
        add_three(force, i, 3, 1.0, three(wrench, i, 6))
        at = plus(three(frame, i, 9), 1.0, turned(frame, i, three(wrench, i, 12)))
        add_force(force, frame, i, at, 1.0, three(wrench, i, 9))
        for k in range(3):
            axis = frame[i, k], frame[i, 3 + k], frame[i, 6 + k]
            add_three(force, i, 3, 1.0, cross(axis, three(wrench, i, 15 + 3 * k)))
        end = point(frame, i, three(wrench, i, 27))
        add_force(force, frame, i, end[0], wrench[i, 33], plus(three(wrench, i, 24), -1.0, end[0]))
        add_force(force, frame, i, end[0], -wrench[i, 34], end[1])
        add_three(force, i, 3, 1.0, three(wrench, i, 30))
        add_three(force, i, 3, -wrench[i, 35], omega)
    _joint_forces(loads, frame, angle, force, angle_rate_out)
