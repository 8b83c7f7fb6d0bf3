# SPDX-License-Identifier: Apache-2.0
"""Base class of inputs with joint names: joints of a scene, checks of names and limits."""

import functools
from typing import NamedTuple

from liegroup_core.fields.values import suggestion
from liegroup_core.forces.kinds import servos
from liegroup_core.joints.limits import BeyondLimits
from liegroup_sim_ros.messages.commands import joint_labels

from .counted_input import LONGEST_NAME, CountedInput

# Reasons of refusals of all inputs with joint names.
OF_JOINTS = ("not_finite", "wrong_length", "unknown_joint", "no_coordinate", "repeated_joint", "no_servo")


class Jumps(NamedTuple):
    """Limit on the distance between a commanded position and the present position of its joint.

    most      : largest distance, rad or m
    positions : {joint of the scene: present position}; empty if they are not known: then all commands are refused
    period    : s, during which a trajectory may move a joint by `most`
    """

    most: float
    positions: dict
    period: float


class JointInput(CountedInput):
    """Counter of messages with names of joints of a scene.

    layout  : Layout
    present : SimulationServer, or an object with its `check`, `check_motion` and `check_jump`; None: limits
              are not checked for motions of driven joints and jumps of servos
    Other arguments are those of CountedInput.

    joints     : {name in messages: joint of the scene} of the joints with one coordinate
    servos     : {name in messages: whether its servo needs a target position}, without those that laws lead
    driven     : names in messages of the driven joints
    most_names : largest number of names in a message
    limits     : {joint of the scene: Limits}
    """

    def __init__(self, what, counted, reasons, layout, present=None):
        super().__init__(what, counted, reasons)
        scene, names = layout.scene, layout.coordinates.names
        self.limits, self._present = layout.limits, present
        self.joints = dict(zip(joint_labels(names, scene.robot), names))
        self._others = set(joint_labels([joint.name for joint in scene.joints], scene.robot))
        if scene.robot is not None:
            self._others |= scene.robot.still.keys()
        self._others -= self.joints.keys()
        self.most_names = len(self.joints) + len(self._others)
        found = [servo for servo in servos(scene.forces) if servo.joint not in layout.leaders]
        labels = joint_labels([servo.joint for servo in found], scene.robot)
        self.servos = {label: servo.stiffness > 0.0 for label, servo in zip(labels, found)}
        self.driven = {name for name, joint in self.joints.items() if joint in layout.motions}
        shown = dict(zip(names, joint_labels(names, scene.robot)))
        rigid = [c for c in scene.couplings if c.joint in shown and not c.backlash]
        self._leaders = {shown[c.joint]: shown.get(c.other, c.other) for c in rigid}
        self._laws = {shown[joint]: law for joint, law in layout.leaders.items() if joint in shown}

    @property
    def follows(self):
        """Whether any joint can follow a trajectory: it is driven, or has a servo with stiffness."""
        return any(self.servos.values()) or bool(self.driven)

    def no_servo(self, name, text):
        """Refuse a position or velocity for a joint without a servo; text : what it lacks. Raises Refusal."""
        if law := self._laws.get(name):
            self.refuse("no_servo", lambda: f"{name} follows the law {law}, whose output is the target of its servo")
        leader = self._leaders.get(name)
        advice = f"it follows {leader}: command that joint" if leader else "change the scene"
        self.refuse("no_servo", lambda: f"{name} {text}: {advice}")

    def check_names(self, names):
        """Refuse unknown and repeated names, and joints without one coordinate. Raises Refusal."""
        for name in names:
            if name in self.joints:
                continue
            hint = functools.partial(suggestion, name[:LONGEST_NAME], list(self.joints))
            if name in self._others:
                self.refuse(
                    "no_coordinate",
                    lambda: f"joint {name!r:.{LONGEST_NAME}} is fixed, or has more than one coordinate; {hint()}",
                )
            self.refuse("unknown_joint", lambda: f"unknown joint {name!r:.{LONGEST_NAME}}; {hint()}")
        if len(set(names)) < len(names):
            self.refuse("repeated_joint", lambda: "a joint occurs twice; give each joint once")

    def refuse_beyond_limits(self, check, *arguments):
        """Refuse the message if `check(*arguments)` raises BeyondLimits. Raises Refusal."""
        try:
            check(*arguments)
        except BeyondLimits as error:
            text = str(error)
            self.refuse("beyond_limits", lambda: text)

    def refuse_late(self, text):
        """Count a command that was accepted, but cannot be followed when it starts. Raises Refusal."""
        self.refuse("beyond_limits", lambda: text)

    def refuse_jump(self, name, before, after, most):
        """Refuse a commanded position that is too far from the previous position. Raises Refusal."""
        if not abs(after - before) <= most:
            unit = self.limits[self.joints[name]].unit
            self.refuse(
                "jump_too_large",
                lambda: (
                    f"it moves {name} from {before:.6g} to {after:.6g} {unit}, by more than {most:.6g} "
                    f"{unit} at once (parameter command_jump): approach it in smaller steps"
                ),
            )
