# SPDX-License-Identifier: Apache-2.0
"""State in relative coordinates, for all integrators: from the caller's arrays, and back to them.

The coordinates and rates of the links are the state; the bodies follow from them. See
dynamics/coordinates.py.
"""

from liegroup_core.compiling import borrowed, kernel, shared
from liegroup_core.forces import kinds as forces
from liegroup_core.forces.external import PULL
from liegroup_core.lie.vec3 import load3, store3
from liegroup_core.mechanism.arrays import make_relative_work
from liegroup_core.mechanism.bodies import copy_state, make_work
from liegroup_core.motion_groups.direct import to_world
from liegroup_core.motion_groups.table import FLOATING
from liegroup_core.status import OK

from .algebra import is_direct
from .coordinates import coordinates, place_bodies, place_links
from .free_bodies import copy_bodies, copy_links
from .trees import move_links


def model_and_work(layout, group, options, stages, kinks=0):
    """(model, its work, Work of the bodies) of an integrator.

    options : "space": "auto" for the plane of a planar mechanism, or "space"
    kinks   : number of those of laws, from the first one on, whose times it finds
    """
    work = make_work(layout.model, stages)
    model = layout.floating(group) if group in FLOATING else layout.relative
    if options["space"] == "space" and model is layout.relative:
        model = layout.relative_in_space
    return model, make_relative_work(model, work, stages, kinks), work


@kernel
def enter_states(model, work, twist):
    """Write the states of laws that are kept to the rates of their links."""
    first = len(work.angle) - len(model.law_links)
    for s in range(len(model.law_links)):
        twist[len(model.bodies) + model.law_links[s], 0] = work.angle[first + s]


@kernel
def count_turns(model, work):
    """Unwrap the angles at the end of a step, and keep the states of laws."""
    forces.count_turns(model.space.forces, work.stage_pose, work.angle)
    first = len(work.angle) - len(model.law_links)
    for s in range(len(model.law_links)):
        row = len(model.bodies) + model.law_links[s]
        work.angle[first + s] = work.stage_twist[row, 0]
        # Its link stays where it is: the integral of a state is no part of the motion. x and y in a plane, and r.
        for c in (2, 3, 9, 10, 11):
            work.stage_pose[row, c] = 0.0


@kernel
def enter(model, work, pose, twist, external):
    """Continue from the coordinates of the last call, or compute them from a state that was set."""
    copy_state(pose, twist, work.pose, work.twist)
    if work.known[0] == 0.0:
        if model.only_free_bodies:
            copy_links(model, work.pose, work.twist)
        else:
            coordinates(model, work, work.pose, work.twist)
            enter_states(model, work, work.twist)
        work.known[0] = 1.0
        # Bodies that are welded to the world get their poses only here.
        copy_state(work.pose, work.twist, work.stage_pose, work.stage_twist)
        copy_state(pose, twist, work.space.stage_pose, work.space.stage_twist)
    total = 0.0
    for i in range(len(external)):
        total += external[i, 15] + external[i, PULL]
        for c in range(6):
            total += abs(external[i, c])
    work.pushed[0] = total
    return work.pose, work.twist, external, OK


@kernel
def leave(model, work, pose, twist, pose_out, twist_out):
    """Write poses and twists of the bodies to the caller's arrays."""
    begin(model, work, pose, twist)
    place(model, work, pose_out, twist_out)


@kernel
def begin(model, work, pose, twist):
    """Set stage 0 to the state."""
    n = len(model.bodies)
    for b in range(len(model.links)):
        for k in range(12):
            work.stage_pose[n + b, k] = pose[n + b, k]
        for k in range(6):
            work.velocity[b, k] = twist[n + b, k]
            work.stage_twist[n + b, k] = twist[n + b, k]
        if is_direct(model, model.links[b]):
            store3(to_world(pose, n + b, load3(twist, n + b, 3)), work.velocity, b, 3)


@shared
def place(model, work, pose_out, twist_out):
    """Poses and twists of the bodies, from the links at the stage."""
    if model.only_free_bodies:
        copy_bodies(model, work.stage_pose, work.stage_twist, borrowed(pose_out), borrowed(twist_out))
        return 0
    move_links(model, work)
    place_links(model, work)
    place_bodies(model, work, borrowed(pose_out), borrowed(twist_out))
    return 0
