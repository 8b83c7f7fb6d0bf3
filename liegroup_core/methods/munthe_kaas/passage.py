# SPDX-License-Identifier: Apache-2.0
"""Passage of an explicit Munthe-Kaas method through parts of time, each with inputs and a step size of its own.

One call for a whole run: between two calls for steps Python takes ten times as long as a small mechanism's step.
"""

from liegroup_core.compiling import borrowed, kernel, stepper
from liegroup_core.dynamics.switches import write_modes
from liegroup_core.events.crossings import CALM
from liegroup_core.mechanism.bodies import copy_state
from liegroup_core.status import EVENT, OK

from .advance import accept, attempt
from .ahead import keep_turns, set_turns
from .steps import close, enter, find_event, leave, watches


@kernel
def _copy_rows(source, first, out):
    for i in range(len(out)):
        for c in range(out.shape[1]):
            out[i, c] = source[first + i, c]


@kernel
def _keep(model, work, pose, twist, place, poses_out, twists_out, modes_out, angles_out):
    """Write poses, twists, modes and unwrapped angles to the rows of a kept time."""
    n = len(pose)
    for i in range(n):
        for c in range(12):
            poses_out[place * n + i, c] = pose[i, c]
        for c in range(6):
            twists_out[place * n + i, c] = twist[i, c]
    write_modes(model, work, place * len(model.switches), modes_out)
    for k in range(len(work.angle)):
        angles_out[place, k] = work.angle[k]


@stepper
def passage(
    model,
    work,
    scheme,
    times,
    counts,
    places,
    wrenches,
    targets,
    motions,
    pose_in,
    twist_in,
    external_in,
    kept,
    angles_out,
):
    """Go through m parts, in place of pose (n, 12) and twist (n, 6).

    A part in which stops or friction change is not begun: the status is EVENT.

    scheme   : of an explicit method without error control
    times    : (m + 1,) s, the ends of the parts
    counts   : (m,) equal steps of each part
    places   : (m + 1,) row of the kept states for each time, -1: not kept
    wrenches : (m n, COLUMNS) external wrenches of each part, see forces/external.py
    targets  : (m s, 2) target positions and velocities of the servos
    motions  : (m d, 7) motions of the driven joints
    kept, angles_out : (poses (k n, 12), twists (k n, 6), modes (k s, 5)) and unwrapped angles (k, a) of kept states
    returns (parts done, status), see `advance`
    """
    pose_now, twist_now, inputs = borrowed(pose_in), borrowed(twist_in), borrowed(external_in)
    n, servos = len(pose_now), len(work.targets)
    driven, watching = len(work.motions), watches(model, work)
    for k in range(len(counts)):
        if places[k] >= 0:
            _keep(model, work, pose_now, twist_now, places[k], kept[0], kept[1], kept[2], angles_out)
        _copy_rows(wrenches, k * n, inputs)
        _copy_rows(targets, k * servos, work.targets)
        _copy_rows(motions, k * driven, work.motions)
        keep_turns(work, work.start_angle, work.start_coordinates)
        pose, twist, external, status = enter(model, work, pose_now, twist_now, inputs)
        if watching:
            copy_state(pose, twist, work.start_pose, work.start_twist)
        size = (times[k + 1] - times[k]) / counts[k]
        for step in range(counts[k]):
            status = attempt(model, work, scheme, size, times[k] + step * size, 0.0, 0, pose, twist, external)
            if status == OK and watching and find_event(model, work, scheme, 0.0, size) != CALM:
                status = EVENT
            if status == OK and model.projects:
                status = close(model, work, False)
            if status == EVENT:
                copy_state(work.start_pose, work.start_twist, pose, twist)
                set_turns(work, work.start_angle, work.start_coordinates)
            if status != OK:
                return k, status
            accept(model, work, pose, twist, external)
        leave(model, work, pose, twist, pose_now, twist_now)
    last = len(counts)
    if places[last] >= 0:
        _keep(model, work, pose_now, twist_now, places[last], kept[0], kept[1], kept[2], angles_out)
    return last, OK
