# SPDX-License-Identifier: Apache-2.0
"""Steps of a Munthe-Kaas method: equal ones, in substeps that meet tolerances, and ahead of the caller.

Only the functions that Python calls are compiled with the mechanics; explicit.substep is the loop over the stages.
"""

import math

from liegroup_core.compiling import borrowed, kernel, stepper
from liegroup_core.events.crossings import AGAIN, CALM, CROSSED, first_place, is_too_long
from liegroup_core.mechanism.arrays import BEGIN
from liegroup_core.mechanism.bodies import LARGEST_TURN, ROUND_OFF, STEP_TURN, copy_state
from liegroup_core.status import EVENT, OK, TOO_MANY_SUBSTEPS

from . import explicit, implicit
from .ahead import (
    divides,
    fraction,
    go_on,
    keep,
    keep_lead,
    keep_slopes,
    keep_turns,
    meet_inputs,
    meet_limit,
    passes,
    recall,
    recall_lead,
    set_turns,
    set_weights,
    shorten,
    start_lead,
    time_before,
    time_left,
    time_of,
)
from .error_control import DIVIDED, judge, unlike
from .steps import begin, check_end, close, count_turns, enter, find_event, leave, place, rest, store_slopes, watches

SLOWER = 0.9  # part of the longest substep, that is repeated
MOST_EQUAL = 2.0  # substeps up to a known change that are equal


@kernel
def is_timed(model, work):
    """Whether accelerations depend on the time, which has other round-off at the end of a substep than at a start."""
    return len(work.motions) > 0 or model.space.forces.laws.timed


@kernel
def attempt(model, work, scheme, size, start, since, first, pose, twist, external):
    """Set the stage to the end of a substep of `size` s from a state. Returns a status.

    start, since : s, time of the step, and of the substep in it
    first        : 1: the derivative at the start is that of stage 0
    """
    work.report[STEP_TURN] = work.report[ROUND_OFF] = 0.0
    begin(model, work, pose, twist)
    if len(scheme.newton.z) > 0:
        status = implicit.substep(scheme, model, work, size, start, since, first, pose, external)
    else:
        last = scheme.error.shape[1]
        status = explicit.substep(scheme, model, work, size, start, since, first, last, pose, external)
    if status == OK:
        status = check_end(model, work, size)
    return status


@kernel
def accept(model, work, pose, twist, external):
    """The end of a substep, at the stage, becomes the state."""
    count_turns(model, work, external)
    copy_state(work.stage_pose, work.stage_twist, pose, twist)
    work.report[LARGEST_TURN] = max(work.report[LARGEST_TURN], work.report[STEP_TURN])


@kernel
def _accept_controlled(model, work, scheme, control, pose, twist, external):
    """As `accept`; returns 1 if the derivative there is that of stage 0 of the next substep."""
    # First same as last: the end of a substep is stage 0 of the next one, where Psi is zero. Projection changes the
    # end, so that it must be evaluated again.
    store_slopes(model, work, scheme, 0)
    if control.coarse[0] > 0.0:
        _coarsen(control.coarse[0], work.stage_pose, work.stage_twist)
    accept(model, work, pose, twist, external)
    return 0 if model.projects or control.coarse[0] > 0.0 or is_timed(model, work) else 1


@kernel
def _seen(model, work, scheme, start, size):
    """As `find_event`, of a substep under error control: AGAIN, too, if it is too long to see all contacts."""
    if not watches(model, work):
        return CALM
    return AGAIN if is_too_long(model, work, size) else find_event(model, work, scheme, start, size)


@kernel
def _take_again(work, control, size):
    """Let the next substep have the size of the last one, or the pace; returns 0: its first stage is computed again."""
    control.accepted[0] -= 1.0
    control.size[0] = min(size, SLOWER * work.pace[0])
    return 0


@kernel
def _coarsen(factor, pose, twist):
    """Round all numbers to b fewer bits; factor : 2^b + 1 (Veltkamp's splitting)."""
    for i in range(len(pose)):
        for c in range(12):
            large = factor * pose[i, c]
            pose[i, c] = large - (large - pose[i, c])
        for c in range(6):
            large = factor * twist[i, c]
            twist[i, c] = large - (large - twist[i, c])


