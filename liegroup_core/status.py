# SPDX-License-Identifier: Apache-2.0
"""Status codes of integrations, as kernels return them, and their messages for users."""

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
NO_RATTLE_STEP = 9
DIVERGED = 10
EVENTS_WITHOUT_END = 11
BEYOND_STOP = 13
NO_FRICTION = 14
# Not a failure: within a step a stop is reached or friction changes. Integrators never return it.
EVENT = 12

# rad in one step. dexp^-1 is singular at 2 pi and loses digits near it: its norm is
# (t/2)/sin(t/2), 62 at 2 pi - 0.1. Beyond pi a step is valid but rarely accurate.
LARGEST_ROTATION = 2.0 * math.pi - 0.1
LARGE_ROTATION = math.pi
# rad in one step, for methods without a limit at 2 pi. A larger rotation means that the integration
# is unstable: a damper or spring is too stiff for the step of an explicit method.
HOPELESS_ROTATION = 1e3
# Largest number of events of stops and friction in a step.
MOST_EVENTS = 1000

MESSAGES = {
    NOT_FINITE: "the state is no longer finite: the step is too large for this motion, or a "
    "force is too large; {smaller}",
    ROTATION_TOO_LARGE: "a body would rotate by almost 2 pi within one step, beyond the method's "
    "limit; {smaller}{hint}",
    DEPENDENT_ROWS: "the constraint equations of joint {joint} are redundant in this configuration "
    "(a singular configuration or a redundant joint)",
    TURNS_NOT_COUNTED: "the joint of {force} rotates by pi or more within one step, so its angle "
    "cannot be unwrapped; {smaller}",
    SUBSTEP_TOO_SMALL: "no substep meets the tolerance: a force is discontinuous, or the tolerance is "
    "below round-off; increase atol and rtol",
    TOO_MANY_SUBSTEPS: "the tolerance requires too many substeps within one step; {fewer}",
    NOT_CONVERGED: "Newton's method does not converge in an implicit step: the step is too large "
    "for this motion, or the configuration is singular; {smaller}{hint}",
    NOT_PROJECTED: "projection onto the constraints does not converge: the step is too large for "
    "this motion; {smaller}",
    DIVERGED: "a body rotates by more than 1000 rad within one step: the integration is "
    "unstable, the step is too large for the forces; {smaller}",
    BEYOND_STOP: "joint {joint} is beyond its stop: set a state between the stops",
    EVENTS_WITHOUT_END: "a step has more than {events} impacts or changes of friction or of branches of laws, which "
    "do not end with these parameters; change them",
    NO_FRICTION: "friction by load has no solution, or several, at this pose (Painleve's paradox): mu times "
    "radius is too large for the load that friction itself causes; reduce it",
    NO_RATTLE_STEP: "RATTLE has no solution for body {body}: it rotates by {angle:.3g} rad in a "
    "step, and the limit is 1 rad; {smaller}{hint}",
}
