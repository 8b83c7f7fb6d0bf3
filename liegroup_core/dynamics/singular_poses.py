# SPDX-License-Identifier: Apache-2.0
"""Accelerations of loops near a singular pose, where two branches of their motion cross.

At a distance t from such a pose a row of the cut joints, or a sum of rows, is J_s = t B. If a stage violates the
constraints by e, its accelerations are wrong by about e / t^2: they are those of another mechanism, whose branches
do not cross. On the constraints accelerations are smooth in t, so the stage is projected first. Very near the pose
that does not help, because e is at least round-off. There the accelerations are interpolated up to O(d^6) between
both sides: from the poses displaced by +- d V, +- 2 d V and +- 3 d V and projected.
Error control adds the round-off that remains in the accelerations to its tolerance.

Steps keep their normal size at these poses: test/verification/test_accuracy.py. Scenes with stops or
friction use only the regularisation of loops.py.
"""

from liegroup_core.compiling import kernel
from liegroup_core.mechanism.bodies import ROUND_OFF, copy_state

from .algebra import link_of, rate_twist, spatial
from .coordinates import displace_by_twist

# Displacement d V of the joint that turns fastest, rad: three times the distance at which a pose is singular.
ASIDE = 2e-2
# Round-off in accelerations, relative to the square of the fastest rate of rotation: a tenth of the round-off of a
# pose, 3e-16, divided by the cube of the distance at which a pose counts as singular.
NOISE = 4e-10
# Displacements in d, and weights of the interpolation.
SIDES = (0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0)
WEIGHTS = (0.0, 0.75, 0.75, -0.3, -0.3, 0.05, 0.05)


@kernel
def begin_aside(model, work):
    """Save the stage and its accelerations; returns d in s, or 0 if no joint turns."""
    n, fastest = len(model.bodies), 0.0
    copy_state(work.stage_pose, work.stage_twist, work.middle_pose, work.middle_twist)
    for b in range(len(model.links)):
        S = rate_twist(model, link_of(model, b), work.stage_twist, n + b)
        for rate in spatial(model, S)[0]:
            fastest = max(fastest, abs(rate))
    for f in range(len(work.freedoms)):
        work.middle[f, 0] = work.acceleration[f, 0]
        work.middle[f, 1] = 0.0
    work.report[ROUND_OFF] = max(work.report[ROUND_OFF], NOISE * fastest * fastest)
    return ASIDE / fastest if fastest > 0.0 else 0.0


@kernel
def go_aside(model, work, d):
    """Displace the stage by the time d along the saved velocities and accelerations."""
    n = len(model.bodies)
    for b in range(len(model.links)):
        f = model.links[b]["freedom"]
        for k in range(model.links[b]["freedoms"]):
            rate = work.middle_twist[n + b, k]
            work.total[f + k, 0] = d * rate
            work.stage_twist[n + b, k] = rate + d * work.middle[f + k, 0]
        displace_by_twist(model, b, work.middle_pose, work.total, f, work.stage_pose)


@kernel
def add_aside(work, weight):
    """Add the accelerations of a displaced stage to their sum."""
    for f in range(len(work.freedoms)):
        work.middle[f, 1] += weight * work.acceleration[f, 0]


@kernel
def end_aside(work, column):
    """Restore the saved stage, with the summed accelerations (column 1) or the saved ones (column 0)."""
    copy_state(work.middle_pose, work.middle_twist, work.stage_pose, work.stage_twist)
    for f in range(len(work.freedoms)):
        work.acceleration[f, 0] = work.middle[f, column]
