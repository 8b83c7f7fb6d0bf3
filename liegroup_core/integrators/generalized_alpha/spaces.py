# SPDX-License-Identifier: Apache-2.0
"""Operations of a generalised-alpha step, selected by the type of the model: absolute or relative.

newton.py and generalized_alpha.py take the steps for both. absolute.py has the operations for a
Model, relative.py those for a RelativeModel or a PlaneModel:

    enter, leave            as those of the Munthe-Kaas methods, see rkmk/spaces.py
    begin(model, work, memory, group, pose, twist)
                            velocity on the group at the start of a step, to memory.velocity
    initialise(model, work, memory, group, pose, twist, external) -> int
                            Vdot and lambda of a state, to memory.x; -1, or the element with
                            dependent rows
    move(model, work, memory, numbers, group, h, pose) -> status
                            end of the step for memory.x, to work.stage_pose and stage_twist
    residual(model, work, memory, numbers, group, h, pose, external) -> status
                            the same, and the residual of the equations, to memory.residual; status
                            is OK, ROTATION_TOO_LARGE or NOT_FINITE
    finish(model, work, memory, h) -> status
                            check the end of a step of size h: NOT_FINITE, or TURNS_NOT_COUNTED +
                            (spring << 8) if its angle cannot be unwrapped; remove round-off, unwrap
                            angles
"""

from liegroup_core.formulations.relative.kinds import by_formulation

from . import absolute, relative


def _of(name):
    return by_formulation(name, absolute, relative)


enter, leave, begin, initialise = map(_of, ("enter", "leave", "begin", "initialise"))
move, residual, finish = map(_of, ("move", "residual", "finish"))
