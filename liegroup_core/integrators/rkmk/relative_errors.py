# SPDX-License-Identifier: Apache-2.0
"""Error estimates in relative coordinates: those of the bodies, from those of the freedoms.

The differences of the freedoms add up along the tree: links come in the order of the tree.
"""

import math

from liegroup_core.compiling import Choice, kernel
from liegroup_core.formulations.relative.arrays import HINGE, SLIDE, PlaneModel, RelativeModel
from liegroup_core.formulations.relative.coordinates import rate_twist
from liegroup_core.joints.elements import WORLD
from liegroup_core.lie.se3 import se3_Ad_inverse
from liegroup_core.lie.vec3 import add3, cross3, dot3, load3, load9, store3, vector3


@kernel
def _difference(model, work, scheme, row, h, i):
    """Write the differences of the freedoms of link i to work.difference: algebra, qdot."""
    count, parts = len(work.freedoms), work.difference
    for k in range(model.bodies[i]["freedoms"]):
        psi, dq = 0.0, 0.0
        for stage in range(scheme.error.shape[1]):
            weight = scheme.error[row, stage]
            if weight != 0.0:
                at = stage * count + model.bodies[i]["freedom"] + k
                psi += weight * work.slopes[at, 0]
                dq += weight * work.slopes[at, 1]
        parts[0, k], parts[1, k] = h * psi, h * dq


@kernel
def _in_space(model, work, i, place):
    """Differences (xi, eta, dw, dv) of the origin of link i; work.errors has its parent's."""
    link = model.bodies[i]
    xi, eta = rate_twist(link, work.difference, 0)
    dw, dv = rate_twist(link, work.difference, 1)
    a = link["parent"]
    if a != WORLD:
        rot, p = load9(work.relative, i, 0), load3(work.relative, i, 9)
        at = place + a
        w, v = se3_Ad_inverse(rot, p, load3(work.errors, at, 0), load3(work.errors, at, 3))
        xi, eta = add3(xi, w), add3(eta, v)
        w, v = se3_Ad_inverse(rot, p, load3(work.errors, at, 6), load3(work.errors, at, 9))
        dw, dv = add3(dw, w), add3(dv, v)
    return xi, eta, dw, dv


@kernel
def _planar_twist(group, rates, row):
    """S qdot of a link of a planar mechanism as a twist in space."""
    first = rates[row, 0]
    if group == HINGE:
        return (0.0, 0.0, first), (0.0, 0.0, 0.0)
    if group == SLIDE:
        return (0.0, 0.0, 0.0), (first, 0.0, 0.0)
    return (0.0, 0.0, first), (rates[row, 1], rates[row, 2], 0.0)


@kernel
def _in_plane(model, work, i, place):
    """`_in_space` for a planar mechanism."""
    group, a = model.links[i]["group"], model.links[i]["parent"]
    xi, eta = _planar_twist(group, work.difference, 0)
    dw, dv = _planar_twist(group, work.difference, 1)
    if a != WORLD:
        row = len(model.parts) + i
        c, s = work.stage_pose[row, 0], work.stage_pose[row, 1]
        rot = (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        p = (work.stage_pose[row, 2], work.stage_pose[row, 3], 0.0)
        at = place + a
        w, v = se3_Ad_inverse(rot, p, load3(work.errors, at, 0), load3(work.errors, at, 3))
        xi, eta = add3(xi, w), add3(eta, v)
        w, v = se3_Ad_inverse(rot, p, load3(work.errors, at, 6), load3(work.errors, at, 9))
        dw, dv = add3(dw, w), add3(dv, v)
    return xi, eta, dw, dv


_of_link = Choice("_of_link", {RelativeModel: _in_space, PlaneModel: _in_plane})


@kernel
def error_square(model, work, scheme, row, h, twist, i, rtol, atol):
    """Square of an error estimate of the body that represents link i; see munthe_kaas.py."""
    _difference(model, work, scheme, row, h, i)
    place = row * len(model.bodies)
    xi, eta, dw, dv = _of_link(model, work, i, place)
    store3(xi, work.errors, place + i, 0)
    store3(eta, work.errors, place + i, 3)
    store3(dw, work.errors, place + i, 6)
    store3(dv, work.errors, place + i, 9)
    link = model.bodies[i]
    body = link["body"]
    if body < 0:
        return 0.0
    point = vector3(link["body_point"])
    eta, dv = add3(eta, cross3(xi, point)), add3(dv, cross3(dw, point))
    w0, w1 = load3(twist, body, 0), load3(work.stage_twist, body, 0)
    v0, v1 = load3(twist, body, 3), load3(work.stage_twist, body, 3)
    tol_w = atol + rtol * math.sqrt(max(dot3(w0, w0), dot3(w1, w1)))
    tol_v = atol + rtol * math.sqrt(max(dot3(v0, v0), dot3(v1, v1)))
    return (
        (dot3(xi, xi) + dot3(eta, eta)) / (atol * atol)
        + dot3(dw, dw) / (tol_w * tol_w)
        + dot3(dv, dv) / (tol_v * tol_v)
    )
