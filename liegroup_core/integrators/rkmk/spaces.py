# SPDX-License-Identifier: Apache-2.0
"""The two spaces a Munthe-Kaas method integrates in: bodies in space, or in a plane.

One driver (rkmk.py) takes the steps of both. What it needs stands in integrators/rkmk/spatial.py for a
Model and in integrators/rkmk/planar.py for a PlanarModel; the type of the model chooses:

    enter(model, work, pose, twist, external) -> (pose, twist, external, status)
                            the arrays to integrate, made of the caller's; not OK: nothing is done
    leave(model, work, pose, twist, pose_out, twist_out)
                            the same back into the caller's arrays
    begin(model, work, group, pose, twist)
                            the state becomes stage 0: work.stage_pose, stage_twist, velocity
    move(model, work, scheme, group, h, stage, end, pose) -> status
                            the pose and twist of a later stage, or of the end of the step
    accelerate(model, work, external) -> int
                            accelerations of the stage; -1, or the joint whose rows depend on
                            others
    store_slopes(model, work, scheme, group, stage)
                            slopes of the stage, from its accelerations
    check_end(model, work, h) -> status
                            whether the end of the step is finite, and its turns can be counted
    turns_over(model, work, h) -> bool
                            whether a spring may turn over in a step after a finished one
    error_norm(model, work, scheme, h, twist) -> float
                            error estimate of the step that began with `twist`: good up to 1
    close(model, work) -> status
                            project the end of the step onto the constraints
    count_turns(model, work)
                            angles of torsional springs at the end of the step
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
