# SPDX-License-Identifier: Apache-2.0
"""Operations of a Munthe-Kaas step in relative coordinates: states on the product of joint groups.

The algebra of a link has one number for each freedom. On SO(2), R, SO(2) x R and screws, which are
commutative, dexp is the identity. work.slopes has the degrees of freedom of all links, stage by stage.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.dynamics.accelerations import accelerations
from liegroup_core.dynamics.algebra import first_state, is_direct, tree_size
from liegroup_core.dynamics.coordinates import displace, normalise
from liegroup_core.dynamics.loads import UNSETTLED
from liegroup_core.dynamics.loops import project
from liegroup_core.dynamics.sliding import count_slides
from liegroup_core.dynamics.state import begin as begin
from liegroup_core.dynamics.state import count_turns as keep_angles
from liegroup_core.dynamics.state import enter as enter
from liegroup_core.dynamics.state import leave as leave
from liegroup_core.dynamics.state import place as place
from liegroup_core.dynamics.switches import count_coordinates, set_rates, too_fast
from liegroup_core.events.crossings import CALM, CROSSED, begin_at_end, crossed, note_guards
from liegroup_core.events.crossings import forget_dips as forget_dips
from liegroup_core.events.crossings import note_dips as note_dips
from liegroup_core.lie.vec3 import dot3, load3, load_column, store3, store_column
from liegroup_core.mechanism.arrays import BEGIN, SPAN, WATCHED
from liegroup_core.mechanism.bodies import STEP_TURN
from liegroup_core.methods.checks import end_status
from liegroup_core.motion_groups.direct import to_link, to_world, to_world_rate
from liegroup_core.motion_groups.table import column_twist, is_curved, slope
from liegroup_core.status import LARGEST_ROTATION, NO_FRICTION, NOT_FINITE, OK, ROTATION_TOO_LARGE, TURNS_NOT_COUNTED

from .errors import error_square as error_square
from .free_bodies import move_bodies, store_slopes_of_bodies
from .series import dexpinv_series


@kernel
def _add_slopes(h, weights, row, stages, slopes, count, to):
    """Write the sums h weights[row, l] k_l over the first stages l to rows of slopes from `to` on."""
    for f in range(count):
        psi, dq = 0.0, 0.0
        for stage in range(stages):
            weight = weights[row, stage]
            if weight != 0.0:
                psi += weight * slopes[stage * count + f, 0]
                dq += weight * slopes[stage * count + f, 1]
        slopes[to + f, 0], slopes[to + f, 1] = h * psi, h * dq


@kernel
def move(model, work, scheme, h, stage, end, pose):
    """Set all links to X_0 exp Psi of a stage; at the end of a step, also the bodies if needed."""
    n, count = len(model.bodies), len(work.freedoms)
    first = stage * count
    largest, links = 0.0, tree_size(model)
    if model.only_free_bodies:
        largest, links = move_bodies(model, work, scheme, h, stage, end, pose), 0
    else:
        _add_slopes(h, scheme.a, stage, stage, work.slopes, count, first)
    for b in range(links):
        link = model.links[b]
        f = first + link["freedom"]
        largest = max(largest, displace(model, b, pose, work.slopes, f, work.stage_pose))
        if end:
            normalise(model, b, work.stage_pose)
        work.stage_twist[n + b, 0] = work.velocity[b, 0] + work.slopes[f, 1]
        for k in range(1, link["freedoms"]):
            work.stage_twist[n + b, k] = work.velocity[b, k] + work.slopes[f + k, 1]
        if is_direct(model, link):
            v = to_link(work.stage_pose, n + b, load3(work.stage_twist, n + b, 3))
            store3(v, work.stage_twist, n + b, 3)
    size, state = tree_size(model), first + first_state(model, work)
    for s in range(len(model.law_links)):  # what it integrates is its rate
        work.stage_twist[n + size + s, 0] = work.velocity[size + s, 0] + work.slopes[state + s, 1]
    if not largest < LARGEST_ROTATION * LARGEST_ROTATION:
        return ROTATION_TOO_LARGE if largest < math.inf else NOT_FINITE
    work.report[STEP_TURN] = max(work.report[STEP_TURN], largest)
    if end and (len(scheme.error) > 0 or len(work.angle) > 0):
        place(model, work, work.stage_pose, work.stage_twist)
    return OK


@kernel
def accelerate(model, work, external):
    """Compute the accelerations of a stage. Returns -1, or the element with dependent rows."""
    joint = accelerations(model, work, external)
    return joint if joint < 0 else model.owners[joint]


@kernel
def store_slopes(model, work, scheme, stage):
    """Compute k of all links from the accelerations of a stage."""
    n, count = len(model.bodies), len(work.freedoms)
    first = stage * count
    if model.only_free_bodies:
        store_slopes_of_bodies(model, work, scheme, stage)
        return
    size, state = tree_size(model), first_state(model, work)
    for b in range(size):
        link = model.links[b]
        f, row = link["freedom"], n + b
        at = first + f
        # At stage 0 Psi is zero, and dexp^-1 the identity.
        if stage > 0 and is_curved(link):
            turn, _ = column_twist(link, work.slopes, at)
            factor, b_x, u_x = dexpinv_series(scheme, dot3(turn, turn))
            slope(link, factor, b_x, u_x, work.stage_twist, row, work.slopes, at)
        else:
            for k in range(link["freedoms"]):
                work.slopes[at + k, 0] = work.stage_twist[row, k]
        for k in range(link["freedoms"]):
            work.slopes[at + k, 1] = work.acceleration[f + k, 0]
        if is_direct(model, link):
            w, v = load3(work.stage_twist, row, 0), load3(work.stage_twist, row, 3)
            rate = load_column(work.slopes, at + 3, 1)
            store_column(to_world(work.stage_pose, row, v), work.slopes, at + 3, 0)
            rate = to_world_rate(work.stage_pose, row, w, v, rate)
            store_column(rate, work.slopes, at + 3, 1)
    for s in range(len(model.law_links)):
        at = first + state + s
        work.slopes[at, 0], work.slopes[at, 1] = work.stage_twist[n + size + s, 0], work.acceleration[state + s, 0]
    if stage == 0 and len(model.switches) > 0:
        set_rates(model, work, work.since)


@kernel
def check_end(model, work, h):
    """Status of the end of a step of size h: NOT_FINITE, or TURNS_NOT_COUNTED + (spring or switch << 8)."""
    if work.iteration[UNSETTLED] != 0.0:
        work.iteration[UNSETTLED] = 0.0
        return NO_FRICTION
    status = end_status(model.space.forces, h, work.stage_pose, work.stage_twist)
    if status == OK and len(model.switches) > 0:
        fast = too_fast(model, work, h)
        if fast >= 0:
            return TURNS_NOT_COUNTED + ((len(work.angle) + fast) << 8)
    return status


@kernel
def close(model, work, controlled):
    """Project the end of a step onto the cut joints. Returns a status.

    The tolerance of the next substep depends on the twists of the bodies.
    """
    status = project(model, work)
    if status == OK and (controlled or len(work.angle) > 0):
        place(model, work, work.stage_pose, work.stage_twist)
    return status


@kernel
def count_turns(model, work, external):
    """Unwrap the angles of torsional springs and switches at the end of a step, and keep what laws hold."""
    keep_angles(model, work)
    count_coordinates(model, work)
    if len(work.shares) == 0:
        return
    laws, sliding = model.space.forces.laws, count_slides(model, work) > 0
    for j in range(len(work.shares)):
        work.kept_branches[j] = work.branches[laws.surfaces[j]]
    if sliding:
        accelerations(model, work, external)
    for j in range(len(work.shares)):
        k = laws.surfaces[j]
        work.angle[laws.first + len(laws.held) + j] = work.branches[k] if work.branches[k] > 1.0 else 0.0
        work.branches[k] = work.kept_branches[j]


@kernel
def rest(model, work, twist):
    """Set the rates of held freedoms to zero: those of a state that was entered have round-off."""
    n = len(model.bodies)
    for b in range(len(model.links)):
        for k in range(model.links[b]["freedoms"]):
            if work.held[model.links[b]["freedom"] + k] != 0.0:
                twist[n + b, k] = 0.0


@kernel
def watches(model, work):
    """Whether steps stop at events."""
    return work.watch[WATCHED] > 0.0


@kernel
def notes(work):
    """Whether the guards of the stages are kept in Work.course."""
    return work.watch[WATCHED] != 0.0


@kernel
def note_stage(model, work, scheme, stage):
    """Save the guards of held switches; at the end of a substep set those of all switches."""
    note_guards(model, work, scheme.rows[stage])


@kernel
def find_event(model, work, scheme, start, h):
    """CROSSED if an event is in the substep of size h that begins at time `start` of the step, AGAIN, or CALM."""
    seen = crossed(model, work, h, scheme.weights)
    if seen == CALM:
        begin_at_end(work)
    elif seen == CROSSED:
        work.watch[BEGIN], work.watch[SPAN] = start, h
    return seen
