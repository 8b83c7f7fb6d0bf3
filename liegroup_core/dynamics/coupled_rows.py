# SPDX-License-Identifier: Apache-2.0
"""Rows of couplings and driven joints: residuals and velocities.

The model has each of them as a cut joint with an element and rows of zeros; this module adds the nonzero
terms, couplings.py forces and accelerations. The row of a driven joint is that of a coupling without a
second joint, and rheonomic: its coordinate, rate and acceleration are those of the prescribed motion at
the time of the stage, work.clock[NOW].
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.forces.turn import unwrapped
from liegroup_core.joints.motion import acceleration, position, rate
from liegroup_core.mechanism.arrays import COORDINATE
from liegroup_core.mechanism.bodies import NOW

from .constraints import ROUND_OFF, position_residuals
from .couplings import law, link_coordinate
from .matrix import is_off
from .rows import set_rows


@kernel
def _second(model, work, coupling):
    """Coordinate of the second link of a coupling at the stage, unwrapped."""
    second = link_coordinate(model, coupling["links"][1], work.stage_pose)
    if coupling["angle"] >= 0:
        second = unwrapped(second, coupling["sign"] * work.angle[coupling["angle"]])
    return second


@kernel
def slopes_of(model, work, coupling):
    """First, second and third derivative of the curve of a coupling at the stage."""
    q, a = coupling["sign"] * _second(model, work, coupling), coupling["curve"]
    _, slope, bend = law(coupling, q)
    return slope, bend, 6.0 * a[2] + q * (24.0 * a[3])


@subroutine
def _set_slope(model, work, c):
    """Set the factor of the second rate of a curved coupling at the stage. Returns the bias of its row."""
    coupling = model.couplings[c]
    slope, bend, _ = slopes_of(model, work, coupling)
    work.factors[c, 1] = -slope * coupling["sign"]
    speed = work.stage_twist[len(model.parts) + coupling["links"][1], 0]
    return bend * speed * speed if coupling["order"] == 2 else 0.0


@kernel
def set_slopes(model, work):
    """Set the factors of all curved couplings at the stage, without their rows."""
    for c in range(len(model.couplings)):
        if model.couplings[c]["curved"] == 1:
            _set_slope(model, work, c)


@kernel
def set_all_rows(model, work):
    """Set the rows of all cut joints and couplings; see rows.set_rows."""
    set_rows(model, work)
    n = len(model.parts)
    for c in range(len(model.couplings)):
        coupling = model.couplings[c]
        slip, bias = 0.0, 0.0
        if coupling["curved"] == 1:
            bias = _set_slope(model, work, c)
        for k in range(2):
            slip += work.factors[c, k] * work.stage_twist[n + coupling["links"][k], 0]
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
        links = coupling["links"]
        first = link_coordinate(model, links[0], work.stage_pose)
        second = _second(model, work, coupling)
        if moved == 1:
            first += moves[model.bodies[links[0]]["freedom"], 0]
            second += moves[model.bodies[links[1]]["freedom"], 0]
        first = coupling["factors"][0] * first
        value, _, _ = law(coupling, coupling["sign"] * second)
        if coupling["motion"] >= 0:
            value = position(work.motions, coupling["motion"], work.clock[NOW])
        gap = first - value - coupling["offset"]
        # The terms of a curve may be larger than their sum; those of its slope are at most four times as large.
        terms = abs(value)
        if coupling["curved"] == 1:
            a, q = coupling["curve"], abs(second)
            terms = q * (abs(a[0]) + q * (abs(a[1]) + q * (abs(a[2]) + q * abs(a[3]))))
        size = 1.0 + abs(first) + terms + abs(coupling["offset"])
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
