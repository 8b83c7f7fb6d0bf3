# SPDX-License-Identifier: Apache-2.0
"""Position residuals of the joints' constraint equations, and when they count as zero."""

from liegroup_core.compiling import borrowed, kernel, shared
from liegroup_core.joints.elements import PAIR, WORLD
from liegroup_core.joints.kinds import variable_residual
from liegroup_core.joints.pairs import pair_coordinates
from liegroup_core.lie.vec3 import (
    add3,
    dot3,
    load3,
    load9,
    matmul3,
    matrix3,
    matvec3,
    sub3,
    tmatmul3,
    tmatvec3,
    vector3,
)

# Newton's method converges quadratically: a residual of a tenth of the characteristic length takes
# four or five iterations.
MAX_ITERATIONS = 20
# A residual is a sum of about ten products, each with a round-off of 2^-53 of its lengths.
ROUND_OFF = 16 * 2.0**-52


@kernel
def _frame(pose, body, rotation, point):
    """Rotation and origin, world axes, of a frame that is fixed in a body or in the world."""
    if body == WORLD:
        return rotation, point
    rot = load9(pose, body, 0)
    return matmul3(rot, rotation), add3(load3(pose, body, 9), matvec3(rot, point))


@shared
def position_residuals(model, pose, residual_out):
    """Position residuals of all rows of all elements, rad and m; see joints/elements.py.

    pose (n, 12), residual_out (all rows,)
    """
    pose, residual_out = borrowed(pose), borrowed(residual_out)
    for e in range(len(model.elements)):
        element = model.elements[e]
        kind = element["kind"]
        first = element["row_start"]
        rot_a, at_a = _frame(
            pose, element["parent"], matrix3(element["parent_rotation"]), vector3(element["parent_point"])
        )
        rot_b, at_b = _frame(
            pose, element["child"], matrix3(element["child_rotation"]), vector3(element["child_point"])
        )
        rot = tmatmul3(rot_a, rot_b)
        p = tmatvec3(rot_a, sub3(at_b, at_a))
        if kind != PAIR:
            residual_out[first] = variable_residual(kind, rot, p, element["parameter"])
        else:
            angular, linear = pair_coordinates(rot, p, element["turns_freely"] == 1, element["parameter"])
            forbidden = element["forbidden"]
            for r in range(element["rows"]):
                total = 0.0
                for c in range(3):
                    total += forbidden[6 * r + c] * angular[c] + forbidden[6 * r + 3 + c] * linear[c]
                residual_out[first + r] = total
    return 0


@kernel
def _largest3(a):
    """Largest magnitude of a component of a vector."""
    return max(abs(a[0]), max(abs(a[1]), abs(a[2])))


@kernel
def is_satisfied(model, work, pose):
    """True if all residuals in work.gap are at round-off level; pose (n, 12)."""
    for j in range(len(model.cuts)):
        a = model.cuts[j]["parent"]
        b = model.cuts[j]["child"]
        element = model.elements[model.cuts[j]["element"]]
        length = (
            _largest3(load3(pose, b, 9))
            + _largest3(element["child_point"])
            + _largest3(element["parent_point"])
            + abs(element["parameter"])
        )
        if a != WORLD:
            length += _largest3(load3(pose, a, 9))
        for r in range(model.cuts[j]["rows"]):
            row = model.cuts[j]["first"] + r
            beta = load3(work.child_jacobian, row, 3)
            scale = 1.0 if dot3(beta, beta) == 0.0 else length
            # NaN does not satisfy a constraint.
            if not abs(work.gap[model.row_residual[row]]) <= ROUND_OFF * scale:
                return False
    return True
