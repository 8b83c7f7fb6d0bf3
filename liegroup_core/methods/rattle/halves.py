# SPDX-License-Identifier: Apache-2.0
"""Both halves of a RATTLE step.

The discrete Lagrangian of rattle.py on the trajectories of the tree. Every link is one rigid body. Its
variations are S at the start and S+ at the end of a step, so that no joint of the tree has a
multiplier: with S^T the sum over a link and its children, in their axes,
    S^T (M V' - M V - (h/2) Q) + J^T lambda = 0 ,   g+ = 0        unknown: psi, lambda
    S+^T (M V+ - M V'+ - (h/2) Q+) + J+^T mu = 0 ,   J+ V+ = 0    unknown: qdot+, mu
psi are the displacements of the joints, J, lambda, mu and g those of the cut joints. M V' follows from
psi, see space_links.py. The second half solves for rates as the index-1 equations do for accelerations,
with links at rest under the impulses M V'+ + (h/2) Q+.

The derivative of the first half is (M/h, J^T; J, 0) of the tree at the start up to O(h). With its
factors, from the second half of the last step, a correction takes two sweeps. It does not
depend on lambda, which the solve eliminates; Broyden's method acts on psi alone.
"""

import math

from liegroup_core.compiling import borrowed, kernel, subroutine
from liegroup_core.dynamics.accelerations import apply_forces, solve_equations
from liegroup_core.dynamics.constraints import is_satisfied, position_residuals
from liegroup_core.dynamics.coordinates import normalise, place_links
from liegroup_core.dynamics.coupled_rows import set_coupled_gaps
from liegroup_core.dynamics.loops import close_loops, gather_alone, set_loops
from liegroup_core.dynamics.residuals import add_multipliers, gather_forces, set_response_residual
from liegroup_core.dynamics.state import count_turns, place
from liegroup_core.dynamics.state import enter as enter
from liegroup_core.dynamics.state import leave as leave
from liegroup_core.dynamics.trees import move_links, spread_response
from liegroup_core.mechanism.bodies import STEP_TURN
from liegroup_core.methods.broyden import broyden
from liegroup_core.methods.checks import end_status
from liegroup_core.status import DEPENDENT_ROWS, LARGEST_ROTATION, NOT_CONVERGED, NOT_FINITE, OK, ROTATION_TOO_LARGE

from .arrays import HISTORY, MAX_REPEATS, STUCK, TOLERANCE, times_between
from .free_bodies import first_half_of_bodies, loads_of_bodies, second_half_of_bodies
from .links import (
    add_applied,
    add_rotor_impulses,
    displace_links,
    move_coordinates,
    place_ends,
    set_at_rest,
    set_momentum,
    transport,
    weigh,
)

MAX_ITERATIONS = 50


@kernel
def _has_applied(model, work):
    """Whether anything but gravity acts."""
    return model.space.forces.exist or work.pushed[0] > 0.0


@subroutine
def _move(model, work, is_placed):
    """Poses and velocities of all links at the stage; is_placed: poses in the world are known."""
    move_links(model, work)
    if is_placed:
        return 0
    if len(model.cuts) > 0 or _has_applied(model, work):
        place_links(model, work)
    return 0


@subroutine
def _loads(model, work, memory, external):
    """Write Q of all links at the stage to memory.load. Overwrites work.applied and force."""
    external = borrowed(external)
    weigh(model, work, memory)
    if _has_applied(model, work):
        for b in range(len(model.links)):
            for c in range(work.applied.shape[1]):
                work.applied[b, c] = 0.0
        apply_forces(model, work, external)
        add_applied(model, work, memory)
    return 0


@kernel
def begin(model, work, memory, pose, twist, external, fresh):
    """Set the stage to the state, and Q there."""
    if fresh:
        for row in range(len(model.bodies), len(pose)):
            for c in range(12):
                work.stage_pose[row, c] = pose[row, c]
            for c in range(6):
                work.stage_twist[row, c] = twist[row, c]
        if not model.only_free_bodies:
            _move(model, work, False)
    if model.only_free_bodies:
        loads_of_bodies(model, work, external)
        for i in range(len(model.bodies)):
            for c in range(6):
                memory.load[i, c] = work.wrench[i, c]
        return
    _loads(model, work, memory, external)


