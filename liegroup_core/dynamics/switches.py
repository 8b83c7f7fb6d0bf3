# SPDX-License-Identifier: Apache-2.0
"""Coordinates with stops or dry friction: their forces, and the distance to the next event.

A switch is such a coordinate; it is free or held. Most switches are degrees of freedom of the tree. The
sweeps of trees.py do not eliminate a held one, so that its rate stays exactly zero. The effort that holds
it, from a rigid stop or from friction at rest, follows from the residual of the equations of motion of its
link. The other switches are rows in addition to those of the cut joints: the length of a cable, the slack of a
coupling, the angle of a cone, the coordinate of a cut joint. If such a row is held, it is solved with those
of the cut joints, and its multiplier is the effort that holds it; else it is inactive. If more switches rest
than there are degrees of freedom, only some are held, and the others rest because of them, each with its
last effort. A free switch has sliding friction and the force of a compliant stop:

    -slip coulomb - viscous qdot   and, beyond a compliant stop,  stiffness depth + damping d depth/dt

Between two events all this is smooth. Work.modes has the present branch, Work.guards the distance to the
event that ends it; events/switching.py changes the branch.
"""

import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.forces.axis import unwrapped
from liegroup_core.forces.law import distances_in
from liegroup_core.mechanism.arrays import COORDINATE, EFFORT, KNOWN, RESTS, SIDE, SLIP

from .coordinates import lift_links, place_links
from .coupled_rows import set_gap
from .couplings import add_effort, link_coordinate, link_shift
from .loads import FOUND, LOAD, find_loads, gather_lacking
from .matrix import is_off
from .residuals import set_present_residual
from .trees import move_links

# Columns of Work.guards; LOWER and UPPER are the stops, the last two the bounds of the effort that holds, or the ends
# of a branch.
LOWER, UPPER, SLIDING, LEAST, MOST = 0, 1, 2, 3, 4
# Round-off of an effort that holds, relative to the sum of the wrenches on all links.
ROUND_OFF = 1e-13
# All relative to 1 rad or the characteristic length, `unit` of a switch.
MOVES = 1e-9  # 1/s: from this rate on, a switch that rests because of others moves
# Round-off: depth beyond a stop below AT_STOP (unit + |stop|), and rates up to RESTING unit, per second.
AT_STOP, RESTING = 1e-13, 1e-11


def modes_of(model, work):
    """Modes (k, 5) of all switches, in the coordinates of their joints. Columns: 1 if held, 2 if at rest because
    of others, else 0; direction of slip; stop in contact (-1 lower, 1 upper); coordinate; effort at rest.
    """
    table, modes = model.switches, work.modes
    found, rests = np.empty((len(modes), 5)), modes[:, RESTS]
    found[:, 0] = work.held[table["freedom"]] + 2.0 * rests
    np.multiply(modes[:, [SLIP, SIDE, COORDINATE, EFFORT]], table["sign"][:, None], out=found[:, 1:])
    found[:, 4] *= rests
    return found


@kernel
def write_modes(model, work, first, out):
    """Write the modes of all switches, as of `modes_of`, to rows of out from `first` on."""
    for k in range(len(model.switches)):
        sign, rests = model.switches[k]["sign"], work.modes[k, RESTS]
        out[first + k, 0] = work.held[model.switches[k]["freedom"]] + 2.0 * rests
        out[first + k, 1], out[first + k, 2] = sign * work.modes[k, SLIP], sign * work.modes[k, SIDE]
        out[first + k, 3], out[first + k, 4] = sign * work.modes[k, COORDINATE], sign * work.modes[k, EFFORT] * rests


def set_modes(model, work, modes):
    """Set the modes to those that `modes_of` returned for another model of the same scene."""
    table = model.switches
    work.held[:] = 0.0
    work.held[table["freedom"]] = modes[:, 0] == 1.0
    work.modes[:, [SLIP, SIDE, COORDINATE, EFFORT]] = modes[:, 1:] * table["sign"][:, None]
    work.modes[:, KNOWN], work.modes[:, RESTS] = 1.0, modes[:, 0] == 2.0


@kernel
def coordinate(model, work, k, pose):
    """Coordinate of switch k, rad (unwrapped from the last one) or m; for a row see `set_gap`."""
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
    """Compute the coordinates of the switches that are rows, from the links at the stage."""
    if model.has_switched_rows:
        lift_links(model, work)
        set_gap(model, work)


