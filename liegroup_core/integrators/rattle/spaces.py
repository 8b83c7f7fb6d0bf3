# SPDX-License-Identifier: Apache-2.0
"""Operations of a RATTLE step, selected by the type of the model: on bodies, or on links.

rattle.py takes the steps for both. absolute.py has the operations for a Model, relative.py those for
a RelativeModel or a PlaneModel:

    enter, leave            as those of the Munthe-Kaas methods, see rkmk/spaces.py
    begin(model, work, memory, pose, twist, external, fresh)
                            start of a step: state and forces. fresh: the last substep did not end
                            at this state in the same call
    first_half(model, work, memory, h, fresh) -> status
                            V' and the poses at the end of a substep of size h
    second_half(model, work, memory, h, external) -> status
                            V+ and Q+ at its end, which starts the next substep
    keep(model, work, memory)
                            continue from the end of a substep; largest squared rotation of a body,
                            to work.report[1]
    finish(model, work, h) -> status
                            check the end of a step of size h: NOT_FINITE, or TURNS_NOT_COUNTED +
                            (spring << 8) if its angle cannot be unwrapped; unwrap angles
"""

from liegroup_core.formulations.relative.kinds import by_formulation

from . import absolute, relative


def _of(name):
    return by_formulation(name, absolute, relative)


enter, leave, begin, keep, finish = map(_of, ("enter", "leave", "begin", "keep", "finish"))
first_half, second_half = map(_of, ("first_half", "second_half"))
