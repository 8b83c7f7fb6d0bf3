# SPDX-License-Identifier: Apache-2.0
"""Couplings: relations of joint coordinates, for gears, belts, racks, cams, differentials and mimic joints.

    q_joint = ratio q_other + a_2 q_other^2 + a_3 q_other^3 + a_4 q_other^4 + sum_k c_k q_k + offset

q is the angle of a revolute or screw joint about z, or the displacement of a prismatic joint along z.
A coupling transmits a torque or force lambda to `joint` and -(d q_joint / d q_k) lambda to the others, so
it does no work. Its row acts on the rates of the spanning tree, see dynamics/couplings.py. The groups of rigid
bodies have no such row.

Poses determine angles modulo 2 pi. Those of all but `joint` are unwrapped like that of a torsional spring
(forces/axis.py). The turns of `joint` follow from the relation; with backlash its angle is unwrapped, too.
"""

import math

from pydantic import Field

from liegroup_core.fields.values import Curve, Described, Name, Number, Text
from liegroup_core.lie.groups import SE3, UNKNOWN_TURN, within_a_turn

from .kinds import TYPES
from .stops import BACKLASH, Backlash, Friction, Switch

# Types of joints that can be coupled: those with exactly one coordinate.
COUPLED = ("revolute", "prismatic", "screw")


class Coupling(Described):
    """Relation of the coordinates of two or more joints."""

    name: Name = Field(description="name, unique among joints, couplings and forces")
    joint: Text = Field(description="name of a revolute, prismatic or screw joint")
    other: Text = Field(description="name of another such joint; the two need not share a body")
    ratio: Number = Field(
        description="ratio r of q_joint = r q_other + offset; for example -0.5 for a gear pair where "
        "joint has twice the teeth; in m/rad for a rack"
    )
    curve: Curve = Field(
        (),
        description="coefficients [a2, a3, a4], or fewer, of the further terms a2 q_other^2 + a3 q_other^3 + "
        "a4 q_other^4, for a cam; default: none",
    )
    terms: dict[Text, Number] = Field(
        {},
        description="further joints {joint: c}, of which q_joint has the terms c q; for example the ring of a "
        "planetary gear, beside sun and carrier; default: none",
    )
    offset: Number | None = Field(None, description="offset in rad or m; default: computed from the initial poses")
    backlash: Backlash | None = Field(
        None, description="backlash: the relation holds within a gap, or by a spring; default: it is rigid"
    )

    @property
    def others(self):
        """Names of all joints but `joint`."""
        return (self.other, *self.terms)

    @property
    def counted(self):
        """Names of the joints whose angles are unwrapped."""
        return (self.joint, *self.others) if self.backlash else self.others

    @property
    def switches(self):
        """[Switch]: violation of the relation, if the coupling has backlash."""
        if self.backlash is None:
            return []
        gap, viscous = self.backlash.gap, self.backlash.viscous
        limits = None if gap is None else self.backlash.between(0.0 - 0.5 * gap, 0.5 * gap)
        return [Switch(self.name, BACKLASH, limits, Friction(viscous=viscous) if viscous else None)]


def turns(joint):
    """True if the coordinate of a joint of the scene is an angle."""
    return TYPES[joint.type].turns


def coordinate(joint, C_rel):
    """Coordinate of a joint, rad in (-pi, pi] or m; C_rel: see consistency.py."""
    if turns(joint):
        angle = math.atan2(C_rel[1, 0] - C_rel[0, 1], C_rel[0, 0] + C_rel[1, 1])
        return within_a_turn(angle, UNKNOWN_TURN)
    return float(C_rel[2, 3])


def difference(first, second, turned):
    """first - second; if `turned`, the value modulo 2 pi that is nearest to 0."""
    return within_a_turn(first - second) if turned else first - second


def gap(coupling, at, turned):
    """Violation of a resolved coupling by coordinates {joint: q}; turned: of `difference`."""
    return difference(at[coupling.joint] - coupling.rise(at), coupling.offset, turned)


def rate_row(joint, F_b):
    """Row (6,) of the rate of a joint; it multiplies the relative twist in the child's body frame."""
    return SE3.Ad(SE3.inverse(F_b))[TYPES[joint.type].rate]
