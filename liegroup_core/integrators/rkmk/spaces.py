# SPDX-License-Identifier: Apache-2.0
"""Operations of a Munthe-Kaas step, selected by the type of the model: absolute or relative.

munthe_kaas.py takes the steps for both. spatial.py has the operations for a Model, relative.py those
for a RelativeModel or a PlaneModel:

    enter(model, work, pose, twist, external) -> (pose, twist, external, status)
                            arrays to integrate, from the arrays of the caller, which stay
                            unchanged if the status is not OK
    leave(model, work, pose, twist, pose_out, twist_out)
                            write the result back to the arrays of the caller
    begin(model, work, group, pose, twist)
                            set stage 0 to the state: work.stage_pose, stage_twist, velocity
    move(model, work, scheme, group, h, stage, end, pose) -> status
                            pose and twist of a later stage, or of the end of the step
    accelerate(model, work, external) -> int
                            accelerations of the stage; -1, or the element with dependent rows
    store_slopes(model, work, scheme, group, stage)
                            stage derivatives k, from the accelerations of the stage
    check_end(model, work, h) -> status
                            status of the end of a step of size h: NOT_FINITE, or
                            TURNS_NOT_COUNTED + (spring or switch << 8) if its angle cannot be unwrapped
    error_square(model, work, scheme, row, h, twist, i, rtol, atol, length) -> float
                            square of an error estimate of body i for the step from `twist`
    close(model, work, controlled) -> status
                            project the end of the step onto the constraints
    count_turns(model, work)
                            unwrap the angles of torsional springs at the end of the step
    watches(model, work) -> bool
                            whether stops and dry friction are looked at: see switching.py
    note_stage(model, work, scheme, stage)
                            keep what they need to know of a stage, or of the end, of the step
    has_event(model, work, scheme, start, h) -> bool
                            whether they change in a substep of size h that starts `start` s after
                            the step
"""

from liegroup_core.formulations.relative.kinds import by_formulation

from . import relative, spatial


def _of(name):
    return by_formulation(name, spatial, relative)


enter, leave, begin, move = map(_of, ("enter", "leave", "begin", "move"))
store_slopes, check_end, error_square = map(_of, ("store_slopes", "check_end", "error_square"))
close, count_turns = map(_of, ("close", "count_turns"))
accelerate, watches = map(_of, ("accelerate", "watches"))
note_stage, has_event = map(_of, ("note_stage", "has_event"))
