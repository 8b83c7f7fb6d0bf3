# SPDX-License-Identifier: Apache-2.0
"""Couplings of links of the spanning tree: coordinates, and the forces that a multiplier causes.

The row of a coupling has the coefficients sign_0 for the rate of the first link, -p'(q) sign_1 for that of
the second, -c_k sign_k for further ones; work.factors has those of the stage. They are constant unless the
coupling is curved. The coordinate of a joint is its sign times that of its link. J^T lambda is a torque or force
on each link, and its reaction on the parent link. Every Runge-Kutta method satisfies rows that are linear in
coordinates of SO(2) and R without drift. Rows of curved couplings drift, and those of driven joints, whose motion
depends on time.

Residuals and velocities are in coupled_rows.py.
"""

from liegroup_core.compiling import kernel
from liegroup_core.joints.elements import WORLD

from .algebra import add_to, choice, column, coordinate, link_of, relative, unit, wrench_at


@kernel
def link_coordinate(model, b, pose):
    """Angle in [-pi, pi] or displacement of link b: hinge, screw or slide."""
    return coordinate(model, link_of(model, b), pose, len(model.bodies) + b)


@kernel
def link_shift(model, b, pose):
    """Displacement of link b along its axis, for a cylinder; planar models have none."""
    return pose[len(model.bodies) + b, 4]


@kernel
def add_pair(model, work, b, component, value, out, stride):
    """Add a generalised force on link b, and its reaction on the parent, to wrenches.

    component : 1 for the displacement of a cylinder, else 0
    out : its row stride * b has the wrench of link b
    """
    link = link_of(model, b)
    axis = column(model, link, component)
    out[stride * b, axis] += value
    if link["parent"] != WORLD:
        back = wrench_at(model, relative(model, work, b), unit(model, axis, -value))
        add_to(model, back, out, stride * link["parent"])


@kernel
def add_rotors(model, work, rates, factor, out):
    """Add the wrenches that the rotors of joints need for rates or accelerations, (f, 1) times a factor."""
    for b in range(len(model.links)):
        link = link_of(model, b)
        if link["rotor"] > 0.0:
            add_pair(model, work, b, 0, link["rotor"] * (factor * rates[link["freedom"], 0]), out, 1)


@kernel
def law(coupling, q):
    """p, p' and p'' of a coupling at the coordinate q of its second joint."""
    a = coupling["curve"]
    value = q * (a[0] + q * (a[1] + q * (a[2] + q * a[3])))
    slope = a[0] + q * (2.0 * a[1] + q * (3.0 * a[2] + q * (4.0 * a[3])))
    return value, slope, 2.0 * a[1] + q * (6.0 * a[2] + q * (12.0 * a[3]))


@kernel
def add_coupling(model, work, c, value, out, stride):
    """Add J^T of coupling c times a multiplier to wrenches; see `add_pair`."""
    begin, end = model.couplings[c]["terms"]
    for k in range(begin, end):
        add_pair(model, work, model.coupling_terms[k]["link"], 0, work.factors[k] * value, out, stride)


@kernel
def _add_effort_in_space(model, work, b, component, value):
    """Apply a generalised force to link b, and its reaction to the parent."""
    add_pair(model, work, b, component, value, work.applied, 1)


@kernel
def _add_effort_in_plane(model, work, b, component, value):
    # The bias forces in work.force are already set, so they change, too.
    add_pair(model, work, b, component, value, work.applied, 1)
    add_pair(model, work, b, component, -value, work.force, 1)


add_effort = choice("add_effort", _add_effort_in_space, _add_effort_in_plane)


@kernel
def coupled_rate(model, work, rates, at, c):
    """J times rates of the degrees of freedom, for coupling c; rates[at + f, 0] is that of freedom f."""
    begin, end = model.couplings[c]["terms"]
    total = 0.0
    for k in range(begin, end):
        total += work.factors[k] * rates[at + model.links[model.coupling_terms[k]["link"]]["freedom"], 0]
    return total
