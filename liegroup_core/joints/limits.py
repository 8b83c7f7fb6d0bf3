# SPDX-License-Identifier: Apache-2.0
"""Limits of commands to a joint. A command beyond them is refused; the simulation does not enforce them.

They are the numbers lower, upper, velocity and effort in `data` of the joint; for a robot, those of its
file. A velocity or effort of zero or less means no limit, because files use it for unknown values.
Without a velocity limit, SPEED applies, so that every permitted motion can be integrated.
"""

import math
from typing import NamedTuple

import numpy as np

from liegroup_core.fields.arguments import finite, got, is_finite
from liegroup_core.fields.values import LARGEST_NUMBER

from .coupling import turns
from .motion import extremes, peak_rate

SPEED = 1e3  # rad/s, or characteristic lengths per s
ROUNDING = 1e-9  # relative tolerance, because limits are printed with fewer digits


class BeyondLimits(ValueError):
    """A command that is beyond the limits of its joint; one line of text."""


def usable(what, given, shape):
    """`finite` numbers up to LARGEST_NUMBER. Raises ValueError, and BeyondLimits for a larger one."""
    numbers = finite(what, given, shape)
    if (largest := np.abs(numbers).max(initial=0.0)) > LARGEST_NUMBER:
        raise BeyondLimits(f"{what}: {largest:g} is too large, the limit is {LARGEST_NUMBER:g}")
    return numbers


def check_number(what, value):
    """Raise the errors of `usable` for what is not one usable number."""
    if not is_finite(value):
        raise ValueError(f"{what}, {got(value)}")
    usable(what, value, ())


class CommandLimits(NamedTuple):
    """Limits of the commands to one joint."""

    joint: str
    unit: str  # "rad" or "m"
    lower: float  # rad or m
    upper: float
    speed: float  # rad/s or m/s
    effort: float  # N m or N

    def check_position(self, position):
        """Raises BeyondLimits."""
        if not self.holds(position):
            raise BeyondLimits(
                f"position {position:.6g} {self.unit} of joint {self.joint!r} is beyond its limits, "
                f"{self.lower:.6g} to {self.upper:.6g} {self.unit}"
            )

    def holds(self, position):
        """Whether a position is within the limits, up to their digits."""
        slack = ROUNDING * max(1.0, abs(position))
        return self.lower - slack <= position <= self.upper + slack

    def check_velocity(self, velocity):
        """Raises BeyondLimits."""
        if abs(velocity) > self.speed * (1.0 + ROUNDING):
            raise BeyondLimits(
                f"velocity {velocity:.6g} {self.unit}/s of joint {self.joint!r} is beyond its limit of {self._speed}"
            )

    def check_effort(self, effort):
        """Raises BeyondLimits."""
        if abs(effort) > self.effort * (1.0 + ROUNDING):
            unit = "N m" if self.unit == "rad" else "N"
            raise BeyondLimits(
                f"effort {effort:.6g} {unit} of joint {self.joint!r} is beyond its limit of {self.effort:.6g} {unit}"
            )

    def check_jump(self, before, after):
        """Check a commanded servo position against the previous one. Raises BeyondLimits.

        Position limits suffice. Without them, a jump may be at most the speed limit times one second.
        """
        self.check_position(after)
        free = math.isinf(self.lower) or math.isinf(self.upper)
        if free and abs(after - before) > self.speed:
            raise BeyondLimits(
                f"joint {self.joint!r} cannot jump from {before:.6g} to {after:.6g} {self.unit}: approach "
                f"it in steps of at most {self.speed:.6g} {self.unit}"
            )

    def check_motion(self, rows, positions, velocities, start=None):
        """Check a whole motion through positions and velocities, or velocities alone.

        rows  : (m + 1, COLUMNS) of joints/motion.py
        start : (position, rate) of the joint; None: the start of the rows. The joint may keep a rate
                above its limit, and return from beyond its position limits
        Raises BeyondLimits.
        """
        position, rate = rows[0][1:3] if start is None else start
        for velocity in () if velocities is None else velocities:
            self.check_velocity(velocity)
        if positions is None:
            return
        for end in positions:
            self.check_position(end)
        most = max(self.speed, abs(rate)) * (1.0 + ROUNDING)
        returns = not self.holds(position)
        for row, after in zip(rows, rows[1:]):
            duration, end = after[0] - row[0], after[1]
            needed = peak_rate(row, duration, most)
            if not needed <= most:
                raise BeyondLimits(
                    f"joint {self.joint!r} would need {needed:.6g} {self.unit}/s to reach "
                    f"{end:.6g} {self.unit} in time, beyond its limit of {self._speed}: give a nearer "
                    "position, or more time"
                )
            for between in () if returns else extremes(row, duration, self.lower, self.upper):
                if not self.holds(between):
                    raise BeyondLimits(
                        f"joint {self.joint!r} would pass {between:.6g} {self.unit} on its way to "
                        f"{end:.6g} {self.unit}, beyond its limits, {self.lower:.6g} to {self.upper:.6g} "
                        f"{self.unit}: give a lower velocity, or less time"
                    )
            returns = False

    @property
    def _speed(self):
        return f"{self.speed:.6g} {self.unit}/s (velocity in its data)"


def limits_of(joint, size):
    """CommandLimits of a joint with one coordinate; size : characteristic length in m."""
    data, angle = joint.data or {}, turns(joint)
    lower, upper = data.get("lower", -math.inf), data.get("upper", math.inf)
    if lower > upper:  # an error of the robot file, reported in the notes of the scene
        lower, upper = -math.inf, math.inf
    speed, effort = (
        number if (number := data.get(key, 0.0)) > 0.0 else otherwise
        for key, otherwise in (("velocity", SPEED if angle else SPEED * size), ("effort", math.inf))
    )
    return CommandLimits(joint.name, "rad" if angle else "m", lower, upper, speed, effort)
