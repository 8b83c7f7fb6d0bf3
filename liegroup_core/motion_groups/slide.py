# SPDX-License-Identifier: Apache-2.0
"""R: a link moves along z of its frame; along x of it in a plane."""

from liegroup_core.compiling import kernel

from .about_z import relative_pose as relative_pose
from .about_z import store_place

JOINTS = ("prismatic",)
COMPONENTS, PLANE_COMPONENTS = (5,), (3,)
MAY_BE_HELD = True


@kernel
def project_pose(link, rot, p, coordinates, row):
    """X nearest to a relative pose."""
    store_place(1.0, 0.0, 0.0, 0.0, p[2], coordinates, row)


@kernel
def displace(link, coordinates, row, screws, at, out):
    """X exp(Psi)."""
    out[row, 0], out[row, 1] = 1.0, 0.0
    out[row, 4] = coordinates[row, 4] + screws[at, 0]
    return 0.0


@kernel
def normalise(link, coordinates, row):
    """Nothing: a sum leaves no group, and (cos, sin) are (1, 0)."""
