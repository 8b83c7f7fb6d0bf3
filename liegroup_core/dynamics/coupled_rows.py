# SPDX-License-Identifier: Apache-2.0
"""Rows of couplings and driven joints: residuals and velocities.

The model has each of them as a cut joint with an element and rows of zeros; this module adds the nonzero
terms, couplings.py forces and accelerations. The row of a driven joint is that of a coupling of this
joint alone, and rheonomic: its coordinate, rate and acceleration are those of the prescribed motion at
the time of the stage, work.clock.now[0].
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.forces.axis import unwrapped
from liegroup_core.joints.motion import acceleration, position, rate
from liegroup_core.mechanism.arrays import COORDINATE

from .constraints import ROUND_OFF, position_residuals
from .couplings import law, link_coordinate
from .matrix import is_off
from .rows import set_rows


@kernel
def _coordinate(model, work, term):
    """Coordinate of the link of a term at the stage, unwrapped."""
    q = link_coordinate(model, term["link"], work.stage_pose)
    if term["angle"] >= 0:
        q = unwrapped(q, term["sign"] * work.angle[term["angle"]])
    return q


@kernel
def slopes_of(model, work, coupling):
    """First, second and third derivative of the curve of a coupling at the stage."""
    term, a = model.coupling_terms[coupling["terms"][0] + 1], coupling["curve"]
    q = term["sign"] * _coordinate(model, work, term)
    _, slope, bend = law(coupling, q)
    return slope, bend, 6.0 * a[2] + q * (24.0 * a[3])


@subroutine
def _set_slope(model, work, c):
    """Set the factor of the second rate of a curved coupling at the stage. Returns the bias of its row."""
    coupling = model.couplings[c]
    k = coupling["terms"][0] + 1
    term = model.coupling_terms[k]
    slope, bend, _ = slopes_of(model, work, coupling)
    work.factors[k] = -slope * term["sign"]
    speed = work.stage_twist[len(model.bodies) + term["link"], 0]
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
    n = len(model.bodies)
    for c in range(len(model.couplings)):
        coupling = model.couplings[c]
        slip, bias = 0.0, 0.0
        if coupling["curved"] == 1:
            bias = _set_slope(model, work, c)
        for k in range(coupling["terms"][0], coupling["terms"][1]):
            slip += work.factors[k] * work.stage_twist[n + model.coupling_terms[k]["link"], 0]
        if coupling["motion"] >= 0:
            bias = rate(work.motions, coupling["motion"], work.clock.now[0])
            slip -= bias
            if coupling["order"] == 2:
                bias = acceleration(work.motions, coupling["motion"], work.clock.now[0])
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
        begin, end = coupling["terms"]
        gap, size = 0.0, 1.0
        for k in range(begin, end):
            term = model.coupling_terms[k]
            q = _coordinate(model, work, term)
            if moved == 1:
                q += moves[model.links[term["link"]]["freedom"], 0]
            value = term["factor"] * q
            terms = abs(value)
            if coupling["curved"] == 1 and k == begin + 1:
                # The terms of a curve may be larger than their sum; those of its slope are at most four times as large.
                value, a = -law(coupling, term["sign"] * q)[0], coupling["curve"]
                q = abs(q)
                terms = q * (abs(a[0]) + q * (abs(a[1]) + q * (abs(a[2]) + q * abs(a[3]))))
            gap += value
            size += terms
        if coupling["motion"] >= 0:
            value = position(work.motions, coupling["motion"], work.clock.now[0])
            gap -= value
            size += abs(value)
        gap -= coupling["offset"]
        size += abs(coupling["offset"])
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
