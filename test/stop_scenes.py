# SPDX-License-Identifier: Apache-2.0
"""Scenes with stops and friction that several tests use."""

import numpy as np
import yaml
from scene_files import text_of

from liegroup_core.scene.load import scene_from_text

# Slider-crank whose ram has a stop and whose main bearing has friction.
PRESS = text_of("press.yaml")


def chain(seed, joints, floating):
    """Random tree of hinges and slides with stops, most of them with friction.

    floating : True: in space, tumbling; False: held by the world, falling
    """
    rng = np.random.default_rng(seed)
    bodies, links = [], []
    for i in range(joints + 1):
        bodies.append(
            {
                "name": f"b{i}",
                "mass": float(rng.uniform(0.5, 2.0)),
                "inertia": [0.02, 0.03, 0.025],
                "position": [0.3 * i, 0.0, 0.0],
            }
        )
        if i == 0:
            continue
        size = 1.0 if rng.random() < 0.8 else 0.2
        joint = {
            "name": f"j{i}",
            "type": "revolute" if size == 1.0 else "prismatic",
            "parent": f"b{i - 1 if rng.random() < 0.8 else int(rng.integers(i))}",
            "child": f"b{i}",
            "child_frame": {"position": [-0.3, 0.0, 0.0], "rotation_vector": rng.uniform(-1.5, 1.5, 3).tolist()},
            "limits": {
                "lower": float(-rng.uniform(0.2, 1.0) * size),
                "upper": float(rng.uniform(0.2, 1.0) * size),
                "restitution": float(rng.choice([0.0, 0.3, 0.8])),
            },
        }
        if rng.random() < 0.7:
            coulomb = float(rng.uniform(0.01, 0.5)) * (0.1 if floating else 10.0)
            joint["friction"] = {"coulomb": coulomb, "static": coulomb * float(rng.uniform(1, 1.5))}
        links.append(joint)
    if floating:
        # As one rigid body: all joints are at rest at the start.
        spin, at = np.array([2.0, 3.0, -4.0]), np.array([0.0, 0.1, 0.2])
        for body in bodies:
            body["angular_velocity"] = spin.tolist()
            body["linear_velocity"] = (at + np.cross(spin, body["position"])).tolist()
    else:
        hinge = {"name": "j0", "type": "revolute", "parent": "world", "child": "b0"}
        links.append(hinge | {"child_frame": {"axis": [0.1, 1.0, 0.2]}})
    gravity = [0.0, 0.0, 0.0 if floating else -9.81]
    scene = {"name": "chain", "gravity": gravity, "bodies": bodies, "joints": links}
    return scene_from_text(yaml.safe_dump(scene))