@stepper
def advance(model, work, scheme, h, steps, pose_in, twist_in, external_in):
    """Take `steps` steps of size h in place of pose (n, 12) and twist (n, 6).

    model, work     : RelativeModel or PlaneModel, and RelativeWork
    external        : external wrenches of these steps, see forces/external.py
    returns (steps done, status): fewer steps if status is not OK. Pose, twist and work.angle are those of the last
    valid step. The low byte of status is the code. The other bytes are the element for DEPENDENT_ROWS, and for
    TURNS_NOT_COUNTED the torsional spring, or the switch, counted after the springs.
    """
    pose_in, twist_in, external_in = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
    watching, done = watches(model, work), 0
    while done < steps and status == OK:
        start = (work.clock.count[0] + done) * h + work.clock.offset[0]
        status = attempt(model, work, scheme, h, start, 0.0, 0, pose, twist, external)
        seen = find_event(model, work, scheme, 0.0, h) if status == OK and watching else CALM
        if seen == AGAIN:
            continue
        if seen == CROSSED:
            status = EVENT
        if status == OK and model.projects:
            status = close(model, work, False)
        if status == OK:
            accept(model, work, pose, twist, external)
            done += 1
    if done > 0 or status == EVENT:
        leave(model, work, pose, twist, pose_in, twist_in)
    return done, status


@stepper
def advance_controlled(model, work, scheme, h, steps, pose_in, twist_in, external_in, control):
    """As `advance`, each step in substeps that meet the tolerances of a SubstepControl.

    After EVENT, pose, twist and work.angle are those of the last valid substep.
    """
    pose_in, twist_in, external_in = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
    watching, done, first = watches(model, work), 0, 0
    while done < steps and status == OK:
        _save(work, pose, twist, control)
        start, remaining = (work.clock.count[0] + done) * h + work.clock.offset[0], h
        attempts, planned = 0, 0
        if is_timed(model, work):
            first = 0  # the time at the end of the last step differs by round-off
        while status == OK and remaining > 0.0:
            # Equal substeps up to the end of the step, so that the last one is not tiny.
            count = max(1, math.ceil(remaining / control.size[0] - 1e-6))
            if remaining == h and control.longer[0] > 0.0:
                planned = unlike(work, control, h, count)
            count = max(count, planned)
            size = remaining / count
            if remaining == h and control.coarse[0] > 0.0:  # after an event, whose time is that of the simulation
                count, size = count + 1, size * DIVIDED
            status = attempt(model, work, scheme, size, start, h - remaining, first, pose, twist, external)
            attempts += 1
            if status == OK:
                first = 1
            status, accepted = judge(model, work, scheme, size, status, twist, control)
            if status == OK and _is_dear(scheme, control, attempts, 1) and not (accepted and count == 1):
                status = TOO_MANY_SUBSTEPS
            if status != OK or not accepted:
                continue
            seen = _seen(model, work, scheme, h - remaining, size)
            if seen == AGAIN:
                first = _take_again(work, control, size)
                continue
            if seen == CROSSED:
                status = EVENT
            if status == OK and model.projects:
                status = close(model, work, True)
            if status == OK:
                first = _accept_controlled(model, work, scheme, control, pose, twist, external)
                if watching:
                    control.size[0] = min(control.size[0], work.pace[0])
                remaining, planned = remaining - size if count > 1 else 0.0, planned - 1
        if status == OK:
            done += 1
        elif status != EVENT:
            _note_attempts(control, status, attempts, remaining)
            _restore(work, pose, twist, control)
    if done > 0 or status == EVENT:
        leave(model, work, pose, twist, pose_in, twist_in)
    return done, status


@kernel
def _save(work, pose, twist, control):
    """Save the state at the start of a step for `_restore`."""
    copy_state(pose, twist, work.start_pose, work.start_twist)
    keep_turns(work, work.start_angle, work.start_coordinates)
    control.kept_size[0] = control.size[0]


