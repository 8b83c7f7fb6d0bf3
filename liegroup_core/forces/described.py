# SPDX-License-Identifier: Apache-2.0
"""Keys that all forces of a scene share: the base of all force classes."""

from typing import ClassVar

from pydantic import Field

from liegroup_core.fields.values import Described, Name


class Force(Described):
    """Force of a scene: between two bodies (`parent`, `child`), at a joint or on one body.

    joint_moves : motion about or along z that its joint must allow: "turns", "slides" or None
    group       : of a force with such a joint, that of its power: "dampers", "motors" or "servos"
    """

    joint_moves: ClassVar = None
    group: ClassVar = None
    name: Name = Field(description="name, unique among joints and forces")
    type: str

    @property
    def is_conservative(self):
        """True if the force has a potential and dissipates nothing."""
        return False
