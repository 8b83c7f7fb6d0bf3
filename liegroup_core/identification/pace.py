# SPDX-License-Identifier: Apache-2.0
"""Steps of runs with contacts: short where a body is hit or begins to stick, longer where it flies or rests.

Steps are those of one run: later runs have the same ones, so that outputs stay smooth functions of the unknowns.
"""

from dataclasses import replace

import numpy as np

from .machine import Segment

SHARE = 0.1  # of the error of a run, that one part may add


def paced(fit, point, most, halves):
    """Unknowns with steps of their own in each part, that add a share of an error `most` by the noise at most.

    halves : largest number of halvings
    """
    machine, starts, levels = fit.runs.machine(point.values), [], []
    for segment, state in zip(fit.runs.segments(replace(point, calm=None)), point.states):
        own = []
        for k in range(len(segment.inputs)):
            state, level = _part(fit, machine, segment, k, machine.timed(state, segment.times[k]), most * SHARE, halves)
            own.append(level)
        around = np.pad(own, 1, mode="edge") if own else np.zeros(2, dtype=int)
        own = np.maximum(np.maximum(around[:-2], around[1:-1]), around[2:])  # events move to the next part
        starts += segment.times.tolist()
        levels += [*own.tolist(), halves]  # nothing is known of what follows
    found = max([0, *(level for level in levels if level < halves)])
    return replace(point, halves=found, calm=(np.array(starts), found - np.minimum(levels, found)))


def _part(fit, machine, segment, k, state, most, halves):
    """(state at its end, least number of halvings) of part k of a Segment, from a state."""
    one, clocks = np.array([1]), range(len(segment.rows))
    part = Segment(
        segment.times[k],
        segment.times[k : k + 2],
        segment.inputs[k : k + 1],
        (one,) * len(clocks),
        (one,) * len(clocks),
    )
    before, level = None, 0
    while True:
        outputs = machine.run(part, state, None, level)[:-1]
        if before is not None:
            parts = zip(fit.apart, outputs, before, fit.deviation)
            error = max(np.abs(np.nan_to_num(apart(a, b)) / s).max(initial=0.0) for apart, a, b, s in parts)
            if error <= most or level >= halves:
                return machine.present(), level - 1
        before, level = outputs, level + 1
