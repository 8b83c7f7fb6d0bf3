# SPDX-License-Identifier: Apache-2.0
"""Rows of couplings and driven joints: residuals and velocities.

The model has each of them as a cut joint with an element and rows of zeros; this module adds the nonzero
terms, couplings.py forces and accelerations. The row of a driven joint is that of a coupling without a
second joint, and rheonomic: its coordinate, rate and acceleration are those of the prescribed motion at
the time of the stage, work.clock[NOW].
"""

from liegroup_core.compiling import kernel
from liegroup_core.forces.turn import unwrapped
from liegroup_core.joints.motion import acceleration, position, rate
from liegroup_core.mechanism.arrays import COORDINATE
from liegroup_core.mechanism.bodies import NOW

from .constraints import ROUND_OFF, position_residuals
from .couplings import link_coordinate
from .matrix import is_off
from .rows import set_rows


@kernel
def set_all_rows(model, work):
    """Set the rows of all cut joints and couplings; see rows.set_rows."""
    set_rows(model, work)
    n = len(model.parts)
    for c in range(len(model.couplings)):
        coupling = model.couplings[c]
        slip = 0.0
        for k in range(2):
            slip += coupling["factors"][k] * work.stage_twist[n + coupling["links"][k], 0]
        bias = 0.0
        if coupling["motion"] >= 0:
            bias = rate(work.motions, coupling["motion"], work.clock[NOW])
            slip -= bias
            if coupling["order"] == 2:
                bias = acceleration(work.motions, coupling["motion"], work.clock[NOW])
        work.slip[coupling["row"]] = slip
        work.bias[coupling["row"]] = bias


@kernel
def set_coupled_gaps(model, work, moves, moved):
    """Write the position residuals of the couplings at the stage to work.gap.

    moves : (f, 1) changes of the coordinates, rad or m;  moved : 1 to add them, else 0
    A residual below the round-off of its terms is 0.
    """
    for c in range(len(model.couplings)):
        coupling = model.couplings[c]
        links, factors = coupling["links"], coupling["factors"]
        first = link_coordinate(model, links[0], work.stage_pose)
        second = link_coordinate(model, links[1], work.stage_pose)
        if coupling["angle"] >= 0:
            second = unwrapped(second, coupling["sign"] * work.angle[coupling["angle"]])
        if moved == 1:
            first += moves[model.bodies[links[0]]["freedom"], 0]
            second += moves[model.bodies[links[1]]["freedom"], 0]
        first, second = factors[0] * first, factors[1] * second
        if coupling["motion"] >= 0:
            second = -position(work.motions, coupling["motion"], work.clock[NOW])
        gap = first + second - coupling["offset"]
        size = 1.0 + abs(first) + abs(second) + abs(coupling["offset"])
        if coupling["turned"] == 1:
            gap = unwrapped(gap, 0.0)
        work.gap[coupling["residual"]] = 0.0 if abs(gap) <= ROUND_OFF * size else gap


@kernel
def set_gap(model, work):
    """Write the position residuals of all cut joints and couplings at the stage to work.gap.

    The coordinate of a switch goes to work.reach. Its residual is the distance from the held coordinate, or 0.
    """
    position_residuals(model, work.world, work.gap)
    set_coupled_gaps(model, work, work.acceleration, 0)
    if not model.has_switched_rows:
        return
    for k in range(len(model.switches)):
        r = model.switches[k]["row"]
        if r < 0:
            continue
        q, kept = work.gap[model.row_residual[r]], work.modes[k, COORDINATE]
        if model.switches[k]["turned"] == 1:
            q = unwrapped(q, kept)
        work.reach[k] = q
        work.gap[model.row_residual[r]] = 0.0 if is_off(model, work, r) else q - kept
