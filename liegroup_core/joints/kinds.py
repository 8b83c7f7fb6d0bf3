# SPDX-License-Identifier: Apache-2.0
"""All types of joints, and the geometry of their elements.

A lower pair is a file of motion_groups. For a joint whose row depends on the pose, add a file with a
class for the scene and the functions listed in elements.py, and its lines below.
test/contract/test_joints.py tests every type.
"""

from typing import Literal

import numpy as np
from pydantic import Field

from liegroup_core.compiling import kernel
from liegroup_core.fields.values import Number

from . import cone, distance, perpendicular, rolling
from .cable import CableJoint
from .described import JointBase
from .distance import DistanceJoint
from .elements import ELEMENT, PAIR, Element, JointType
from .pairs import LOWER_PAIRS, pair_coordinates, pair_element
from .perpendicular import PERPENDICULAR
from .rolling import KnifeEdge, RollingJoint
from .stops import CONE, DISTANCE, SLIDE, TURN

__all__ = ["CableJoint", "DistanceJoint", "Joint", "ScrewJoint"]

# Types with constraint rows.
CONSTRAINTS = LOWER_PAIRS | {
    "universal": JointType(
        "the frames share their origin; the parent's x axis and the child's y axis are the arms of the cross"
    ),
    "distance": JointType("the origins of the frames keep their distance (rod)"),
}
# Types with rows that forbid velocities only.
ROLLING = {
    "wheel": JointType("a thin disk of the given radius about z rolls on the plane z = 0 of the parent's frame"),
    "ball_on_plane": JointType("a ball of the given radius rolls on the plane z = 0 of the parent's frame"),
    "knife_edge": JointType("the origin of the child's frame has no velocity along its y axis"),
}
TYPES = (
    CONSTRAINTS
    | ROLLING
    | {
        "cable": JointType("the origins of the frames are at most its length apart"),
        "strut": JointType("the origins of the frames are at least its length apart"),
    }
)
# {kind of a Switch: element whose residual is its coordinate}
COORDINATES = {
    TURN: Element(PAIR, ("wz",), np.eye(6)[2:3]),
    SLIDE: Element(PAIR, ("vz",), np.eye(6)[5:]),
    DISTANCE: Element(distance.KIND, ("length",), np.eye(6)[3:]),
    CONE: cone.CONE_ANGLE,
}
# Types without a parameter, and types with a pitch.
PLAIN = (*(name for name, pair in LOWER_PAIRS.items() if not pair.has_pitch), "universal")
THREADED = tuple(name for name, pair in LOWER_PAIRS.items() if pair.has_pitch)


class Joint(JointBase):
    """Joint without a parameter: a lower pair, or a universal joint."""

    type: Literal[PLAIN] = Field(description=f"kind of joint: {', '.join(PLAIN[:-1])} or {PLAIN[-1]}")

    def elements(self, C_rel):
        """One lower pair; for a universal joint also the row that keeps the axes of its cross perpendicular."""
        if self.type == "universal":
            return pair_element("spherical"), PERPENDICULAR
        return (pair_element(self.type),)


class ScrewJoint(JointBase):
    """Screw joint: rotation about z moves the child along z."""

    type: Literal[THREADED] = Field("screw", description=" or ".join(THREADED))
    pitch: Number = Field(description="displacement along z in m per radian, positive for a right-handed thread")

    def elements(self, C_rel):
        """One lower pair."""
        return (pair_element(self.type, self.pitch),)


JOINTS = (Joint, ScrewJoint, DistanceJoint, CableJoint, RollingJoint, KnifeEdge)


@kernel
def variable_row(element, rot, p, w, v):
    """Row of an element other than a PAIR, and its rate; see `row` in the file of its kind."""
    if element["kind"] == perpendicular.KIND:
        return perpendicular.row(element, rot, p, w, v)
    if element["kind"] == cone.KIND:
        return cone.row(element, rot, p, w, v)
    if element["kind"] >= rolling.FIRST:
        return rolling.row(element, rot, p, w, v)
    return distance.row(element, rot, p, w, v)


@kernel
def variable_residual(kind, rot, p, parameter):
    """Position residual of an element other than a PAIR.

    rot, p : pose of the child's joint frame in the parent's
    """
    if kind == perpendicular.KIND:
        return perpendicular.residual(rot, p, parameter)
    if kind == cone.KIND:
        return cone.residual(rot, p, parameter)
    if kind >= rolling.FIRST:
        return rolling.residual(kind, rot, p, parameter)
    return distance.residual(rot, p, parameter)


def position_residual(elements, C_rel):
    """Position residual of a relative pose; zero exactly where the elements allow this pose.

    elements : tuple of Element
    C_rel    : (4, 4) pose of the child's joint frame in the parent's joint frame
    returns (rows,) in the order of the rows of `forbidden_rows`: rad for angular rows, m for the
    others. Where it vanishes, these rows are its derivative: d residual = rows V_rel for C_rel exp(V_rel).
    """
    rot, p = tuple(C_rel[:3, :3].ravel().tolist()), tuple(C_rel[:3, 3].tolist())
    parts = [np.zeros(0)]
    for element in elements:
        if element.kind == PAIR:
            angular, linear = pair_coordinates(rot, p, element.turns_freely, element.parameter)
            parts.append(element.forbidden @ (*angular, *linear))
        else:
            parts.append([variable_residual(element.kind, rot, p, element.parameter)])
    return np.concatenate(parts)


def forbidden_rows(elements, C_rel):
    """Rows (k, 6) of relative twist, in the child's joint frame, that elements forbid at C_rel."""
    still = (0.0, 0.0, 0.0)
    rot = tuple(C_rel[:3, :3].T.ravel().tolist())
    p = tuple((-C_rel[:3, :3].T @ C_rel[:3, 3]).tolist())
    parts = [np.zeros((0, 6))]
    for element in elements:
        if element.kind == PAIR:
            parts.append(element.forbidden)
        else:
            record = np.array([element.record()], dtype=ELEMENT)[0]
            angular, linear, _ = variable_row(record, rot, p, still, still)
            parts.append([(*angular, *linear)])
    return np.concatenate(parts)
