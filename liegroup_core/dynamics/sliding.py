# SPDX-License-Identifier: Apache-2.0
"""Sliding motions along surfaces of laws: both sides of a comparison a > b lead back to a = b.

Filippov's solution: the motion stays on the surface with a share s of the forces below it and 1 - s of those above,
so that the rate of a - b is zero (Filippov, Differential Equations with Discontinuous Righthand Sides, 1988).
The rates of all surfaces are affine in their shares if the forces are; else Newton's method finds the shares.
The motion leaves the surface where a share is 0 or 1, which is a guard of events/crossings.py.
"""

from liegroup_core.compiling import kernel, shared
from liegroup_core.forces.formulas import OPEN, SHARED
from liegroup_core.forces.law import measure_slopes
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import load_column, matrix3, store3, vector3

from .algebra import Ad_inverse, freed, placed, resting, spatial, sub
from .dense_lu import lu_factorise, lu_solve

# Newton's method with one matrix goes on while the rates decrease by half, down to ENOUGH; affine rates take one step.
ENOUGH, PRECISE = 1e-13, 1e-8  # the largest that are accepted
RATE, SIZE = 0, 1  # columns of Work.shares


@kernel
def slides(model, work, j):
    """Whether the motion slides along surface j."""
    return work.branches[model.space.forces.laws.surfaces[j]] > 1.0


@kernel
def count_slides(model, work):
    """Number of surfaces along which the motion slides."""
    count = 0
    for j in range(len(work.shares)):
        count += 1 if slides(model, work, j) else 0
    return count


@shared
def set_surface_rates(model, work):
    """Write the rates of all surfaces at the accelerations of the stage to work.surface_rates (s,)."""
    laws = model.space.forces.laws
    for i in range(len(model.bodies)):
        body, b = model.bodies[i], model.bodies[i]["link"]
        w, v = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if model.only_free_bodies:
            f = model.links[i]["freedom"]
            w, v = load_column(work.acceleration, f, 0), load_column(work.acceleration, f + 3, 0)
        elif b != WORLD:
            gravity = Ad_inverse(model, placed(model, work, b), resting(model))
            A = spatial(model, sub(model, freed(model, work, b), gravity))
            w, v = se3_Ad_inverse(matrix3(body["rotation"]), vector3(body["point"]), A[0], A[1])
        store3(w, work.body_rates, i, 0)
        store3(v, work.body_rates, i, 3)
    for s in range(len(model.law_links)):
        f = model.links[model.law_links[s]]["freedom"]
        work.registers[laws.states[s, 0], 1] = work.acceleration[f, 0]
    pose, twist = work.space.stage_pose, work.space.stage_twist
    measure_slopes(laws, work.angle, pose, twist, work.body_rates, work.registers, work.surface_rates)
    return 0


@kernel
def begin_shares(model, work):
    """Set all shares of sliding surfaces to zero."""
    for j in range(len(work.shares)):
        if slides(model, work, j):
            work.branches[model.space.forces.laws.surfaces[j]] = SHARED


@kernel
def add_share(model, work, j, share):
    """Add to the share of a surface."""
    work.branches[model.space.forces.laws.surfaces[j]] += share


@kernel
def keep_rates(work):
    """Keep the rates at the present shares."""
    for j in range(len(work.shares)):
        work.shares[j, RATE] = work.surface_rates[j]


@kernel
def take_kept_rates(work):
    """Continue with the rates of `keep_rates`."""
    for j in range(len(work.shares)):
        work.surface_rates[j] = work.shares[j, RATE]


@kernel
def set_column(model, work, j):
    """Column j of the matrix of the rates by shares: their change since `keep_rates`."""
    for i in range(len(work.shares)):
        work.share_matrix[i, j] = work.surface_rates[i] - work.shares[i, RATE] if slides(model, work, i) else 0.0


@kernel
def factorise_shares(model, work):
    """Whether the shares are determined, and factors of their matrix; see `set_column`."""
    for j in range(len(work.shares)):
        if not slides(model, work, j):
            for i in range(len(work.shares)):
                work.share_matrix[i, j] = 0.0
            work.share_matrix[j, j] = 1.0
        work.shares[j, SIZE] = 0.0
        for i in range(len(work.shares)):
            work.shares[j, SIZE] += abs(work.share_matrix[j, i])
    return lu_factorise(work.share_matrix, work.share_pivots, len(work.shares))


@kernel
def improve_shares(model, work):
    """Newton's step from the present rates."""
    for j in range(len(work.shares)):
        work.surface_rates[j] = -work.surface_rates[j] if slides(model, work, j) else 0.0
    lu_solve(work.share_matrix, work.share_pivots, len(work.shares), work.surface_rates)
    for j in range(len(work.shares)):
        if slides(model, work, j):
            add_share(model, work, j, work.surface_rates[j])


@kernel
def largest_rate(model, work):
    """Largest rate of a surface along which the motion slides, relative to the sum of its changes by all shares."""
    largest = 0.0
    for j in range(len(work.shares)):
        if slides(model, work, j):
            largest = max(largest, abs(work.surface_rates[j]) / work.shares[j, SIZE])
    return largest


@kernel
def open_surfaces(model, work):
    """Give up the shares: the forces are those of the arguments at every stage."""
    for j in range(len(work.shares)):
        if slides(model, work, j):
            work.branches[model.space.forces.laws.surfaces[j]] = OPEN
