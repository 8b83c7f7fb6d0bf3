# SPDX-License-Identifier: Apache-2.0
"""Operations of a generalised-alpha step in relative coordinates; see generalized_alpha.py.

A step multiplies the coordinates of every link by the exponential of an element of the algebra of
its motion group, so that joints of the tree stay exactly closed. The residual is
    M qddot_1 + bias + J^T lambda - S^T W = 0 ,   g / sigma = 0
in N m or N, and in m/s^2 or rad/s^2. g are the position residuals of the independent rows of the cut
joints, lambda their multipliers.
"""

from liegroup_core.compiling import borrowed, kernel, subroutine
from liegroup_core.dynamics import state as link_state
from liegroup_core.dynamics.accelerations import accelerations, apply_forces
from liegroup_core.dynamics.algebra import is_direct
from liegroup_core.dynamics.coordinates import displace, lift_links, normalise, place_links
from liegroup_core.dynamics.coupled_rows import set_gap, set_slopes
from liegroup_core.dynamics.inverse_dynamics import inverse_dynamics
from liegroup_core.dynamics.rows import set_rows
from liegroup_core.dynamics.state import enter as enter
from liegroup_core.dynamics.state import leave as leave
from liegroup_core.dynamics.trees import move_links
from liegroup_core.lie.vec3 import load3, load_column, store3
from liegroup_core.mechanism.bodies import STEP_TURN
from liegroup_core.methods.checks import end_status, rotation_status
from liegroup_core.motion_groups.direct import to_link, to_link_rate, to_world, to_world_rate
from liegroup_core.status import OK

from .arrays import set_end, set_size, sigma


@kernel
def begin(model, work, memory, pose, twist):
    """Write the rates of all links to memory.velocity."""
    n = len(model.bodies)
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            memory.velocity[first + k] = twist[n + b, k]
        if is_direct(model, model.links[b]):
            v = to_world(pose, n + b, load3(twist, n + b, 3))
            memory.velocity[first + 3], memory.velocity[first + 4], memory.velocity[first + 5] = v


@kernel
def set_unknowns(model, work, memory, pose, twist, external):
    """Write qddot and lambda of the index-1 equations to memory.x; returns -1 or a dependent element."""
    set_size(model.space, memory, pose)
    link_state.begin(model, work, pose, twist)
    dependent = accelerations(model, work, external)
    if dependent >= 0:
        return model.owners[dependent]
    f = len(memory.rate)
    for k in range(f):
        memory.x[k] = work.acceleration[k, 0]
    n = len(model.bodies)
    for b in range(len(model.links)):
        if is_direct(model, model.links[b]):
            at, w, v = (model.links[b]["freedom"] + 3, load3(twist, n + b, 0), load3(twist, n + b, 3))
            rate = to_world_rate(pose, n + b, w, v, load_column(work.acceleration, at, 0))
            memory.x[at], memory.x[at + 1], memory.x[at + 2] = rate
    for r in range(len(work.multipliers)):
        memory.x[f + r] = work.multipliers[r]
    return -1


@kernel
def move(model, work, memory, numbers, h, pose):
    """Write the end of the step for memory.x to the links at the stage. Returns a status."""
    set_end(memory, numbers, h)
    n, largest = len(model.bodies), 0.0
    for b in range(len(model.links)):
        first = model.links[b]["freedom"]
        rotation = displace(model, b, pose, memory.psi, first, work.stage_pose)
        # NaN propagates.
        if not rotation <= largest:
            largest = rotation
        for k in range(model.links[b]["freedoms"]):
            work.stage_twist[n + b, k] = memory.end[first + k]
            memory.body_rate[first + k, 0] = memory.x[first + k]
        if is_direct(model, model.links[b]):
            v = to_link(work.stage_pose, n + b, load3(work.stage_twist, n + b, 3))
            store3(v, work.stage_twist, n + b, 3)
            rate = memory.x[first + 3], memory.x[first + 4], memory.x[first + 5]
            w = load3(work.stage_twist, n + b, 0)
            rate = to_link_rate(work.stage_pose, n + b, w, v, rate)
            memory.body_rate[first + 3, 0], memory.body_rate[first + 4, 0] = rate[0], rate[1]
            memory.body_rate[first + 5, 0] = rate[2]
    work.report[STEP_TURN] = max(work.report[STEP_TURN], largest)
    return rotation_status(largest)


@subroutine
def residual(model, work, memory, numbers, h, pose, external):
    """Write the residual of one step at memory.x into memory.residual, and the state as `move`."""
    pose, external = borrowed(pose), borrowed(external)
    status = move(model, work, memory, numbers, h, pose)
    if status != OK:
        return status
    f = len(memory.rate)
    for r in range(len(work.multipliers)):
        work.multipliers[r] = memory.x[f + r]
    applied = model.space.forces.exist or work.pushed[0] > 0.0
    move_links(model, work)
    if applied or len(model.cuts) > 0:
        place_links(model, work)
    if applied:
        apply_forces(model, work, external)
    if len(model.cuts) > 0:
        set_rows(model, work)
        set_slopes(model, work)
        lift_links(model, work)
        set_gap(model, work)
    inverse_dynamics(model, work, memory.body_rate, memory.residual)
    for row in range(len(model.row_residual)):
        memory.residual[f + row] = work.gap[model.row_residual[row]] / sigma(numbers, h)
    return OK


@kernel
def finish(model, work, memory, h):
    """Check and normalise the end of the step, place the bodies, unwrap angles. Returns a status."""
    for b in range(len(model.links)):
        normalise(model, b, work.stage_pose)
    link_state.place(model, work, work.stage_pose, work.stage_twist)
    status = end_status(model.space.forces, h, work.stage_pose, work.stage_twist)
    if status != OK:
        return status
    link_state.count_turns(model, work)
    set_size(model.space, memory, work.stage_pose)
    return OK
