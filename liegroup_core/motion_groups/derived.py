# SPDX-License-Identifier: Apache-2.0
"""What follows from the data of a motion group, for all groups: twists, and freedoms one after the other.

A group whose freedoms are components of a twist says which (COMPONENTS), in which order they are
eliminated (ORDER) and whether stops and friction may hold them (MAY_BE_HELD). These factories make
its kernels. Numbers of the group are constants in them.
"""

from liegroup_core.compiling import kernel
from liegroup_core.lie.se3 import se3_ad
from liegroup_core.lie.vec3 import add3

from .elimination import accelerate_component, eliminate_component, leave_component


@kernel
def in_row(array, row, k):
    """Number k of a link whose numbers are a row of an array: coordinates, rates."""
    return array[row, k]


@kernel
def in_column(array, first, k):
    """Number k of a link whose numbers start at a row of the first column: Psi, psi."""
    return array[first + k, 0]


def twist_of(components, read):
    """Kernel of S q as angular and linear part; read: `in_row` or `in_column`, for q."""
    a, b, c, d, e, f = (components.index(k) if k in components else -1 for k in range(6))

    @kernel
    def twist(link, array, at):
        return (
            (
                read(array, at, a) if a >= 0 else 0.0,
                read(array, at, b) if b >= 0 else 0.0,
                read(array, at, c) if c >= 0 else 0.0,
            ),
            (
                read(array, at, d) if d >= 0 else 0.0,
                read(array, at, e) if e >= 0 else 0.0,
                read(array, at, f) if f >= 0 else 0.0,
            ),
        )

    return twist


def elimination_of(components, order, may_be_held):
    """Kernel that eliminates the freedoms of a link from its articulated body."""
    number, k = order[0], components[order[0]]
    if len(order) == 1:

        @kernel
        def last(link, work, f, m, torque, force):
            return eliminate_component(work, f + number, k, may_be_held, m, torque, force)

        return last
    rest = elimination_of(components, order[1:], may_be_held)

    @kernel
    def eliminate(link, work, f, m, torque, force):
        m, torque, force = eliminate_component(work, f + number, k, may_be_held, m, torque, force)
        return rest(link, work, f, m, torque, force)

    return eliminate


def acceleration_of(components, order):
    """Kernel of the acceleration of a link with its freedoms, in the reverse order of elimination."""
    number, k = order[0], components[order[0]]
    if len(order) == 1:

        @kernel
        def first(link, work, f, w, v):
            return accelerate_component(work, f + number, k, w, v)

        return first
    rest = acceleration_of(components, order[1:])

    @kernel
    def accelerate(link, work, f, w, v):
        w, v = rest(link, work, f, w, v)
        return accelerate_component(work, f + number, k, w, v)

    return accelerate


def leaving_of(components, order, may_be_held):
    """Kernel of a wrench of a row without the freedoms of a link."""
    number, k = order[0], components[order[0]]
    if len(order) == 1:

        @kernel
        def last(link, work, f, place, rows, torque, force):
            return leave_component(work, f + number, k, may_be_held, place, torque, force)

        return last
    rest = leaving_of(components, order[1:], may_be_held)

    @kernel
    def leave(link, work, f, place, rows, torque, force):
        torque, force = leave_component(work, f + number, k, may_be_held, place, torque, force)
        return rest(link, work, f, place + rows, rows, torque, force)

    return leave


@kernel
def add_rates(link, sw, sv, w, v):
    """V of a link and [V, S qdot], from the velocity (w, v) of its frame in the parent and S qdot."""
    w, v = add3(w, sw), add3(v, sv)
    return (w, v), se3_ad(w, v, sw, sv)


@kernel
def hand_on(link, work, b, m, torque, force):
    """Whether a short form added what is left of the inertia of link b to its parent; see table.py."""
    return False, torque, force
