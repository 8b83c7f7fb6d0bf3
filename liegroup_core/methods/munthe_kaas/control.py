# SPDX-License-Identifier: Apache-2.0
"""Record of the control of the substeps: numbers that kernels read and write between the substeps of a method."""

import numpy as np

from liegroup_core.compiling import Record, shaped


class SubstepControl(Record):
    """Numbers of the error control and of the integration ahead."""

    size: np.ndarray = shaped(1)  # next substep, s
    accepted: np.ndarray = shaped(1)  # numbers of accepted and of attempted substeps so far
    attempted: np.ndarray = shaped(1)
    kept_size: np.ndarray = shaped(1)  # next substep at the start of the step
    rtol: np.ndarray = shaped(1)  # of velocities
    atol: np.ndarray = shaped(1)  # rad, m, rad/s, m/s
    longest: np.ndarray = shaped(1)  # substep, s
    most: np.ndarray = shaped(1)  # attempts in a step
    dear: np.ndarray = shaped(1)  # number of evaluations, of all steps, at which a trial ends
    length: np.ndarray = shaped(1)  # m, factor of atol for positions
    rounded: np.ndarray = shaped(1)  # round-off of a pose
    # After too many attempts, their fraction of those of the whole step, if its rest takes equal substeps.
    part: np.ndarray = shaped(1)
    coarse: np.ndarray = shaped(1)  # factor of the rounding of a companion, or 0
    growth: np.ndarray = shaped(1)  # e_3 atol / h^4 of the last substep, or 0
    rejected: np.ndarray = shaped(1)  # 1 if the last substep was
    shared: np.ndarray = shaped(1)  # 1 if the lead is at a time at which that of every other run is, too
    # Number of substeps near a singular pose or in which a force seemed to jump, and of parts of steps that a companion
    # with given tolerances took.
    jumps: np.ndarray = shaped(1)
    # Of a method that runs ahead, see ahead.py. Times are whole steps, and s after them.
    ahead: np.ndarray = shaped(1)  # 1 if it does
    base: np.ndarray = shaped(1)  # time of the lead
    lead: np.ndarray = shaped(1)
    kept_base: np.ndarray = shaped(1)  # of the start of the kept substep
    kept_lead: np.ndarray = shaped(1)
    limit_base: np.ndarray = shaped(1)  # of the next known change of the inputs
    limit: np.ndarray = shaped(1)
    left: np.ndarray = shaped(1)  # s from the lead to that
    last: np.ndarray = shaped(1)  # size of the kept substep, s
    leads: np.ndarray = shaped(1)  # 1 if the lead is known, else it starts at the caller's state
    seen: np.ndarray = shaped(1)  # s from the lead within which an event was seen, or 0
    due: np.ndarray = shaped(1)  # 1 if it is in the next substep within the step of the lead
    ready: np.ndarray = shaped(1)  # 1 if the further stages of the kept substep are known
    fresh: np.ndarray = shaped(1)  # 1 if the derivative at the lead is
    next_base: np.ndarray = shaped(1)  # of the call: the next known change of the inputs, and s to it
    next: np.ndarray = shaped(1)
    next_after: np.ndarray = shaped(1)
    begins: np.ndarray = shaped(1)  # 1 if no substep has begun since the lead passed the end of a step
    longer: np.ndarray = shaped(1)  # ratio of the substeps of a companion with given tolerances, or 0
