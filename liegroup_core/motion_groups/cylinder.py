# SPDX-License-Identifier: Apache-2.0
"""SO(2) x R: a link turns about z and moves along it."""

from liegroup_core.compiling import kernel

from . import about_z
from .about_z import normalise as normalise
from .about_z import relative_pose as relative_pose
from .about_z import store_place, turn_of

JOINTS = ("cylindrical",)
COMPONENTS = (2, 5)
MAY_BE_HELD = True


@kernel
def project_pose(link, rot, p, coordinates, row):
    """X nearest to a relative pose."""
    c, s = turn_of(rot)
    store_place(c, s, 0.0, 0.0, p[2], coordinates, row)


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi)."""
    out[row, 4] = coordinates[row, 4] + screws[at + 1, 0]
    return about_z.turn(coordinates, row, screws[at, 0], out)
