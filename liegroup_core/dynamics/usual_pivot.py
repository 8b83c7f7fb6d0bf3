# SPDX-License-Identifier: Apache-2.0
"""The usual pivot of a mechanism: smallest pivot of W of its loops at poses that are not singular.

At a distance t from a singular pose the smallest pivot is t^2 times the usual one. The usual one depends on the
masses: it is between 1 and 1e-4 of the mobility. So a pose is near a singular one if its pivot is a small fraction
of the usual one, which is the largest found at a few poses: the initial pose, and those to which joints turn by
TURNS in random directions in which the loops can move.
"""

import numpy as np

from liegroup_core.compiling import SameTypes, kernel
from liegroup_core.forces.external import COLUMNS
from liegroup_core.mechanism.arrays import make_relative_work
from liegroup_core.mechanism.bodies import PIVOT, make_work
from liegroup_core.status import OK

from .loops import project
from .singular_poses import ASIDE, begin_aside, go_aside
from .state import begin, enter

TURNS = (0.0, 0.25, -0.25, 0.5, -0.5)  # rad, of the joint that turns fastest
LEAST = 1e-8  # smaller ones are round-off


@kernel
def _pivot_aside(model, work, pose, twist, external, rates, turn):
    """Pivot after the joints have turned along rates (L, 6); 0 if the loops cannot get there."""
    enter(model, work, pose, twist, external)
    begin(model, work, work.pose, work.twist)
    if turn != 0.0:
        for b in range(len(model.links)):
            for k in range(6):
                work.stage_twist[len(model.bodies) + b, k] = rates[b, k]
        if project(model, work) != OK:
            return 0.0
        for f in range(len(work.freedoms)):
            work.acceleration[f, 0] = 0.0
        go_aside(model, work, turn / ASIDE * begin_aside(model, work))
    return work.report[PIVOT] if project(model, work) == OK else 0.0


def with_usual_pivot(model, pose, twist, angles):
    """RelativeModel with its `usual_pivot`; that of `model` must be 1.

    pose, twist, angles : of the bodies and of unwrapped angles at the start
    """
    if not len(model.cuts):
        return model
    space = make_work(model.space, 1)
    work, external = make_relative_work(model, space, 1), np.zeros((len(pose), COLUMNS))
    pivot, rng, found = SameTypes(_pivot_aside), np.random.default_rng(0), LEAST
    for turn in TURNS:
        work.angle[:] = angles
        rates = rng.normal(size=(len(model.links), 6))
        found = max(found, float(pivot(model, work, pose, twist, external, rates, turn)))
    return model.replace(usual_pivot=min(found, 1.0))
