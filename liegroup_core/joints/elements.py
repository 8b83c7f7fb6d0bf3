# SPDX-License-Identifier: Apache-2.0
"""Constraint elements, of which every joint of a scene is made, and their geometry in NumPy.

    PAIR           a lower pair: constant rows A
    PERPENDICULAR  one row: the parent's x axis stays perpendicular to the child's y axis
    DISTANCE       one row: the origins of the frames keep their distance

A universal joint is a spherical PAIR and a PERPENDICULAR. The rows of the last two kinds depend
on the pose: they are no subgroups, and so not kept exactly, even to ground on SE(3).
"""

import math
from dataclasses import dataclass

import numpy as np

from .distance import distance_residual, distance_row
from .pairs import LOWER_PAIRS, pair_coordinates
from .perpendicular import perpendicular_residual, perpendicular_row

WORLD = -1  # body index that stands for the world
PAIR, PERPENDICULAR, DISTANCE = 0, 1, 2

# Types of scene joints that have a name and two frames, and no parameter.
PLAIN_JOINTS = (*(name for name, pair in LOWER_PAIRS.items() if not pair.has_pitch), "universal")


@dataclass(frozen=True, eq=False)
class Element:
    """One constraint element.

    kind         : PAIR, PERPENDICULAR or DISTANCE
    forbidden    : (k, 6) A of a PAIR; of the others (1, 6), in place of rows that are not constant
    names        : of the rows, what each of them forbids
    turns_freely : PAIR that allows every rotation
    pitch        : m/rad, of a screw
    length       : m, of a DISTANCE
    """

    kind: int
    forbidden: np.ndarray
    names: tuple
    turns_freely: bool = False
    pitch: float = 0.0
    length: float = 0.0


def _pair(name, pitch=0.0):
    pair = LOWER_PAIRS[name]
    return Element(PAIR, pair.forbidden(pitch), pair.coordinates, pair.turns_freely, pitch)


def elements_of(joint, C_rel):
    """Elements of a joint of a scene.

    joint : one of the classes in scene.description.JOINTS
    C_rel : (4, 4) initial pose of the child's joint frame in the parent's one: a distance that the
            scene leaves out is the one there
    """
    if joint.type == "universal":
        return (_pair("spherical"), Element(PERPENDICULAR, np.zeros((1, 6)), ("wn",)))
    if joint.type == "distance":
        length = math.hypot(*C_rel[:3, 3]) if joint.length is None else joint.length
        return (Element(DISTANCE, np.zeros((1, 6)), ("length",), length=length),)
    return (_pair(joint.type, joint.pitch if LOWER_PAIRS[joint.type].has_pitch else 0.0),)


def position_residual(elements, C_rel):
    """How far a relative pose is from what elements allow; zero exactly there.

    elements : tuple of Element
    C_rel    : (4, 4) pose of the child's joint frame in the parent's joint frame
    returns (rows,) in the order of the rows of `forbidden_rows`: rad for angular rows, m for the
    others. Where it vanishes its slope is theirs: d residual = rows V_rel for C_rel exp(V_rel).
    """
    rot, p = tuple(C_rel[:3, :3].ravel().tolist()), tuple(C_rel[:3, 3].tolist())
    parts = [np.zeros(0)]
    for element in elements:
        if element.kind == PERPENDICULAR:
            parts.append([perpendicular_residual(rot)])
        elif element.kind == DISTANCE:
            parts.append([distance_residual(p, element.length)])
        else:
            angular, linear = pair_coordinates(rot, p, element.turns_freely, element.pitch)
            parts.append(element.forbidden @ (*angular, *linear))
    return np.concatenate(parts)


def forbidden_rows(elements, C_rel):
    """Rows (k, 6) of relative twist, in the child's joint frame, that elements forbid at C_rel."""
    rot, p = C_rel[:3, :3], C_rel[:3, 3]
    parts = [np.zeros((0, 6))]
    for element in elements:
        if element.kind == PERPENDICULAR:
            parts.append([(*perpendicular_row(tuple(rot[0].tolist()), (0.0, 1.0, 0.0)), 0, 0, 0)])
        elif element.kind == DISTANCE:
            angular, linear = distance_row((0.0, 0.0, 0.0), tuple((-rot.T @ p).tolist()))
            parts.append([(*angular, *linear)])
        else:
            parts.append(element.forbidden)
    return np.concatenate(parts)
