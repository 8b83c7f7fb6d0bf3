# SPDX-License-Identifier: Apache-2.0
"""Coordinates with stops or dry friction: their forces, and how far the next event is.

A switch is such a coordinate. It is free or held. Most are freedoms of the tree. A held freedom does
not accelerate: the sweeps of trees.py leave it in the inertia of its link, so that its rate stays
exactly zero. What holds it, the contact at a rigid stop or the friction of a joint at rest, follows
from what the equations of motion of its link lack. The others, the length of a cable, the slack of a
coupling, the angle of a cone, the coordinate of a cut joint, are rows beside those of the cut joints:
held, a row is solved for like them, and its multiplier is what holds it; else it does not act. Where
more switches are at rest than the mechanism has freedoms, some are held, and the others rest with
them, each with the effort that it had last. A free switch has sliding friction, and the force of a
compliant stop beyond it:

    -slip coulomb - viscous qdot   and, beyond a compliant stop,  stiffness depth + damping d depth/dt

Between two events all this is smooth. Work.modes says which branch holds, Work.guards how far the
event is that ends it; integrators/switching.py changes the branch.
"""

import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.forces.turn import unwrapped

from .arrays import COORDINATE, EFFORT, KNOWN, RESTS, SIDE, SLIP
from .coupled_rows import set_gap
from .kinds import (
    add_effort,
    lift_links,
    link_coordinate,
    link_shift,
    move_links,
    place_links,
    set_present_residual,
)
from .loads import FOUND, LOAD, find_loads, gather_lacking
from .matrix import is_off

# Columns of Work.guards; LOWER and UPPER are the stops, the last two the bounds of what holds.
LOWER, UPPER, SLIDING, LEAST, MOST = 0, 1, 2, 3, 4
# Of the wrenches on all links: what holds a freedom is known to this part.
ROUND_OFF = 1e-13
MOVES = 1e-9  # rad/s or m/s: what rests because of others moves from here on
NONE = -1.0  # in Work.crossed: the guard is not crossed
POINTS, DOUBT = 16, 4.0  # of a step at which its gap is tested; see `lowest`
# Less than this beyond a stop, rad or m, and of a larger one, is round-off; and so is a rate of RESTING.
AT_STOP, RESTING = 1e-13, 1e-11


def modes_of(model, work):
    """(k, 5) of each switch, in the coordinate of its joint: 1 if it is held, 2 if it rests because of
    others; direction of slip; stop that it touches (-1 lower, 1 upper); coordinate; effort if it rests.
    """
    table, modes = model.switches, work.modes
    signs = table["sign"][:, None]
    own = modes[:, [SLIP, SIDE, COORDINATE, EFFORT]] * signs
    own[:, 3] *= modes[:, RESTS]
    at_rest = work.held[table["freedom"]] + 2.0 * modes[:, RESTS]
    return np.hstack([at_rest[:, None], own])


def set_modes(model, work, modes):
    """Write `modes_of` another model of the same scene."""
    table = model.switches
    work.held[:] = 0.0
    work.held[table["freedom"]] = modes[:, 0] == 1.0
    work.modes[:, [SLIP, SIDE, COORDINATE, EFFORT]] = modes[:, 1:] * table["sign"][:, None]
    work.modes[:, KNOWN], work.modes[:, RESTS] = 1.0, modes[:, 0] == 2.0


@kernel
def coordinate(model, work, k, pose):
    """Coordinate of switch k, rad in the turn of the last one, or m; of a row: see `set_gap`."""
    switch = model.switches[k]
    b = switch["link"]
    if b < 0:
        return work.reach[k]
    if switch["component"] == 1:
        return link_shift(model, b, pose)
    q = link_coordinate(model, b, pose)
    if switch["turned"] == 0:
        return q
    return unwrapped(q, work.modes[k, COORDINATE])


@kernel
def _find_rows(model, work):
    """Coordinates of the switches that are rows, at the links of the stage."""
    if model.has_switched_rows:
        lift_links(model, work)
        set_gap(model, work)


@kernel
def count_coordinates(model, work):
    """Keep the coordinates of all switches at the end of a step; held rows stay where they are held."""
    if model.has_switched_rows:
        move_links(model, work)
        place_links(model, work)
        _find_rows(model, work)
    for k in range(len(model.switches)):
        if model.switches[k]["row"] < 0 or work.held[model.switches[k]["freedom"]] == 0.0:
            work.modes[k, COORDINATE] = coordinate(model, work, k, work.stage_pose)


@kernel
def set_rates(model, work, out):
    """Rates and accelerations of all switches at the stage, to out (k, 2)."""
    if model.has_switched_rows:
        set_present_residual(model, work)
    for k in range(len(model.switches)):
        switch = model.switches[k]
        r = switch["row"]
        if r < 0:
            out[k, 0] = work.stage_twist[len(model.parts) + switch["link"], switch["component"]]
            out[k, 1] = work.acceleration[switch["freedom"], 0]
        else:
            out[k, 0], out[k, 1] = work.slip[r], work.right[r]


