# SPDX-License-Identifier: Apache-2.0
"""Elimination of one degree of freedom from an articulated body, a wrench or an acceleration; see dynamics/trees.py.

A degree of freedom f is a direction s of a twist. For most it is a component k: rotations are 0 to 2, translations 3
to 5.
"""

from textwrap import dedent

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import axpy3, dot3, load3

# Rows and columns of the 21 numbers of an inertia, see articulated.py.
ENTRIES = (
    *((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)),
    *((i, j) for i in (0, 1, 2) for j in (3, 4, 5)),
    *((3, 3), (3, 4), (3, 5), (4, 4), (4, 5), (5, 5)),
)


def column(k):
    """Text of U = I s for the inertia m and component k."""
    places = [ENTRIES.index((min(k, c), max(k, c))) for c in range(6)]
    return "(" + ", ".join(f"m[{place}]" for place in places) + ")"


def replaced(vector, k, value):
    """Text of a 3-tuple whose entry k is replaced by `value`; unchanged if k is not an index of it."""
    return "(" + ", ".join(value if c == k else f"{vector}[{c}]" for c in range(3)) + ")"


def made(name, text, called):
    """Kernel compiled from a text; its cache key counts the text as a part of this file."""
    names = {"__name__": __name__} | called
    exec(compile(text, __file__, "exec"), names)
    return kernel(names[name])


@kernel
def store_freedom(work, f, U, inverse, u):
    """Store a degree of freedom: U, 1 / D and u."""
    for c in range(6):
        work.freedoms[f, c] = U[c]
    work.freedoms[f, 6] = inverse
    work.freedoms[f, 7] = u


@kernel
def is_held(work, f):
    """Whether degree of freedom f is held: then its U and 1 / D become zero, and it remains in the inertia."""
    if work.held[f] == 0.0:
        return False
    store_freedom(work, f, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    return True


@kernel
def accelerate_direction(work, f, w, v):
    """Acceleration of freedom f, from the acceleration (w, v) of its link without it."""
    U = work.freedoms
    rate = U[f, 6] * (U[f, 7] - (dot3(load3(U, f, 0), w) + dot3(load3(U, f, 3), v)))
    work.acceleration[f, 0] = rate
    return rate


@kernel
def leave_direction(work, f, y, place, torque, force):
    """Wrench minus U y / D of freedom f; writes its component y to work.response[place]."""
    work.response[place] = y
    share = -y * work.freedoms[f, 6]
    return (axpy3(share, load3(work.freedoms, f, 0), torque), axpy3(share, load3(work.freedoms, f, 3), force))


@kernel
def load_direction(work, f, y, torque, force):
    """(torque, force) = -W minus U y / D of freedom f; sets its u to -y, the component of W."""
    work.freedoms[f, 7] = -y
    share = -y * work.freedoms[f, 6]
    return (axpy3(share, load3(work.freedoms, f, 0), torque), axpy3(share, load3(work.freedoms, f, 3), force))


@kernel
def inverse_of(D):
    """1 / D, or 0 where D = 0: a degree of freedom without inertia gets no acceleration."""
    return 1.0 / D if D > 0.0 else 0.0


def _less(k=None):
    """Text of I - U U^T / D, without row and column k."""
    return ", ".join("0.0" if k in (i, j) else f"m[{place}] - s[{i}] * U[{j}]" for place, (i, j) in enumerate(ENTRIES))


_SCALED = "s = (" + ", ".join(f"inverse * U[{c}]" for c in range(6)) + ")"
reduced = made("reduced", f"def reduced(m, U, inverse):\n    {_SCALED}\n    return ({_less()})\n", {})


@kernel
def without_helix(work, pitch, rotor, f, m, torque, force):
    """Inertia and bias force without degree of freedom f, a rotation about z with a translation of pitch along z."""
    U = (
        m[2] + pitch * m[8],
        m[4] + pitch * m[11],
        m[5] + pitch * m[14],
        m[12] + pitch * m[17],
        m[13] + pitch * m[19],
        m[14] + pitch * m[20],
    )
    u = -(torque[2] + pitch * force[2])
    inverse = inverse_of(U[2] + pitch * U[5] + rotor)
    store_freedom(work, f, U, inverse, u)
    share = u * inverse
    torque = axpy3(share, (U[0], U[1], U[2]), torque)
    return reduced(m, U, inverse), torque, axpy3(share, (U[3], U[4], U[5]), force)


def _with_rotor(k):
    """Kernel that eliminates component k of the twist, a degree of freedom f with a rotor.

    With the rotor's inertia in D, row k of I does not vanish: the rotor resists an acceleration of the parent.
    """
    wrench = f"torque[{k}]" if k < 3 else f"force[{k - 3}]"
    text = f"""
        def with_rotor(work, rotor, f, m, torque, force):
            U = {column(k)}
            inverse, u = inverse_of(U[{k}] + rotor), -{wrench}
            store_freedom(work, f, U, inverse, u)
            share = u * inverse
            torque = axpy3(share, (U[0], U[1], U[2]), torque)
            return reduced(m, U, inverse), torque, axpy3(share, (U[3], U[4], U[5]), force)
        """
    return made("with_rotor", dedent(text), globals())


def _without(k):
    """Kernel that eliminates component k of the twist: degree of freedom f.

    It stores the degree of freedom, and returns inertia and bias force without it. Row k of I becomes exactly zero.
    """
    wrench = f"torque[{k}]" if k < 3 else f"force[{k - 3}]"
    text = f"""
        def without(work, f, m, torque, force):
            U = {column(k)}
            inverse, u = inverse_of(U[{k}]), -{wrench}
            store_freedom(work, f, U, inverse, u)
            share = u * inverse
            torque = axpy3(share, (U[0], U[1], U[2]), torque)
            force = axpy3(share, (U[3], U[4], U[5]), force)
            {_SCALED}
            return ({_less(k)}), {replaced("torque", k, "0.0")}, {replaced("force", k - 3, "0.0")}
        """
    return made("without", dedent(text), globals())


WITHOUT = tuple(map(_without, range(6)))
WITH_ROTOR = tuple(map(_with_rotor, range(6)))