@kernel
def _extrapolate(model, work, memory, h):
    """Extrapolate psi from the last substeps.

    (2/h) (psi/h - qdot) is the acceleration at h/3 after the start of a substep, up to O(h^2).
    returns the time in s between these points of the last substep and of this one
    """
    n = len(model.bodies)
    since, ahead = times_between(memory, h)
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            f = first + k
            mean = memory.bias[f] + ahead * memory.growth[f]
            memory.psi[f, 0] = h * (work.stage_twist[n + b, k] + 0.5 * h * mean)
    return since


@kernel
def _store_history(model, work, memory, h, since):
    """Store psi of a finished substep for `_extrapolate`."""
    # With backward substeps these points may be too close in time for a difference quotient.
    are_apart = memory.size[0] != 0.0 and abs(since) > 0.2 * abs(h)
    n = len(model.bodies)
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            f = first + k
            bias = 2.0 / h * (memory.psi[f, 0] / h - work.stage_twist[n + b, k])
            if are_apart:
                memory.growth[f] = (bias - memory.bias[f]) / since
            memory.bias[f] = bias
    memory.size[0] = h


@kernel
def _correct(model, work, memory, h, k, is_open):
    """Add correction k to memory.psi.

    work.force : (L, s) M V' - M V - (h/2) Q; overwritten
    is_open    : False: the cut joints are closed, so that work.gap is not corrected
    returns (largest component of the correction, largest one of psi)
    """
    if len(model.cuts) > 0:
        add_multipliers(model, work)
    add_rotor_impulses(model, work, memory, h)
    gather_forces(model, work)
    if len(model.cuts) > 0:
        for r in range(len(work.bias)):
            work.bias[r] = -work.gap[model.row_residual[r]] / h if is_open else 0.0
        set_response_residual(model, work)
        close_loops(model, work)
    spread_response(model, work)
    step, size, change = memory.corrections, 0.0, 0.0
    for f in range(len(memory.bias)):
        step[k, f] = h * work.acceleration[f, 0]
    broyden(step, k, 0.5)
    for f in range(len(memory.bias)):
        memory.psi[f, 0] += step[k, f]
        # NaN propagates.
        if not abs(step[k, f]) <= change:
            change = abs(step[k, f])
        size = max(size, abs(memory.psi[f, 0]))
    return change, size


@kernel
def _length(model, memory):
    """Largest term in the residuals of the cut joints, m or rad."""
    length = 0.0
    for j in range(len(model.cuts)):
        cut = model.cuts[j]
        element = model.elements[cut["element"]]
        length = max(length, abs(element["parameter"]))
        for c in range(3):
            length = max(length, abs(memory.world[cut["child"], 9 + c]))
            length = max(length, abs(element["child_point"][c]))
        for r in range(cut["first"], cut["first"] + cut["rows"]):
            length = max(length, float(model.row_turns[r]))
    return length


@kernel
def first_half(model, work, memory, h, fresh):
    """Find psi and V' that satisfy the constraints at the end. Returns a status.

    h     : s, substep
    fresh : True: the matrices at the start are not factorised yet
    """
    if model.only_free_bodies:
        return first_half_of_bodies(model, work, memory, h)
    if fresh:
        gather_alone(model, work)
        if len(model.cuts) > 0:
            found = set_loops(model, work)
            if found >= 0:
                return DEPENDENT_ROWS + (model.owners[found] << 8)
    set_momentum(model, work, memory, h)
    since = _extrapolate(model, work, memory, h)
    for r in range(len(work.multipliers)):
        work.multipliers[r] = 0.0
    previous, done, was_closed = math.inf, False, False
    for iteration in range(MAX_ITERATIONS):
        angle = displace_links(model, work, memory, h)
        if not angle < LARGEST_ROTATION:
            return ROTATION_TOO_LARGE if angle < math.inf else NOT_FINITE
        if done:
            break
        closed, length = True, 0.0
        if len(model.cuts) > 0:
            place_ends(model, work, memory)
            position_residuals(model, memory.world, work.gap)
            set_coupled_gaps(model, work, memory.psi, 1)
            closed = is_satisfied(model, work, memory.world)
            length = _length(model, memory)
        # At round-off level, one more correction removes the bias of the remaining residual. Next to
        # a singular pose further ones would only add its round-off, many times larger.
        is_open = not (closed and was_closed)
        change, size = _correct(model, work, memory, h, iteration % HISTORY, is_open)
        was_closed = closed
        rate = 1.0 if previous == math.inf else max(0.01, min(1.0, change / previous))
        noise = 2.0**-52 * (size + length)
        done = closed and (
            change * rate <= 2.0**-53 * size or change <= noise or (0.5 * previous < change <= STUCK * noise)
        )
        previous = change
    if not done:
        return NOT_CONVERGED
    _store_history(model, work, memory, h, since)
    n = len(model.bodies)
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            # 2 V' - V, the initial guess of V+
            work.stage_twist[n + b, k] = 2.0 / h * memory.psi[first + k, 0] - work.stage_twist[n + b, k]
        move_coordinates(model, b, memory.psi, work.stage_pose)
        normalise(model, b, work.stage_pose)
    return OK