@kernel
def _restore(work, pose, twist, control):
    """Restore the state saved by `_save`."""
    copy_state(work.start_pose, work.start_twist, pose, twist)
    set_turns(work, work.start_angle, work.start_coordinates)
    control.size[0] = control.kept_size[0]


@kernel
def _is_dear(scheme, control, attempts, steps):
    """Whether attempts in some steps are too many, or all evaluations."""
    return attempts >= control.most[0] * steps or scheme.spent[0] >= control.dear[0]


@kernel
def _note_attempts(control, status, attempts, remaining):
    """Note which part of its attempts a step made that failed because of too many."""
    control.part[0] = 0.0
    if status == TOO_MANY_SUBSTEPS:
        control.part[0] = attempts / (attempts + remaining / control.size[0])


@stepper
def reach(model, work, scheme, steps, pose_in, twist_in, external_in, control):
    """Integrate up to the end of the call, or further; set pose (n, 12) and twist (n, 6) to the state there.

    steps : in the call, at least 1, or 0 to do nothing
    returns (steps done, status). Before an event, and where the integration cannot go on, it is the state at the end of
    the last step that the lead has passed; if there is none, 0 steps are done.
    """
    pose_in, twist_in, external_in = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    meet_inputs(work, external_in, control)
    keep_turns(work, work.start_angle, work.start_coordinates)
    if control.leads[0] != 0.0:
        meet_limit(work, control)
        pose, twist, external, status = enter(model, work, work.pose, work.twist, external_in)
        set_turns(work, work.lead_angle, work.lead_coordinates)
    else:
        start_lead(work, control)
        pose, twist, external, status = enter(model, work, pose_in, twist_in, external_in)
        if watches(model, work):
            rest(model, work, twist)
    failed = OK
    if status == OK and steps > 0:
        status = _go_ahead(model, work, scheme, steps, pose, twist, external, control)
        passed = int(control.base[0] - work.clock.from_step[0])
        if status == EVENT:
            work.watch[BEGIN] = time_before(work, control)
        if status != OK and passed > 0 and (status == EVENT or passed < steps):
            failed, status, steps = OK if status == EVENT else status, OK, passed
            work.clock.to_step[0], work.clock.until[0] = control.base[0], 0.0
    inside = steps > 0 and time_left(work, control) < 0.0
    if status == OK and inside:
        status = _go_inside(model, work, scheme, control, external)
    keep_turns(work, work.lead_angle, work.lead_coordinates)
    if status != OK or steps == 0:
        set_turns(work, work.start_angle, work.start_coordinates)
        return 0, status
    if inside:
        set_turns(work, work.kept_angle, work.kept_coordinates)
        count_turns(model, work, external)
    else:
        begin(model, work, pose, twist)
    place(model, work, pose_in, twist_in)
    return steps, failed


@stepper
def inside(model, work, scheme, pose_in, twist_in, external_in, control):
    """Set pose (n, 12), twist (n, 6), angles and coordinates to the end of the call, in the kept substep. A status."""
    pose, twist, external, status = enter(model, work, work.pose, work.twist, borrowed(external_in))
    if time_left(work, control) >= 0.0:  # its end
        set_turns(work, work.lead_angle, work.lead_coordinates)
        begin(model, work, pose, twist)
    elif status == OK:
        status = _go_inside(model, work, scheme, control, external)
        set_turns(work, work.kept_angle, work.kept_coordinates)
        count_turns(model, work, external)
    if status == OK:
        place(model, work, borrowed(pose_in), borrowed(twist_in))
    return status