@kernel
def _depth(switch, q, rate, side):
    """(depth, its rate) beyond the lower stop, side -1, or the upper one, side 1."""
    if side < 0.0:
        return switch["lower"] - q, -rate
    return q - switch["upper"], rate


@kernel
def _pressure(switch, q, rate, side):
    """Force of a compliant stop if it acts, N m or N; it does not pull."""
    depth, speed = _depth(switch, q, rate, side)
    return switch["stiffness"] * depth + switch["damping"] * speed


@kernel
def _effort(model, work, k, rate):
    """Friction and force of a compliant stop of switch k, which is not held, N m or N."""
    switch, side = model.switches[k], work.modes[k, SIDE]
    if work.modes[k, RESTS] != 0.0:
        return work.modes[k, EFFORT]
    sliding = switch["coulomb"] + switch["sliding_by_load"] * work.loads[k, LOAD]
    effort = -work.modes[k, SLIP] * sliding - switch["viscous"] * rate
    if side != 0.0:
        q = coordinate(model, work, k, work.stage_pose)
        effort -= side * _pressure(switch, q, rate, side)
    return effort


@kernel
def apply_switches(model, work):
    """Apply friction and compliant stops of freedoms to the links at the stage."""
    n = len(model.parts)
    for k in range(len(model.switches)):
        switch = model.switches[k]
        b, component = switch["link"], switch["component"]
        if b >= 0 and work.held[switch["freedom"]] == 0.0:
            effort = _effort(model, work, k, work.stage_twist[n + b, component])
            add_effort(model, work, b, component, effort)


@kernel
def set_row_efforts(model, work):
    """Multipliers of the rows that are not held, by friction and compliant stops; whether there are any."""
    compliant, found = False, False
    for k in range(len(model.switches)):
        if model.switches[k]["row"] >= 0 and work.modes[k, SIDE] != 0.0:
            compliant = compliant or model.switches[k]["stiffness"] > 0.0
    if compliant:
        _find_rows(model, work)
    for k in range(len(model.switches)):
        r = model.switches[k]["row"]
        if r >= 0 and is_off(model, work, r):
            work.multipliers[r] = -_effort(model, work, k, work.slip[r])
            found = found or work.multipliers[r] != 0.0
    return found


@kernel
def bounds(most, side):
    """(least, largest) effort that can hold a switch which touches the rigid stop of a side, or none.

    most : friction at rest
    """
    return (-math.inf if side > 0.0 else -most, math.inf if side < 0.0 else most)


@kernel
def set_guards(model, work):
    """How far every switch is from its next event, to work.guards: negative if it is beyond."""
    held = False
    for k in range(len(model.switches)):
        for c in range(5):
            work.guards[k, c] = math.inf
        held = held or work.held[model.switches[k]["freedom"]] != 0.0
    set_rates(model, work, work.now)
    _find_rows(model, work)
    total = 0.0
    if held or model.has_loads:
        total = gather_lacking(model, work)
        find_loads(model, work)
    for k in range(len(model.switches)):
        switch, guards, side = model.switches[k], work.guards, work.modes[k, SIDE]
        f = switch["freedom"]
        if work.held[f] != 0.0:
            row = switch["row"]
            effort = -work.freedoms[f, 7] if row < 0 else -work.multipliers[row]
            at_rest = switch["static"] + switch["static_by_load"] * work.loads[k, FOUND]
            least, most = bounds(at_rest, side)
            guards[k, LEAST] = effort - least + ROUND_OFF * total
            guards[k, MOST] = most - effort + ROUND_OFF * total
            continue
        rate = work.now[k, 0]
        if work.modes[k, RESTS] != 0.0:
            guards[k, SLIDING] = MOVES - abs(rate)
            continue
        q = coordinate(model, work, k, work.stage_pose)
        if switch["stiffness"] == 0.0:
            guards[k, LOWER], guards[k, UPPER] = q - switch["lower"], switch["upper"] - q
        else:
            for end in range(2):
                at = -1.0 if end == 0 else 1.0
                depth, _ = _depth(switch, q, rate, at)
                acting = min(depth, _pressure(switch, q, rate, at))
                guards[k, end] = acting if side == at else -acting
        if switch["static"] > 0.0 or switch["static_by_load"] > 0.0:
            guards[k, SLIDING] = work.modes[k, SLIP] * rate


@kernel
def _dip(g0, d0, g1, d1, h):
    """Part of a step at which a cubic with these ends and slopes dips below zero, or NONE."""
    if not (d0 < 0.0 < d1):
        return NONE
    a, b, c = (
        3.0 * (2.0 * (g0 - g1) + (d0 + d1) * h),
        2.0 * (3.0 * (g1 - g0) - (2.0 * d0 + d1) * h),
        d0 * h,
    )
    # The root of a s^2 + b s + c with a positive slope; c < 0 and a + b + c > 0.
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    s = -2.0 * c / (b + root) if b + root > 0.0 else 1.0
    least = g0 + s * (c + s * (0.5 * b + s * a / 3.0))
    return s if 0.0 < s < 1.0 and least < min(g0, 0.0) else NONE


