# SPDX-License-Identifier: Apache-2.0
"""Axes of the robustness map: parameters that are driven to their limits, and their values."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from . import problems as problems
from . import stops as stops


@dataclass(frozen=True)
class Axis:
    """Axis of the robustness map.

    name    : one word, for the command line
    title   : meaning of the values
    unit    : unit of the values, or ""
    values  : values in the order of the map
    problem : function that returns the Problem for a value
    alike   : value at which the problem has its natural scale; the errors of scaled problems must
              be similar, see cell.ALIKE. None: the problems differ in more than their scale
    quick   : values for tests and `--quick`
    long    : whether the axis takes long and runs on request only
    """

    name: str
    title: str
    unit: str
    values: tuple
    problem: Callable
    alike: float | None = None
    quick: tuple = ()
    long: bool = False


def _powers(first, last, every=1):
    return tuple(float(f"1e{k}") for k in range(first, last + 1, every))


_TURNS = (0.1, 0.5, 1.0, 2.0, 3.0, np.pi, 3.5, 5.0, 6.1, 2 * np.pi, 7.0, 10.0, 30.0)
_RATIOS = (1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6)
_MASSES = _powers(-8, 8, 2)
_ANGLES = (1e-250, 1e-200, 1e-160, 1e-100, 1e-30, 1e-16, 1e-12, 1e-8, 1e-4, 1e-2, 1.0)
_STEPS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3)

AXES = (
    Axis(
        "step_free",
        "step, free body over 16 s",
        "s",
        (8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.125, 0.0625, 0.015625),
        problems.step_free,
        quick=(8.0, 1.0, 0.25),
    ),
    Axis("step_top", "step, top at 30 rad/s", "s", _STEPS, problems.step_top, quick=(0.5, 0.02)),
    Axis("step_stiff", "step, top on a spring of 1e4 N/m", "s", _STEPS, problems.step_stiff, quick=(0.02,)),
    Axis("step_bars", "step, four-bar at 20 to 54 rad/s", "s", _STEPS, problems.step_bars, quick=(0.01,)),
    Axis("turn", "turn in a step, free body", "rad", _TURNS, problems.turn, quick=(1.0, np.pi)),
    Axis("turn_steady", "turn in a step, about a principal axis", "rad", _TURNS, problems.steady_turn, quick=(7.0,)),
    Axis("spin_free", "spin, free body at 1 ms", "rad/s", _powers(-6, 5), problems.spin_free, quick=(1e-6, 1e3)),
    Axis("spin_top", "spin, top at 1 ms", "rad/s", _powers(-6, 5), problems.spin_top, quick=(1e3,)),
    Axis(
        "angle",
        "amplitude, pendulum, 0.1 rad of its swing a step",
        "rad",
        _ANGLES,
        problems.angle,
        alike=1e-2,
        quick=(1e-250, 1e-2),
    ),
    Axis(
        "angle_coarse",
        "amplitude, pendulum, 1 rad of its swing a step",
        "rad",
        _ANGLES,
        partial(problems.angle, part=1.0),
        quick=(1e-4,),
    ),
    Axis("mass_chain", "mass ratio, two rods", "", _MASSES, problems.mass_chain, quick=(1e8,)),
    Axis("mass_spring", "mass ratio, two bodies on a spring", "", _MASSES, problems.mass_spring, quick=(1e-8,)),
    Axis("inertia_rod", "inertia ratio, rod at 0.05 s", "", _RATIOS, problems.inertia_rod, quick=(1e3,)),
    Axis(
        "inertia_rod_coarse",
        "inertia ratio, rod at 0.2 s",
        "",
        _RATIOS,
        partial(problems.inertia_rod, step=0.2),
        quick=(1e2,),
    ),
    Axis(
        "inertia_limit",
        "inertia ratio at the triangle limit, 0.05 s",
        "",
        _RATIOS,
        problems.inertia_limit,
        quick=(1e6,),
    ),
    Axis("length_top", "length, top", "m", _powers(-6, 6), problems.length_top, alike=1.0, quick=(1e-6, 1.0)),
    Axis("length_bars", "length, four-bar", "m", _powers(-6, 6), problems.length_bars, alike=1.0, quick=(1.0, 1e6)),
    Axis("stiff", "stiffness, top at 1 ms", "N/m", _powers(2, 9), problems.stiff, quick=(1e6,)),
    Axis("stiff_damped", "stiffness, with damping", "N/m", _powers(2, 9), problems.stiff_damped, quick=(1e8,)),
    Axis("redundant", "hinges of a door", "", (1.0, 2.0, 3.0, 5.0, 9.0), problems.redundant, quick=(3.0,)),
    Axis(
        "flat",
        "rate through flat poses, parallelogram",
        "rad/s",
        (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0),
        problems.flat,
        quick=(10.0,),
    ),
    Axis(
        "flat_projected",
        "the same with projection",
        "rad/s",
        (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0),
        partial(problems.flat, stabilisation="projection"),
    ),
    Axis(
        "sleeping",
        "spin relative to the stability limit, sleeping top",
        "",
        (0.5, 0.9, 0.99, 0.999, 0.999999, 1.0, 1.000001, 1.001, 1.01, 1.1, 2.0),
        problems.sleeping,
        quick=(0.99,),
    ),
    Axis("racket", "offset from the middle axis, 0.05 s", "", _powers(-10, -2, 2), problems.racket, quick=(1e-6,)),
    Axis(
        "racket_coarse",
        "offset from the middle axis, 0.5 s",
        "",
        _powers(-10, -2, 2),
        partial(problems.racket, step=0.5),
    ),
    Axis(
        "restitution",
        "restitution, bouncing ball",
        "",
        (0.0, 0.1, 0.5, 0.9, 0.99, 1.0),
        stops.restitution,
        quick=(0.5,),
    ),
    Axis(
        "stop_stiffness", "stiffness of an elastic stop", "N/m", _powers(2, 10, 2), stops.stop_stiffness, quick=(1e4,)
    ),
    Axis(
        "friction",
        "dry friction relative to the spring's force",
        "",
        (1e-8, 1e-4, 1e-2, 0.03, 0.13, 0.4, 0.99, 1.01, 10.0),
        stops.friction,
        quick=(0.13,),
    ),
    Axis("cable", "restitution of a cable", "", (0.0, 0.1, 0.5, 0.9, 0.99, 1.0), stops.cable, quick=(0.5,)),
    Axis("simultaneous", "balls in a row, simultaneous impacts", "", (2, 3, 5, 10, 30), stops.simultaneous, quick=(5,)),
    Axis("bounces", "bounces between two stops", "1/s", _powers(0, 5), stops.bounces, quick=(1e2,)),
    Axis(
        "steps", "number of steps, free body at 0.05 s", "", (1e3, 1e4, 1e5, 1e6, 1e7), problems.steps_free, long=True
    ),
)
