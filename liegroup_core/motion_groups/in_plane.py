# SPDX-License-Identifier: Apache-2.0
"""Groups of a planar mechanism: functions that hinges and slides share, and texts generated from their data.

The coordinates of a link are its pose in its parent link, (cos, sin, x, y) in m: the product of the joint's
placement and its motion. Links are displaced by products from the right, so stages do not need the
placement. Twists are (omega, v_x, v_y). An inertia is (6): I, -m c_y, m c_x, and the mass matrix (xx, xy, yy).

Hinges and slides store U in the axes of their parents, U X, so that qddot = (u - U X . E_a) / D follows
directly from the parent. A link with all degrees of freedom of the plane adds nothing to its parent.
"""

from liegroup_core.compiling import kernel, subroutine
from liegroup_core.lie.se2 import se2_compose, se2_turned_mass, se2_wrench, turn2
from liegroup_core.lie.vec3 import ZERO3, add_to3

from .about_z import turn_of
from .elimination import inverse_of


@kernel
def place(coordinates, row):
    """Pose of a link in its parent."""
    return coordinates[row, 0], coordinates[row, 1], coordinates[row, 2], coordinates[row, 3]


@kernel
def place_at(link, c, s, x, y, coordinates, row):
    """Write coordinates T X for the pose X."""
    T = (link["cos"], link["sin"], link["x"], link["y"])
    c, s, x, y = se2_compose(T, (c, s, x, y))
    coordinates[row, 0], coordinates[row, 1] = c, s
    coordinates[row, 2], coordinates[row, 3] = x, y


@kernel
def store_freedom(work, f, U, inverse, u):
    """Store a degree of freedom: U, 1 / D and u."""
    freedoms = work.freedoms
    freedoms[f, 0], freedoms[f, 1], freedoms[f, 2] = U
    freedoms[f, 6], freedoms[f, 7] = inverse, u


@kernel
def begin_freedom(work, f, D, part):
    """Store 1 / D and u of a degree of freedom, zeros if it is held. `hand_on` stores U if the link has a parent."""
    inverse, u = (inverse_of(D), -part) if work.held[f] == 0.0 else (0.0, 0.0)
    work.freedoms[f, 6], work.freedoms[f, 7] = inverse, u


@subroutine
def hand_on_whole(work, a, row, m, F):
    """Add inertia and bias force of a link to those of its parent a."""
    inertia, (c, s, x, y) = work.inertia, place(work.stage_pose, row)
    ww, (wx, wy) = m[0], turn2(c, s, m[1], m[2])
    xx, xy, yy = se2_turned_mass(c, s, m[3], m[4], m[5])
    # M times the velocity of the link if the parent turns
    bx, by = xy * x - xx * y, yy * x - xy * y
    ww += x * (by + 2.0 * wy) - y * (bx + 2.0 * wx)
    add_to3((ww, wx + bx, wy + by), inertia, a, 0)
    add_to3((xx, xy, yy), inertia, a, 3)
    add_to3(se2_wrench((c, s, x, y), F), work.force, a, 0)
    return 0


@kernel
def hand_on_with_rotor(link, work, row, m, F, U):
    """Add the rest to the parent of a link whose degree of freedom has a rotor; U = I s in link axes.

    The rotor's inertia is in D, so that no row of the rest vanishes.
    """
    f = link["freedom"]
    inverse, u, V = work.freedoms[f, 6], work.freedoms[f, 7], ZERO3
    if work.held[f] == 0.0:
        V = se2_wrench(place(work.stage_pose, row), U)
        a, b, c = inverse * U[0], inverse * U[1], inverse * U[2]
        m = (m[0] - a * U[0], m[1] - a * U[1], m[2] - a * U[2], m[3] - b * U[1], m[4] - b * U[2], m[5] - c * U[2])
        F = (F[0] + a * u, F[1] + b * u, F[2] + c * u)
    store_freedom(work, f, V, inverse, u)
    hand_on_whole(work, link["parent"], row, m, F)


@kernel
def accelerate_at(work, f, E):
    """Acceleration of freedom f, from E of the parent of its link."""
    U = work.freedoms
    rate = U[f, 6] * (U[f, 7] - (U[f, 0] * E[0] + U[f, 1] * E[1] + U[f, 2] * E[2]))
    work.acceleration[f, 0] = rate
    return rate


@kernel
def leave_at(work, f, row, F, y):
    """Wrench without degree of freedom f in the axes of the parent, and its component y of f."""
    U, share = work.freedoms, y * work.freedoms[f, 6]
    torque, fx, fy = se2_wrench(place(work.stage_pose, row), F)
    return (torque - share * U[f, 0], fx - share * U[f, 1], fy - share * U[f, 2]), y, 0.0, 0.0


# Names that the texts use.
CALLED = {each.__name__: each for each in (accelerate_at, begin_freedom, leave_at, place_at, turn_of)}


def twist_of(components, number):
    """Text of S q; number: text of component {k} of q."""
    parts = [number.format(k=components.index(c)) if c in components else "0.0" for c in (2, 3, 4)]
    return f"return {', '.join(parts)}"


def functions_of(components):
    """{name: text of a function} of a group, see table.IN_PLANE; the last three for groups with one freedom."""
    x, y = (f"p[{c - 3}]" if c in components else "0.0" for c in (3, 4))
    turn = "turn_of(rot)" if 2 in components else "1.0, 0.0"
    k = components[0] - 2
    moved = ", ".join(f"V[{c}]{' + rate' * (c == k)}" for c in range(3))
    return {
        "rate_twist": twist_of(components, "rates[row, {k}]"),
        "column_twist": twist_of(components, "psi[at + {k}, 0]"),
        "rates_of": "\n".join(f"rates[row, {n}] = V[{c - 2}]" for n, c in enumerate(components)),
        "own_forces": "\n".join(f"out[f + {n}] = F[{c - 2}]" for n, c in enumerate(components)),
        "project_pose": f"c, s = {turn}\nplace_at(link, c, s, {x}, {y}, coordinates, row)",
        "eliminate": f"begin_freedom(work, f, m[{3 * k}] + link['rotor'], F[{k}])\nreturn m, F",
        "accelerate": f"rate = accelerate_at(work, f, E)\nreturn {moved}",
        "leave": f"return leave_at(work, f, row, F, F[{k}])",
    }