@kernel
def _go_ahead(model, work, scheme, steps, pose, twist, external, control):
    """Take substeps until the lead is at the end of the call or after it. Returns a status."""
    step, watching, status, attempts = work.clock.step_size[0], watches(model, work), OK, 0
    first = 1 if control.fresh[0] != 0.0 and not is_timed(model, work) else 0
    remaining, before = time_left(work, control), control.size[0]
    if remaining > 0.0 and control.due[0] != 0.0:
        status = EVENT
    while status == OK and remaining > 0.0:
        size, at_limit = _next_size(control)
        start, since = time_of(control.base[0], control.lead[0], step), 0.0
        if control.begins[0] == 0.0:
            start, since = 0.0, start  # an implicit method keeps its Jacobian
        control.begins[0] = 0.0
        if first == 1:
            recall_lead(work)
        status = attempt(model, work, scheme, size, start, since, first, pose, twist, external)
        attempts += 1
        if status == OK:
            first = 1
            if control.fresh[0] == 0.0:
                keep_lead(work, control)
        status, accepted = judge(model, work, scheme, size, status, twist, control)
        # A halt sets the number of attempts from another thread.
        if status == OK and _is_dear(scheme, control, attempts, steps) and not (accepted and size >= remaining):
            status = TOO_MANY_SUBSTEPS
        if status != OK or not accepted:
            continue
        seen = _seen(model, work, scheme, 0.0, size)
        if seen == AGAIN:
            first = _take_again(work, control, size)
            control.fresh[0] = 0.0
            continue
        if seen == CROSSED:
            if shorten(work, control, size, at_limit, first_place(model, work)):
                control.accepted[0] -= 1.0
                continue
            status = EVENT
        if status == OK and model.projects:
            status = close(model, work, True)
        if status != OK:
            continue
        if passes(work, control, size, at_limit):
            keep(work, pose, twist, size, control)
            if len(scheme.newton.z) > 0:
                implicit.keep_stages(scheme, work)
            else:
                keep_slopes(work)
        first = _accept_controlled(model, work, scheme, control, pose, twist, external)
        if watching:
            control.size[0] = min(control.size[0], work.pace[0])
        before = control.size[0]
        go_on(work, control, size, at_limit)
        if control.begins[0] != 0.0 and len(scheme.newton.z) > 0:
            scheme.newton.known[0] = 0.0  # a step begins with a new one, see implicit.substep
        remaining = time_left(work, control)
        control.fresh[0] = 0.0
        if first == 1:
            keep_lead(work, control)
    if status != OK and status != EVENT:
        _note_attempts(control, status, attempts, remaining)
        control.size[0] = before
    return status


@kernel
def _next_size(control):
    """Size of the next substep in s, and whether it ends at a known change: substeps up to that are equal.

    But a substep that ends with a step, before an event, stays as it is.
    """
    size, left, count = control.size[0], control.left[0], 1
    if control.seen[0] > 0.0 and size < left:
        return size, False
    if 0.0 < left < size * MOST_EQUAL:
        count = max(1, math.ceil(left / size - 1e-6))
        size = left / count
        if divides(control):
            count, size = count + 1, size * DIVIDED
    return size, count == 1 and size == left


@kernel
def _go_inside(model, work, scheme, control, external):
    """Set the stage to the caller's time, which is inside the kept substep. Returns a status."""
    start, size = time_of(control.kept_base[0], control.kept_lead[0], work.clock.step_size[0]), control.last[0]
    stages, inside, status, pose = scheme.error.shape[1] - 1, len(scheme.a) - 1, OK, work.kept_pose
    work.report[STEP_TURN] = work.report[ROUND_OFF] = 0.0
    begin(model, work, pose, work.kept_twist)
    if len(scheme.newton.z) > 0:
        status = implicit.inside(scheme, model, work, fraction(work, control), start, size, pose)
    else:
        recall(work)
        if control.ready[0] == 0.0:
            # The derivative at the end before a projection is not known either.
            first = stages + 1 - model.projects
            status = explicit.substep(scheme, model, work, size, start, 0.0, first, inside, pose, external)
            if status == OK:
                keep_slopes(work)
                control.ready[0] = 1.0
                begin(model, work, pose, work.kept_twist)
        if status == OK:
            set_weights(scheme, fraction(work, control))
            status = explicit.substep(scheme, model, work, size, start, 0.0, inside, inside + 1, pose, external)
    if status == OK and model.projects:
        status = close(model, work, True)
    work.clock.now[0] = start + fraction(work, control) * size
    return status
