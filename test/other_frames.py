# SPDX-License-Identifier: Apache-2.0
"""Scenes with body frames away from the centres of mass."""

import numpy as np


def described_elsewhere(scene, com):
    """Same mechanism with centres of mass at com[name] in the body frames.

    Follows the meaning of the keys: everything in a body's frame is shifted by the offset.
    """
    com = com | {"world": np.zeros(3)}

    def moved(link):
        update = {}
        for end in ("parent", "child"):
            offset = com.get(getattr(link, end, None))
            frame, point = (getattr(link, f"{end}_{what}", None) for what in ("frame", "point"))
            if frame is not None:
                update[f"{end}_frame"] = frame.remade(position=frame.position + offset)
            if point is not None:
                update[f"{end}_point"] = point + offset
        if hasattr(link, "point"):
            update["point"] = link.point + com[link.body]
        return link.remade(**update)

    bodies = []
    for body in scene.bodies:
        c = com[body.name]
        bodies.append(
            body.remade(
                com=c,
                position=body.position - body.rotation @ c,
                linear_velocity=body.linear_velocity - np.cross(body.angular_velocity, c),
            )
        )
    return scene.remade(
        bodies=bodies, joints=[moved(joint) for joint in scene.joints], forces=[moved(force) for force in scene.forces]
    )
