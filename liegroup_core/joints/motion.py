# SPDX-License-Identifier: Apache-2.0
"""Prescribed motions of driven joints: piecewise quintic polynomials of time, twice differentiable.

    q(t) = c0 + c1 s + ... + c5 s^5 ,   s = t - origin

A driven joint has a rheonomic row: the rate of its coordinate is qdot(t), its acceleration qddot(t).
The multiplier of the row is the effort that the motion requires.

A motion is a row of COLUMNS numbers: origin in s, then c0 to c5. It holds until the origin of the next
row, where position, rate and acceleration of both agree.
"""

import math
from typing import Annotated

import numpy as np
import scipy
from pydantic import BeforeValidator, Field, model_validator

from liegroup_core.compiling import kernel
from liegroup_core.errors import SceneError
from liegroup_core.fields.values import Described, Number, listed

COLUMNS = 7
# Quintic of s in [0, 1] from position, rate and acceleration at both ends: matrix for c3, c4, c5 from the
# differences to the end values after subtracting the quadratic of the start values.
_END = np.array([[10.0, -4.0, 0.5], [-15.0, 7.0, -1.0], [6.0, -3.0, 0.5]])

Numbers = Annotated[tuple[Number, ...], BeforeValidator(listed)]


class Motion(Described):
    """Prescribed motion of a joint through points. After the last point, the joint keeps its last velocity."""

    times: Numbers = Field(description="increasing times in s; the first is 0")
    positions: Numbers = Field(
        description="joint coordinate at each time in m, or in rad, which may exceed 2 pi; the first "
        "must be that of the initial poses"
    )
    velocities: Numbers | None = Field(
        None,
        description="rate in rad/s or m/s at each time; default: from the cubic spline through the "
        "points that starts with the joint's initial rate and ends at rest",
    )
    accelerations: Numbers | None = Field(
        None,
        description="acceleration in rad/s^2 or m/s^2 at each time; requires velocities; default: the mean of "
        "the accelerations before and after the time",
    )

    @model_validator(mode="after")
    def _check(self):
        if len(self.times) < 2:
            raise SceneError("times needs at least two numbers", place=("times",))
        if self.times[0] != 0.0:
            raise SceneError(f"times must start with 0, got {self.times[0]:g}", place=("times", 0))
        for i, (before, after) in enumerate(zip(self.times, self.times[1:]), 1):
            if not after > before:
                raise SceneError(f"times must increase, got {after:g} after {before:g}", place=("times", i))
        for key in ("positions", "velocities", "accelerations"):
            given = getattr(self, key)
            if given is not None and len(given) != len(self.times):
                raise SceneError(
                    f"{key} must have as many numbers as times, {len(self.times)}, got {len(given)}", place=(key,)
                )
        if self.accelerations is not None:
            if self.velocities is None:
                raise SceneError("accelerations require velocities", place=("accelerations",))
            if self.accelerations[-1] != 0.0:
                raise SceneError(
                    "the last acceleration must be 0, because the joint keeps its last rate",
                    place=("accelerations", len(self.times) - 1),
                )
        return self


@kernel
def position(motions, d, time):
    """Coordinate of motion d at a time, rad or m."""
    s = time - motions[d, 0]
    total = motions[d, 6]
    for k in range(5, 0, -1):
        total = total * s + motions[d, k]
    return total


@kernel
def rate(motions, d, time):
    """Rate of motion d at a time, rad/s or m/s."""
    s = time - motions[d, 0]
    total = 5.0 * motions[d, 6]
    for k in range(5, 1, -1):
        total = total * s + (k - 1) * motions[d, k]
    return total


@kernel
def acceleration(motions, d, time):
    """Acceleration of motion d at a time, rad/s^2 or m/s^2."""
    s = time - motions[d, 0]
    total = 20.0 * motions[d, 6]
    for k in range(5, 2, -1):
        total = total * s + (k - 1) * (k - 2) * motions[d, k]
    return total


def at(motion, time):
    """(position, rate, acceleration) of a motion (COLUMNS,) at a time."""
    row = np.asarray(motion, dtype=float)[None]
    return tuple(float(part(row, 0, time)) for part in (position, rate, acceleration))


def peak_rate(motion, duration, enough):
    """Largest absolute rate of a motion (COLUMNS,) within a duration from its origin.

    enough : if a simple bound is below this value, return the bound
    """
    rates = np.arange(1.0, 6.0) * np.asarray(motion[2:], dtype=float) * duration ** np.arange(5.0)
    bound = float(np.abs(rates).sum())
    if bound <= enough or not math.isfinite(bound):
        return bound
    return float(np.abs(_extremes(np.polynomial.Polynomial(rates))).max())


