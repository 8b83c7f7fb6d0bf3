# SPDX-License-Identifier: Apache-2.0
"""Stops and dry friction of a joint, as a scene describes them."""

import math
from typing import Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from liegroup_core.errors import SceneError
from liegroup_core.fields.values import Described, NotNegative, Number, Positive
from liegroup_core.lie.groups import within_a_turn

WITH_STOPS = ("revolute", "prismatic", "screw", "cylindrical")
# Half a turn, reduced by a margin for round-off.
WITHIN_A_TURN = math.pi * (1.0 - 1e-12)


class Stop(Described):
    """Properties of a stop: rigid, or compliant with a stiffness."""

    restitution: NotNegative | None = Field(
        None, description="coefficient of restitution of rigid stops, rebound speed / impact speed, 0 to 1; default 0"
    )
    stiffness: Positive | None = Field(
        None, description="stiffness of compliant stops in N m/rad or N/m; default: rigid stops"
    )
    damping: NotNegative | None = Field(None, description="damping of compliant stops in N m s/rad or N s/m; default 0")

    @model_validator(mode="after")
    def _check(self):
        if self.restitution is not None and self.restitution > 1.0:
            raise SceneError(f"restitution must be at most 1, got {self.restitution:g}", place=("restitution",))
        if self.stiffness is None and self.damping is not None:
            raise SceneError("damping requires a stiffness", place=("damping",))
        if self.stiffness is not None and self.restitution is not None:
            raise SceneError(
                "restitution belongs to rigid stops, stiffness to compliant ones: keep one of them",
                place=("restitution",),
            )
        return self

    def between(self, lower, upper):
        """Limits with these stop properties; None for `lower` or `upper`: no stop at this end."""
        like = {key: getattr(self, key) for key in Stop.model_fields}
        return Limits(lower=lower, upper=upper, **like)


class Limits(Stop):
    """Stops of a joint: rigid ones, or compliant ones with a stiffness."""

    lower: Number | None = Field(
        None, description="least coordinate in m, or in rad, which may exceed 2 pi; default: no stop"
    )
    upper: Number | None = Field(None, description="largest coordinate; default: no stop")

    @model_validator(mode="after")
    def _check_order(self):
        if self.lower is None and self.upper is None:
            raise SceneError("give lower, upper or both")
        if not (self.least < self.largest or self.least == self.largest and self.stiffness):
            raise SceneError(f"lower must be below upper, got {self.lower:g} and {self.upper:g}", place=("lower",))
        return self

    @property
    def expected(self):
        """Reference for unwrapping: an angle is taken within half a turn of this coordinate.

        Angles in (-pi, pi] between the stops then keep their value.
        """
        first, last = self.least + WITHIN_A_TURN, self.largest - WITHIN_A_TURN
        return 0.5 * (first + last) if first > last else min(max(first, 0.0), last)

    def turn_of(self, q, is_angle):
        """The coordinate q; an angle is unwrapped to within half a turn of `expected`."""
        return within_a_turn(q, self.expected) if is_angle else q

    def at_start(self, q):
        """The angle at the start of a scene, rad; q: result of `turn_of`.

        If the stops are less than a turn apart, or both beyond pi or both below -pi, the angle is q. Otherwise it
        is in (-pi, pi], even if only another turn lies between the stops.
        """
        only = self.largest - self.least < 2.0 * math.pi
        only = only or self.least > math.pi or self.largest < -math.pi
        return q if only or abs(q) <= math.pi * (1.0 + 1e-9) else within_a_turn(q)

    def excess(self, q):
        """Distance of a coordinate beyond a stop, rad or m; negative between the stops."""
        return max(self.least - q, q - self.largest)

    @property
    def least(self):
        """Least coordinate, -inf without a lower stop."""
        return -math.inf if self.lower is None else self.lower

    @property
    def largest(self):
        """Largest coordinate, inf without an upper stop."""
        return math.inf if self.upper is None else self.upper


