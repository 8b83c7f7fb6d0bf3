# SPDX-License-Identifier: Apache-2.0
"""Error estimates of the bodies from those of the degrees of freedom, in relative coordinates.

The differences of the degrees of freedom add up along the tree, so links are processed in the order of the tree.
"""

from liegroup_core.compiling import kernel
from liegroup_core.dynamics.algebra import (
    first_state,
    is_direct,
    lifted,
    link_of,
    rate_twist,
    relative,
    spatial,
    tree_size,
)
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import add3, cross3, load3, store3, vector3
from liegroup_core.methods.checks import error_norm_square
from liegroup_core.motion_groups.direct import to_link


@kernel
def _difference(model, work, scheme, row, h, i):
    """Write the differences of the degrees of freedom of link i to work.difference: algebra, qdot."""
    count, parts = len(work.freedoms), work.difference
    for k in range(model.links[i]["freedoms"]):
        psi, dq = 0.0, 0.0
        for stage in range(scheme.error.shape[1]):
            weight = scheme.error[row, stage]
            if weight != 0.0:
                at = stage * count + model.links[i]["freedom"] + k
                psi += weight * work.slopes[at, 0]
                dq += weight * work.slopes[at, 1]
        parts[0, k], parts[1, k] = h * psi, h * dq


@kernel
def _with_parent(work, at, rot, p, moved, rate):
    """Add the differences of the parent, row `at` of work.errors, to a link's; rot, p: its pose in the parent."""
    errors = work.errors
    xi, eta = se3_Ad_inverse(rot, p, load3(errors, at, 0), load3(errors, at, 3))
    dw, dv = se3_Ad_inverse(rot, p, load3(errors, at, 6), load3(errors, at, 9))
    return add3(moved[0], xi), add3(moved[1], eta), add3(rate[0], dw), add3(rate[1], dv)


@kernel
def _of_link(model, work, i, place):
    """Differences (xi, eta, dw, dv) of the origin of link i; work.errors has its parent's."""
    link = link_of(model, i)
    moved = spatial(model, rate_twist(model, link, work.difference, 0))
    rate = spatial(model, rate_twist(model, link, work.difference, 1))
    a = link["parent"]
    if a == WORLD:
        if is_direct(model, link):
            pose, at = work.stage_pose, len(model.bodies) + i
            return moved[0], to_link(pose, at, moved[1]), rate[0], to_link(pose, at, rate[1])
        return moved[0], moved[1], rate[0], rate[1]
    rot, p = lifted(model, relative(model, work, i))
    return _with_parent(work, place + a, rot, p, moved, rate)


@kernel
def _error_of_state(model, work, scheme, row, h, i, rtol, atol):
    """Square of the error estimate of the state of a law, the rate of link i."""
    change, value = 0.0, abs(work.stage_twist[len(model.bodies) + i, 0])
    s = i - tree_size(model)
    f = first_state(model, work) + s
    for stage in range(scheme.error.shape[1]):
        change += scheme.error[row, stage] * work.slopes[stage * len(work.freedoms) + f, 1]
    error = h * change / (atol * model.space.forces.laws.scales[s] + rtol * value)
    return error * error


@kernel
def error_square(model, work, scheme, row, h, twist, i, rtol, atol, length):
    """Square of an error estimate of the body that represents link i; see error_control.py."""
    if i >= tree_size(model):
        return _error_of_state(model, work, scheme, row, h, i, rtol, atol)
    _difference(model, work, scheme, row, h, i)
    place = row * len(model.links)
    xi, eta, dw, dv = _of_link(model, work, i, place)
    store3(xi, work.errors, place + i, 0)
    store3(eta, work.errors, place + i, 3)
    store3(dw, work.errors, place + i, 6)
    store3(dv, work.errors, place + i, 9)
    link = model.links[i]
    body = link["body"]
    if body < 0:
        return 0.0
    point = vector3(link["body_point"])
    eta, dv = add3(eta, cross3(xi, point)), add3(dv, cross3(dw, point))
    return error_norm_square(xi, eta, dw, dv, twist, work.stage_twist, body, rtol, atol, length)
