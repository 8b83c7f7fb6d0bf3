# SPDX-License-Identifier: Apache-2.0
"""Wrench messages: decoding and validation of WrenchStamped on the wrench topics.

On ~/wrench and ~/wrench/persistent, frame_id is the body, and components are in its axes. It may also
be a link that the import has merged into a body: then axes and origin are those of the link. On
~/BODY/wrench, frame_id gives the axes: those of the body or of the world. The frame id of a body is
the node's prefix and its name. Torques are about the origin of the body frame. A name after a
slash, as in `top/left`, distinguishes publishers of one topic. Wrenches of different topics and
names add up; a wrench replaces the previous one of the same topic and name.

On ~/pull, a point in world axes is where the origin of the body in frame_id is pulled by a spring, see read_pull.

A wrench starts at its stamp if that is in the future, else with the next step. A message is
accepted or refused as a whole; refusals are counted by reason.
"""

import math

import numpy as np

from liegroup_core.fields.values import suggestion
from liegroup_core.forces.commands import PULL, WRENCH, Command
from liegroup_sim_ros.messages.codecs import PointStampedCodec, WrenchStampedCodec

from .counted_input import LONGEST_NAME, CountedInput, bounded

FREQUENCY, DAMPING = 1.0, 0.7  # of a pull: Hz of the mass of its body, and part of critical damping
REASONS = ("not_finite", "no_frame", "unknown_frame", "stamp_too_far", "too_many", "damaged")


def source_prefix(kind, target):
    """Common prefix of the names of all sources of one topic for a body, or for BODY/NAME."""
    return f"{kind}/{target}/" if target else f"{kind}/"


class WrenchInput(CountedInput):
    """Decoder and counter of wrench messages.

    bodies       : names of the bodies
    masses       : {body: kg}, for pulls
    world_frame  : frame id of the world
    frame_prefix : prefix of the frame ids of the bodies
    links        : {body: its link in a robot file}, second names of the frames
    merged       : {link: (its body, (4, 4) pose in the body frame)} of other links
    """

    def __init__(self, bodies, world_frame, frame_prefix="", links=None, merged=None, masses=None):
        self._bodies, self._masses = {name: name for name in bodies}, masses
        self._named = {link: body for body, link in (links or {}).items() if body in self._bodies}
        self._named |= self._bodies
        self._merged = merged or {}
        super().__init__("wrench", "wrenches", REASONS)
        self._world_frame, self._prefix = world_frame, frame_prefix

    def read(self, payload, kind, body, now_ns, held):
        """Command of a serialized WrenchStamped. Raises Refusal.

        kind   : of the topic: "wrench" or "wrench/NAME", "persistent", "body"
        body   : body of the topic, None if frame_id gives it
        now_ns : current stamp
        held   : number of wrenches that act now or start later
        """
        start_ns, frame_id, wrench = self.decoded(WrenchStampedCodec.decode_one, payload)
        axes = "body"
        target, name = self.body_and_name(frame_id)
        if body is not None and target != body and f"{frame_id}/".startswith(f"{self._world_frame}/"):
            axes, target, name = "world", body, frame_id[len(self._world_frame) + 1 :]
        if not frame_id.partition("/")[0]:
            self.refuse("no_frame", lambda: "frame_id is empty; " + self._frames(body))
        if target is None or body not in (None, target):
            self.refuse(
                "unknown_frame", lambda: f"unknown frame_id {frame_id[:LONGEST_NAME]!r}; {self._frames(body, frame_id)}"
            )
        if len(name) > LONGEST_NAME:
            self.refuse(
                "unknown_frame",
                lambda: (
                    f"frame_id {frame_id[:20]!r}...: the name after the slash has more than {LONGEST_NAME} characters"
                ),
            )
        if not bounded(wrench):
            self.refuse("not_finite", lambda: f"for {target}: a component is NaN or infinite, or too large")
        self.refuse_far_stamp(start_ns, now_ns, target)
        self.refuse_too_many(held, target)
        if axes == "body":
            wrench = self._at_body(frame_id, wrench)
        self.accepted += 1
        source = source_prefix(kind, f"{target}/{name}" if name else target)
        return Command(WRENCH, target, wrench, start_ns if start_ns > now_ns else None, None, source, axes)

    def read_pull(self, payload, now_ns, held):
        """Command of a serialized PointStamped on ~/pull; arguments as of `read`. Raises Refusal.

        frame_id is a body, and the point, in world axes, is where its origin, or that of its link, is pulled.
        """
        start_ns, frame_id, to = self.decoded(PointStampedCodec.decode_one, payload)
        target, name = self.body_and_name(frame_id)
        if target is None:
            self.refuse("unknown_frame", lambda: f"~/pull: {frame_id[:LONGEST_NAME]!r}; {self._frames(None, frame_id)}")
        if not bounded(to):
            self.refuse("not_finite", lambda: f"~/pull for {target}: a component is NaN or infinite, or too large")
        self.refuse_far_stamp(start_ns, now_ns, target)
        self.refuse_too_many(held, target)
        self.accepted += 1
        link = frame_id[len(self._prefix) :].partition("/")[0]
        point = None if link in self._named else tuple(self._merged[link][1][:3, 3].tolist())
        omega = 2.0 * math.pi * FREQUENCY
        stiffness = self._masses[target] * omega**2
        values = (stiffness, 2.0 * DAMPING * omega * self._masses[target], *to, 0.0, 0.0, 0.0, 0.0)
        source, start = source_prefix("pull", f"{target}/{name}" if name else target), start_ns
        return Command(PULL, target, values, start if start > now_ns else None, None, source, point=point)

    def refuse_clear(self, text):
        """Count a ~/wrench/clear with an unknown body. Raises Refusal."""
        self.refuse(
            "unknown_frame",
            lambda: (
                f"~/wrench/clear: unknown body {text[:LONGEST_NAME]!r}; give none for all bodies, or "
                f"{self._frames(None, text)}"
            ),
        )

    def body_and_name(self, frame_id):
        """(body, name of the publisher) in a frame id; (None, "") if it contains no body.

        A merged link counts as a publisher of its own.
        """
        if frame_id.startswith(self._prefix):
            body, _, name = frame_id[len(self._prefix) :].partition("/")
            if body in self._named:
                return self._named[body], name
            if body in self._merged:
                return self._merged[body][0], f"({body})/{name}" if name else f"({body})"
        return None, ""

    def _at_body(self, frame_id, wrench):
        """Wrench (6,) in the axes and about the origin of the body's frame."""
        link = frame_id[len(self._prefix) :].partition("/")[0]
        if link in self._named:
            return wrench
        place = self._merged[link][1]
        torque, force = (place[:3, :3] @ np.array(part) for part in (wrench[:3], wrench[3:]))
        return (*(torque + np.cross(place[:3, 3], force)).tolist(), *force.tolist())

    def _frames(self, body, wrong=""):
        names = [body] if body else dict.fromkeys((*self._bodies, *self._named, *self._merged))
        frames = [f"{self._prefix}{name}" for name in names] + [self._world_frame] * bool(body)
        return suggestion(wrong[:LONGEST_NAME], frames)