@kernel
def lowest(g0, v0, a0, g1, v1, a1, h, depth, lag):
    """Part of a step at which a gap may be deepest below zero, or NONE: it stays above.

    g, v, a : gap, rate and acceleration at the start and at the end of a step of size h. A gap that
              starts below zero has to become less than it was
    lag     : s; what may be below zero is the gap and `lag` times its rate
    Between its ends the gap is near the polynomial of degree five with these values. How near, shows
    the distance to that of degree three: DOUBT times it is taken off. Where the gap is not smooth,
    as that of a point that passes another one, this is about as much as it could have closed.
    """
    p0, p1, r0, r1, lag = v0 * h, v1 * h, 0.5 * a0 * h * h, 0.5 * a1 * h * h, lag / h
    if lag == 0.0 and min(g0, g1) > abs(p0) + abs(p1) + abs(r0) + abs(r1):
        return NONE
    rise = g1 - g0
    b, c = 3.0 * rise - 2.0 * p0 - p1, p0 + p1 - 2.0 * rise
    first, last = r0 - b, r1 - b - 3.0 * c
    doubt = DOUBT * max(abs(first), abs(last))
    after = g0 + lag * p0
    place, least = NONE, min(after, 0.0) - depth
    before, now = after, after
    for i in range(POINTS + 1):
        before, now = now, after
        if i < POINTS:
            s = (i + 1) / POINTS
            bump, more = s * (1.0 - s), first + s * (last - first)
            after = g0 + s * (p0 + s * (b + s * c)) + bump * bump * (more - doubt)
            if lag != 0.0:
                slope = p0 + s * (2.0 * b + s * 3.0 * c) + bump * bump * (last - first)
                bend = 2.0 * bump * (1.0 - 2.0 * s)
                after += lag * (slope + bend * more - abs(bend) * doubt)
        # A parabola through three points; at an end, through two with the slope there.
        slope, bend = 0.5 * (after - before), after - 2.0 * now + before
        if i == 0:
            slope = (p0 + 2.0 * lag * r0) / POINTS
            bend = 2.0 * (after - now - slope)
        elif i == POINTS:
            slope = (p1 + 2.0 * lag * r1) / POINTS
            bend = 2.0 * (before - now + slope)
        aside = -slope / bend if bend > 0.0 else math.inf
        if abs(aside) <= 1.0 and 0.0 <= i + aside <= POINTS:
            gap = now + 0.5 * slope * aside
            if gap < least:
                place, least = (i + aside) / POINTS, gap
    return place


@kernel
def crossed(model, work, h):
    """Whether a guard is crossed in a step of size h to the stage; where, to work.crossed."""
    set_guards(model, work)
    found = False
    for k in range(len(model.switches)):
        switch, guards, places = model.switches[k], work.guards, work.crossed
        for c in range(5):
            places[k, c] = NONE
        if work.held[switch["freedom"]] != 0.0 or work.modes[k, RESTS] != 0.0:
            for c in range(SLIDING, MOST + 1):
                if guards[k, c] < 0.0:
                    places[k, c] = 1.0
        else:
            q0, v0, v1 = work.modes[k, COORDINATE], work.since[k, 0], work.now[k, 0]
            a0, a1, soft = work.since[k, 1], work.now[k, 1], switch["stiffness"] > 0.0
            for c in range(2):
                sign = 1.0 if c == LOWER else -1.0
                stop = switch["lower"] if c == LOWER else switch["upper"]
                # Rows that were held drift by round-off and the error of the method: one that leaves
                # its stop may start beyond it, and leaves with the third power of time.
                before, depth, lag = sign * (q0 - stop), AT_STOP * (1.0 + abs(stop)), 0.0
                if guards[k, c] < 0.0:
                    further = guards[k, c] < min(before, 0.0) - depth
                    if soft or further or sign * v1 < -RESTING:
                        places[k, c] = 1.0
                elif before < math.inf:
                    after = guards[k, c]
                    if soft:
                        after = sign * (coordinate(model, work, k, work.stage_pose) - stop)
                    if soft and work.modes[k, SIDE] == -sign:
                        # It ends where its pressure does.
                        sign, before, after = -sign, -before, -after
                        lag = switch["damping"] / switch["stiffness"]
                    v, w, a, b = sign * v0, sign * v1, sign * a0, sign * a1
                    places[k, c] = lowest(before, v, a, after, w, b, h, depth, lag)
            if guards[k, SLIDING] < 0.0:
                places[k, SLIDING] = 1.0
            elif guards[k, SLIDING] < math.inf:
                sign = work.modes[k, SLIP]
                places[k, SLIDING] = _dip(sign * v0, sign * a0, sign * v1, sign * a1, h)
        for c in range(5):
            found = found or places[k, c] != NONE
    return found
