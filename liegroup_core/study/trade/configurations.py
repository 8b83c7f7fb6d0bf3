# SPDX-License-Identifier: Apache-2.0
"""Configurations of a scene: methods, groups, stabilisations, and ladders of steps.

A ladder is a configuration without its step, or with error control, without its tolerance. Its rungs are
steps of 1, 2, 5 times powers of ten in s, or tolerances of powers of ten, from coarse to fine.
"""

import math
from fractions import Fraction
from typing import NamedTuple

from liegroup_core.methods.families import NOT_ON_SE3, ON_JOINTS, choose_group, fitting_methods
from liegroup_core.methods.table import CONFIGURATION_GROUPS, METHODS, RELATIVE

STABILISATIONS = ("none", "projection")
# Candidates for the best configuration: methods that win in at least one example scene if all are
# measured (docs/which_method.json).
SHORTLIST = (
    "rkmk4",
    "rkmk54",
    "rkmk8",
    "generalized_alpha",
    "stoermer_verlet",
    "coadjoint_rkmk4",
    "coadjoint_rkmk8",
    "constrained_rattle",
    "constrained_rattle8",
)

# Number of evaluations over a horizon, and additional ones near its start, because the initial transient
# of a stiff scene ends before the first regular evaluation.
SAMPLES, EARLY = 100, 10
LEAST_SAMPLES = 5  # with coarse steps, fewer sample times lie on whole steps
COARSEST = Fraction(1, 10)  # first step of a ladder, relative to the horizon
# Longest outer step in s of a method with error control: it ends at every sample, and the node
# publishes at this rate.
OUTER_STEP = Fraction(1, 100)
LOOSEST, TIGHTEST = -3, -13  # exponents of its tolerances


class Ladder(NamedTuple):
    """Configuration without step or tolerance."""

    method: str
    group: str
    stabilisation: str

    @property
    def controlled(self):
        """True if the rungs are tolerances."""
        return METHODS[self.method].controlled


class Configuration(NamedTuple):
    """Configuration of one run: arguments of Simulation."""

    method: str
    step: float
    group: str
    stabilisation: str
    options: tuple = ()  # ((name, value), ...)

    def arguments(self):
        """Keyword arguments of Simulation."""
        named = self._asdict()
        options = named.pop("options")
        return named | dict(options)


def ladders(layout, methods=None, groups=None, stabilisations=None):
    """Ladders of a scene (layout.Layout), without equivalent ones.

    Scenes without joints and methods that satisfy the constraints themselves have no stabilisation.
    Methods with a fixed group have only that one.
    """
    fitting = fitting_methods(layout)
    found = []
    for method in methods or fitting:
        if method not in fitting:
            continue
        family = METHODS[method].family
        for group in _groups(method, layout, groups):
            drifts = layout.relative.cuts if group == RELATIVE else layout.scene.joints
            for kind in stabilisations or STABILISATIONS:
                if kind == "none" or (family == "rkmk" and len(drifts)):
                    found.append(Ladder(method, group, kind))
    return found


def _groups(method, layout, groups):
    """Groups of a method for a scene; groups : groups to choose from, None for all."""
    family = METHODS[method].family
    if family in NOT_ON_SE3:
        # The trajectory is the same in all groups, so one is enough: the user's, or the fastest.
        asked = "auto" if groups is None or layout.needs_relative else "so3xr3"
        if groups and RELATIVE in groups and family in ON_JOINTS:
            asked = RELATIVE
        return (choose_group(method, asked),)
    if layout.needs_relative:
        return (RELATIVE,)
    if groups is None:
        groups = CONFIGURATION_GROUPS
    return [group for group in groups if group != RELATIVE or family in ON_JOINTS]


def steps(horizon):
    """Steps, coarse to fine, that divide a horizon (Fraction, s) and its sample times."""
    power = math.floor(math.log10(horizon * COARSEST)) + 1
    while True:
        for digit in (5, 2, 1):
            step = digit * Fraction(10) ** power
            if (
                step <= horizon * COARSEST
                and horizon % sample_spacing(step, horizon) == 0
                and horizon / sample_spacing(step, horizon) >= LEAST_SAMPLES
            ):
                yield step
        power -= 1


def sample_spacing(step, horizon):
    """Time between samples, s: the least common multiple of the step and horizon / SAMPLES."""
    grid = horizon / SAMPLES
    # The lcm of p/q and r/s in lowest terms is lcm(p, r) / gcd(q, s).
    return Fraction(math.lcm(step.numerator, grid.numerator), math.gcd(step.denominator, grid.denominator))


def sample_times(horizon):
    """Times in s (Fraction) of a horizon at which errors are evaluated, from 0 on."""
    return sorted(
        {horizon * k / SAMPLES for k in range(SAMPLES + 1)}
        | {horizon * k / (SAMPLES * finer) for finer in (10, 100) for k in range(1, EARLY + 1)}
    )


def rungs(ladder, horizon):
    """Configurations of a ladder, coarse to fine; endless except for tolerances."""
    if ladder.controlled:
        step = next(step for step in steps(horizon) if step <= min(OUTER_STEP, horizon / SAMPLES))
        for power in range(LOOSEST, TIGHTEST - 1, -1):
            tolerance = float(f"1e{power}")
            yield Configuration(*ladder[:1], float(step), *ladder[1:], (("rtol", tolerance), ("atol", tolerance)))
    else:
        for step in steps(horizon):
            yield Configuration(*ladder[:1], float(step), *ladder[1:])


def as_time(seconds):
    """Time as Fraction, exactly equal to its decimal text."""
    return Fraction(repr(float(seconds)))