def extremes(motion, duration, least, largest):
    """(least, largest) position of a motion (COLUMNS,) within a duration from its origin.

    least, largest : if simple bounds are within this range, return the bounds
    """
    parts = np.asarray(motion[1:], dtype=float) * duration ** np.arange(6.0)
    reach = float(np.abs(parts[1:]).sum())
    bounds = float(parts[0]) - reach, float(parts[0]) + reach
    if (least <= bounds[0] and bounds[1] <= largest) or not math.isfinite(reach):
        return bounds
    found = _extremes(np.polynomial.Polynomial(parts))
    return float(found.min()), float(found.max())


def _extremes(curve):
    """Values of a polynomial at 0, at 1 and at its stationary points between them."""
    turning = curve.deriv().roots()
    inside = turning.real[(np.abs(turning.imag) < 1e-9) & (turning.real > 0) & (turning.real < 1)]
    return curve(np.array([0.0, 1.0, *inside]))


def uniform(origin, q, v):
    """Motion (COLUMNS,) with constant rate v and position q at the time `origin`."""
    return np.array([origin, q, v, 0.0, 0.0, 0.0, 0.0])


def _quintic(origin, duration, start, end):
    """Motion (COLUMNS,) between `start` and `end`, each (position, rate, acceleration)."""
    q0, v0, a0 = start
    q1, v1, a1 = end
    T = duration
    rest = np.array([q1 - q0 - T * (v0 + 0.5 * T * a0), T * (v1 - v0 - T * a0), T * T * (a1 - a0)])
    return np.array([origin, q0, v0, 0.5 * a0, *(_END @ rest / T ** np.arange(3.0, 6.0))])


def through(start, times, positions, velocities=None, accelerations=None):
    """Motions (m + 1, COLUMNS) through m points; the last row continues at the last rate.

    start : (position, rate, acceleration) at times[0]
    times : (m + 1,) s, increasing;  positions, velocities, accelerations : (m,) at times[1:]
    Default velocities are those of the cubic spline that ends at rest. Default accelerations are the means
    of the cubics on both sides, and 0 at the end. Default positions are integrals of the cubic spline of
    the velocities.
    """
    times = np.asarray(times, dtype=float)
    if positions is None:
        v = np.array([start[1], *velocities])
        spline = scipy.interpolate.CubicSpline(times, v, bc_type=((1, start[2]), (1, 0.0)))
        positions = [start[0] + spline.integrate(times[0], time) for time in times[1:]]
        accelerations = [*spline(times[1:-1], 1), 0.0]
    q = np.array([start[0], *positions])
    if velocities is None:
        velocities = scipy.interpolate.CubicSpline(times, q, bc_type=((1, start[1]), (1, 0.0)))(times[1:], 1)
    v = np.array([start[1], *velocities])
    if accelerations is None:
        T, dq = np.diff(times), np.diff(q)
        # Accelerations of the cubic between two points, at its start and at its end.
        first = 6.0 * dq / T**2 - (4.0 * v[:-1] + 2.0 * v[1:]) / T
        last = -6.0 * dq / T**2 + (2.0 * v[:-1] + 4.0 * v[1:]) / T
        accelerations = np.append(0.5 * (last[:-1] + first[1:]), 0.0)
    points = list(zip(q, v, [start[2], *accelerations]))
    rows = [
        _quintic(origin, after - origin, *pair)
        for origin, after, pair in zip(times, times[1:], zip(points, points[1:]))
    ]
    return np.array([*rows, uniform(times[-1], *points[-1][:2])])


def prescribed(motion, q, v):
    """Motions (m, COLUMNS) of a driven joint of a scene.

    motion : Motion, or True for a constant rate
    q, v   : coordinate and rate at the initial poses and twists
    """
    if motion is True:
        return uniform(0.0, q, v)[None]
    v0 = v if motion.velocities is None else motion.velocities[0]
    a0 = 0.0 if motion.accelerations is None else motion.accelerations[0]
    rest = [None if part is None else part[1:] for part in (motion.velocities, motion.accelerations)]
    return through((motion.positions[0], v0, a0), motion.times, motion.positions[1:], *rest)


def row_at(rows, time):
    """Row (COLUMNS,) that holds at a time, or rows (m, COLUMNS); rows: motions in the order of their origins."""
    return rows[np.maximum(0, np.searchsorted(rows[:, 0], time, side="right") - 1)]


FROM_SCENE = np.array([math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # no command: the scene's motion holds
