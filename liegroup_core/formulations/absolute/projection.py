# SPDX-License-Identifier: Apache-2.0
"""Projection onto the constraints by mass-weighted least squares on the group.

Positions: the displacement C_i <- C_i exp X_i of all bodies with the smallest sum of X^T M X / 2
that satisfies all joints, g(C exp X) = 0. Newton's method with dg = J X near the constraints:
    M X + J^T lambda = 0 ,   J X = -g
Velocities: the change of smallest kinetic energy with J (V + dV) = 0:
    M dV + J^T lambda = 0 ,   J dV = -J V
Joint forces cause both changes, as pairs of equal and opposite forces. Without a joint to the world
the projection of velocities conserves momentum, and that of positions the centre of mass. When the
latter rotates a body, its velocity stays constant in world axes and its angular velocity in body
axes: this conserves kinetic energy and linear momentum. Displacements are minimal up to second
order.

Source: Terze, Mueller and Zlatar, ref. [34] of the chapter, with the mass matrix as the weight.
"""

from liegroup_core.compiling import borrowed, kernel, shared
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_compose, se3_exp
from liegroup_core.lie.vec3 import dot3, load3, load9, store3, store9, tmatvec3
from liegroup_core.status import DEPENDENT_ROWS, NOT_PROJECTED, OK

from .constraints import assemble, position_residuals
from .saddle_point import solve

# Newton's method converges quadratically: a residual of a tenth of the characteristic length takes
# four or five iterations.
MAX_ITERATIONS = 20
# A residual is a sum of about ten products, each with a round-off of 2^-53 of its lengths.
ROUND_OFF = 16 * 2.0**-52


@kernel
def _largest3(a):
    """Largest magnitude of a component of a vector."""
    return max(abs(a[0]), max(abs(a[1]), abs(a[2])))


@kernel
def is_satisfied(model, work, pose):
    """True if all residuals in work.gap are at round-off level; pose (n, 12)."""
    for j in range(len(model.joints)):
        a = model.joints[j]["parent"]
        b = model.joints[j]["child"]
        element = model.elements[model.joints[j]["element"]]
        length = (
            _largest3(load3(pose, b, 9))
            + _largest3(element["child_point"])
            + _largest3(element["parent_point"])
            + abs(element["parameter"])
        )
        if a != WORLD:
            length += _largest3(load3(pose, a, 9))
        for r in range(model.joints[j]["rows"]):
            row = model.joints[j]["first"] + r
            beta = load3(work.child_jacobian, row, 3)
            scale = 1.0 if dot3(beta, beta) == 0.0 else length
            # NaN does not satisfy a constraint.
            if not abs(work.gap[model.row_residual[row]]) <= ROUND_OFF * scale:
                return False
    return True


@kernel
def _displace(pose, twist, i, xi, eta):
    """Multiply the pose of body i by exp(xi, eta); keep its velocity constant in world axes."""
    turn, shift = se3_exp(xi, eta)
    rot, r = se3_compose(load9(pose, i, 0), load3(pose, i, 9), turn, shift)
    store9(rot, pose, i, 0)
    store3(r, pose, i, 9)
    store3(tmatvec3(turn, load3(twist, i, 3)), twist, i, 3)


@kernel
def project(model, work, pose, twist):
    """Project pose (n, 12) and twist (n, 6) onto the constraints, in place.

    returns (iterations, status): 0 iterations if the residual was at round-off level; status OK,
    NOT_PROJECTED or DEPENDENT_ROWS + (element << 8)
    """
    pose, twist = borrowed(pose), borrowed(twist)
    if len(model.joints) == 0:
        return 0, OK
    for iterations in range(MAX_ITERATIONS + 1):
        position_residuals(model, pose, work.gap)
        assemble(model, work, pose, twist)
        satisfied = is_satisfied(model, work, pose)
        for i in range(len(work.solution)):
            work.solution[i] = 0.0
        for j in range(len(model.joints)):
            start, first = model.joints[j]["start"], model.joints[j]["first"]
            for r in range(model.joints[j]["rows"]):
                if satisfied:
                    work.solution[start + r] = -work.slip[first + r]
                else:
                    work.solution[start + r] = -work.gap[model.row_residual[first + r]]
        dependent = solve(model, work, model.refinements, 0.0, True)
        if dependent >= 0:
            return iterations, DEPENDENT_ROWS + (model.joints[dependent]["element"] << 8)
        for i in range(len(model.bodies)):
            if satisfied:
                for c in range(6):
                    twist[i, c] += work.acceleration[i, c]
            else:
                _displace(
                    pose, twist, i, load3(work.acceleration, i, 0), load3(work.acceleration, i, 3)
                )
        if satisfied:
            return iterations, OK
    return MAX_ITERATIONS, NOT_PROJECTED


@shared
def close_joints(model, work):
    """Project work.stage_pose and work.stage_twist, see `project`; returns a status."""
    _, status = project(model, work, work.stage_pose, work.stage_twist)
    return status