@kernel
def count_coordinates(model, work):
    """Save the coordinates of all switches at the end of a step; held rows keep theirs."""
    if model.has_switched_rows:
        move_links(model, work)
        place_links(model, work)
        _find_rows(model, work)
    for k in range(len(model.switches)):
        if model.switches[k]["row"] < 0 or work.held[model.switches[k]["freedom"]] == 0.0:
            work.modes[k, COORDINATE] = coordinate(model, work, k, work.stage_pose)


@kernel
def set_rates(model, work, out):
    """Write the rates and accelerations of all switches at the stage to out (k, 2)."""
    if model.has_switched_rows:
        set_present_residual(model, work)
    for k in range(len(model.switches)):
        switch = model.switches[k]
        r = switch["row"]
        if r < 0:
            out[k, 0] = work.stage_twist[len(model.bodies) + switch["link"], switch["component"]]
            out[k, 1] = work.acceleration[switch["freedom"], 0]
        else:
            out[k, 0], out[k, 1] = work.slip[r], work.right[r]


@kernel
def too_fast(model, work, h):
    """First switch with stops whose angle changes by half a turn or more in a step h to the stage, or -1.

    Poses then do not determine the number of turns.
    """
    counts = False
    for k in range(len(model.switches)):
        counts = counts or _counts_turns(model.switches[k])
    if counts:
        set_rates(model, work, work.now)
        for k in range(len(model.switches)):
            if _counts_turns(model.switches[k]) and abs(h * work.now[k, 0]) >= math.pi:
                return k
    return -1


@kernel
def _counts_turns(switch):
    return switch["turned"] == 1 and (switch["lower"] > -math.inf or switch["upper"] < math.inf)


@kernel
def _depth(switch, q, rate, side):
    """(depth, its rate) beyond the lower stop, side -1, or the upper one, side 1."""
    if side < 0.0:
        return switch["lower"] - q, -rate
    return q - switch["upper"], rate


@kernel
def _pressure(switch, q, rate, side):
    """Force of a compliant stop, N m or N; if negative, the stop does not act, because it cannot pull."""
    depth, speed = _depth(switch, q, rate, side)
    return switch["stiffness"] * depth + switch["damping"] * speed


@kernel
def side_of(model, work, k):
    """Side of the compliant stop that acts at switch k; 1 where both are at one place: a spring, which also pulls."""
    return 1.0 if model.switches[k]["lower"] == model.switches[k]["upper"] else work.modes[k, SIDE]


@kernel
def _effort(model, work, k, rate):
    """Friction and force of a compliant stop of switch k, which is not held, N m or N."""
    switch, side = model.switches[k], side_of(model, work, k)
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
    n = len(model.bodies)
    for k in range(len(model.switches)):
        switch = model.switches[k]
        b, component = switch["link"], switch["component"]
        if b >= 0 and work.held[switch["freedom"]] == 0.0:
            effort = _effort(model, work, k, work.stage_twist[n + b, component])
            add_effort(model, work, b, component, effort)


@kernel
def set_row_efforts(model, work):
    """Set the multipliers of rows that are not held, by friction and compliant stops; returns whether any is not 0."""
    compliant, found = False, False
    for k in range(len(model.switches)):
        if model.switches[k]["row"] >= 0 and side_of(model, work, k) != 0.0:
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
    """(least, largest) effort that can hold a switch in contact with the rigid stop of a side; side 0: with none.

    most : friction at rest
    """
    return (-math.inf if side > 0.0 else -most, math.inf if side < 0.0 else most)


@kernel
def set_branch_guards(model, work):
    """Write the distances of the kinks of laws to the ends of their branches behind those of the switches."""
    laws, first = model.space.forces.laws, len(model.switches)
    for k in range(len(work.branches)):
        for c in range(LEAST):
            work.guards[first + k, c] = math.inf
        ends = distances_in(laws, work.branches[k], work.registers, k)
        work.guards[first + k, LEAST], work.guards[first + k, MOST] = ends


@kernel
def set_guards(model, work):
    """Write the distance of every switch and branch to its next event to work.guards; negative beyond the event."""
    set_branch_guards(model, work)
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
            guards[k, SLIDING] = MOVES * switch["unit"] - abs(rate)
            continue
        q = coordinate(model, work, k, work.stage_pose)
        if switch["stiffness"] == 0.0:
            guards[k, LOWER], guards[k, UPPER] = q - switch["lower"], switch["upper"] - q
        elif switch["lower"] < switch["upper"]:
            for end in range(2):
                at = -1.0 if end == 0 else 1.0
                depth, _ = _depth(switch, q, rate, at)
                acting = min(depth, _pressure(switch, q, rate, at))
                guards[k, end] = acting if side == at else -acting
        if switch["static"] > 0.0 or switch["static_by_load"] > 0.0:
            guards[k, SLIDING] = work.modes[k, SLIP] * rate
