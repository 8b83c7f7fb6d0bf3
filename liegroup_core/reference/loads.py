# SPDX-License-Identifier: Apache-2.0
"""Gravity and all forces of a scene, with unit quaternions and in world axes.

Forces between bodies act along the line between two points, about the z axis of a joint, or along
that axis. Each of them is linear in coordinate and rate:

    constant - stiffness * coordinate - damping * rate, within +- limit

A spring at rest at x0 has constant = stiffness * x0. A motor with a rate limit has
damping = |its force| / limit. Only servos have a limit, of the force or torque.
"""

from typing import NamedTuple

import numpy as np

from liegroup_core.compiling import subroutine

from .equations import GROUND, direction, point, rotate, rotate_back, turning


class Loads(NamedTuple):
    """Gravity and forces of a scene of n bodies; a law is (constant, stiffness, damping, limit)."""

    gravity: np.ndarray  # (3,) m/s^2
    line_body: np.ndarray  # (l, 2) parent, child; GROUND = -1
    line_point: np.ndarray  # (l, 2, 3) m, in the frames of the two
    line_law: np.ndarray  # (l, 4) N, N/m, N s/m, N; coordinate: the length
    turn_body: np.ndarray  # (t, 2)
    turn_axis: np.ndarray  # (t, 3) z of the joint in the parent's axes
    turn_law: np.ndarray  # (t, 4) N m, N m/rad, N m s/rad, N m; coordinate: the angle; zero for screws
    slide_body: np.ndarray  # (s, 2)
    slide_point: np.ndarray  # (s, 2, 3) m, origins of the joint frames
    slide_axis: np.ndarray  # (s, 3) z of the joint in the parent's axes
    slide_law: np.ndarray  # (s, 4) N, N/m, N s/m, N; coordinate: origin of the child's frame along z
    drag: np.ndarray  # (n, 4) N s/m, N s^2/m^2, N m s, N m s^2: linear, quadratic, the same angular
    push_body: np.ndarray  # (p,) bodies of the applied wrenches
    push_world: np.ndarray  # (p,) True: constant in world axes, False: in body axes
    push_point: np.ndarray  # (p, 3) m
    push_load: np.ndarray  # (p, 6) torque N m, force N


@subroutine
def _add_force(force, state, body, offset, f):
    """Add a force, world axes, at a body-fixed point; offset: (3,) m, body frame."""
    if body != GROUND:
        force[body, 0:3] += f
        force[body, 3:6] += np.cross(offset, rotate_back(state[body, 0:4], f))


@subroutine
def _add_torque(force, state, body, torque):
    """Add a torque, world axes, on a body."""
    if body != GROUND:
        force[body, 3:6] += rotate_back(state[body, 0:4], torque)


@subroutine
def _lines(loads, state, force):
    for i in range(len(loads.line_body)):
        parent, child = loads.line_body[i]
        start = point(state, parent, loads.line_point[i, 0])
        end = point(state, child, loads.line_point[i, 1])
        constant, stiffness, damping, _ = loads.line_law[i]
        d = end[0] - start[0]
        length = np.sqrt(np.dot(d, d))
        f = -stiffness * d
        if length > 0.0:
            unit = d / length
            f += (constant - damping * np.dot(unit, end[1] - start[1])) * unit
        _add_force(force, state, child, loads.line_point[i, 1], f)
        _add_force(force, state, parent, loads.line_point[i, 0], -f)


@subroutine
def _turns(loads, state, angle, force, angle_rate_out):
    for i in range(len(loads.turn_body)):
        parent, child = loads.turn_body[i]
        axis = direction(state, parent, loads.turn_axis[i])[0]
        angle_rate_out[i] = np.dot(axis, turning(state, parent, child))
        constant, stiffness, damping, limit = loads.turn_law[i]
        torque = constant - stiffness * angle[i] - damping * angle_rate_out[i]
        torque = min(max(torque, -limit), limit) * axis
        _add_torque(force, state, child, torque)
        _add_torque(force, state, parent, -torque)


@subroutine
def _slides(loads, state, force):
    for i in range(len(loads.slide_body)):
        parent, child = loads.slide_body[i]
        axis = direction(state, parent, loads.slide_axis[i])
        end = point(state, child, loads.slide_point[i, 1])
        d = end - point(state, parent, loads.slide_point[i, 0])
        constant, stiffness, damping, limit = loads.slide_law[i]
        f = constant - stiffness * np.dot(axis[0], d[0]) - damping * (np.dot(axis[1], d[0]) + np.dot(axis[0], d[1]))
        f = min(max(f, -limit), limit) * axis[0]
        _add_force(force, state, child, loads.slide_point[i, 1], f)
        if parent != GROUND:  # at the same point, so that the wrenches on both bodies cancel
            arm = end[0] - state[parent, 4:7]
            force[parent, 0:3] -= f
            force[parent, 3:6] -= rotate_back(state[parent, 0:4], np.cross(arm, f))


@subroutine
def add_loads(loads, mass, state, angle, wrench, acting, force, angle_rate_out):
    """Add gravity, external wrenches and all forces of the scene at one state to `force`.

    mass   : (n,) kg
    state  : (n, 13), see rigid_body_dae.py
    angle  : (t,) rad, of the joints with an integrated angle
    wrench : (n, 24) external wrenches: (6) body axes, about the centre of mass; (6) world axes,
             about the point (3) of the body, relative to the centre of mass; (9) forces in world axes
             1 m from this point along x, y and z of the body, whose opposites act at this point
    acting : (p,) mask of the applied wrenches
    force  : (n, 6) force in N, world axes; torque in N m, body axes, about the centre of mass
    angle_rate_out : (t,) rad/s
    """
    for i in range(len(mass)):
        q, v, omega = state[i, 0:4], state[i, 7:10], state[i, 10:13]
        linear, quadratic, angular, angular_quadratic = loads.drag[i]
        force[i, 0:3] += (
            mass[i] * loads.gravity + rotate(q, wrench[i, 3:6]) - (linear + quadratic * np.sqrt(np.dot(v, v))) * v
        )
        force[i, 3:6] += wrench[i, 0:3] - (angular + angular_quadratic * np.sqrt(np.dot(omega, omega))) * omega
        if wrench[i, 6:12].any():
            _add_torque(force, state, i, wrench[i, 6:9])
            _add_force(force, state, i, wrench[i, 12:15], wrench[i, 9:12])
        for k in range(3):
            f = wrench[i, 15 + 3 * k : 18 + 3 * k]
            if f.any():
                end = wrench[i, 12:15].copy()
                end[k] += 1.0
                _add_force(force, state, i, end, f)
                _add_force(force, state, i, wrench[i, 12:15], -f)
    _lines(loads, state, force)
    _turns(loads, state, angle, force, angle_rate_out)
    _slides(loads, state, force)
    for i in range(len(loads.push_body)):
        if acting[i]:
            body = loads.push_body[i]
            torque, f = loads.push_load[i, 0:3], loads.push_load[i, 3:6]
            if not loads.push_world[i]:
                torque, f = rotate(state[body, 0:4], torque), rotate(state[body, 0:4], f)
            _add_torque(force, state, body, torque)
            _add_force(force, state, body, loads.push_point[i], f)
