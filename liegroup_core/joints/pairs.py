# SPDX-License-Identifier: Apache-2.0
"""Lower pairs: the constant directions of relative twist that a joint forbids.

A lower pair lets the relative pose of its two joint frames,

    C_rel = F_a^-1 C_a^-1 C_b F_b,

move in a subgroup H of SE(3). It is therefore described by a constant matrix A of shape (k, 6),
whose rows span the complement of the Lie algebra of H, and by nothing else:

    velocity      A V_rel = 0
    position      A (tilt_x, tilt_y, turn_z, p_x, p_y, p_z) = 0

Twists are (omega, v), angular first, in the axes of the child's joint frame. Where a pair has an
axis, it is the z axis of both joint frames. A new lower pair is one row in `LOWER_PAIRS`.
"""

from dataclasses import dataclass
from math import atan2, hypot

import numpy as np

_COORDINATES = ("wx", "wy", "wz", "vx", "vy", "vz")


@dataclass(frozen=True, eq=False)
class LowerPair:
    """One lower pair.

    forbidden : (k, 6) A, rows of forbidden relative twist, angular first, read-only
    text      : what the pair lets the child do, for people
    """

    forbidden: np.ndarray
    text: str

    @property
    def row_names(self):
        """Names of the rows: the coordinate of the relative twist that each one forbids."""
        return tuple(_COORDINATES[int(np.argmax(row))] for row in self.forbidden)


def _forbid(*names):
    """Rows of A that forbid the named coordinates of the relative twist."""
    rows = np.eye(6)[[_COORDINATES.index(name) for name in names]]
    rows.flags.writeable = False
    return rows


LOWER_PAIRS = {
    "spherical": LowerPair(
        _forbid("vx", "vy", "vz"),
        "ball joint: the frames share their origin, the child turns freely about it",
    ),
    "revolute": LowerPair(
        _forbid("wx", "wy", "vx", "vy", "vz"),
        "hinge: the frames share origin and z axis, the child turns about z",
    ),
}


def rotation_z_to(axis):
    """Shortest rotation R with R (0, 0, 1) = axis; for axis = -z, the half turn about y.

    axis : (3,) unit vector
    returns (3, 3)

    Written with the unit vector u of the axis' horizontal part in place of the usual
    1 / (1 + z), so that it stays orthogonal to round-off next to axis = -z, where that quotient
    is singular (`test_rotation_z_to_is_a_rotation_to_round_off`).
    """
    x, y, z = (float(component) for component in axis)
    horizontal = hypot(x, y)
    u_x, u_y = (x / horizontal, y / horizontal) if horizontal > 0.0 else (1.0, 0.0)
    bend = 1.0 - z
    return np.array([
        [1.0 - bend * u_x * u_x, -bend * u_x * u_y, x],
        [-bend * u_x * u_y, 1.0 - bend * u_y * u_y, y],
        [-x, -y, z],
    ])


def position_residual(kind, C_rel):
    """How far a relative pose is from the subgroup of a lower pair; zero exactly on it.

    kind  : name in LOWER_PAIRS
    C_rel : (4, 4) pose of the child's joint frame in the parent's joint frame
    returns (k,) in the order of the rows of A: rad for angular rows, m for linear ones

    The rotation is split into a turn about z and a tilt of the z axis (swing and twist). The tilt
    is the rotation vector that tilts z, its angle from atan2 of sine and cosine: an axis that
    points the wrong way is a residual of pi, not of zero. Next to H the residual changes as
    A V_rel does, seen in the parent's joint frame instead of the child's. Not for the hot loop.
    """
    R, p = C_rel[:3, :3], C_rel[:3, 3]
    axis_x, axis_y, axis_z = R[:, 2]
    sine = hypot(axis_x, axis_y)
    angle = atan2(sine, axis_z)
    # the tilt's axis is z cross the child's axis; upside down, every horizontal axis would do
    u_x, u_y = (-axis_y / sine, axis_x / sine) if sine > 0.0 else (1.0, 0.0)
    turn = atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
    coordinates = np.array([angle * u_x, angle * u_y, turn, *p])
    return LOWER_PAIRS[kind].forbidden @ coordinates
