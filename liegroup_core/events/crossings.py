# SPDX-License-Identifier: Apache-2.0
"""Guards of switches and branches that are crossed in a substep: negative at its end, or in between.

Within a substep a gap is interpolated from its values, rates and accelerations at both ends. The effort that
holds a switch has no known derivative, and may exceed its bounds for only a part of a substep. Its guards
are computed at some stages of the method, and interpolated by the polynomial through these. The distance to
the polynomial without the middle node estimates the error. So are those of the branches of laws.

A branch is OPEN where both of its sides lead back to its end, or where it changes without effect: the law takes at
every stage the branch of its arguments. Once all stages of a substep agree, and it leads away from the end, that one
holds.
Of a comparison the sides are shared instead, if their shares are determined: see dynamics/sliding.py.

times.py confirms and locates the suspected crossings.
"""

import functools
import math

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.dynamics.switches import (
    AT_STOP,
    LEAST,
    LOWER,
    MOST,
    RESTING,
    SLIDING,
    UPPER,
    coordinate,
    set_branch_guards,
    set_guards,
)
from liegroup_core.forces.formulas import BELOW, OPEN
from liegroup_core.forces.law import (
    branch_matters,
    branch_of,
    distances_in,
    is_shared,
    is_table,
    may_be_beyond,
    next_branch,
)
from liegroup_core.lie.vec3 import dot3, load3, load9, matvec3, sub3
from liegroup_core.mechanism.arrays import COORDINATE, NODES, RESTS, SIDE, SLIP
from liegroup_core.mechanism.bodies import DEEPEST, DEEPEST_OF

NONE, IDLE = -1.0, -2.0  # in Work.crossed: the guard is not crossed; without effect at the end of the step
CALM, CROSSED, AGAIN = 0, 1, 2  # results of `crossed`
START, END = 0, 1  # rows of Work.course of the first stage and of the end
APART = 0.125  # fraction of a step; a stage that is closer to a chosen one is omitted
LATEST = 0.9  # fraction of a substep with an event, that is repeated up to there at most
FAR = 1.001  # at least 1 by more than round-off, see `rows_and_weights`
PARTS, DOUBT = 16, 4.0  # parts of a step, at whose ends guards are tested; safety factor, see `lowest`


def rows_and_weights(times):
    """(s + 1,) row of Work.course of every stage, or -1, and (3, PARTS - 1, NODES) weights of these rows.

    times : (s + 1,) of the stages and of the end, as fractions of the step
    The weights give the polynomials through all nodes, and through all but the middle one. The last ones are a bound:
    both minus their distance exceed the mean of the least and the largest value less `bound` times half of their range.
    """
    return _rows_and_weights(tuple(np.asarray(times).tolist()))


