# SPDX-License-Identifier: Apache-2.0
"""A step, or a substep, of an explicit Munthe-Kaas method: see munthe_kaas.py."""

import numpy as np

from liegroup_core.compiling import Struct, kernel
from liegroup_core.events.crossings import rows_and_weights
from liegroup_core.methods.table import EXACT
from liegroup_core.status import DEPENDENT_ROWS, OK

from . import steps
from .ahead import further_stages, polynomials
from .collocation import Collocation, make_collocation, no_collocation, stage_polynomials


class Scheme(Struct):
    """Data of a Munthe-Kaas method: tableau of s stages, series of dexpinv.

    For an implicit method, implicit.py computes the sums. The operations of steps.py treat it as a method of
    one stage with step 1, whose derivative is Psi; its nodes are those of the stages, then 0 and 1.
    """

    a: np.ndarray  # (s + 1, s) the tableau's a, below it its b; of the method that runs ahead see ahead.py
    nodes: np.ndarray  # (s + 1,) its c, then 1: times of the stages as fractions of a step
    rows: np.ndarray  # (s + 1,) and weights: see crossings.py
    weights: np.ndarray
    error: np.ndarray  # (0 to 2, s + 1) weights of the error estimates
    inside: np.ndarray  # (s + 1 + m, d) polynomials of b_j(theta) inside a substep, of an implicit one those of the
    # stages, collocation.py; (0, 0): none
    highest: int  # last power of ad in dexpinv, or EXACT
    spent: np.ndarray  # (2,) evaluations of the accelerations so far, with error control: of substeps, and inside
    newton: Collocation  # of an implicit method


def make_scheme(tableau, highest, runs_ahead=False):
    """Scheme of an explicit Tableau; runs_ahead: with states inside a substep, for the 8(5,3) pair."""
    times = np.append(tableau.c, 1.0)
    a, data, inside = np.vstack([tableau.a, tableau.b]), rows_and_weights(times), np.zeros((0, 0))
    if runs_ahead:
        rows, nodes = further_stages()
        stages, width = len(tableau.b), rows.shape[1]
        whole = np.zeros((stages + 2 + len(rows), width))
        whole[: stages + 1, :stages], whole[stages + 1 : -1] = a, rows
        a, times, inside = whole, np.concatenate([times, nodes, [0.0]]), polynomials()
    return Scheme(a, times, *data, tableau.e, inside, highest, np.zeros(2), no_collocation())


def make_implicit_scheme(tableau, freedoms):
    """Scheme of an implicit Tableau of three stages, for a number of freedoms."""
    data = rows_and_weights(np.concatenate([[0.0], tableau.c, [1.0]]))
    a, nodes = np.array([[0.0], [1.0]]), np.concatenate([tableau.c, [0.0, 1.0]])
    newton = make_collocation(tableau, freedoms)
    return Scheme(a, nodes, *data, np.array([[0.0, 1.0]]), stage_polynomials(tableau.c), EXACT, np.zeros(2), newton)


@kernel
def substep(scheme, model, work, size, start, elapsed, first, last, pose, external):
    """Set the stage to the end of a substep of `size` s, from a pose and the twist of `begin`.

    start, elapsed : s, time of the step, and of the substep in it
    first, last    : stages to compute; 1: the stage derivatives of the start are in work.slopes; the end is one more
    returns a status
    """
    stages, inside = scheme.error.shape[1] - 1, len(scheme.a) - 1
    controlled = len(scheme.error) > 0
    noting = steps.notes(work)
    # Accelerations at the end are needed for events, for the next substep unless the end is projected, and
    # for estimates that have a weight for them.
    if noting:
        steps.forget_dips(work)
    ending = noting or controlled and not model.projects
    for row in range(len(scheme.error)):
        ending = ending or scheme.error[row, stages] != 0.0
    if controlled:
        if last == stages + 1:
            scheme.spent[0] += stages
        else:
            scheme.spent[1] += max(0, inside - first)
    for stage in range(first, last):
        if stage > 0:
            status = steps.move(model, work, scheme, size, stage, stage == stages or stage == inside, pose)
            if status != OK:
                return status
        work.clock.now[0] = start + elapsed + scheme.nodes[stage] * size
        if stage < stages or stage > stages and stage < inside or stage == stages and (ending or last > stages + 1):
            dependent = steps.accelerate(model, work, external)
            if dependent >= 0:
                return DEPENDENT_ROWS + (dependent << 8)
            steps.store_slopes(model, work, scheme, stage)
            if noting and last == stages + 1:
                steps.note_stage(model, work, scheme, stage)
                if scheme.rows[stage] < 0 and stage < stages:
                    steps.note_dips(model, work, scheme.nodes[stage])
    return OK
