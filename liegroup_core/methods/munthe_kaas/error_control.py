# SPDX-License-Identifier: Apache-2.0
"""Error control of Munthe-Kaas methods with an error estimate: each step is divided into substeps.

The estimate is the difference of two methods in the algebra:
    delta = h sum_j e_j k_j ,   k_s+1 = dexp^-1_{-Psi} F(X_1) ,   Psi = h sum_j b_j k_j
It has one screw (dxi, deta) and one twist difference (dw, dv) for every body. A substep is accepted
if for every body
    |dxi|^2/atol^2 + |deta|^2/(atol L)^2 + |dw|^2/tol_w^2 + |dv|^2/tol_v^2 <= 1
    tol_w = atol + rtol max(|w_0|, |w_1|),   tol_v = atol L + rtol max(|v_0|, |v_1|)
in rad, m, rad/s and m/s. L is 1 m or, with an accuracy, the characteristic length. The tolerance of poses is
absolute, so that it does not depend on the origin of the world. The largest error of a body decides: a
mean would hide one fast body among many slow ones. If a method has two estimates with norms e_5 and e_3, the
norm is e_5^2 / sqrt(e_5^2 + e_3^2 / 100) instead (Hairer, Norsett and Wanner, Solving ODEs I, (10.17)).

If a force jumps within a substep, e_5 may be near a zero, and this norm small by chance. So e_3 must also be at
most 1 if it exceeds JUMP times the value expected from the last substep. In smooth motion it is proportional to
h^4.

A tolerance below round-off would only make substeps smaller. So atol is increased by h times the round-off in the
accelerations near a singular pose and, with an accuracy, by ROUNDING / h. With given tolerances such a step ends
with SUBSTEP_TOO_SMALL.
"""

import math

from liegroup_core.compiling import kernel
from liegroup_core.mechanism.bodies import ROUND_OFF
from liegroup_core.status import OK, SUBSTEP_TOO_SMALL

from . import steps

# Bounds of the ratio of two successive substeps, and safety factor of the next one.
LARGEST_GROWTH, LARGEST_CUT, SAFETY = 5.0, 0.2, 0.85
# Of a companion with an accuracy: number of bits of its state that it rounds away, and ratio q of its substeps to those
# of the simulation. Tolerances of order 8 differ by q^8 = 2^BITS.
BITS = 4
RATIO = 2.0 ** (BITS / 8.0)
# It divides a substep that would begin and end where that of the simulation does: equal substeps have equal errors. In
# the golden ratio, parts differ most from equal ones.
DIVIDED = 0.5 * (math.sqrt(5.0) - 1.0)
# Its substeps may grow by more, and by at least q; by 1 / DIVIDED, that after a division would again be the same.
MORE = 1.5
# Round-off of a pose, m or rad, as it appears in an error estimate: stiff forces turn it into accelerations. With
# h at their fastest oscillation, these change velocities by about the round-off of a pose divided by h.
ROUNDING = 0.03 * 2.0**-52
# Smallest substep as a fraction of a step: dampers may stop light bodies that fast.
SMALLEST_SUBSTEP = 1e-13
# A change of an external wrench may count as a jump, which costs a few substeps.
JUMP = 1e3


@kernel
def _change(error, most, estimates):
    """Ratio of the next substep to this one: SAFETY error^(-3/16), or SAFETY error^(-1/8), up to `most`.

    For an estimate of order 4 the error is proportional to h^5. The exponent 3/16 instead of 1/5
    needs only square roots. They are bit-identical on every machine, and so is the run. With two
    estimates the error is proportional to h^8.
    """
    if not error < 1e8:
        return LARGEST_CUT
    root = math.sqrt(math.sqrt(math.sqrt(max(error, 1e-8))))
    if estimates == 1:
        root *= math.sqrt(root)
    return min(most, max(LARGEST_CUT, SAFETY / root))


@kernel
def _error(model, work, scheme, h, twist, control):
    """Norm of the error estimate of a step from `twist`, accepted up to 1, and e_3 if there are two."""
    largest, largest_3, rtol, length = 0.0, 0.0, control.rtol[0], control.length[0]
    atol = control.atol[0] + h * work.report[ROUND_OFF] + control.rounded[0] / h
    for i in range(len(model.links)):
        error = steps.error_square(model, work, scheme, 0, h, twist, i, rtol, atol, length)
        if len(scheme.error) == 2:
            other = steps.error_square(model, work, scheme, 1, h, twist, i, rtol, atol, length)
            largest_3 = max(largest_3, other)
            if error > 0.0:
                error *= error / (error + 0.01 * other)
        if not error < math.inf:
            return math.inf, 0.0
        largest = max(largest, error)
    return math.sqrt(largest), math.sqrt(largest_3)


@kernel
def unlike(work, control, time, count):
    """Number of substeps of a companion with given tolerances in a step or a part of one, in place of `count`.

    It differs from that of the simulation, because equal substeps have equal errors. In parts of steps, which changes
    of the inputs end, substeps follow tolerances less well, and the simulation may have another end of a step. So there
    the companion has more than twice as many: the two differ by the error of the simulation.
    """
    likely = max(1, math.ceil(control.longer[0] * time / control.size[0] - 1e-6))
    if time < work.clock.step_size[0]:
        control.jumps[0] += 1.0
        return 2 * likely + 1
    return likely + 1 if likely <= count else count


@kernel
def judge(model, work, scheme, size, status, twist, control):
    """Accept or reject a substep of the given size, and set the size of the next one.

    status  : of the substep; a substep that failed is rejected
    control : SubstepControl
    returns (status, accepted): status is not OK if no smaller substep is allowed
    """
    error, growth = math.inf, 0.0
    if status == OK:
        error, error_3 = _error(model, work, scheme, size, twist, control)
        if work.report[ROUND_OFF] == 0.0:  # near a singular pose round-off jumps
            growth = error_3 * control.atol[0] / (size * size * size * size)
        if growth > JUMP * control.growth[0] > 0.0:
            error = max(error, error_3)
    most = LARGEST_GROWTH if control.coarse[0] == 0.0 else LARGEST_GROWTH * MORE
    change = _change(error, most, len(scheme.error))
    if control.rejected[0] != 0.0:
        change = min(1.0, change)  # else stability, or a force with kinks, would have every second substep rejected
    control.rejected[0] = 0.0 if error <= 1.0 else 1.0
    if work.report[ROUND_OFF] > 0.0 or control.growth[0] > 0.0 and control.shared[0] == 0.0 and JUMP < error < math.inf:
        control.jumps[0] += 1.0  # a known one begins at a shared time
    # A substep that ends early, at a change of inputs, says little about the longer one before it.
    kept = control.size[0] if change == most else 0.0
    control.size[0] = min(control.longest[0], max(kept, size * change))
    control.attempted[0] += 1.0
    if error <= 1.0:
        control.accepted[0] += 1.0
        control.growth[0] = growth
        return OK, True
    if control.size[0] < SMALLEST_SUBSTEP * work.clock.step_size[0]:
        return (status if status != OK else SUBSTEP_TOO_SMALL), False
    return OK, False