class Friction(Described):
    """Friction of a joint: dry, with stiction, and viscous."""

    coulomb: NotNegative = Field(0.0, description="torque or force of sliding friction in N m or N, opposes the motion")
    static: NotNegative | None = Field(
        None, description="largest friction at rest in N m or N, at least coulomb; default: coulomb"
    )
    viscous: NotNegative = Field(0.0, description="coefficient of viscous friction in N m s/rad or N s/m")
    mu: NotNegative | None = Field(
        None, description="coefficient of sliding friction by load (force across the axis); not for a screw; default 0"
    )
    mu_static: NotNegative | None = Field(
        None, description="coefficient of friction at rest by load, at least mu; default: mu"
    )
    radius: Positive | None = Field(None, description="bearing radius in m; required with mu if the joint rotates")

    @model_validator(mode="after")
    def _check(self):
        if self.static is not None and self.static < self.coulomb:
            raise SceneError(
                f"static must be at least coulomb, got {self.static:g} and {self.coulomb:g}", place=("static",)
            )
        if self.mu_static is not None and self.mu_static < (self.mu or 0.0):
            raise SceneError(
                f"mu_static must be at least mu, got {self.mu_static:g} and {self.mu:g}", place=("mu_static",)
            )
        if self.radius is not None and self.mu is None and self.mu_static is None:
            raise SceneError("radius requires mu", place=("radius",))
        if not self.model_fields_set:
            raise SceneError("give coulomb, static, viscous or mu")
        return self

    @property
    def at_rest(self):
        """Largest constant friction at rest."""
        return self.coulomb if self.static is None else self.static

    def against(self, rate):
        """Effort that a motion takes against sliding and viscous friction, N m or N; rate : rad/s or m/s, any shape."""
        return self.coulomb * np.sign(rate) + self.viscous * rate

    @property
    def by_load(self):
        """(sliding, at rest): friction in N m or N per N of load."""
        lever = 1.0 if self.radius is None else self.radius
        mu = self.mu or 0.0
        return lever * mu, lever * (mu if self.mu_static is None else self.mu_static)


class Cone(Stop):
    """Largest angle between the z axes of both frames of a ball joint."""

    cone: Positive = Field(description="largest angle between the z axes of both joint frames, rad, below pi")

    @model_validator(mode="after")
    def _check_angle(self):
        if not self.cone < math.pi:
            raise SceneError(f"cone must be below pi, got {self.cone:g}", place=("cone",))
        return self


class Backlash(Stop):
    """Backlash of a coupling: free play between two stops, or a spring; and viscous damping."""

    gap: NotNegative | None = Field(
        None,
        description="free play of the coordinate of `joint` in rad or m, half of it on either side; 0 with a "
        "stiffness: a spring, which also pulls; default: without end, for viscous",
    )
    viscous: NotNegative = Field(0.0, description="damping in and beyond the gap, in N m s/rad or N s/m")

    @model_validator(mode="after")
    def _check_gap(self):
        if not (self.gap or (self.stiffness if self.gap == 0.0 else self.viscous and not self.stiffness)):
            text = "gap must be above 0, or 0 with a stiffness, or omitted with viscous alone"
            raise SceneError(f"{text}, got {self.gap}", place=("gap",))
        return self


class _OfBoth(Described):
    """Base of properties of a cylindrical joint: for its rotation, its translation, or both."""

    @model_validator(mode="after")
    def _check(self):
        if self.rotation is None and self.translation is None:
            raise SceneError("give rotation, translation or both")
        return self


class CylinderLimits(_OfBoth):
    """Stops of a cylindrical joint."""

    rotation: Limits | None = Field(None, description="stops of the angle about z")
    translation: Limits | None = Field(None, description="stops of the displacement along z")


class CylinderFriction(_OfBoth):
    """Friction of a cylindrical joint."""

    rotation: Friction | None = Field(None, description="friction of the rotation about z")
    translation: Friction | None = Field(None, description="friction of the translation along z")


# Kinds of the coordinate of a Switch.
TURN, SLIDE, DISTANCE, CONE, BACKLASH = "turn", "slide", "distance", "cone", "backlash"


class Switch(NamedTuple):
    """Coordinate of a mechanism with stops or dry friction.

    name     : of the coupling or joint; for a cylindrical joint JOINT/rotation or JOINT/translation
    kind     : TURN, SLIDE, DISTANCE (of two points), CONE (angle of two axes) or BACKLASH
    limits   : Limits or None;  friction : Friction or None
    joint    : index of the joint, or None;  coupling : index of the coupling, or None
    """

    name: str
    kind: str
    limits: Any
    friction: Any
    joint: int | None = None
    coupling: int | None = None

    @property
    def is_angle(self):
        """True if poses determine the coordinate modulo 2 pi."""
        return self.kind == TURN


def _by_type(usual, **others):
    """Validator of a value whose class depends on the type of its joint."""

    def make(value, info: ValidationInfo):
        cls = others.get(info.data.get("type"), usual)
        return value if value is None or isinstance(value, cls) else cls.model_validate(value)

    return BeforeValidator(make)


limits_of_type = _by_type(Limits, spherical=Cone, cylindrical=CylinderLimits)
friction_of_type = _by_type(Friction, cylindrical=CylinderFriction)


def switches_of_joint(joint):
    """[Switch] of a joint with `limits` and `friction`."""
    limits, friction = joint.limits, joint.friction
    if limits is None and friction is None:
        return []
    if joint.type == "spherical":
        return [Switch(joint.name, CONE, limits and limits.between(None, limits.cone), None)]
    if joint.type != "cylindrical":
        kind = SLIDE if joint.type == "prismatic" else TURN
        return [Switch(joint.name, kind, limits, friction)]
    found = []
    for part, kind in (("rotation", TURN), ("translation", SLIDE)):
        own = getattr(limits, part, None), getattr(friction, part, None)
        if any(own):
            found.append(Switch(f"{joint.name}/{part}", kind, *own))
    return found
