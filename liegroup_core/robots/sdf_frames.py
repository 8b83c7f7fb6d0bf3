# SPDX-License-Identifier: Apache-2.0
"""Frames of SDF models: poses relative to other frames, names of nested models.

Source: http://sdformat.org, Pose Frame Semantics. Without relative_to, a link, a frame or a nested
model is relative to its model, and a joint to its child link. A name `a::b` is b in the nested model a.
"""

import numpy as np

from liegroup_core.lie.groups import SE3, SO3

from .description import WORLD, place

MODEL_FRAMES = ("__model__", "world")


class SdfModel:
    """Model or world with its named parts; the frame of a world does not move.

    name   : full name with the names of the enclosing models: outer::inner
    frames : {name: element} of links, joints, frames and nested models
    nested : {name: SdfModel}
    """

    def __init__(self, reader, element, name, outer=None, is_world=False):
        self.reader, self.element, self.name, self.outer = reader, element, name, outer
        self.is_world = is_world
        self.frames, self.nested, self._known, self._open = {}, {}, {}, []
        for part in element:
            if part.tag in ("link", "joint", "frame", "model"):
                own = reader.name(part)
                if own in self.frames:
                    raise reader.error(
                        part,
                        f'"{own}" is defined twice in "{name or element.get("name")}", first on line '
                        f"{self.frames[own].sourceline}: rename one",
                    )
                self.frames[own] = part

    def full(self, name):
        """Full name, in the robot, of a link of this model."""
        return f"{self.name}::{name}" if self.name else name

    def split(self, name, element):
        """(model, name in this model) for a name such as a::b, which may be in a nested model."""
        head, separator, rest = name.partition("::")
        if separator and head in self.nested:
            return self.nested[head].split(rest, element)
        if name not in self.frames:
            raise self.reader.unknown(element, "frame", name, self.frames)
        return self, name

    def pose(self, name, element):
        """(4, 4) pose of a frame in the frame of this model."""
        if name in MODEL_FRAMES:
            return np.eye(4)
        model, own = self.split(name, element)
        found = model._pose(own, element)
        while model is not self:
            found = model.placed() @ found
            model = model.outer
        return found

    def place_in(self, element, part):
        """(4, 4) pose of a part of a link or joint, such as a sensor, in the frame of this element."""
        raw, base = read_pose(self.reader, part)
        name = element.get("name")
        if base in (None, name):
            return raw
        return SE3.inverse(self.pose(name, part)) @ self.pose(base, part) @ raw

    def placed(self):
        """(4, 4) pose of this nested model in the enclosing model."""
        return self.outer._pose(self.element.get("name"), self.element)

    def _pose(self, name, element):
        if name in self._known:
            return self._known[name]
        if name in self._open:
            raise self.reader.error(element, f"poses are relative to each other in a circle: {' -> '.join(self._open)}")
        self._open.append(name)
        part = self.frames[name]
        raw, base = read_pose(self.reader, part)
        if not base:
            base = {"joint": text_of(part, "child"), "frame": part.get("attached_to")}.get(part.tag)
            base = None if base == WORLD else base
        found = (self.pose(base, part) if base else np.eye(4)) @ raw
        if part.tag == "model" and part.get("placement_frame"):
            inner = self.nested[name]
            found = found @ SE3.inverse(inner.pose(part.get("placement_frame"), part))
        self._open.pop()
        self._known[name] = found
        return found

    def link_of(self, name, element):
        """Full name of the link that a frame is attached to, or world."""
        seen = []
        model, own = self, name
        while True:
            if own == WORLD:
                return WORLD
            if own == "__model__":
                if model.is_world:
                    return WORLD
                own = next((n for n, part in model.frames.items() if part.tag == "link"), None)
                if own is None:
                    raise self.reader.error(element, f'the model "{model.name}" has no link')
            model, own = model.split(own, element)
            part = model.frames[own]
            if part.tag == "link":
                return model.full(own)
            if (model, own) in seen:
                raise self.reader.error(element, f'frame "{name}" is attached to itself')
            seen.append((model, own))
            if part.tag == "model":
                model, own = model.nested[own], "__model__"
            elif part.tag == "joint":
                own = text_of(part, "child") or "__model__"
            else:
                own = part.get("attached_to") or "__model__"


def read_pose(reader, element):
    """(pose (4, 4), name of the frame that it is relative to or None) from the <pose> of an element."""
    pose = element.find("pose")
    if pose is None:
        return np.eye(4), None
    base = pose.get("relative_to") or pose.get("frame") or None
    text = pose.text
    if text is None or not text.strip():
        return np.eye(4), base
    if pose.get("rotation_format") == "quat_xyzw":
        numbers = reader.numbers(pose, text, 7, "<pose>")
        length = np.linalg.norm(numbers[3:])
        if not length > 1e-12:
            raise reader.error(pose, "the quaternion of <pose> must not be zero")
        return place(numbers[:3], SO3.from_quaternion(numbers[3:] / length)), base
    numbers = reader.numbers(pose, text, 6, "<pose>")
    if pose.get("degrees") in ("true", "1"):
        numbers[3:] = np.radians(numbers[3:])
    return reader.pose_of(numbers), base


def text_of(element, key):
    """Text of a child element without blanks, or None."""
    found = element.find(key)
    return None if found is None or not found.text or not found.text.strip() else found.text.strip()
