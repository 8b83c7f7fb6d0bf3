# SPDX-License-Identifier: Apache-2.0
"""Friction by load: by the joint force normal to the axis, which itself depends on the friction.

    friction = (coulomb + mu r N) ,  N = |joint force normal to the axis|

with the radius r of the bearing; r = 1 where the joint translates. N follows from the accelerations,
which depend on the friction: N = f(N) is solved by iteration, from N = 0 at every stage. Aitken's
acceleration, for vectors, keeps the iterations few. If the first ones do not converge, sliding friction has
no solution or several (Painleve's paradox), which is reported.

Source: Irons and Tuck, Int. J. Numer. Meth. Eng. 1 (1969) 275; Pfeiffer and Glocker, Multibody
Dynamics with Unilateral Contacts, chapter 8. Accuracy: test/verification/test_friction_by_load.py.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import ZERO3, axpy3, dot3, load3
from liegroup_core.mechanism.arrays import RESTS, SLIP

from .couplings import add_effort, add_rotors
from .residuals import add_multipliers, add_own_forces, gather_forces

# Columns of Work.loads.
LOAD, FOUND, OLD_LOAD, OLD_FOUND = 0, 1, 2, 3
GIVEN, UNSETTLED, REST = range(3)  # of Work.iteration
MOST_ITERATIONS = 60
SETTLED = 1e-14  # residual, relative to the largest load
CLOSE = 1e-11  # below it, a residual that no longer decreases is at round-off level
NEARER = 0.95  # the second iteration must reduce the residual at least to this fraction


@kernel
def gather_lacking(model, work):
    """Write the wrenches that links need from their parents to work.force, efforts of held degrees of freedom to -u.

    returns the sum of the magnitudes of the terms: weights, and wrenches that single links need
    """
    for b in range(len(model.links)):
        for c in range(work.moved.shape[1]):
            work.force[b, c] = 0.0
    add_multipliers(model, work)
    add_own_forces(model, work)
    g = load3(model.gravity, 0, 0)
    gravity, total = math.sqrt(dot3(g, g)), 0.0
    for b in range(len(model.links)):
        total += model.links[b]["mass"] * gravity
        for c in range(work.moved.shape[1]):
            total += abs(work.force[b, c])
    add_rotors(model, work, work.acceleration, 1.0, work.force)
    gather_forces(model, work)
    return total


@kernel
def _bearing_load(model, work, j):
    """Force of cut joint j normal to its axis, N."""
    cut = model.cuts[j]
    force = ZERO3
    for r in range(cut["first"], cut["first"] + cut["rows"]):
        force = axpy3(-work.multipliers[r], load3(work.child_jacobian, r, 3), force)
    turn = model.elements[cut["element"]]["child_rotation"]
    axis = (turn[2], turn[5], turn[8])
    across = axpy3(-dot3(force, axis), axis, force)
    return math.sqrt(dot3(across, across))


@kernel
def find_loads(model, work):
    """Write the loads at the present accelerations to work.loads; call gather_lacking first."""
    for k in range(len(model.switches)):
        switch = model.switches[k]
        b = switch["link"]
        if switch["static_by_load"] == 0.0:
            continue
        if switch["bearing"] >= 0:
            work.loads[k, FOUND] = _bearing_load(model, work, switch["bearing"])
        elif b >= 0:
            work.loads[k, FOUND] = math.hypot(work.force[b, 3], work.force[b, 4])


@kernel
def begin_loads(model, work):
    """Begin the iteration at a stage, unless the loads are given."""
    if work.iteration[GIVEN] == 0.0:
        for k in range(len(model.switches)):
            work.loads[k, LOAD] = 0.0


@kernel
def _is_free(model, work, k):
    """Whether switch k is neither held nor at rest because of others."""
    return work.held[model.switches[k]["freedom"]] == 0.0 and work.modes[k, RESTS] == 0.0


@kernel
def _apply(model, work, k, load):
    """Set the load of switch k, and apply the change of its sliding friction."""
    switch = model.switches[k]
    b = switch["link"]
    if b >= 0 and _is_free(model, work, k):
        change = -work.modes[k, SLIP] * switch["sliding_by_load"] * (load - work.loads[k, LOAD])
        add_effort(model, work, b, switch["component"], change)
    work.loads[k, LOAD] = load


@kernel
def settle_loads(model, work, iteration):
    """Update the loads after a solve; returns True once they have converged or cannot converge."""
    slides = False
    for k in range(len(model.switches)):
        by_load = model.switches[k]["sliding_by_load"] * work.modes[k, SLIP]
        slides = slides or (by_load != 0.0 and _is_free(model, work, k))
    if not slides:
        return True
    gather_lacking(model, work)
    find_loads(model, work)
    loads, largest, rest = work.loads, 0.0, 0.0
    along, square = 0.0, 0.0
    for k in range(len(model.switches)):
        r = loads[k, FOUND] - loads[k, LOAD]
        change = r - (loads[k, OLD_FOUND] - loads[k, OLD_LOAD])
        largest, rest = max(largest, loads[k, FOUND]), max(rest, abs(r))
        along, square = along + r * change, square + change * change
    before = work.iteration[REST]
    work.iteration[REST] = rest
    if rest <= SETTLED * largest or (iteration > 1 and CLOSE * largest >= rest >= before):
        return True
    if iteration + 1 == MOST_ITERATIONS or not rest < math.inf:
        work.iteration[UNSETTLED] = 1.0
        return True
    if iteration == 1 and rest > NEARER * before:
        work.iteration[UNSETTLED] = 1.0
        return True
    part = along / square if iteration > 0 and square > 0.0 else 0.0
    for k in range(len(model.switches)):
        found, load = loads[k, FOUND], loads[k, LOAD]
        to = found - part * (found - loads[k, OLD_FOUND]) if iteration > 0 else found
        loads[k, OLD_LOAD], loads[k, OLD_FOUND] = load, found
        _apply(model, work, k, max(to, 0.0))
    return False
