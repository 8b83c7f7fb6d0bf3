# SPDX-License-Identifier: Apache-2.0
"""Constraint elements, of which every joint consists.

A PAIR is a lower pair, constant rows A. Every other kind is one row that depends on the pose; a
joint with two such rows has two kinds. Such a row belongs to no subgroup of SE(3), so integration on
SE(3) does not satisfy it exactly, even for a joint to the world. The file of a kind has

    KIND                         number of the kind, the next free one after those of kinds.py
    row(element, rot, p, w, v)   row of the child, and its rate times the relative twist
    residual(rot, p, parameter)  position residual

and kinds.py calls these.
"""

from dataclasses import dataclass

import numpy as np

WORLD = -1  # body index that stands for the world
PAIR = 0  # kind of a lower pair

ELEMENT = np.dtype(
    [
        ("kind", "i8"),
        ("parent", "i8"),
        ("child", "i8"),  # body index; the parent may be WORLD
        ("rows", "i8"),
        ("row_start", "i8"),  # number of rows, and index of the first one in a residual
        ("parent_rotation", "f8", (9,)),
        ("parent_point", "f8", (3,)),  # joint frame in the parent, m
        ("child_rotation", "f8", (9,)),
        ("child_point", "f8", (3,)),  # joint frame in the child, m
        ("forbidden", "f8", (36,)),
        ("turns_freely", "i8"),
        ("parameter", "f8"),  # see Element
    ],
    align=True,
)


@dataclass(frozen=True, eq=False)
class Element:
    """One constraint element.

    kind         : PAIR, or KIND of another file
    names        : for each row, the name of what it forbids
    forbidden    : (k, 6) A of a PAIR; for another kind, directions that span its row
    turns_freely : True for a PAIR that allows all rotations
    parameter    : pitch of a screw in m/rad, length of a distance in m, or the parameter of another kind
    """

    kind: int
    names: tuple
    forbidden: np.ndarray
    turns_freely: bool = False
    parameter: float = 0.0

    def record(self, parent=WORLD, child=0, row_start=0, F_a=np.eye(4), F_b=np.eye(4)):
        """Values of ELEMENT between two bodies; F_a, F_b: (4, 4) joint frames in the body frames."""
        forbidden = np.zeros(36)
        forbidden[: self.forbidden.size] = self.forbidden.ravel()
        return (
            self.kind,
            parent,
            child,
            len(self.names),
            row_start,
            F_a[:3, :3].ravel(),
            F_a[:3, 3],
            F_b[:3, :3].ravel(),
            F_b[:3, 3],
            forbidden,
            self.turns_freely,
            self.parameter,
        )


@dataclass(frozen=True)
class JointType:
    """Properties of a joint type that other packages use.

    text       : motion that the joint allows, for readers of the code
    turns      : the z axes stay parallel and the child rotates about z; torques about z can act
    slides     : the z axes coincide and the child translates along z; forces along z can act
    coordinate : "rad" or "m", the unit of the joint coordinate about or along z, "rad" of a screw; None if the
                 joint has not exactly one degree of freedom
    """

    text: str
    turns: bool = False
    slides: bool = False
    coordinate: str | None = None

    @property
    def rate(self):
        """Component of the relative twist that is the joint's `rate` in a scene, or None."""
        return 2 if self.turns else 5 if self.slides else None
