# SPDX-License-Identifier: Apache-2.0
"""Operations of a Munthe-Kaas step, selected by the type of the model: in space or in a plane.

munthe_kaas.py takes the steps for both. The operations are in spatial.py for a Model and in
planar.py for a PlanarModel:

    enter(model, work, pose, twist, external) -> (pose, twist, external, status)
                            arrays to integrate, from the caller's; unchanged if not OK
    leave(model, work, pose, twist, pose_out, twist_out)
                            write them back to the caller's arrays
    begin(model, work, group, pose, twist)
                            set stage 0 to the state: work.stage_pose, stage_twist, velocity
    move(model, work, scheme, group, h, stage, end, pose) -> status
                            pose and twist of a later stage, or of the end of the step
    accelerate(model, work, external) -> int
                            accelerations of the stage; -1, or the joint with dependent rows
    store_slopes(model, work, scheme, group, stage)
                            slopes of the stage, from its accelerations
    check_end(model, work, h) -> status
                            not OK if the end is not finite, or an angle cannot be unwrapped
    turns_over(model, work, h) -> bool
                            True if a spring may reverse its direction in the next step
    error_norm(model, work, scheme, h, twist) -> float
                            error estimate of the step from `twist`: accepted up to 1
    close(model, work) -> status
                            project the end of the step onto the constraints
    count_turns(model, work)
                            unwrap the angles of torsional springs at the end of the step
"""

from liegroup_core.compiling import Choice
from liegroup_core.formulations.planar.arrays import PlanarModel
from liegroup_core.formulations.planar.dynamics import accelerations
from liegroup_core.model.arrays import Model

from . import planar as planar
from . import spatial


def _of(name):
    return Choice(name, {Model: getattr(spatial, name), PlanarModel: getattr(planar, name)})


enter, leave, begin, move = map(_of, ("enter", "leave", "begin", "move"))
store_slopes, check_end, error_norm = map(_of, ("store_slopes", "check_end", "error_norm"))
close, count_turns, turns_over = map(_of, ("close", "count_turns", "turns_over"))
accelerate = Choice("accelerate", {Model: spatial.accelerate, PlanarModel: accelerations})