@kernel
def _set_rates(model, work):
    """Set the rates of all links to work.acceleration."""
    n = len(model.bodies)
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            work.stage_twist[n + b, k] = work.acceleration[first + k, 0]


@kernel
def _change_rates(model, work, memory, h, k):
    """Add correction k to the rates, for the change of Q+ from memory.last_load to memory.load.

    The residual of the rates is qdot+ minus the response to P + (h/2) Q+, P = M V'+. It is updated by the
    last correction minus the response to the change of Q+, which become small numbers.
    returns (largest component of the correction, largest rate)
    """
    for b in range(len(model.links)):
        for c in range(work.force.shape[1]):
            work.force[b, c] = -0.5 * h * (memory.load[b, c] - memory.last_load[b, c])
    gather_forces(model, work)
    if len(model.cuts) > 0:
        for r in range(len(work.bias)):
            work.bias[r] = 0.0
        set_response_residual(model, work)
        close_loops(model, work)
    spread_response(model, work)
    step, last = memory.corrections, (k - 1) % HISTORY
    for f in range(len(memory.residual)):
        memory.residual[f] -= work.acceleration[f, 0]
        if k > 0:
            memory.residual[f] += step[last, f]
    k %= HISTORY
    for f in range(len(memory.residual)):
        step[k, f] = -memory.residual[f]
    broyden(step, k, 0.5)
    n, change, speed = len(model.bodies), 0.0, 0.0
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        for i in range(model.links[b]["freedoms"]):
            rate = step[k, first + i]
            work.stage_twist[n + b, i] += rate
            # NaN propagates.
            if not abs(rate) <= change:
                change = abs(rate)
            speed = max(speed, abs(work.stage_twist[n + b, i]))
    return change, speed


@kernel
def second_half(model, work, memory, h, external):
    """Find V+ at the end of a substep, as the rates at the stage, and Q+. Returns a status."""
    if model.only_free_bodies:
        return second_half_of_bodies(model, work, memory, h, external)
    applied = _has_applied(model, work)
    transport(model, work, memory)
    _move(model, work, False)
    _loads(model, work, memory, external)
    set_at_rest(model, work, memory, h)
    found = solve_equations(model, work)
    if found >= 0:
        return DEPENDENT_ROWS + (model.owners[found] << 8)
    _set_rates(model, work)
    _move(model, work, True)
    if not applied:
        return OK
    for f in range(len(memory.residual)):
        memory.residual[f] = 0.0
    previous = math.inf
    for repeat in range(MAX_REPEATS):
        for b in range(len(model.links)):
            for c in range(memory.load.shape[1]):
                memory.last_load[b, c] = memory.load[b, c]
        _loads(model, work, memory, external)
        change, speed = _change_rates(model, work, memory, h, repeat)
        _move(model, work, True)
        if change <= TOLERANCE * speed or (0.5 * previous < change <= STUCK * TOLERANCE * speed):
            return OK
        previous = change
    return NOT_CONVERGED


@kernel
def keep(model, work, memory):
    """Continue from the end of a substep, which is the stage."""
    work.report[STEP_TURN] = max(work.report[STEP_TURN], memory.turned[0])


@kernel
def finish(model, work, h):
    """Check the end of a step, place the bodies if needed, and unwrap angles. Returns a status."""
    if len(work.angle) > 0:
        place(model, work, work.stage_pose, work.stage_twist)
    status = end_status(model.space.forces, h, work.stage_pose, work.stage_twist)
    if status == OK:
        count_turns(model, work)
    return status
