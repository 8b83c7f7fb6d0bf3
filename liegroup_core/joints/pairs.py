# SPDX-License-Identifier: Apache-2.0
"""Lower pairs: the constant directions of relative twist that a joint forbids.

A lower pair allows the relative pose of its two joint frames,

    C_rel = F_a^-1 C_a^-1 C_b F_b,

to vary in a subgroup H of SE(3). A constant matrix A of shape (k, 6) describes it completely; its
rows span the complement of the Lie algebra of H:

    velocity      A V_rel = 0
    position      A (tilt_x, tilt_y, turn, x, y, z) = 0

Twists are (omega, v), angular first, in the axes of the child's joint frame. The axis of a pair is
the z axis of both joint frames. A new lower pair is a file of `motion_groups`.
"""

import math
from dataclasses import dataclass

import numpy as np

from liegroup_core.compiling import kernel
from liegroup_core.lie.vec3 import tmatvec3
from liegroup_core.motion_groups.table import JOINTS

from .elements import PAIR, Element

_COORDINATES = ("wx", "wy", "wz", "vx", "vy", "vz")


@dataclass(frozen=True, eq=False)
class LowerPair:
    """One lower pair.

    coordinates : names of the components of the relative twist that it forbids
    text        : motion that the pair allows, for readers of the code
    has_pitch   : True: the child moves by `pitch` (m/rad) along z per radian about z, so that
                  v_z - pitch w_z is forbidden instead of v_z
    """

    coordinates: tuple
    text: str
    has_pitch: bool = False

    def forbidden(self, pitch=0.0):
        """A (k, 6), rows of forbidden relative twist, angular first."""
        rows = np.eye(6)[[_COORDINATES.index(name) for name in self.coordinates]]
        if self.has_pitch and "vz" in self.coordinates:
            rows[self.coordinates.index("vz"), _COORDINATES.index("wz")] = -pitch
        return rows

    @property
    def turns_freely(self):
        """True if all rotations are allowed."""
        return not any(name.startswith("w") for name in self.coordinates)

    # The following properties are those of JointType.

    @property
    def turns(self):
        """True for one angle about z: the z axes stay parallel, w_z is free or coupled."""
        return {"wx", "wy"} <= set(self.coordinates) and "wz" not in self.coordinates

    @property
    def slides(self):
        """True for one displacement along z: the z axes coincide, v_z is free or coupled."""
        z_is_kept = {"wx", "wy", "vx", "vy"} <= set(self.coordinates)
        return z_is_kept and ("vz" not in self.coordinates or self.has_pitch)

    @property
    def coordinate(self):
        """Unit of the joint coordinate, "rad" or "m"; None if the pair has not exactly one free direction."""
        free = set(_COORDINATES) - set(self.coordinates)
        return {"wz": "rad", "vz": "m"}[free.pop()] if len(free) == 1 else None

    @property
    def rate(self):
        """Component of the relative twist that is the joint's `rate` in a scene, or None."""
        return 2 if self.turns else 5 if self.slides else None


def _of_group(group, text):
    """LowerPair that allows the motions of a motion group and forbids all other components."""
    names = (name for k, name in enumerate(_COORDINATES) if k not in group.COMPONENTS)
    return LowerPair(tuple(names), text, getattr(group, "HAS_PITCH", False))


LOWER_PAIRS = {kind: _of_group(group, group.JOINTS[kind]) for kind, group in JOINTS.items()}
LOWER_PAIRS["fixed"] = LowerPair(_COORDINATES, "the frames coincide (weld)")


def pair_element(name, pitch=0.0):
    """Element of a lower pair; pitch: m/rad, for a screw."""
    pair = LOWER_PAIRS[name]
    return Element(PAIR, pair.coordinates, pair.forbidden(pitch), pair.turns_freely, pitch)


@kernel
def pair_coordinates(rot, p, turns_freely, pitch):
    """Six coordinates of a relative pose; A times these is the position residual of a lower pair.

    rot, p       : C_rel, pose of the child's joint frame in the parent's
    turns_freely : see LowerPair
    pitch        : m/rad of a screw, else 0
    returns (tilt_x, tilt_y, turn) rad, (x, y, z) m; in the limit to H, d(A coordinates) = A V_rel

    R = Rz(turn) tilt (twist and swing). The tilt is about a horizontal axis of the child's frame. Its
    angle is atan2 of sine and cosine, so that a reversed z axis has a residual of pi instead of 0. The
    position is in the axes of the element of H nearest to C_rel: those of Rz(turn), or those of the
    child if all rotations are allowed. For a screw, the angle among turn + 2 pi k that is nearest to
    z / pitch is used, so that the residual along z is at most half a thread.
    """
    if turns_freely:
        return (0.0, 0.0, 0.0), tmatvec3(rot, p)
    # The third row of R is the parent's z axis in the child's axes: z x (tilt axis) times sine.
    sine = math.hypot(rot[6], rot[7])
    angle = math.atan2(sine, rot[8])
    tilt_x, tilt_y = angle, 0.0  # with reversed z, every horizontal axis is valid
    if sine > 0.0:
        tilt_x, tilt_y = angle * (rot[7] / sine), -angle * (rot[6] / sine)
    turn = math.atan2(rot[3] - rot[1], rot[0] + rot[4])
    c, s = math.cos(turn), math.sin(turn)
    x, y, z = c * p[0] + s * p[1], c * p[1] - s * p[0], p[2]
    lead = 2.0 * math.pi * pitch
    ahead = z - pitch * turn
    # Skipped if the pitch is 0, or so small that a turn is below the round-off of z.
    if abs(ahead) < 1e15 * abs(lead):
        turn += 2.0 * math.pi * math.floor(ahead / lead + 0.5)
    return (tilt_x, tilt_y, turn), (x, y, z)
