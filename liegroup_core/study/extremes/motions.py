# SPDX-License-Identifier: Apache-2.0
"""Reference solutions of the stress tests, independent of the engine.

A motion is a function of times (k,) in s, increasing from 0, that returns a ReferenceMotion. Free bodies and
symmetric tops use Jacobi's elliptic functions (reference/elliptic.py). Mechanisms of one degree of
freedom use an equation in one angle. All others use the integration of reference/trajectory.py,
with its own uncertainty.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from liegroup_core.mechanism.body_model import initial_state
from liegroup_core.reference import integrate
from liegroup_core.scene.assembly import ready

DIGITS = 25
# Tolerance for equations in one or two angles, and the error of their solution after several hundred
# radians, relative to the largest angle.
TIGHT, ANGLE_ERROR = 1e-13, 1e-9


class ReferenceMotion(NamedTuple):
    """Reference solution of n bodies at k times."""

    rotation: np.ndarray  # (k, n, 3, 3) body -> world
    position: np.ndarray  # (k, n, 3) m, world, of the body frames
    uncertainty: float  # rad; for positions, relative to the length of the problem


def free_body(inertia, omega):
    """Free body about its centre of mass at the origin; initially aligned with the world."""
    from liegroup_core.reference import elliptic

    def motion(times):
        R = [elliptic.to_floats(elliptic.free_body(inertia, np.eye(3), omega, t, DIGITS)[0]) for t in times.tolist()]
        # Only round-off of times and initial state; the elliptic functions are exact.
        turned = np.linalg.norm(omega) * times[-1]
        return ReferenceMotion(np.array(R)[:, None], np.zeros((len(times), 1, 3)), 1e-15 * (1.0 + turned))

    return motion


def spinning(axis, rate):
    """Steady rotation about a fixed axis through the origin, rad/s."""
    axis = np.asarray(axis, dtype=float)
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])

    def motion(times):
        angle = (rate * times)[:, None, None]
        R = np.eye(3) + np.sin(angle) * skew + 2.0 * np.sin(0.5 * angle) ** 2 * skew @ skew
        return ReferenceMotion(R[:, None], np.zeros((len(times), 1, 3)), 1e-15 * (1.0 + rate * times[-1]))

    return motion


def top(body, field, rotation=np.eye(3)):
    """Symmetric top on a spherical joint at the origin, in a constant force field in N.

    body : Body of the scene with its frame at the centre of mass. The axis of symmetry passes through
           the joint, whose position in the body is -rotation^T position
    """
    from liegroup_core.reference import elliptic

    arm = rotation.T @ np.array(body.position)
    length = np.linalg.norm(arm)
    axis = arm / length
    spin = float(axis @ body.inertia_matrix @ axis)
    across = 0.5 * (np.trace(body.inertia_matrix) - spin)

    def motion(times):
        R = np.array(
            [
                elliptic.to_floats(
                    elliptic.heavy_top(
                        across + body.mass * length**2,
                        spin,
                        body.mass * length,
                        axis,
                        np.asarray(field) / body.mass,
                        rotation,
                        body.angular_velocity,
                        t,
                        DIGITS,
                    )[0]
                )
                for t in times.tolist()
            ]
        )
        turned = np.linalg.norm(body.angular_velocity) * times[-1]
        # Near an unstable motion, round-off of the initial state grows; see the horizons of the axes.
        return ReferenceMotion(R[:, None], (R @ arm)[:, None], 1e-12 * (1.0 + turned))

    return motion


def one_angle(acceleration, start, rate, place):
    """Mechanism of one degree of freedom with angle'' = acceleration(angle).

    place : function of angles (k,) -> (rotation (k, n, 3, 3), position (k, n, 3))
    """

    def motion(times):
        found = _solved(lambda t, y: (y[1], acceleration(y[0])), times, (start, rate))
        return ReferenceMotion(*place(found[0]), ANGLE_ERROR * min(1.0, np.abs(found[0]).max()))

    return motion


def two_rods(rods, gravity):
    """Two rods of 1 m on revolute joints about y, hung at the origin, released along world x.

    rods : (mass, moment of inertia about the middle, across) of each; frames at the near ends
    """
    (m1, I1), (m2, I2) = rods
    A, B, C = I1 + 0.25 * m1 + m2, I2 / m2 + 0.25, 0.5  # the second equation is divided by m2

    def rate(t, y):
        a, b, da, db = y
        c, s = np.cos(a - b), np.sin(a - b)
        first = -m2 * C * s * db * db - gravity * (0.5 * m1 + m2) * np.cos(a)
        second = C * s * da * da - 0.5 * gravity * np.cos(b)
        det = A * B - m2 * C * C * c * c
        return da, db, (B * first - m2 * C * c * second) / det, (A * second - C * c * first) / det

    def motion(times):
        a, b, _, _ = _solved(rate, times, (0.0, 0.0, 0.0, 0.0))
        R = np.stack([about(1, -a), about(1, -b)], axis=1)
        zero = np.zeros_like(a)
        far = np.stack([np.cos(a), zero, np.sin(a)], axis=-1)
        return ReferenceMotion(R, np.stack([np.zeros_like(far), far], axis=1), ANGLE_ERROR)

    return motion


def four_bar(crank, rate, bars, length):
    """Planar four-bar without forces: energy conservation gives the speed at each crank angle.

    crank : length of the crank relative to `length`, which is that of coupler, rocker and ground
    rate  : rad/s of the crank at time 0, when it is upright
    bars  : (mass, moment of inertia about the middle over length^2) of crank, coupler, rocker;
            frames at their middles
    """
    (m1, I1), (m2, I2), (m3, I3) = bars

    def places(angle):
        """Tip A of the crank, B between coupler and rocker, and the pin of the rocker, (..., 2)."""
        A = crank * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        D = np.array([1.0, 0.0])
        half = 0.5 * (D - A)
        square = (half * half).sum(axis=-1, keepdims=True)
        across = np.stack([-half[..., 1], half[..., 0]], axis=-1)
        return A, A + half + np.sqrt(1.0 / square - 1.0) * across, D

    def speed(t, y):
        A, B, D = places(y[0])
        dA = np.array([-A[1], A[0]])
        along, rocker = B - A, B - D
        dB = np.linalg.solve([along, rocker], [along @ dA, 0.0])
        turn = along[0] * (dB - dA)[1] - along[1] * (dB - dA)[0]
        swing = rocker[0] * dB[1] - rocker[1] * dB[0]
        middle = 0.5 * (dA + dB)
        return (
            np.sqrt(
                2.0
                * energy
                / (I1 + 0.25 * m1 * crank**2 + m2 * middle @ middle + I2 * turn**2 + (I3 + 0.25 * m3) * swing**2)
            ),
        )

    energy = 0.5
    energy = 0.5 * (rate / speed(0.0, (0.5 * np.pi,))[0]) ** 2

    def motion(times):
        (angle,) = _solved(speed, times, (0.5 * np.pi,))
        A, B, D = places(angle)
        links = A, B - A, B - D
        middles = 0.5 * A, 0.5 * (A + B), 0.5 * (B + D)
        R = np.stack([about(2, np.arctan2(x[:, 1], x[:, 0])) for x in links], axis=1)
        position = np.stack([np.pad(x, ((0, 0), (0, 1))) for x in middles], axis=1)
        return ReferenceMotion(R, length * position, ANGLE_ERROR)

    return motion


def _solved(rate, times, start):
    """Solution (len(start), k) of an equation at times from 0 on, by DOP853."""
    start = np.asarray(start, dtype=float)
    if not times[-1] > 0.0:
        return np.repeat(start[:, None], len(times), axis=1)
    return solve_ivp(
        rate, (0.0, times[-1]), start, "DOP853", times, rtol=TIGHT, atol=TIGHT * (np.abs(start).max() or 1.0)
    ).y


def linear_swing(amplitude, frequency, place):
    """Mechanism of one degree of freedom, from rest, with small (linear) oscillations."""

    def motion(times):
        return ReferenceMotion(*place(amplitude * np.cos(frequency * times)), 1e-13 * amplitude)

    return motion


def integrated(scene, length, scale=1.0, time_scale=1.0, shown=None):
    """Reference integration of a scene, with positions and times scaled by `scale` and `time_scale`.

    shown : names of the bodies to return
    """
    described, centred = ready(scene)
    rows = [i for i, body in enumerate(described.bodies) if shown is None or body.name in shown]

    def motion(times):
        found, apart = integrate(scene, *initial_state(centred), times / time_scale)
        uncertainty = max(apart.angle[:, rows].max(), apart.position[:, rows].max() / length)
        return ReferenceMotion(found.rotation[:, rows], scale * found.position[:, rows], uncertainty)

    return motion


def about(axis, angles):
    """Rotations (k, 3, 3) by angles (k,) about coordinate axis 0 to 2, accurate for tiny angles."""
    c, s = np.cos(angles), np.sin(angles)
    R = np.zeros((len(angles), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[:, axis, axis] = 1.0
    R[:, i, i] = R[:, j, j] = c
    R[:, j, i], R[:, i, j] = s, -s
    return R
