# SPDX-License-Identifier: Apache-2.0
"""Rotor of a joint, of a motor behind a gear: an inertia that moves with the joint's coordinate q.

With the inertia I and the gear ratio c, the rotor turns by c q. Its kinetic energy is c^2 I qdot^2 / 2, so the joint
needs an effort of c^2 I qddot more. What else a turning rotor does, as a gyroscope, is not part of it: the field's
"reflected inertia" (MuJoCo's armature, Drake's rotor inertia and gear ratio).

In the articulated body of the joint's link, see dynamics/trees.py, c^2 I adds to D of the degree of freedom. Other
methods add the effort -c^2 I qddot as a pair of wrenches on both links.

Source: Featherstone, Rigid Body Dynamics Algorithms, section 9.6 (gears).
"""

from pydantic import BeforeValidator, Field, ValidationInfo

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import Described, Number, Positive

WITH_ROTOR = ("revolute", "prismatic", "screw")


class Rotor(Described):
    """Inertia that turns with a joint, through a gear."""

    inertia: Positive = Field(description="moment of inertia of the rotor about its axis, kg m^2")
    ratio: Number = Field(
        1.0,
        description="turns of the rotor in a turn of the joint, or rad/m for a joint that does not rotate; default 1",
    )

    @property
    def reflected(self):
        """c^2 I: kg m^2, or kg for a joint that does not rotate."""
        return self.ratio**2 * self.inertia


def _of_type(value, info: ValidationInfo):
    """Refuse a rotor at a joint without exactly one coordinate, before its own checks."""
    kind = info.data.get("type")
    if value is not None and kind is not None and kind not in WITH_ROTOR:
        raise SceneError(f"a rotor needs a joint with one coordinate: {', '.join(WITH_ROTOR)}; this one is {kind}")
    return value


rotor_of_type = BeforeValidator(_of_type)
