# SPDX-License-Identifier: Apache-2.0
"""How a run of steps ended: the codes that kernels return and what they mean to a user."""

import math

OK = 0
NOT_FINITE = 1
ROTATION_TOO_LARGE = 2
DEPENDENT_ROWS = 3
TURNS_NOT_COUNTED = 4
SUBSTEP_TOO_SMALL = 5
TOO_MANY_SUBSTEPS = 6
NOT_CONVERGED = 7
NOT_PROJECTED = 8
OFF_PLANE = 9  # not for a user: the same steps are taken in space
NO_RATTLE_STEP = 10
DIVERGED = 11

# dexp^-1 is singular at a rotation of 2 pi within a step and loses digits near it: its norm is
# (t/2)/sin(t/2), 62 at 2 pi - 0.1. Beyond pi a step is legal and rarely accurate.
LARGEST_ROTATION = 2.0 * math.pi - 0.1
LARGE_ROTATION = math.pi
# rad in a step, of methods for which 2 pi is no bound. More is no motion of a mechanism: explicit
# methods get there where damping or a spring is too much for the step.
HOPELESS_ROTATION = 1e3

MESSAGES = {
    NOT_FINITE: "the state is no longer finite: the step is too large for this motion, or a force "
    "is; take a smaller step",
    ROTATION_TOO_LARGE: "a body would turn by nearly a full turn within one step, where the method "
    "has no solution; take a smaller step, or, where joints are next to a "
    "singular pose, stabilisation projection",
    DEPENDENT_ROWS: "the rows of joint {joint} depend on those of other joints at this pose "
    "(a singular pose or a redundant joint)",
    TURNS_NOT_COUNTED: "the joint of {force} turns by half a turn or more within one step, where "
    "its turns cannot be counted; take a smaller step",
    SUBSTEP_TOO_SMALL: "the tolerance cannot be met by any substep: a force jumps, or the "
    "tolerance is below rounding; raise atol and rtol",
    TOO_MANY_SUBSTEPS: "the tolerance asks for too many substeps within one step: take a smaller "
    "step or larger tolerances; for a stiff scene another method",
    NOT_CONVERGED: "Newton's method does not solve the equations of an implicit step: it is too "
    "large for this motion, or the pose is singular; take a smaller step{hint}",
    NOT_PROJECTED: "the joints cannot be closed again by small displacements: the step is too "
    "large for this motion; take a smaller step",
    DIVERGED: "a body turns by more than a thousand rad within one step: the motion grows without "
    "bound, the step is too large for its forces; take a smaller step",
    NO_RATTLE_STEP: "RATTLE has no solution for body {body}, which turns by {angle:.3g} rad in a "
    "step: that must stay below 1 rad; take a smaller step{hint}",
}
