# SPDX-License-Identifier: Apache-2.0
"""What a scene can be integrated with: methods, groups, stabilisations, and ladders of steps.

A ladder is one choice of all but the step (of a method with error control: but its tolerance).
Its rungs are 1, 2, 5 times powers of ten of a second (powers of ten), from coarse to fine.
"""

import math
from fractions import Fraction
from typing import NamedTuple

from liegroup_core.integrators.families import NOT_ON_SE3, fitting_methods
from liegroup_core.integrators.methods import GROUPS, METHODS

STABILISATIONS = ("none", "projection")
# Where only the best is looked for: what wins in one scene or another of those that come along,
# found by measuring all (docs/which_method.json).
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

# Errors are looked at at so many times of a horizon, and at so many in the first thousandths and
# ten-thousandths of it: a stiff scene begins with a motion that is over before the first of them.
SAMPLES, EARLY = 100, 10
LEAST_SAMPLES = 5  # with coarse steps fewer of them are whole numbers of steps
COARSEST = Fraction(1, 10)  # of the horizon: the first step of a ladder
# A method with error control takes its substeps within steps of at most so much, s: it ends one at
# every sample, and the node publishes that often.
OUTER_STEP = Fraction(1, 100)
LOOSEST, TIGHTEST = -3, -13  # powers of ten of its tolerances


class Ladder(NamedTuple):
    """All of a setting but its step or tolerance."""

    method: str
    group: str
    stabilisation: str

    @property
    def controlled(self):
        """Whether the rungs are tolerances."""
        method = METHODS[self.method]
        return method.family == "rkmk" and method.tableau.e is not None


class Setting(NamedTuple):
    """What one run is made with: arguments of Simulation."""

    method: str
    step: float
    group: str
    stabilisation: str
    options: tuple = ()  # ((name, value), ...)

    def arguments(self):
        """Keyword arguments of Simulation."""
        return {
            "method": self.method,
            "step": self.step,
            "group": self.group,
            "stabilisation": self.stabilisation,
            **dict(self.options),
        }


def ladders(layout, methods=None, groups=None, stabilisations=None):
    """The ladders of a scene (layout.Layout), those left out that would repeat another.

    Without joints there is nothing to stabilise. Methods with a group of their own have that one,
    and those that close the joints by themselves no stabilisation.
    """
    fitting = fitting_methods(layout)
    found = []
    for method in methods or fitting:
        if method not in fitting:
            continue
        family = METHODS[method].family
        alone = family in NOT_ON_SE3
        for group in ("so3xr3",) if alone else groups or tuple(GROUPS):
            for kind in stabilisations or STABILISATIONS:
                if kind == "none" or (family == "rkmk" and layout.scene.joints):
                    found.append(Ladder(method, group, kind))
    return found


def steps(horizon):
    """Steps from coarse to fine that a horizon (Fraction, s) and its samples are multiples of."""
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
    # That of p/q and r/s in lowest terms is lcm(p, r) / gcd(q, s).
    return Fraction(
        math.lcm(step.numerator, grid.numerator), math.gcd(step.denominator, grid.denominator)
    )


def sample_times(horizon):
    """The times, s (Fraction), of a horizon at which errors are looked at, from 0 on."""
    return sorted(
        {horizon * k / SAMPLES for k in range(SAMPLES + 1)}
        | {horizon * k / (SAMPLES * finer) for finer in (10, 100) for k in range(1, EARLY + 1)}
    )


def rungs(ladder, horizon):
    """Settings of a ladder from coarse to fine, without end but for tolerances."""
    if ladder.controlled:
        step = next(step for step in steps(horizon) if step <= min(OUTER_STEP, horizon / SAMPLES))
        for power in range(LOOSEST, TIGHTEST - 1, -1):
            tolerance = float(f"1e{power}")
            yield Setting(
                *ladder[:1], float(step), *ladder[1:], (("rtol", tolerance), ("atol", tolerance))
            )
    else:
        for step in steps(horizon):
            yield Setting(*ladder[:1], float(step), *ladder[1:])


def as_time(seconds):
    """A time as Fraction, exactly the decimal number that was written."""
    return Fraction(repr(float(seconds)))
