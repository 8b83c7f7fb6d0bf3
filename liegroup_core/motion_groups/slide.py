# SPDX-License-Identifier: Apache-2.0
"""R: a link moves along z of its frame; in a plane, along x."""

from liegroup_core.compiling import kernel
from liegroup_core.lie.se2 import se2_wrench, turn_back2
from liegroup_core.lie.vec3 import ZERO3

from .in_plane import hand_on_whole, hand_on_with_rotor, place, place_at, store_freedom

NAME = "R"
JOINTS = {"prismatic": "the frames share their axes; the child translates along z (slider)"}
COMPONENTS, PLANE_COMPONENTS = (5,), (3,)
MAY_BE_HELD = True


@kernel
def plane_displace(link, coordinates, row, screws, at, out):
    """X exp(Psi): along its x axis."""
    c, s = coordinates[row, 0], coordinates[row, 1]
    out[row, 2] = coordinates[row, 2] + c * screws[at, 0]
    out[row, 3] = coordinates[row, 3] + s * screws[at, 0]
    return 0.0


@kernel
def plane_coordinate(link, coordinates, row):
    """Displacement."""
    x, y = coordinates[row, 2] - link["x"], coordinates[row, 3] - link["y"]
    return turn_back2(link["cos"], link["sin"], x, y)[0]


@kernel
def plane_normalise(link, coordinates, row):
    """Remove the round-off of translations across the axis."""
    place_at(link, 1.0, 0.0, plane_coordinate(link, coordinates, row), 0.0, coordinates, row)


@kernel
def plane_add_rates(link, S, V):
    """V and [V, S qdot] of a planar mechanism."""
    return (V[0], V[1] + S[1], V[2]), (0.0, V[0] * S[1])


@kernel
def plane_hand_on(link, work, row, m, F):
    """Add inertia and bias force without the translation along x to those of the parent."""
    if link["rotor"] > 0.0:
        hand_on_with_rotor(link, work, row, m, F, (m[1], m[3], m[4]))
        return
    f, (ww, wx, wy, xx, xy, yy) = link["freedom"], m
    inverse, u, U = work.freedoms[f, 6], work.freedoms[f, 7], ZERO3
    if work.held[f] == 0.0:
        U = se2_wrench(place(work.stage_pose, row), (wx, xx, xy))
        a, b = inverse * wx, inverse * xy
        m = (ww - a * wx, 0.0, wy - a * xy, 0.0, 0.0, yy - b * xy)
        F = (F[0] + a * u, 0.0, F[2] + b * u)
    store_freedom(work, f, U, inverse, u)
    hand_on_whole(work, link["parent"], row, m, F)
