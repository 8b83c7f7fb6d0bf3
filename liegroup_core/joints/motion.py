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
from liegroup_core.fields.values import Described, Flag, Number, listed

COLUMNS = 7
REACH = 1.25  # of the lower slope beside a point: largest velocity with which accelerations of 0 are monotone
NEGLIGIBLE = 1e-6  # part of the range of a motion
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

    monotone: Flag = Field(
        False,
        description="true: between two times the joint stays between their positions, so that it rests between "
        "equal ones; replaces velocities, and is less smooth than the spline",
    )

    @model_validator(mode="after")
    def _check(self):
        if self.monotone and self.velocities is not None:
            raise SceneError("monotone and velocities both define the velocities: keep one", place=("monotone",))
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


def _monotone(times, q, v0, a0):
    """Velocities and accelerations (m + 1,) at points with which quintics between them are monotone.

    Velocities are those of Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5, 1984), at most REACH times the lower
    slope. The derivative of a quintic has the Bernstein coefficients v0, v0 + T a0 / 4, 5 dq/T - 2 (v0 + v1) +
    T (a1 - a0) / 4, v1 - T a1 / 4 and v1. Accelerations are those of the cubics, bounded so that none changes its sign.
    """
    T, dq = np.diff(times), np.diff(q)
    size, sign = np.abs(dq) / T, np.where(dq[:-1] * dq[1:] > 0.0, np.sign(dq[1:]), 0.0)
    before, after = size[:-1], size[1:]
    w = 2.0 * T[1:] + T[:-1], T[1:] + 2.0 * T[:-1]
    with np.errstate(divide="ignore"):
        mean = (w[0] + w[1]) / (w[0] / before + w[1] / after)
    v = np.array([v0, *(sign * np.minimum(mean, REACH * np.minimum(before, after))), 0.0])
    a = np.array([a0, *_cubic_accelerations(T, dq, v)])
    room = np.maximum(0.0, 10.0 * size - 4.0 * np.abs(v[:-1] + v[1:])) / T
    steep = 4.0 * np.abs(v[1:-1])
    least, most = -np.minimum(steep / T[1:], room[:-1]), np.minimum(steep / T[:-1], room[1:])
    a[1:-1] = sign * np.clip(sign * a[1:-1], least, most)
    return v, a


def _cubic_accelerations(T, dq, v):
    """Means of the accelerations of the cubics before and after points (m,), 0 at the last one."""
    first = 6.0 * dq / T**2 - (4.0 * v[:-1] + 2.0 * v[1:]) / T
    last = -6.0 * dq / T**2 + (2.0 * v[:-1] + 4.0 * v[1:]) / T
    return np.append(0.5 * (last[:-1] + first[1:]), 0.0)


def overshoot(rows):
    """(time, positions at two neighbouring points, distance by which a motion leaves their range), or None.

    It counts where it exceeds the distance of the points, and is the largest of these. rows : (m, COLUMNS)
    """
    q = rows[:, 1]
    low, high = np.minimum(q[:-1], q[1:]), np.maximum(q[:-1], q[1:])
    s = np.diff(rows[:, :1], axis=0) * np.linspace(0.0, 1.0, 65)
    path = sum(rows[:-1, 1 + k, None] * s**k for k in range(6))
    by = np.maximum(low - path.min(axis=1), path.max(axis=1) - high)
    by[by <= np.maximum(high - low, NEGLIGIBLE * np.ptp(q))] = 0.0
    k = int(by.argmax()) if by.any() else None
    return None if k is None else (*rows[k, :2], q[k + 1], by[k])


def through(start, times, positions, velocities=None, accelerations=None, monotone=False):
    """Motions (m + 1, COLUMNS) through m points; the last row continues at the last rate.

    start : (position, rate, acceleration) at times[0]
    times : (m + 1,) s, increasing;  positions, velocities, accelerations : (m,) at times[1:]
    Default velocities are those of the cubic spline that ends at rest. Default accelerations are the means
    of the cubics on both sides, and 0 at the end. Default positions are integrals of the cubic spline of
    the velocities. monotone : replace both by those of `_monotone`
    """
    times = np.asarray(times, dtype=float)
    if positions is None:
        v = np.array([start[1], *velocities])
        spline = scipy.interpolate.CubicSpline(times, v, bc_type=((1, start[2]), (1, 0.0)))
        positions = [start[0] + spline.integrate(times[0], time) for time in times[1:]]
        accelerations = [*spline(times[1:-1], 1), 0.0]
    q = np.array([start[0], *positions])
    if monotone:
        velocities, accelerations = (part[1:] for part in _monotone(times, q, *start[1:]))
    elif velocities is None:
        velocities = scipy.interpolate.CubicSpline(times, q, bc_type=((1, start[1]), (1, 0.0)))(times[1:], 1)
    v = np.array([start[1], *velocities])
    if accelerations is None:
        accelerations = _cubic_accelerations(np.diff(times), np.diff(q), v)
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
    return through((motion.positions[0], v0, a0), motion.times, motion.positions[1:], *rest, motion.monotone)


def row_at(rows, time):
    """Row (COLUMNS,) that holds at a time, or rows (m, COLUMNS); rows: motions in the order of their origins."""
    return rows[np.maximum(0, np.searchsorted(rows[:, 0], time, side="right") - 1)]


FROM_SCENE = np.array([math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # no command: the scene's motion holds