@functools.cache
def _rows_and_weights(times):
    times, stages = np.array(times), len(times) - 1
    chosen = [0, stages]
    for stage in reversed(range(1, stages)):
        if len(chosen) < NODES and np.abs(times[stage] - times[chosen]).min() >= APART:
            chosen.append(stage)
    rows = np.full(stages + 1, -1)
    rows[chosen] = range(len(chosen))
    nodes = times[chosen]
    inner = sorted(range(2, len(nodes)), key=lambda row: nodes[row])
    weights = np.zeros((3, PARTS - 1, NODES))
    for which, without in enumerate((None, inner[len(inner) // 2] if inner else None)):
        used = [row for row in range(len(nodes)) if row != without]
        for i, s in enumerate(np.arange(1, PARTS) / PARTS):
            for row in used:
                others = nodes[[other for other in used if other != row]]
                weights[which, i, row] = np.prod((s - others) / (nodes[row] - others))
    weights[2] = (np.abs(weights[0]) + np.abs(weights[0] - weights[1])).sum(axis=1).max()
    return rows, weights


@kernel
def note_guards(model, work, row):
    """Set the guards of a stage, and save those of held switches and of branches in a row of Work.course."""
    held, switches = row == END, len(model.switches)
    for k in range(switches):
        held = held or work.held[model.switches[k]["freedom"]] != 0.0
    if row < 0 or not held and len(work.branches) == 0:
        return
    if held:
        set_guards(model, work)
    else:
        set_branch_guards(model, work)
    for k in range(0 if held else switches, len(work.guards)):
        for c in range(2):
            work.course[row, k, c] = work.guards[k, LEAST + c]
    for k in range(len(work.branches)):
        if work.branches[k] == OPEN:
            now = branch_of(model.space.forces.laws, work.registers, k)
            low, high = distances_in(model.space.forces.laws, now, work.registers, k)
            work.course[row, switches + k, 0], work.course[row, switches + k, 1] = now, min(low, high)


@kernel
def forget_dips(work):
    """Begin a substep: no guard was seen below zero."""
    for k in range(len(work.guards)):
        for c in range(2):
            work.dips[k, c, 0] = NONE


@kernel
def note_dips(model, work, place):
    """Note the guards of branches that are negative at a stage of which no values are kept, a fraction of the step.

    So what is short and soon after an event, where the stages lie close together, is not overlooked.
    """
    laws, switches = model.space.forces.laws, len(model.switches)
    for k in range(len(work.branches)):
        if work.branches[k] != OPEN:
            ends = distances_in(laws, work.branches[k], work.registers, k)
            for c in range(2):
                if ends[c] < 0.0 and work.dips[switches + k, c, 0] == NONE:
                    work.dips[switches + k, c, 0], work.dips[switches + k, c, 1] = place, ends[c]


@kernel
def _matters(model, work, k, c, way, h):
    """Whether the branch k beyond its end c differs from the next one by more than Work.least, or others follow.

    way : guard, negative: of a continuous kink the difference grows with it
    """
    laws, end = model.space.forces.laws, work.guards[len(model.switches) + k, c]
    other, part = next_branch(laws, work.branches[k], k, c == MOST), 1.0
    if way == end and end < 0.0 and other != branch_of(laws, work.registers, k):
        return True  # further segments of a table are passed
    force = 0.0
    for i in range(len(work.wrench)):
        for j in range(6):
            force += abs(work.wrench[i, j])
    if way != end and end > 0.0:
        part = min(1.0, -way / end)
    return branch_matters(laws, work.branches, work.registers, k, other, force, h, part, work.least[0]) != 0


@kernel
def _close_branch(work, weights, k, row):
    """Let a branch that is OPEN hold, if all saved stages of the substep have it, and lead away from its end."""
    now = work.course[END, row, 0]
    if not work.course[END, row, 1] > work.course[START, row, 1]:
        return
    for node in range(NODES):
        if node == START or node == END or weights[0, 0, node] != 0.0:
            if work.course[node, row, 0] != now:
                return
    work.branches[k] = now


@kernel
def begin_at_end(work):
    """Copy the guards at the end of a substep to the start of the next one."""
    for k in range(len(work.guards)):
        for c in range(2):
            work.course[START, k, c] = work.course[END, k, c]


@kernel
def _gives_way(weights, course, k, c, start):
    """(fraction of the step at which guard c, LEAST or MOST, of switch k may be negative, guard there), or NONE, 0.

    start : of the guard, which is relative to it
    """
    place, least = NONE, 0.0
    if not course[END, k, c - LEAST] < math.inf:
        return place, least
    low, high = course[END, k, c - LEAST], course[END, k, c - LEAST]
    for row in range(NODES):
        if row == START or weights[0, 0, row] != 0.0:
            low, high = min(low, course[row, k, c - LEAST]), max(high, course[row, k, c - LEAST])
    if low + high > FAR * weights[2, 0, 0] * (high - low):
        return place, least
    after = course[START, k, c - LEAST] - start
    before, now = after, after
    for i in range(PARTS):
        before, now, after = now, after, course[END, k, c - LEAST] - start
        if i < PARTS - 1:
            after, other = 0.0, 0.0
            for row in range(NODES):
                after += weights[0, i, row] * course[row, k, c - LEAST]
                other += weights[1, i, row] * course[row, k, c - LEAST]
            after -= abs(after - other) + start
            if after < least:
                place, least = (i + 1) / PARTS, after
        slope, bend = 0.5 * (after - before), after - 2.0 * now + before
        if i > 0 and abs(slope) < bend and now - 0.5 * slope * slope / bend < least:
            place, least = (i - slope / bend) / PARTS, now - 0.5 * slope * slope / bend
    return place, least


@kernel
def _dip(g0, d0, g1, d1, h):
    """Fraction of the step at which a cubic with these end values and slopes is below zero, or NONE."""
    if not (d0 < 0.0 < d1):
        return NONE
    a, b, c = (3.0 * (2.0 * (g0 - g1) + (d0 + d1) * h), 2.0 * (3.0 * (g1 - g0) - (2.0 * d0 + d1) * h), d0 * h)
    # The root of a s^2 + b s + c with a positive slope; c < 0 and a + b + c > 0.
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    s = -2.0 * c / (b + root) if b + root > 0.0 else 1.0
    least = g0 + s * (c + s * (0.5 * b + s * a / 3.0))
    return s if 0.0 < s < 1.0 and least < min(g0, 0.0) else NONE


@kernel
def lowest(g0, v0, a0, g1, v1, a1, h, depth, lag):
    """Fraction of the step at which a gap may be deepest below zero, or NONE if it stays above.

    g, v, a : gap, rate and acceleration at the start and at the end of a step of size h. A gap that
              starts below zero counts only if it decreases
    lag     : s; the quantity tested is the gap plus `lag` times its rate
    The gap is approximated by the polynomial of degree five with these values. Its distance to that of
    degree three, times DOUBT, is subtracted as an error bound. If the gap is not smooth, as for a point that
    passes another one, this is about as much as it could have closed.
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
    for i in range(PARTS + 1):
        before, now = now, after
        if i < PARTS:
            s = (i + 1) / PARTS
            bump, more = s * (1.0 - s), first + s * (last - first)
            after = g0 + s * (p0 + s * (b + s * c)) + bump * bump * (more - doubt)
            if lag != 0.0:
                slope = p0 + s * (2.0 * b + s * 3.0 * c) + bump * bump * (last - first)
                bend = 2.0 * bump * (1.0 - 2.0 * s)
                after += lag * (slope + bend * more - abs(bend) * doubt)
        # A parabola through three points; at an end, through two with the slope there.
        slope, bend = 0.5 * (after - before), after - 2.0 * now + before
        if i == 0:
            slope = (p0 + 2.0 * lag * r0) / PARTS
            bend = 2.0 * (after - now - slope)
        elif i == PARTS:
            slope = (p1 + 2.0 * lag * r1) / PARTS
            bend = 2.0 * (before - now + slope)
        aside = -slope / bend if bend > 0.0 else math.inf
        if abs(aside) <= 1.0 and 0.0 <= i + aside <= PARTS:
            gap = now + 0.5 * slope * aside
            if gap < least:
                place, least = (i + aside) / PARTS, gap
    return place


@kernel
def first_place(model, work):
    """Fraction of the substep at which the first of its events is expected, at most LATEST.

    Of a guard that is negative at the end, by linear interpolation; where its start is not known half of it.
    """
    first = LATEST
    for k in range(len(model.switches)):
        for c in range(5):
            place, after = work.crossed[k, c], work.guards[k, c]
            if place == 1.0:
                before = 0.0
                if c == SLIDING:
                    before = work.modes[k, SLIP] * work.since[k, 0]
                elif c == LOWER:
                    before = work.modes[k, COORDINATE] - model.switches[k]["lower"]
                elif c == UPPER:
                    before = model.switches[k]["upper"] - work.modes[k, COORDINATE]
                place = before / (before - after) if 0.0 < before < math.inf else 0.5
            if place != NONE:
                first = min(first, place)
    for row in range(len(model.switches), len(work.crossed)):
        for c in range(LEAST, MOST + 1):
            place, before = work.crossed[row, c], work.course[START, row, c - LEAST]
            if place == 1.0:
                place = before / (before - work.guards[row, c]) if before > 0.0 else 0.5
            if place != NONE:
                first = min(first, place)
    return first


@kernel
def _longest(model, work, at):
    """Longest step in s from the guards in a row of Work.course on, in which no contact is overlooked.

    At the speed of the stage two bodies, or a body that turns above a plane, do not touch in it, or go on by no more
    than Laws.closing says.
    """
    laws, longest = model.space.forces.laws, math.inf
    pose, twist = work.space.stage_pose, work.space.stage_twist
    for j in range(len(laws.closing) if len(work.branches) > 0 else 0):
        row = laws.closing[j]
        k, a, b = row["kink"], row["bodies"][0], row["bodies"][1]
        gap = work.course[at, len(model.switches) + k, 1 if work.branches[k] == OPEN else 0]
        turn, speed = load3(twist, a, 0), 0.0
        if b >= 0:
            away = sub3(matvec3(load9(pose, a, 0), load3(twist, a, 3)), matvec3(load9(pose, b, 0), load3(twist, b, 3)))
            other = load3(twist, b, 0)
            speed = math.sqrt(dot3(away, away)) + row["reach"][1] * math.sqrt(dot3(other, other))
        speed += row["reach"][0] * math.sqrt(dot3(turn, turn))
        if speed > 0.0:
            longest = min(longest, max(gap, row["size"]) / speed)
    return longest


@kernel
def is_too_long(model, work, h):
    """Whether a contact may be overlooked in the step of size h that ends at the stage, longer than Work.pace."""
    work.pace[0] = _longest(model, work, START)
    return h > work.pace[0]


@kernel
def crossed(model, work, h, weights):
    """CROSSED: a guard is crossed in the step of size h that ends at the stage, at the places in Work.crossed.

    AGAIN: the step is to be taken again. A branch whose end is crossed without effect at the end of the step is OPEN
    from now on: what it does in between, and where branches behind it change, are seen with the branches of all stages.
    """
    found, again = False, False
    for k in range(len(model.switches)):
        switch, guards, places = model.switches[k], work.guards, work.crossed
        for c in range(5):
            places[k, c] = NONE
        if work.held[switch["freedom"]] != 0.0 or work.modes[k, RESTS] != 0.0:
            for c in range(SLIDING, MOST + 1):
                if guards[k, c] < 0.0:
                    places[k, c] = 1.0
                elif c > SLIDING:
                    places[k, c] = _gives_way(weights, work.course, k, c, 0.0)[0]
        else:
            q0, v0, v1 = work.modes[k, COORDINATE], work.since[k, 0], work.now[k, 0]
            a0, a1, soft = work.since[k, 1], work.now[k, 1], switch["stiffness"] > 0.0
            for c in range(2):
                sign = 1.0 if c == LOWER else -1.0
                stop = switch["lower"] if c == LOWER else switch["upper"]
                # Held rows drift by round-off and the error of the method, so one that leaves its stop may
                # start beyond it. It leaves with the third power of time.
                before, depth, lag = sign * (q0 - stop), AT_STOP * (switch["unit"] + abs(stop)), 0.0
                if guards[k, c] < 0.0:
                    further = guards[k, c] < min(before, 0.0) - depth
                    if soft or further or sign * v1 < -RESTING * switch["unit"]:
                        places[k, c] = 1.0
                elif guards[k, c] < math.inf:
                    after = guards[k, c]
                    if soft:
                        after = sign * (coordinate(model, work, k, work.stage_pose) - stop)
                    if soft and work.modes[k, SIDE] == -sign:
                        # Contact ends where the pressure vanishes.
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
    for k in range(len(work.branches)):
        row, places = len(model.switches) + k, work.crossed
        for c in range(5):
            places[row, c] = NONE
        if work.branches[k] == OPEN:
            continue
        for c in range(LEAST, MOST + 1):
            # After an event a guard starts at zero, up to the error of the method.
            start = 0.0
            if may_be_beyond(model.space.forces.laws, work.branches[k], k):
                start = min(work.course[START, row, c - LEAST], 0.0)
            place, way = 1.0, work.guards[row, c] - start
            if not way < 0.0:
                place, way = _gives_way(weights, work.course, row, c, start)
                if place == NONE and start == 0.0 and work.dips[row, c - LEAST, 0] > 0.0:
                    place, way = work.dips[row, c - LEAST, 0], work.dips[row, c - LEAST, 1]
            if place != NONE and not _matters(model, work, k, c, way, h):
                again = again or place == 1.0
                place = IDLE if place == 1.0 else NONE
            places[row, c] = place
            found = found or place >= 0.0
    for row in range(len(model.switches), len(work.crossed) if again else 0):
        for c in range(LEAST, MOST + 1):
            if work.crossed[row, c] == IDLE:
                work.crossed[row, c] = NONE
                if not found:  # else it may matter up to what was found
                    k, laws = row - len(model.switches), model.space.forces.laws
                    if is_shared(laws, work.branches[k], k) or is_table(laws, k):
                        work.branches[k] = next_branch(laws, work.branches[k], k, c == MOST)
                    else:
                        work.branches[k] = OPEN
    if again and not found:
        return AGAIN
    for k in range(len(work.branches)):
        if work.branches[k] == OPEN:
            _close_branch(work, weights, k, len(model.switches) + k)
    work.pace[0] = _longest(model, work, END)
    if not found:
        _note_depths(model, work)
    return CROSSED if found else CALM


@kernel
def _note_depths(model, work):
    """Note the largest depth of a contact of two bodies at the end of a step."""
    closing = model.space.forces.laws.closing
    for j in range(len(closing)):
        k = closing[j]["kink"]
        if closing[j]["bodies"][1] >= 0 and work.branches[k] == BELOW:  # 0 < depth
            part = work.guards[len(model.switches) + k, LEAST] / closing[j]["size"]
            if part > work.report[DEEPEST]:
                work.report[DEEPEST], work.report[DEEPEST_OF] = part, j
