# SPDX-License-Identifier: Apache-2.0
"""What a scene says of every force: the base of the classes of all kinds."""

from typing import ClassVar

from pydantic import Field

from liegroup_core.fields.values import Described, Name


class Force(Described):
    """Force of a scene: between two bodies (`parent`, `child`), at a joint or on one body.

    counts_turns : True: the angle of its joint is counted over many turns (see turn.py)
    joint_moves  : motion about or along z that its joint must allow: "turns", "slides" or None
    """

    counts_turns: ClassVar = False
    joint_moves: ClassVar = None
    name: Name = Field(description="name, unique among joints and forces")
    type: str

    @property
    def is_conservative(self):
        """True if the force has a potential and dissipates nothing."""
        return False
