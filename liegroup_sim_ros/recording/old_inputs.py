# SPDX-License-Identifier: Apache-2.0
"""Inputs of recordings up to version 0.2: total wrenches on a body in some axes, as Commands.

Such a recording has geometry_msgs/WrenchStamped with the frame_id BODY (body axes), world/BODY (world axes), and
world_x/BODY, world_y/BODY, world_z/BODY: a force at the point 1 m along this axis of the body frame, and its
opposite at the origin. A total becomes the wrench of a source with the name of its axes. The two forces of a couple
become two sources, whose names come first in the order of their addition, so that they cancel exactly.
"""

from liegroup_core.forces.commands import WRENCH, Command

LEVERS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
AXES = ("body", "world", *(f"world_{k}" for k in LEVERS))


def frames(bodies, prefix, world):
    """{frame_id: (body, axes)} of total wrenches on these bodies."""
    names = {}
    for body in bodies:
        for axes in AXES:
            names[prefix + body if axes == "body" else f"{world}{axes[len('world') :]}/{prefix}{body}"] = body, axes
    return names


def commands(body, axes, wrench):
    """[Command] of a total wrench (6,) from time 0 on."""
    if axes in ("body", "world"):
        return [Command(WRENCH, body, tuple(wrench), 0, None, axes, axes)]
    force = wrench[3:]
    back = tuple(-component for component in force)
    lever = axes[len("world_") :]
    return [
        Command(WRENCH, body, (0.0, 0.0, 0.0, *force), 0, None, f"pair_{lever}+", "world", LEVERS[lever]),
        Command(WRENCH, body, (0.0, 0.0, 0.0, *back), 0, None, f"pair_{lever}-", "world"),
    ]
